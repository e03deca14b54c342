"""A recorded session once more on the bus, at its pace or another."""
