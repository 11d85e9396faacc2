"""Benchmarks compare fg_orient with other software. Run them from the folder of the repository (``make bench``)."""
