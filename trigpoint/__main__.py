"""`python -m trigpoint` runs the program `trigpoint`."""

from .cli import main

main()
