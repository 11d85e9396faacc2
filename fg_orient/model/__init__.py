"""Data model used by all other packages: blocks, options, unknowns, names, errors and messages."""
