"""The pages of a calibration, and of a demo: a calibration with a truth beside it."""
