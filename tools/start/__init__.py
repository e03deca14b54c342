"""`trigpoint start`: asks what one has, and strings the other commands together."""
