"""`trigpoint secure` and `router`: a site's authority, its certificates, its door."""
