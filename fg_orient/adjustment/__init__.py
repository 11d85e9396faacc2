"""Adjustment: the problem as arrays, the backends, one loop over all of them."""
