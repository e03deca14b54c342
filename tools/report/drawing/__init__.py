"""SVG, axes, maps and frames that every report is drawn with."""
