"""Outputs of commands and backends are kept before a change and compared after it.

``python -m tests.golden keep FOLDER`` runs the cases of :mod:`tests.golden.cases` with the code beside it and keeps
every file, the standard output and the exit code. Run it in the tree before a change (a git worktree) and in the tree
after it, on the same machine; then ``python -m tests.golden compare BEFORE AFTER`` names each value that is another
one. Values are compared to the last bit, or within ``--within 1e-12`` where a factorisation was replaced. Signs that
turn on purpose are declared in a file, ``--signs`` (:class:`tests.golden.compare.Signs`).
"""
