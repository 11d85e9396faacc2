"""The data model of an adjustment: images, ground points, image points. Immutable.

A :class:`Block` holds what is known before the adjustment. The coordinates of **check
points** are not in :class:`GroundPoints` (their rows are nan): they stay sealed in
:class:`WithheldCoordinates` and are opened by the accuracy assessment after convergence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fg_orient.names import Role

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Image:
    """One image: its id and the sensor that binds its metadata to the equations."""

    id: str
    sensor: PushbroomSensor


@dataclass(frozen=True)
class Coordinates:
    """Measured ground coordinates: ``ecef_m`` (n, 3), ``sigma_enu_m`` (n, 3), ``fixed`` (n,) bool.

    Sigmas are East, North, Up of the point itself; rows without coordinates are nan.
    """

    ecef_m: Array
    sigma_enu_m: Array
    fixed: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class GroundPoints:
    """Ground points in file order; ``known`` holds rows of control points only (others nan)."""

    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    known: Coordinates

    def where(self, role: Role) -> Index:
        """Indices of the points with this role."""
        return np.flatnonzero([r is role for r in self.roles])


@dataclass(frozen=True)
class WithheldCoordinates:
    """Coordinates of the check points, sealed until :meth:`open` after convergence.

    ``ids`` names the points; opening calls ``reader`` and gives rows in the order of ``ids``.
    """

    ids: tuple[str, ...]
    reader: Callable[[], Coordinates]

    def open(self) -> Coordinates:
        """Read the withheld coordinates."""
        return self.reader()


@dataclass(frozen=True)
class ImagePoints:
    """Image observations: index arrays into images and ground points, pixels and their sigmas."""

    image: Index
    point: Index
    line: Array
    sample: Array
    sigma_line_px: Array
    sigma_sample_px: Array

    def __len__(self) -> int:
        return len(self.line)

    def take(self, rows: npt.NDArray[np.bool_] | Index) -> ImagePoints:
        """Give the selected rows."""
        return ImagePoints(
            self.image[rows], self.point[rows], self.line[rows],
            self.sample[rows], self.sigma_line_px[rows], self.sigma_sample_px[rows],
        )  # fmt: skip


@dataclass(frozen=True)
class Options:
    """Choices of one adjustment; the project file's values, overridden by the command line.

    Parameters
    ----------
    eop_set : int
        Number 1-20 of the EOP set (docs/concepts.md).
    look_polynomial : int or None
        Degree of the look-angle correction polynomial; None = no such unknowns.
    priors : bool
        False leaves the orientation unknowns without prior observations.
    position_sigma_m, velocity_sigma_m_s, attitude_sigma_rad : tuple of 3 floats
        Prior sigmas of c0, c1, c2 of tau.
    look_sigma_rad : float
        Prior sigma of each coefficient of the look polynomial.
    backend : str
        "auto" or "graph" in this version.
    optimizer : str
        "gauss-newton", "levenberg-marquardt", "dogleg" or "native".
    """

    eop_set: int = 15
    look_polynomial: int | None = None
    priors: bool = True
    position_sigma_m: tuple[float, float, float] = (10.0, 1.0, 0.1)
    velocity_sigma_m_s: tuple[float, float, float] = (1e-2, 1e-3, 1e-4)
    attitude_sigma_rad: tuple[float, float, float] = (50e-6, 10e-6, 2e-6)
    look_sigma_rad: float = 1e-4
    small_angle: bool = False
    backend: str = "auto"
    optimizer: str = "gauss-newton"
    max_iterations: int = 50
    check_points: str = "use"  # "use": their rays take part; "exclude": left out, intersected afterwards


@dataclass(frozen=True)
class ExtraObservation:
    """An observation of any registered equation, beyond image and control points.

    Parameters
    ----------
    equation : factors._contract.Equation
        Whitened: a unit of its residual is one sigma.
    unknowns : tuple of str
        One per argument of the equation: "image:left" (its coefficients in prior sigmas) or
        "point:12" (metres relative to the block's local origin, axes parallel to ECEF).
    record, setup : arrays
        Constants of the observation, see ``factors._contract``.
    n_residuals : int
        Length of the residual.
    label : str
        Named in messages.
    """

    equation: Equation
    unknowns: tuple[str, ...]
    record: Array
    setup: Array
    n_residuals: int
    label: str


@dataclass(frozen=True)
class Source:
    """An input file of the block, for the provenance record."""

    path: str
    sha256: str


@dataclass(frozen=True)
class Block:
    """Everything an adjustment starts from."""

    name: str
    images: tuple[Image, ...]
    points: GroundPoints
    observations: ImagePoints
    withheld: WithheldCoordinates
    options: Options = field(default_factory=Options)
    sources: tuple[Source, ...] = ()
    notes: tuple[str, ...] = ()  # remarks of the readers, shown in the report
    extra: tuple[ExtraObservation, ...] = ()

    def image_index(self, image_id: str) -> int:
        """Position of the image with this id."""
        return [image.id for image in self.images].index(image_id)
