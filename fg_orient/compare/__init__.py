"""Dense against sparse on any block: EOP sets x solvers x backends, as table, plots and report."""
