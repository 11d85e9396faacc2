"""Work on RPC files: check, convert, refine with control points, fit to points or to a rigorous model."""
