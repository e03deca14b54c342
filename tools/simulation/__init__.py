"""A simulated lab: rooms, cameras and robots whose truth is known, deterministic in a seed."""
