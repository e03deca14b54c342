"""Pictures of a simulated world."""
