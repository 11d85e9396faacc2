"""Record of a result: made from a solution, written to a folder, read from it, turned into a page and tables."""
