"""`python -m trigpoint` is the program `trigpoint`."""

from .cli import main

main()
