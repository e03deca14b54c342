"""Shapes of targets: where their faces are on the robot, and the target file that says so."""
