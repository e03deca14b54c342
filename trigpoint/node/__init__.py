"""A node's life, its health, its peers and its watchdog."""
