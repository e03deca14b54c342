"""The parts of a site as processes: started, started again, and stopped in order."""
