"""The estimator's work: updates, memory, growth, and GTSAM on the same problem."""
