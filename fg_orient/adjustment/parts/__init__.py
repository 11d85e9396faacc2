"""Work on many processors: a block in parts, studies of many cases; dask takes both to processes and machines."""
