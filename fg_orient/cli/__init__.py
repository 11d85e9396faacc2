"""The command line ``fg-orient``. It parses arguments, calls the library and prints results.

Standard output contains only the result: tables, or one JSON object with ``--json``. All
other text goes to standard error. Exit codes are 0 for a good result, 2 for bad input, 3
for no solution, 4 for a solution that is not trustworthy, 130 after an interruption, and
1 for an error of the program itself or a broken installation.
"""

from fg_orient.cli.app import app, main

__all__ = ["app", "main"]
