"""Points and image points of other programs: one module for each format, each in a registry (docs/formats)."""
