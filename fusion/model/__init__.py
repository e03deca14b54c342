"""What is estimated and what it is estimated from: odometry, sightings, unknowns, predictions."""
