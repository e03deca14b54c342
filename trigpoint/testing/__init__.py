"""What only tests use: a bus in memory."""
