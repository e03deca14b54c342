"""The default estimator: a smoother over all poses, with a filter for live corrections."""
