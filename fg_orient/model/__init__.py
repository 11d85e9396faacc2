"""Data model of all floors: blocks, options, unknowns, names, errors and messages."""
