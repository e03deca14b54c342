"""`trigpoint coverage`: how well robots are corrected where, and where another camera would help."""
