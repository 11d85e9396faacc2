"""The published experiments run again on the twin: cells of the tables and claims. Knows no published value."""
