"""Pages that a program of ours serves: who may see them, the server, and what every answer has."""
