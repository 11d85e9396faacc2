"""Benchmarks of fg_orient against other software; run from the repository's folder (``make bench``)."""
