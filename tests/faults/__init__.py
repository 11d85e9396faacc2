"""Faults at every system call that writes: ``python -m tests.faults --command adjust`` (Linux, a C compiler)."""
