"""The serial line: ports, protocols, what a board says in bytes, its clock and its wheels."""
