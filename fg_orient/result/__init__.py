"""Record of a result: made from a solution, written to a folder and read again, converted to a page and tables."""
