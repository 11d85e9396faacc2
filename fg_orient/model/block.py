"""The data model of an adjustment: images, ground points, image points. Immutable, arrays included.

A :class:`Block` contains the data known before the adjustment. The coordinates of **check
points** are not in :class:`GroundPoints` (their rows are nan): they stay sealed in
:class:`WithheldCoordinates` and are opened by the accuracy assessment after convergence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.model.errors import Finding
from fg_orient.model.names import Role
from fg_orient.model.options import Options as Options

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.sensors.base import Sensor


def _read_only(record: object, **kinds: type) -> None:
    """Replace arrays of a frozen record by read-only copies of the given types."""
    for name, kind in kinds.items():
        given = getattr(record, name)
        array: npt.NDArray[Any] = np.array(given, dtype=kind)
        array.setflags(write=False)
        object.__setattr__(record, name, array)


@dataclass(frozen=True)
class Image:
    """One image: its id and the sensor that binds its metadata to the equations.

    ``pixels`` and ``pixels_origin`` are the entries of the project file: path of its raster, and line and sample of the
    first pixel of that.
    """

    id: str
    sensor: Sensor
    pixels: str = ""
    pixels_origin: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Measured ground coordinates; the arrays are copied and read-only.

    Parameters
    ----------
    ecef_m : (n, 3) array
        WGS84 Earth-centred coordinates; rows without coordinates are nan.
    sigma_enu_m : (n, 3) array
        Sigmas East, North, Up at the point itself; nan for fixed points and rows without coordinates.
    fixed : (n,) bool array
        Constant in the adjustment: such a point has no residual.
    """

    ecef_m: Array
    sigma_enu_m: Array
    fixed: Mask

    def __post_init__(self) -> None:
        _read_only(self, ecef_m=np.float64, sigma_enu_m=np.float64, fixed=np.bool_)

    def take(self, rows: Index) -> Coordinates:
        """Selected rows."""
        return Coordinates(self.ecef_m[rows], self.sigma_enu_m[rows], self.fixed[rows])

    def only(self, known: Mask) -> Coordinates:
        """Return all rows; rows that are not ``known`` (n,) lose their coordinates."""
        ecef_m, sigma_m = (np.where(known[:, None], values, np.nan) for values in (self.ecef_m, self.sigma_enu_m))
        return Coordinates(ecef_m, sigma_m, self.fixed & known)


@dataclass(frozen=True)
class GroundPoints:
    """Ground points in file order.

    Parameters
    ----------
    ids : tuple of str
        Unique ids.
    roles : tuple of Role
        Control, check or tie, one per id.
    known : Coordinates
        One row per id; rows of control points hold coordinates, those of check points never, those of tie points
        start values or nan.
    """

    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    known: Coordinates

    def where(self, role: Role) -> Index:
        """Indices of the points with this role."""
        return np.flatnonzero([r is role for r in self.roles])

    def take(self, rows: Index) -> GroundPoints:
        """Selected points."""
        ids, roles = (tuple(values[k] for k in rows) for values in (self.ids, self.roles))
        return GroundPoints(ids, roles, self.known.take(rows))

    def without_coordinates(self, gone: Mask, role: Role) -> GroundPoints:
        """Remove the coordinates of the points ``gone`` (n,), which get this role."""
        roles = tuple(role if away else r for away, r in zip(gone, self.roles, strict=True))
        return GroundPoints(self.ids, roles, self.known.only(~gone))


