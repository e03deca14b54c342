"""`trigpoint init` and `status`: a site's file and units, and how the site is."""
