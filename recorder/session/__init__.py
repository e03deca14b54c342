"""A recorded session, or anybody's bag: its files, what is in it, and what can be saved."""
