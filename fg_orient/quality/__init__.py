"""Quality: observability, covariance, accuracy."""
