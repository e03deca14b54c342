"""Where a camera or a robot is that nothing is known of yet, without a guess."""
