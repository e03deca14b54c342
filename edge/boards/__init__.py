"""The search for checkerboards."""
