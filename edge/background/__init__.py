"""Whether a camera still stands as it did, by the still background of its own pictures."""
