"""Messages to observations: who is heard, in which order, and which robot was seen."""
