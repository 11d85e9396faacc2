"""The data model of an adjustment: images, ground points, image points. Immutable, arrays included.

A :class:`Block` holds what is known before the adjustment. The coordinates of **check
points** are not in :class:`GroundPoints` (their rows are nan): they stay sealed in
:class:`WithheldCoordinates` and are opened by the accuracy assessment after convergence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError, Problem, problem
from fg_orient.names import Role

if TYPE_CHECKING:
    from factors._contract import Equation
    from fg_orient.sensors.correction import HeightSurface

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
CheckPoints = Literal["use", "exclude"]
RpcCompensation = Literal["shift", "shift_drift", "affine"]
Datum = Literal["control", "priors", "free"]

#: Bounds of options, both ends included; the project file's schema takes them from here.
EOP_SET_RANGE: Final = (1, 20)
LOOK_DEGREE_RANGE: Final = (0, 5)
ITERATION_RANGE: Final = (1, 10_000)
_THREE: Final = "three numbers above zero: the sigmas of c0, c1, c2"
#: What each checked option must be, in words.
EXPECTED: Final = {
    "eop_set": f"a number from {EOP_SET_RANGE[0]} to {EOP_SET_RANGE[1]}",
    "look_polynomial": f"a degree from {LOOK_DEGREE_RANGE[0]} to {LOOK_DEGREE_RANGE[1]}; "
    "leave it out for no look-angle unknowns",
    "priors": "true or false",
    "position_sigma_m": f"{_THREE} in m",
    "velocity_sigma_m_s": f"{_THREE} in m/s",
    "attitude_sigma_rad": f"{_THREE} in rad",
    "look_sigma_rad": "a number above zero in rad",
    "rpc_compensation": " or ".join(f'"{word}"' for word in get_args(RpcCompensation)),
    "rpc_shift_sigma_px": "a number above zero in pixels",
    "rpc_linear_sigma_px": "a number above zero in pixels",
    "datum": " or ".join(f'"{word}"' for word in get_args(Datum)),
    "small_angle": "true or false",
    "solver": "the name of a linear solver in quotes; leave it out for the default",
    "loss": 'the name of a robust loss in quotes; "none" for least squares',
    "gnc": "true or false",
    "inlier_probability": "a number above 0 and below 1",
    "memory_limit_gb": "a number above zero in GB (1e9 bytes); leave it out for 80 % of what is available",
    "max_iterations": f"a whole number from {ITERATION_RANGE[0]} to {ITERATION_RANGE[1]}",
    "check_points": " or ".join(f'"{word}"' for word in get_args(CheckPoints)),
}


def _read_only(record: object, **kinds: type) -> None:
    """Replace arrays of a frozen record by read-only copies of the given types."""
    for name, kind in kinds.items():
        given = getattr(record, name)
        array: npt.NDArray[Any] = np.array(given, dtype=kind)
        array.setflags(write=False)
        object.__setattr__(record, name, array)


class Sensor(Protocol):
    """What every sensor can do: pixels (line, sample) with (0, 0) = centre of the first pixel, ECEF metres.

    ``correction`` is what the image's adjustment gives (``Solution.correction``); None is the metadata.
    """

    n_lines: int
    n_samples: int
    notes: tuple[str, ...]

    @property
    def georeferenced(self) -> bool:
        """Whether ground points are Earth-fixed; else metres of a local Cartesian system."""
        ...

    @property
    def file(self) -> str:
        """Name of the metadata file."""
        ...

    @property
    def centre_m(self) -> Array:
        """Ground point of the image centre, ECEF m (3,)."""
        ...

    def rays(self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: Any = None, /) -> tuple[Array, Array]:
        """Points on the lines of sight (N, 3) m, above the ground, and unit directions (N, 3), ECEF."""
        ...

    def project(self, ground_m: npt.ArrayLike, correction: Any = None, /) -> tuple[Array, Array]:
        """Line and sample (N,) of ECEF points (N, 3)."""
        ...

    def locate(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, /, *, height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None,
    ) -> Array:  # fmt: skip
        """Ground points (N, 3) ECEF m at ellipsoidal heights or on a DEM."""
        ...

    def is_inside(self, line: Array, sample: Array) -> npt.NDArray[np.bool_]:
        """Tell which pixels lie in the image."""
        ...

    def require_inside(self, line: Array, sample: Array) -> None:
        """Refuse pixels outside the image."""
        ...

    def footprint(self) -> Array:
        """Corners in image order: (4, 2) longitude, latitude in degrees."""
        ...


@dataclass(frozen=True)
class Image:
    """One image: its id and the sensor that binds its metadata to the equations."""

    id: str
    sensor: Sensor


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
    fixed: npt.NDArray[np.bool_]

    def __post_init__(self) -> None:
        _read_only(self, ecef_m=np.float64, sigma_enu_m=np.float64, fixed=np.bool_)


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
        Degree 0-5 of the look-angle correction polynomial; None = no such unknowns.
    priors : bool
        False leaves the orientation unknowns without prior observations.
    position_sigma_m, velocity_sigma_m_s, attitude_sigma_rad : tuple of 3 floats
        Prior sigmas of c0, c1, c2 of tau.
    look_sigma_rad : float
        Prior sigma of each coefficient of the look polynomial.
    rpc_compensation : str
        Image-space compensation of RPC images: "shift", "shift_drift" or "affine".
    rpc_shift_sigma_px, rpc_linear_sigma_px : float
        Prior sigmas of the shift, and of drift and affine terms at the ends of the image (there the model's
        normalised line or sample is -1 or 1), pixels. Vendor RPC of metre-resolution images are off by some
        ten pixels of shift and by a pixel or less in the other terms.
    datum : str
        "control": control points hold the block in the world, a block without any is refused; "priors": a
        relative adjustment, the priors hold it where no control point does; "free": nothing need hold it, the block
        stays near its start values (all steps are damped) and has no covariance.
    small_angle : bool
        True linearises the attitude rotation in its angles, as the publications do; False keeps it exact.
    backend : str
        "auto", "graph", "schur" or "dense"; judged when the block is adjusted. "auto" takes the Schur complement from
        100 image points on where it can, else the graph.
    solver : str or None
        Linear solver of the dense backend by its name in the registry; None = its default, "qr". Judged
        when the block is adjusted.
    optimizer : str
        "gauss-newton", "levenberg-marquardt", "dogleg" or "native"; judged when the block is adjusted.
    loss : str
        Robust loss of image points and control points by its name in the registry (``factors.losses``); "none" is
        least squares. Judged when the block is adjusted.
    gnc : bool
        Graduated non-convexity: the loss "tls" or "geman_mcclure" is approached in stages, so that many
        gross errors do not lead into a wrong minimum. Their limits then follow from ``inlier_probability``.
    inlier_probability : float
        Probability that a good observation lies within the limit of GNC (chi-square of its dimension).
    max_iterations : int
        Give up after so many, 1 to 10000.
    check_points : str
        "use": their rays take part; "exclude": left out, intersected afterwards.
    memory_limit_gb : float or None
        A run that needs more, in 1e9 bytes, is refused; None = 80 % of the available memory.

    Raises
    ------
    InputError
        One problem per value that is not possible.
    """

    eop_set: int = 15
    look_polynomial: int | None = None
    priors: bool = True
    position_sigma_m: tuple[float, float, float] = (10.0, 1.0, 0.1)
    velocity_sigma_m_s: tuple[float, float, float] = (1e-2, 1e-3, 1e-4)
    attitude_sigma_rad: tuple[float, float, float] = (50e-6, 10e-6, 2e-6)
    look_sigma_rad: float = 1e-4
    rpc_compensation: RpcCompensation = "shift"
    rpc_shift_sigma_px: float = 100.0
    rpc_linear_sigma_px: float = 10.0
    datum: Datum = "control"
    small_angle: bool = False
    backend: str = "auto"
    solver: str | None = None
    optimizer: str = "gauss-newton"
    loss: str = "none"
    gnc: bool = False
    inlier_probability: float = 0.99
    max_iterations: int = 50
    check_points: CheckPoints = "use"
    memory_limit_gb: float | None = None

    def __post_init__(self) -> None:
        problems: list[Problem] = []
        for name, expected in EXPECTED.items():
            value = getattr(self, name)
            if not _allowed(name, value):
                problems.append(problem("options.value", place=name, value=repr(value), expected=expected))
        if problems:
            raise InputError(*problems)