@dataclass(frozen=True)
class WithheldCoordinates:
    """Coordinates of the check points, sealed until :meth:`open` after convergence.

    ``ids`` names the points; opening calls ``reader`` and gives rows in the order of ``ids``. Default: no points.
    """

    ids: tuple[str, ...] = ()
    reader: Callable[[], Coordinates] = lambda: Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool))

    def open(self) -> Coordinates:
        """Read the withheld coordinates."""
        return self.reader()


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Image observations, one per row; the arrays are copied and read-only.

    Parameters
    ----------
    image, point : (n,) int arrays
        Positions in the block's images and ground points.
    line, sample : (n,) arrays
        Pixels; (0, 0) is the centre of the first pixel.
    sigma_line_px, sigma_sample_px : (n,) arrays
        Their standard deviations.
    """

    image: Index
    point: Index
    line: Array
    sample: Array
    sigma_line_px: Array
    sigma_sample_px: Array

    def __post_init__(self) -> None:
        _read_only(self, image=np.intp, point=np.intp)
        _read_only(self, line=np.float64, sample=np.float64, sigma_line_px=np.float64, sigma_sample_px=np.float64)

    def __len__(self) -> int:
        return len(self.line)

    def take(self, rows: Mask | Index | slice) -> ImagePoints:
        """Give the selected rows."""
        return ImagePoints(
            self.image[rows], self.point[rows], self.line[rows],
            self.sample[rows], self.sigma_line_px[rows], self.sigma_sample_px[rows],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ExtraObservation:
    """An observation of any registered equation, in addition to image and control points.

    Parameters
    ----------
    equation : factors._contract.Equation
        Whitened: a unit of its residual is one sigma.
    unknowns : tuple of str
        One per argument of the equation: "image:left" (its coefficients in prior sigmas) or
        "point:12" (metres relative to the block's local origin, axes parallel to ECEF).
    record : array
        Constants of the observation, see ``factors._contract``.
    setup : array or None
        What all observations of a group share; None: that of the image that it names first, the codes and prior
        sigmas of the unknowns in force (``ImageParameters.setup``).
    n_residuals : int
        Length of the residual.
    label : str
        Named in messages.
    """

    equation: Equation
    unknowns: tuple[str, ...]
    record: Array
    setup: Array | None
    n_residuals: int
    label: str


@dataclass(frozen=True)
class GroundSystem:
    """Coordinate reference system (CRS) and zero level of heights in which the ground points were given.

    Parameters
    ----------
    crs : str
        ``EPSG:n``, or ``EPSG:n+m`` with a vertical CRS; "" if the points have none.
    geoid : str
        Path of the geoid file that has the zero level; "" for none.
    undulation_m : float or None
        Constant height of the zero level above the WGS84 ellipsoid.
    """

    crs: str = ""
    geoid: str = ""
    undulation_m: float | None = None


@dataclass(frozen=True)
class Source:
    """An input file of the block, for the provenance record."""

    path: str
    sha256: str


@dataclass(frozen=True, repr=False)
class Block:
    """Input of an adjustment.

    Parameters
    ----------
    name : str
        Name of the project, for the report.
    images : tuple of Image
    points : GroundPoints
        All ground points; their rows are what ``observations.point`` counts. Coordinates of tie points are start
        values and nothing else; those without are intersected.
    observations : ImagePoints
    withheld : WithheldCoordinates
        Coordinates of the check points, sealed until the adjustment has converged.
    options : Options
    sources : tuple of Source
        Files it was read from; empty for a block made in memory.
    notes : tuple of Finding
        Remarks of the readers, shown in the report.
    extra : tuple of ExtraObservation, Constraint or gtsam.NonlinearFactor
        Further observations of any registered equation, constraints between ground points, or factors of GTSAM between
        images and points; their keys are those of :func:`fg_orient.factor_graph`.
    ground : GroundSystem
        CRS and zero level of the point table, for outputs.
    """

    name: str
    images: tuple[Image, ...]
    points: GroundPoints
    observations: ImagePoints
    withheld: WithheldCoordinates
    options: Options = field(default_factory=Options)
    sources: tuple[Source, ...] = ()
    notes: tuple[Finding, ...] = ()
    extra: tuple[ExtraObservation, ...] = ()
    ground: GroundSystem = GroundSystem()

    def __repr__(self) -> str:
        counts = f"{len(self.images)} images, {len(self.points.ids)} points, {len(self.observations)} image points"
        return f"<Block {self.name[:60]}: {counts}>"

    @property
    def georeferenced(self) -> bool:
        """True for Earth-fixed coordinates, False for metres of a local Cartesian system."""
        return all(image.sensor.georeferenced for image in self.images)

    def image_index(self, image_id: str) -> int:
        """Index of the image with this id."""
        return [image.id for image in self.images].index(image_id)

    def find(self, name: str) -> tuple[str, int] | None:
        """Kind ("image", "point") and position of a name such as "image:left" or "point:12"; None if there is none."""
        kind, _, identifier = name.partition(":")
        ids = {"image": tuple(image.id for image in self.images), "point": self.points.ids}.get(kind, ())
        return (kind, ids.index(identifier)) if identifier in ids else None
