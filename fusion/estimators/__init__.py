"""What every estimator offers; the estimators are rooms of their own."""
