"""Simulated robots on a serial line: encoders, and the boards that speak for them."""
