"""How well a robot would be corrected where, by the cameras that see it there."""
