"""What one picture can mean: which face, which way up, from where."""
