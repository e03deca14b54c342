"""Networks of cameras, compared with each other, with a truth, with the physical limit."""
