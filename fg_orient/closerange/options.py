"""Options of the commands of close range; each field is the only declaration of its option.

The types are read when the program runs, so annotations are not postponed here.
"""

from dataclasses import dataclass
from typing import Any, Final, Literal

from fg_orient.model.declaration import Checked, Group, Names, documented, option
from fg_orient.model.names import LARGEST, SMALLEST
from fg_orient.model.options import Backend

MODEL: Final = Group("Model")
WEIGHTS: Final = Group("Weights")
#: Smallest and largest standard deviation.
SIZES: Final = (SMALLEST, LARGEST)
#: Options of the common adjustment that a bundle also has, and defaults that differ.
COMMON: Final = (
    "optimizer",
    "solver",
    "datum",
    "max_iterations",
    "memory_limit_gb",
    "loss",
    "gnc",
    "inlier_probability",
    "robust_start",
    "robust_scale",
    "snoop",
    "snoop_kind",
    "outlier_test",
    "outlier_level",
    "multiple_testing",
    "variance_components",
    "accept",
)
DEFAULTS: Final[dict[str, Any]] = {"optimizer": "levenberg-marquardt", "max_iterations": 100}
RELATIVE: Final = "without this option weights are relative, and m0 is that standard deviation"

# fmt: off


@documented
@dataclass(frozen=True, kw_only=True)
class ImageOptions(Checked):
    """Weights of image points."""

    sigma: float | None = option(
        None, WEIGHTS, f"Default standard deviation of image coordinates, in their unit; {RELATIVE}.", within=SIZES,
    )


@documented
@dataclass(frozen=True, kw_only=True)
class DltOptions(ImageOptions):
    """Options of a direct linear transformation."""

    distortion: Names = option((), MODEL, "Unknown distortion coefficients: k1,k2,k3,p1,p2; default: none.")
    direct: bool = option(False, MODEL, "Compute the direct linear solution without iteration.")


@documented
@dataclass(frozen=True, kw_only=True)
class BundleOptions(ImageOptions):
    """Options of a bundle adjustment."""

    unknown: Names = option(
        (), MODEL, "Unknown camera parameters of each photo: c,x0,y0,k1,k2,k3,p1,p2, a1 to a21, or sets such as "
        "radial-even, film or brown (docs/closerange.md).",
    )
    shared: Names = option((), MODEL, "Unknown camera parameters with the same value for all photos.")
    sigma_control_m: float = option(
        0.0, WEIGHTS, "Default standard deviation of control points; 0: exact control points.", unit="m", within=SIZES,
        zero="exact control points",
    )
    backend: Backend = option(
        "auto", MODEL, "Full matrices (dense), a GTSAM graph, or our own loop on arrays (schur); auto: dense up to "
        "2000 unknowns, else graph.",
    )


@documented
@dataclass(frozen=True, kw_only=True)
class SurfaceOptions(Checked):
    """Options of the fit of a surface."""

    axis: Literal["x", "y", "z", "free"] = option("y", MODEL, "Axis of a spheroid.")
    method: Literal["geometric", "algebraic"] = option(
        "geometric", MODEL, "geometric: distances to the surface; algebraic: conditions (Ayhan 1996).",
    )
    sigma_m: float | None = option(
        None, WEIGHTS, f"Default standard deviation of coordinates; {RELATIVE}.", unit="m", within=SIZES,
    )
