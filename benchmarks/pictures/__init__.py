"""Finders of boards on pictures: drawn, photographed, empty, nasty; and what they cost."""
