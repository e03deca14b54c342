"""Corners measured by laying the printed pattern over the picture."""
