"""Each system call that writes fails once: ``python -m tests.faults --command adjust`` (Linux, a C compiler)."""
