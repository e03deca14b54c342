"""`trigpoint pack`: one archive with everything that a machine of a site needs."""
