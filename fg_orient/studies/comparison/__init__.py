"""Dense against sparse on any block: EOP sets, solvers and backends side by side."""
