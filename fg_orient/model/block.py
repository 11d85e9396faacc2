"""Data model of an adjustment: images, ground points and image points. All records and arrays are immutable.

A :class:`Block` contains the data known before the adjustment. :class:`GroundPoints` does not contain the coordinates
of **check points** (their rows are nan): :class:`WithheldCoordinates` keeps them sealed until the accuracy assessment
opens them after convergence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.model import arrays
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.names import Role
from fg_orient.model.options import Options as Options

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.geodesy.bodies import Body
    from fg_orient.sensors.base import Sensor


def _set(record: object, **values: object) -> None:
    """Replace fields of a frozen record, and make its arrays read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(record, name, value)


@dataclass(frozen=True)
class Image:
    """One image: its id, and the sensor, which connects its metadata with the equations.

    ``pixels`` and ``pixels_origin`` are entries of the project file: the path of the raster, and the line and sample of
    its first pixel. The orientation of a ``held`` image stays as in its metadata.
    """

    id: str
    sensor: Sensor
    pixels: str = ""
    pixels_origin: tuple[float, float] | None = None
    held: bool = False

    def __post_init__(self) -> None:
        if fault := arrays.name_fault(self.id):
            raise arrays.wrong("id", repr(self.id), fault)
        if self.pixels_origin is not None:
            arrays.require_size(arrays.array(self.pixels_origin, "pixels_origin", (2,)), "pixels_origin")

    def require_model(self) -> None:
        """Raise InputError if the sensor has no image model."""
        if not hasattr(self.sensor, "image_model"):
            raise InputError.of("adjust.no_model", place=f"image {self.id}", value=type(self.sensor).__name__)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Measured ground coordinates; the arrays are copied and read-only.

    Parameters
    ----------
    ecef_m : (n, 3) array
        WGS84 Earth-centred coordinates; rows without coordinates are nan.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point itself; nan for fixed points and rows without coordinates.
    fixed : (n,) bool array
        True for points that are constant in the adjustment: such a point has no residual.

    Raises
    ------
    InputError
        The arrays have wrong types or shapes.
    """

    ecef_m: Array
    sigma_enu_m: Array
    fixed: Mask

    def __post_init__(self) -> None:
        ecef_m = arrays.array(self.ecef_m, "ecef_m", (-1, 3))
        sigma = arrays.array(self.sigma_enu_m, "sigma_enu_m", ecef_m.shape)
        _set(self, ecef_m=ecef_m, sigma_enu_m=sigma, fixed=arrays.array(self.fixed, "fixed", (len(ecef_m),), np.bool_))

    def take(self, rows: Index) -> Coordinates:
        """Return the coordinates of the selected rows."""
        return Coordinates(self.ecef_m[rows], self.sigma_enu_m[rows], self.fixed[rows])

    def only(self, known: Mask) -> Coordinates:
        """Return a copy in which the rows that are not ``known`` (n,) have no coordinates."""
        ecef_m, sigma_m = (np.where(known[:, None], values, np.nan) for values in (self.ecef_m, self.sigma_enu_m))
        return Coordinates(ecef_m, sigma_m, self.fixed & known)


@dataclass(frozen=True)
class GroundPoints:
    """Ground points in the order of the file.

    Parameters
    ----------
    ids : tuple of str
        Unique ids.
    roles : tuple of Role
        Control, check or tie; one role per id.
    known : Coordinates
        One row per id. Control points always have coordinates, check points never; tie points have start values or nan.

    Raises
    ------
    InputError
        Types are wrong, roles are unknown, or lengths differ. A block also refuses repeated ids and impossible values.
    """

    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    known: Coordinates

    def __post_init__(self) -> None:
        ids, roles = arrays.sequence(self.ids, "ids"), _roles(self.roles)
        if not isinstance(self.known, Coordinates):
            raise arrays.wrong("known", type(self.known).__name__, "Coordinates")
        for place, count in (("ids", len(ids)), ("roles", len(roles))):
            if count != len(self.known.fixed):
                raise arrays.wrong(place, count, f"one for each of the {len(self.known.fixed)} rows of coordinates")
        _set(self, ids=ids, roles=roles)

    @cached_property
    def require_possible(self) -> None:
        """Raise InputError for impossible or repeated ids and for impossible coordinates; the check runs only once."""
        known, place = self.known, "points"
        arrays.names(self.ids, f"{place}.ids")
        control = arrays.having_role(self.roles, Role.CONTROL)
        missing = np.asarray(np.isnan(known.ecef_m).all(axis=1))
        arrays.require_size(known.ecef_m, f"{place}.known.ecef_m", missing=missing)
        arrays.require_sigmas(known.sigma_enu_m, f"{place}.known.sigma_enu_m", missing=True)
        arrays.refuse(missing & control, f"{place}.known.ecef_m", known.ecef_m, "coordinates of each control point")
        arrays.refuse(
            np.isnan(known.sigma_enu_m).any(axis=1) & control & ~known.fixed,
            f"{place}.known.sigma_enu_m",
            known.sigma_enu_m,
            "standard deviations of each control point that is not fixed",
        )

    def where(self, role: Role) -> Index:
        """Return the indices of the points with this role."""
        return np.flatnonzero(arrays.having_role(self.roles, role))

    def take(self, rows: Index) -> GroundPoints:
        """Return the selected points."""
        ids, roles = (tuple(values[k] for k in rows) for values in (self.ids, self.roles))
        return GroundPoints(ids, roles, self.known.take(rows))

    def without_coordinates(self, gone: Mask, role: Role) -> GroundPoints:
        """Return a copy in which the points ``gone`` (n,) have no coordinates and this role."""
        roles = tuple(role if away else r for away, r in zip(gone, self.roles, strict=True))
        return GroundPoints(self.ids, roles, self.known.only(~gone))


def _roles(given: tuple[Role, ...]) -> tuple[Role, ...]:
    """Return the roles named by texts or roles; raise InputError for unknown ones."""
    known, allowed = {str(role): role for role in Role}, f"one of {', '.join(Role)} for each point"
    roles = arrays.sequence(given, "roles")
    if not set(map(type, roles)) <= {Role}:
        k = next((k for k, role in enumerate(roles) if not isinstance(role, str) or role not in known), None)
        if k is not None:
            raise arrays.wrong(f"roles, row {k}", repr(roles[k]), allowed)
        roles = tuple(known[role] for role in roles)
    return roles


@dataclass(frozen=True)
class WithheldCoordinates:
    """Coordinates of the check points, sealed until :meth:`open` after convergence.

    ``ids`` names the points. Opening calls ``reader``, which returns rows in the order of ``ids``. By default there are
    no points.
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
        Positions of the image and of the ground point in the block.
    line, sample : (n,) arrays
        Pixels; (0, 0) is the centre of the first pixel.
    sigma_line_px, sigma_sample_px : (n,) arrays
        Standard deviations of line and sample, pixels.

    Raises
    ------
    InputError
        Types are wrong or lengths differ. A block also refuses impossible values.
    """

    image: Index
    point: Index
    line: Array
    sample: Array
    sigma_line_px: Array
    sigma_sample_px: Array

    def __post_init__(self) -> None:
        point = arrays.array(self.point, "point", (-1,), np.intp)
        read = {"image": arrays.array(self.image, "image", point.shape, np.intp), "point": point}
        for name in ("line", "sample", "sigma_line_px", "sigma_sample_px"):
            read[name] = arrays.array(getattr(self, name), name, point.shape)
        _set(self, **read)

    @cached_property
    def require_possible(self) -> None:
        """Raise InputError for pixels that are not finite and for impossible standard deviations.

        The check runs only once.
        """
        part = "observations"
        for name in ("line", "sample"):
            arrays.require_size(getattr(self, name), f"{part}.{name}")
            arrays.require_sigmas(getattr(self, f"sigma_{name}_px"), f"{part}.sigma_{name}_px")

    def __len__(self) -> int:
        return len(self.line)

    def take(self, rows: Mask | Index | slice) -> ImagePoints:
        """Return the image points of the selected rows."""
        return ImagePoints(
            self.image[rows],
            self.point[rows],
            self.line[rows],
            self.sample[rows],
            self.sigma_line_px[rows],
            self.sigma_sample_px[rows],
        )


@dataclass(frozen=True, eq=False)
class ExtraObservation:
    """Observation with any registered equation, in addition to image points and control points.

    Parameters
    ----------
    equation : factors._contract.Equation
        Its residuals are whitened: one unit is one standard deviation.
    unknowns : tuple of str
        One unknown per argument of the equation: "image:left" (its coefficients in prior sigmas) or "point:12" (metres
        relative to the block's local origin, with axes parallel to ECEF).
    record : array
        Constants of the observation; see ``factors._contract``.
    setup : array or None
        Values shared by all observations of a group. None: the setup of the first named image, which contains the codes
        and prior sigmas of the unknowns in force (``ImageParameters.setup``).
    n_residuals : int
        Number of residuals.
    label : str
        Name in messages.

    Raises
    ------
    InputError
        The equation is not registered, the number of unknowns is not the number of its arguments, the record is short,
        or a value is impossible.
    """

    equation: Equation
    unknowns: tuple[str, ...]
    record: Array
    setup: Array | None
    n_residuals: int
    label: str

    def __post_init__(self) -> None:
        arguments = getattr(self.equation, "arguments", None)
        if arguments is None:
            raise arrays.wrong(f"{self.label}, equation", repr(self.equation), "a registered equation")
        unknowns = arrays.sequence(self.unknowns, f"{self.label}, unknowns")
        if len(unknowns) != len(arguments):
            raise arrays.wrong(f"{self.label}, unknowns", repr(unknowns), f"names of {len(arguments)} unknowns")
        for name in ("record",) if self.setup is None else ("record", "setup"):
            values = arrays.array(getattr(self, name), f"{self.label}, {name}")
            if not np.isfinite(values).all():
                raise arrays.wrong(f"{self.label}, {name}", "values that are not finite", "finite numbers")
        if np.size(self.record) < self.equation.n_constants:
            expected = f"at least the {self.equation.n_constants} constants of {self.equation.name}"
            raise arrays.wrong(f"{self.label}, record", f"{np.size(self.record)} numbers", expected)
        if self.n_residuals < 0:
            raise arrays.wrong(f"{self.label}, n_residuals", self.n_residuals, "a whole number from 0")


@dataclass(frozen=True)
class GroundSystem:
    """Coordinate reference system (CRS) and zero level of heights in which the ground points were given.

    Parameters
    ----------
    crs : str
        ``EPSG:n``, or ``EPSG:n+m`` with a vertical CRS; "" if the points have no CRS.
    geoid : str
        Path of the geoid file that defines the zero level; "" if there is none.
    undulation_m : float or None
        Constant height of the zero level above the WGS84 ellipsoid.
    """

    crs: str = ""
    geoid: str = ""
    undulation_m: float | None = None


@dataclass(frozen=True)
class Source:
    """Input file of the block, for the provenance record."""

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
        All ground points; ``observations.point`` contains row numbers of them. Coordinates of tie points are only start
        values; tie points without coordinates are intersected.
    observations : ImagePoints
    withheld : WithheldCoordinates
        Coordinates of the check points, sealed until the adjustment has converged.
    options : Options
    sources : tuple of Source
        Files from which the block was read; empty for a block made in memory.
    notes : tuple of Finding
        Remarks of the readers, shown in the report.
    extra : tuple of ExtraObservation, Constraint or gtsam.NonlinearFactor
        Further observations with any registered equation, constraints between ground points, or GTSAM factors between
        images and points; their keys come from :func:`fg_orient.factor_graph`.
    ground : GroundSystem
        CRS and zero level of the point table, for outputs.

    Raises
    ------
    InputError
        A part has another type, an image or point occurs twice, positions lie beyond the images or points, values are
        not finite, standard deviations are impossible, control points lack coordinates, or withheld points are unknown.
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

    def __post_init__(self) -> None:
        for place, kind in (
            ("points", GroundPoints),
            ("observations", ImagePoints),
            ("options", Options),
            ("withheld", WithheldCoordinates),
        ):
            if not isinstance(getattr(self, place), kind):
                raise arrays.wrong(place, type(getattr(self, place)).__name__, kind.__name__)
        _set(self, images=arrays.sequence(self.images, "images"), extra=arrays.sequence(self.extra, "extra"))
        others = np.array([not isinstance(image, Image) for image in self.images], bool)
        arrays.refuse(others, "images", self.images, "an Image")
        arrays.names([image.id for image in self.images], "images")
        for name, count in (("image", len(self.images)), ("point", len(self.points.ids))):
            positions = getattr(self.observations, name)
            arrays.require_positions(positions, f"observations.{name}", f"{name}s", count)
        for part in (self.points, self.observations):
            _ = part.require_possible
        foreign = set(self.withheld.ids).difference(self.points.ids) if self.withheld.ids else set()
        if foreign:
            raise arrays.wrong("withheld", min(foreign), "ids of the block's points")

    def __repr__(self) -> str:
        counts = f"{len(self.images)} images, {len(self.points.ids)} points, {len(self.observations)} image points"
        return f"<Block {self.name[:60]}: {counts}>"

    def require_adjustable(self) -> None:
        """Raise InputError if there are no images, or if a sensor cannot be adjusted."""
        if not self.images:
            raise arrays.wrong("images", 0, "one or more")
        for image in self.images:
            image.require_model()

    @property
    def georeferenced(self) -> bool:
        """True for Earth-fixed coordinates, False for metres of a local Cartesian system."""
        return all(image.sensor.georeferenced for image in self.images)

    @property
    def body(self) -> Body | None:
        """Body other than the Earth on which the ground points lie; InputError if the images lie on different ones."""
        bodies = [image.sensor.body for image in self.images]
        first = bodies[0] if bodies else None
        for image, body in zip(self.images, bodies, strict=True):
            if (body is None) != (first is None) or (body is not None and first is not None and not body.same(first)):
                value = "the Earth or a local system" if body is None else body.name
                raise InputError.of("body.mixed", place=f"image {image.id}", value=value)
        return first

    def image_index(self, image_id: str) -> int:
        """Return the index of the image with this id."""
        return [image.id for image in self.images].index(image_id)

    def find(self, name: str) -> tuple[str, int] | None:
        """Return kind ("image", "point") and position of a name such as "image:left" or "point:12".

        None if it is unknown.
        """
        kind, _, identifier = name.partition(":")
        ids = {"image": tuple(image.id for image in self.images), "point": self.points.ids}.get(kind, ())
        return (kind, ids.index(identifier)) if identifier in ids else None
