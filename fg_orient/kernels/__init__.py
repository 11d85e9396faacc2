"""Compiled loops over arrays of observations, ground points and pixels."""
