"""What pages are drawn with: the document and its sections, tables, SVG, charts, maps."""
