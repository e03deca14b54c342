"""The recursive estimators: the extended Kalman filter and the particle filter."""
