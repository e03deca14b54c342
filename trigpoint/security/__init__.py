"""Certificates of a secured site, and signatures on corrections."""
