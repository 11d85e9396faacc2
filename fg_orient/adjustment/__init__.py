"""Adjustment: the problem as arrays, the backends that solve it, and one iteration loop for all backends."""
