"""`trigpoint calibrate`: from a session to a network and its report."""
