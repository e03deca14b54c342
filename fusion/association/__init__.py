"""Data association: the one place that decides what explains a session."""
