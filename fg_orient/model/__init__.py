"""What all floors know: blocks, options, unknowns, names, errors and their words."""
