"""`trigpoint coverage`: how well robots are corrected where."""
