"""Close-range photogrammetry: DLT, resection, intersection, relative and absolute orientation, surfaces."""

from __future__ import annotations

from fg_orient.model.public import names_of, on_first_use

_HOME = names_of(__name__, {
    "bundle": "BundlePhoto adjust_bundle",
    "bundle_result": "Adjustment BundleResult",
    "dlt": "DltFit fit_dlt",
    "fitting": "Comparison compare_points",
    "intersection": "Intersection intersect_photos normal_case",
    "orientation": "RelativeOrientation Similarity absolute_orientation relative_orientation",
    "photo": "Photo PhotoInterior aerial_from_rotation ayhan_from_rotation rotation_from_aerial rotation_from_ayhan",
    "resection": "Resection resect",
    "surface": "Surface map_points",
    "surface_fit": "SurfaceFit fit_surface",
})  # fmt: skip
_HOME["Constraint"] = "fg_orient.model.constraint"
__all__ = sorted(_HOME)
__getattr__ = on_first_use(globals(), _HOME)
