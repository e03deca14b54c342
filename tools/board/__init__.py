"""`trigpoint board`: the live site as a web page, which only reads."""
