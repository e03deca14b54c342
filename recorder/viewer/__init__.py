"""What rerun shows of a site, live or recorded, and the viewer as a process of ours."""
