"""Comparison of published and reproduced values; no other package reads both."""
