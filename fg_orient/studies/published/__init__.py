"""Published values: CSV tables with their sources, and a reader. No module that computes may import this package."""
