"""Assessment of solutions: observability, covariance, outlier tests and accuracy."""
