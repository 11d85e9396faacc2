"""Distribute work over many processors with dask: a block in parts, or a study of many cases."""
