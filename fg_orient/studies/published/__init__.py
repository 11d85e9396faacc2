"""Published values as CSV tables with their sources, and a reader.

Modules that compute must not import this package.
"""
