"""Work on many processors: a block in parts, or studies of many cases, with dask for processes and machines."""
