"""The firmware's side of the `trigpoint` protocol, as a model for real ones and for simulation."""
