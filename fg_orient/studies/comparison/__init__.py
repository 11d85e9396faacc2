"""Comparison of dense and sparse solutions on any block, with all EOP sets, solvers and backends."""
