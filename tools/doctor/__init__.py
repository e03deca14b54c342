"""`trigpoint doctor`: what is not right on this machine or site, and what to do."""
