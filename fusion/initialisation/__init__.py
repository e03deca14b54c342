"""Locates a camera or a robot of which nothing is known yet, without a guess."""
