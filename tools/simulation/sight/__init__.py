"""Which corners of which targets a simulated camera sees, and when."""
