"""The command line ``fg-orient``: thin; it parses, calls the library and prints.

Standard output carries the result (tables, or one JSON object with ``--json``), standard
error everything else. Exit codes: 0 good, 2 bad input, 3 no solution, 4 solution not
trustworthy, 130 interrupted, 1 an error of the program itself or a broken installation.
"""

from fg_orient.cli.app import app, main

__all__ = ["app", "main"]
