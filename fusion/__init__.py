"""The estimator: odometry and sightings in, the network and corrections out."""
