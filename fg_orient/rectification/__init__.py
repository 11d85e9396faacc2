"""Rectification by transformations between image and map; map accuracy, areas and scanner geometry.

Source of the plane methods: C. İpbüker (1994), MSc thesis, Istanbul Technical University:
geometric accuracy of images at map scale from satellite data. Cited as İpbüker 1994.
"""

from __future__ import annotations

from fg_orient.model.public import names_of, on_first_use

_HOME = names_of(
    __name__,
    {
        "fit": "Observations TransformationFit",
        "options": "AccuracyOptions OrthoOptions PointOptions",
        "ortho": "orthorectify",
        "outliers": "PointTests point_tests",
        "points": "MapPoints PointFit fit_points read_map_points",
        "projections": "perimeter_m planar_area_m2",
        "radiometry": "ClassificationErrors classification_errors destripe subtract_dark_object",
        "standards": "check_accuracy nmas_limit_m nssda_m",
        "transformation": "Transformation find_model read_transformation",
        "grid": "MapGrid",
    },
)
__all__ = sorted(_HOME)
__getattr__ = on_first_use(globals(), _HOME)
