"""Comparison of published and reproduced values: the only package that reads both."""
