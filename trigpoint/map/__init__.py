"""A network of cameras, and the building that it hangs in."""