def _allowed(name: str, value: Any) -> bool:
    """Judge one option; what it must be stands in :data:`EXPECTED`."""
    match name:
        case "eop_set":
            return _whole(value, EOP_SET_RANGE)
        case "look_polynomial":
            return value is None or _whole(value, LOOK_DEGREE_RANGE)
        case "solver":
            return value is None or (isinstance(value, str) and bool(value))
        case "memory_limit_gb":
            return value is None or _positive(value)
        case "max_iterations":
            return _whole(value, ITERATION_RANGE)
        case "loss":
            return isinstance(value, str) and bool(value)
        case "inlier_probability":
            return _positive(value) and value < 1.0
        case "priors" | "small_angle" | "gnc":
            return isinstance(value, bool | np.bool_)
        case "check_points":
            return isinstance(value, str) and value in get_args(CheckPoints)
        case "rpc_compensation":
            return isinstance(value, str) and value in get_args(RpcCompensation)
        case "datum":
            return isinstance(value, str) and value in get_args(Datum)
        case "look_sigma_rad" | "rpc_shift_sigma_px" | "rpc_linear_sigma_px":
            return _positive(value)
    return isinstance(value, tuple | list) and len(value) == 3 and all(_positive(v) for v in value)


def _whole(value: Any, limits: tuple[int, int]) -> bool:
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return bool(is_whole and limits[0] <= value <= limits[1])


def _positive(value: Any) -> bool:
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return bool(is_number and 0.0 < value < np.inf)


@dataclass(frozen=True, eq=False)
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
    """Everything an adjustment starts from.

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
        Coordinates of the check points, not to be opened before the solution stands.
    options : Options
    sources : tuple of Source
        Files it was read from; empty for a block made in memory.
    notes : tuple of str
        Remarks of the readers, shown in the report.
    extra : tuple of ExtraObservation
        Further observations of any registered equation.
    """

    name: str
    images: tuple[Image, ...]
    points: GroundPoints
    observations: ImagePoints
    withheld: WithheldCoordinates
    options: Options = field(default_factory=Options)
    sources: tuple[Source, ...] = ()
    notes: tuple[str, ...] = ()
    extra: tuple[ExtraObservation, ...] = ()

    @property
    def georeferenced(self) -> bool:
        """Whether coordinates are Earth-fixed; else metres of a local Cartesian system."""
        return all(image.sensor.georeferenced for image in self.images)

    def image_index(self, image_id: str) -> int:
        """Position of the image with this id."""
        return [image.id for image in self.images].index(image_id)

    def find(self, name: str) -> tuple[str, int] | None:
        """Kind ("image", "point") and position of a name such as "image:left" or "point:12"; None if there is none."""
        kind, _, identifier = name.partition(":")
        ids = {"image": tuple(image.id for image in self.images), "point": self.points.ids}.get(kind, ())
        return (kind, ids.index(identifier)) if identifier in ids else None
