"""Which corrections reach the robot: plausible ones, smoothly."""
