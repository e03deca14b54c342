"""Tools around the parts: the demo, calibration, simulation, set-up."""
