"""`trigpoint look`: one camera without a site file: what it sees, live, and its lens."""
