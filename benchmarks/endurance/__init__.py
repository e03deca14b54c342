"""Whole sites for minutes and hours, with faults and stops."""
