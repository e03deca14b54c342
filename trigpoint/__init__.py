"""Trigpoint surveys the cameras of a building by driving a robot past them."""

__version__ = "0.1.0"

CONTRACT = 1
"""Version of the bus and file contract; nodes announce it and report peers with another one."""
