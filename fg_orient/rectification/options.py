"""Options of rectification; each field is the only declaration of its option (``fg_orient.model.options``).

The types are read when the program runs, so annotations are not postponed here.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.declaration import Checked, Group, Names, documented, option, require_allowed
from fg_orient.model.errors import InputError
from fg_orient.model.names import LARGEST

FIT: Final = Group("Transformation")
STUDY: Final = Group("Study")
ACCURACY: Final = Group("Accuracy")
ORTHO: Final = Group("Map raster")
STANDARDS: Final = ("NMAS", "CMAS", "NSSDA", "ASPRS-1990", "ASPRS-2014", "ASPRS-2023")
_CRS: Final = "Projected coordinate system of the map, EPSG:n."

# fmt: off


@documented
@dataclass(frozen=True)
class PointOptions(Checked):
    """Options of a fit of a transformation to points."""

    model: str | None = option(
        None, FIT, "polynomial, affine, helmert, projective; affine-3d, parallel, dlt (ground to image).",
        left_out="affine, or polynomial with a degree",
    )
    degree: int | None = option(None, FIT, "Degree of the polynomial.", within=(1, 5))
    direction: str | None = option(
        None, FIT, "image-to-map or map-to-image.", left_out="image-to-map for plane models, map-to-image for others",
    )
    crs: str | None = option(None, FIT, _CRS)
    pixel_size_m: float | None = option(
        None, FIT, "Pixel size, for a comparison of distances between points in image and map.", unit="m",
    )
    prune_to: float | None = option(
        None, FIT, "Target of the radial RMSE: the worst point is left out until it is reached. It has the unit of the "
        "residuals.",
    )
    prune_by: Literal["residual", "test"] = option("residual", FIT, "Worst point by the residual or by the F test.")


@documented
@dataclass(frozen=True)
class StudyOptions(Checked):
    """Options of a study of numbers of control points and degrees."""

    layouts: int = option(30, STUDY, "Number of random choices of the points.", within=(1, math.inf))
    seed: int = option(1, STUDY, "Seed of the random choices.", within=(0, math.inf))
    crs: str | None = option(None, STUDY, _CRS)


@documented
@dataclass(frozen=True)
class AccuracyOptions:
    """Options of the assessment of map accuracy."""

    scale: float | None = option(None, ACCURACY, "Denominator of the assessed map scale (NMAS, CMAS, ASPRS 1990).")
    class_m: float | None = option(
        None, ACCURACY, "Assessed accuracy class (ASPRS 2014, 2023).", unit="m", spelled="class-m",
    )
    standards: Names = option(
        STANDARDS, ACCURACY, "NMAS, CMAS, NSSDA, ASPRS-1990, ASPRS-2014, ASPRS-2023.", spelled="standard",
    )
    check_point_rmse_m: float = option(
        0.0, ACCURACY, "Radial RMSE of the check points' own coordinates (ASPRS 2023).", within=(0.0, LARGEST),
        unit="m",
    )

    def __post_init__(self) -> None:
        require_allowed(self)
        unknown = [name for name in self.standards if name not in STANDARDS]
        if unknown:
            raise InputError.of("rectify.standard", option="standard", value=unknown[0], known=", ".join(STANDARDS))


@documented
@dataclass(frozen=True)
class OrthoOptions(Checked):
    """Options of a map raster."""

    resampling: Literal["nearest", "bilinear", "cubic", "cubic-sharp"] = option(
        "bilinear", ORTHO, "Resampling. cubic: a = -0.5; cubic-sharp: a = -1.",
    )
    allow_holes: bool = option(False, ORTHO, "Leave map pixels empty where the DEM has no height.")
    cog: bool = option(False, ORTHO, "Write a cloud optimised GeoTIFF with overviews.")
    compress: Literal["deflate", "lzw", "zstd", "none"] = option("deflate", ORTHO, "Compression of the file.")
    window: int = option(
        1024, ORTHO, "Edge of the windows in map pixels. The result does not depend on it.", within=(1, math.inf),
    )
