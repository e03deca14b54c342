"""`trigpoint target`: target files checked, drawn for print, taken from Kalibr."""
