"""Where a robot should go next."""
