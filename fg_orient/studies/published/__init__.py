"""Published values: tables as CSV with their sources, and their reader. Nothing that computes may import this."""
