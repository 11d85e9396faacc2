"""Close range: DLT, resection, intersection, relative and absolute orientation, parallax, surfaces."""
