"""Compare EOP sets, solvers, and dense and sparse backends on any block."""
