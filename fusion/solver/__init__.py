"""Least squares over everything, and what a solution knows, carried on."""
