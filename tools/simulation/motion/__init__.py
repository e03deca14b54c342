"""How simulated robots move, and what their odometry makes of it."""
