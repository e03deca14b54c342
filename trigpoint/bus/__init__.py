"""The bus that every part uses, and what its implementations share."""
