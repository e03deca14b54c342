"""`trigpoint up`: every part of a site that belongs to this machine, in one command."""
