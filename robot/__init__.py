"""The bridge of a robot: serial port on one side, odometry and corrections on the other."""
