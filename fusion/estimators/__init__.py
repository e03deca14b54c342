"""The interface of every estimator; the estimators are packages of their own."""
