"""The report of a demo: what robots and cameras did, against the truth."""
