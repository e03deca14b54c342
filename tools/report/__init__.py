"""Self-contained pages: of a demo (`page`) and of a calibration (`calibration_page`)."""
