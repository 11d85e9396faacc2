"""Bundle adjustment of close range: self-calibration, observed unknowns, constraints; dense or as a graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.cameras.extended_collinearity import NAMES
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.loop import OPTIMIZERS, Callback, LoopResult
from fg_orient.adjustment.network import DenseNetwork, GraphNetwork, Network, bordered_inverse
from fg_orient.closerange.bundle_checks import (
    HELD,
    missed_most,
    require_consistent,
    require_determined,
    require_independent,
    require_rays,
    require_slopes,
)
from fg_orient.closerange.bundle_network import Built, build
from fg_orient.closerange.bundle_quality import Quality, quality_of
from fg_orient.closerange.constraints import FITTED_FIRST, Constraint
from fg_orient.closerange.fitting import as_points, require_sigmas, unit_weight
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Residual = Literal["image", "condition"]

BACKENDS: Final[dict[str, Callable[[Network], Any]]] = {"dense": DenseNetwork, "graph": GraphNetwork}
MAX_ITERATIONS: Final = 100
#: Step that ends the iteration, at rounding level: metres, radians, and units of camera parameters.
TOLERANCE: Final = 1e-12


@dataclass(frozen=True)
class BundlePhoto:
    """Photo of a bundle: start values, unknowns and observations.

    Parameters
    ----------
    name : str
    interior : PhotoInterior
        Start values.
    rotation : (3, 3) array
        Start: camera axes from ground axes.
    centre_m : (3,) array
        Start.
    unknown : tuple of str
        Camera parameters of this photo alone (photo-variant): c, x0, y0, the names of
        ``factors.cameras.image_corrections``, a1 to a21 of ``factors.cameras.additional_parameters``, and the names of
        ``factors.cameras.image_variants``, relative to the radius of the camera's outermost image point.
        ``closerange.corrections`` has sets of them.
    camera : str
        Photos of one camera have its ``shared`` unknowns in common.
    shared : tuple of str
        Unknown parameters of the camera (block-invariant), with start values of its first photo.
    observed : mapping
        Observed camera parameters, value and sigma, by name; shared ones once per camera.
    sigma_centre_m : (3,) array, optional
        The centre is observed: ``observed_centre_m``, by default the start.
    sigma_turn_rad : (3,) array, optional
        The start attitude is observed: rotations about the camera's axes X right, Y down, Z along the view.
    held : bool
        Rotation and centre are exact.
    observed_centre_m : (3,) array, optional
        Observed centre, if it is not the start.
    """

    name: str
    interior: PhotoInterior
    rotation: Array
    centre_m: Array
    unknown: tuple[str, ...] = ()
    camera: str = ""
    shared: tuple[str, ...] = ()
    observed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sigma_centre_m: Array | None = None
    sigma_turn_rad: Array | None = None
    held: bool = False
    observed_centre_m: Array | None = None

    def __post_init__(self) -> None:
        names = (*self.unknown, *self.shared)
        for name in (n for n in names if n not in NAMES or names.count(n) > 1):
            raise self.fault(f"unknown {name}", name, f"different ones of {', '.join(NAMES)}")
        for name, (value, sigma) in self.observed.items():
            if name not in names or not (np.isfinite(value) and 0.0 < sigma < float("inf")):
                raise self.fault(f"observed {name}", f"{value} +- {sigma}", "value and sigma of unknown parameters")
        for place in ("sigma_centre_m", "sigma_turn_rad"):
            given = getattr(self, place)
            if given is not None:
                spread = np.broadcast_to(np.asarray(given, float), (3,))
                if not (np.isfinite(spread).all() and (spread > 0.0).all()):
                    raise self.fault(place, spread.tolist(), "numbers above 0")
                object.__setattr__(self, place, spread)
        if self.observed_centre_m is not None:
            seen = np.asarray(self.observed_centre_m, float)
            if self.sigma_centre_m is None or seen.shape != (3,) or not np.isfinite(seen).all():
                raise self.fault("observed_centre_m", seen.tolist(), "three numbers, together with sigma_centre_m")
            object.__setattr__(self, "observed_centre_m", seen)

    @property
    def key(self) -> str:
        """Name of its camera, by default of the photo."""
        return self.camera or self.name

    def fault(self, place: str, value: object, expected: str) -> InputError:
        """Error of the photo."""
        return InputError.of("closerange.bundle", place=f"photo {self.name}, {place}", value=value,
                             expected=expected)  # type: ignore[return-value]  # fmt: skip


@dataclass(frozen=True)
class Adjustment:
    """Adjusted photo or figure: names (k), values (k,), their cofactors (k,) and standard deviations (k,).

    Cofactors times m0 squared are variances. Without redundancy ``sigma`` is None.
    """

    name: str
    names: tuple[str, ...]
    values: Array
    cofactors: Array
    sigma: Array | None

    def __getitem__(self, name: str) -> tuple[float, float | None]:
        """Value and standard deviation of one number."""
        k = self.names.index(name)
        return float(self.values[k]), None if self.sigma is None else float(self.sigma[k])


@dataclass(frozen=True)
class BundleResult:
    """Result of :func:`adjust_bundle`.

    Parameters
    ----------
    photos : tuple of Adjustment
        Camera parameters by name, then ``turn_x, turn_y, turn_z`` (rad, about the camera's axes, from the start) and
        ``X0, Y0, Z0`` (m).
    cameras : tuple of Adjustment
        Shared parameters of the cameras.
    interiors, rotations, centres_m
        Of the photos. An interior contains the corrections of :class:`PhotoInterior`: k1 to affinity_b.
    ids : tuple of str
        Of the points.
    points_m, sigma_m : (n, 3) arrays
        ``sigma_m`` is None without redundancy, 0 for a fixed point.
    figures : tuple of Adjustment
    residuals : (m, 2) array
        Computed minus ideal image coordinates, in the order of the observations and in their unit (times metres for
        residuals of conditions).
    state : (u,) array
    labels : tuple of str
        Of the unknowns.
    cofactors : (u,) array
        Diagonal, for the given sigmas.
    m0 : float or None
    redundancy, iterations : int
        Iterations with all constraints; iterations without spheres and spheroids are not counted.
    backend : str
    quality : Quality
        Redundancy numbers, covariances, weak directions.
    """

    photos: tuple[Adjustment, ...]
    cameras: tuple[Adjustment, ...]
    interiors: tuple[PhotoInterior, ...]
    rotations: tuple[Array, ...]
    centres_m: tuple[Array, ...]
    ids: tuple[str, ...]
    points_m: Array
    sigma_m: Array | None
    figures: tuple[Adjustment, ...]
    residuals: Array
    state: Array
    labels: tuple[str, ...]
    cofactors: Array
    m0: float | None
    redundancy: int
    iterations: int
    backend: str
    quality: Quality

    @property
    def beyond(self) -> list[str]:
        """Camera parameters that a photo file cannot contain."""
        names = (name for part in (*self.photos, *self.cameras) for name in part.names)
        return list(dict.fromkeys(name for name in names if name in NAMES[10:]))

    def oriented(self) -> list[Photo]:
        """Photos for intersection.

        Raises
        ------
        InputError
            Cameras have parameters that a photo file cannot contain.
        """
        if self.beyond:
            raise InputError.of("closerange.bundle", place="photos", value=", ".join(self.beyond),
                                expected="corrections that a photo file can hold: k1 to affinity_b")  # fmt: skip
        parts = zip(self.photos, self.interiors, self.rotations, self.centres_m, strict=True)
        return [Photo.of(photo.name, interior, turn, centre) for photo, interior, turn, centre in parts]


def adjust_bundle(
    photos: Sequence[BundlePhoto], ids: Sequence[str], start_m: npt.ArrayLike, photo: npt.ArrayLike,
    point: npt.ArrayLike, image: npt.ArrayLike, *, sigma: npt.ArrayLike = 1.0,
    control: Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]] | None = None, constraints: Sequence[Constraint] = (),
    residual: Residual = "image", backend: str = "dense", optimizer: str = "levenberg-marquardt",
    callback: Callback | None = None,
) -> BundleResult:  # fmt: skip
    """Adjust photos and points together.

    Parameters
    ----------
    photos : sequence of BundlePhoto
    ids : sequence of str
        Of the points.
    start_m : (n, 3) array
        Start coordinates.
    photo, point : (m,) int arrays
        Photo and point of each observation, from 0.
    image : (m, 2) array
        Measured x, y.
    sigma : float or array that fits (m, 2)
        Of the corrected image coordinates; of the conditions (image unit times m) with ``residual="condition"``.
    control : mapping, optional
        Observed points: coordinates and sigmas, m; sigma 0: held.
    constraints : sequence of Constraint
    residual : "image" or "condition"
        Least squares of the image residuals, or of the conditions F = e R3 (Ayhan 1996, eq. 77), with weights that do
        not depend on the depth.
    backend : "dense" or "graph"
        Normal equations bordered by hard constraints, with correlates; or a GTSAM graph, hard constraints as factors
        of sigma 0.
    optimizer : str
        "levenberg-marquardt" or "gauss-newton".
    callback : callable, optional
        Called with an ``IterationRecord`` after each iteration.

    Returns
    -------
    BundleResult

    Raises
    ------
    InputError
        Invalid sizes or values; points without two rays; undetermined motions of the whole block; other undetermined
        unknowns (without a prior their standard deviation exceeds 1000 times that of their observations), named with
        their direction; hard constraints that depend on or contradict each other; more than 2000 unknowns.
    NoSolutionError
        The iteration does not converge, or a point lies behind a photo.
    """
    if backend not in BACKENDS:
        raise InputError.of("closerange.backend", place="backend", value=backend, known=", ".join(BACKENDS))
    measured = as_points(image, 2, "image")
    given = np.broadcast_to(np.asarray(sigma, float), measured.shape)
    require_sigmas(given)
    which, of = np.asarray(photo, np.intp), np.asarray(point, np.intp)
    with one_blas_thread():
        start = as_points(start_m, 3, "points")

        def made(stated: Sequence[Constraint], begin: tuple[Built, Array] | None = None) -> Built:
            return build(photos, tuple(ids), start, which, of, measured, given, control or {}, stated,
                         residual == "condition", begin)  # fmt: skip

        # Inaccurate start points do not determine spheres and spheroids, although their rays do. From such a start a
        # figure of small sigma is a narrow bent valley with many small damped steps. So begin without these figures.
        others, begin = [c for c in constraints if c.kind not in FITTED_FIRST], None
        if len(others) < len(constraints):
            with suppress(FgOrientError):
                free = made(others)
                _require_possible(free, which, of)
                begin = free, _solved(free, DenseNetwork(free.network), optimizer, None).state
        built = made(constraints, begin)
        _require_possible(built, which, of)
        engine = BACKENDS[backend](built.network)
        return _result(built, engine, _solved(built, engine, optimizer, callback), which, of, given)


def _require_possible(built: Built, which: Index, of: Index) -> None:
    """Refuse too many unknowns, and points without rays."""
    if built.network.n_unknowns > MAX_UNKNOWNS:
        raise InputError.of("linear.too_large", place="bundle", value=built.network.n_unknowns, limit=MAX_UNKNOWNS)
    require_rays(built, which, of)


def _solved(built: Built, engine: Any, optimizer: str, callback: Callback | None) -> LoopResult[Array]:
    """Result of the loop; start and end must determine all unknowns."""
    network = built.network
    try:
        rows = network.rows(network.start)
        require_slopes(network, rows)
        require_independent(network, rows)
        require_determined(built, rows)
        run: LoopResult[Array] = OPTIMIZERS[optimizer](
            engine, network.start, MAX_ITERATIONS, callback, tolerance=TOLERANCE
        )
        if not run.converged:
            raise _not_converged(network, run.end.message)
        rows = network.rows(run.state)
        if len(rows.condition) and np.abs(rows.condition).max() > HELD:
            raise _not_converged(network, "hard constraints are not satisfied where the steps end")
        require_slopes(network, rows)
        require_independent(network, rows)  # some depend on others only where these are satisfied
        require_determined(built, rows)
    except (NotFiniteError, RuntimeError) as error:
        raise _not_converged(network, str(error)) from error
    return run


def _not_converged(network: Network, reason: str) -> NoSolutionError:
    """Error with the reason and the hard constraint of the largest misclosure; InputError if they are contradictory."""
    require_consistent(network)
    reason += missed_most(network)
    return NoSolutionError.of("closerange.not_converged", place="bundle", reason=reason)  # type: ignore[return-value]


def _result(built: Built, engine: Any, run: LoopResult[Array], which: Index, of: Index, sigma: Array) -> BundleResult:
    network, state = built.network, run.state
    rows = network.rows(state)
    built.require_in_front(state, which, of)
    m0 = unit_weight(float(rows.residual @ rows.residual), network.redundancy)
    whole = bordered_inverse(rows)
    is_dense = isinstance(engine, DenseNetwork)
    variances = whole.diagonal() if is_dense else np.concatenate([q.diagonal() for q in engine.cofactors(state)])
    cofactors = np.maximum(variances, 0.0)  # hard conditions give variances of 0, which rounding can make negative
    scaled = cofactors * built.steps**2
    values, every = built.values(state), np.arange(network.n_unknowns)

    def of_variables(name: str, numbers: Sequence[int]) -> Adjustment:
        labels = tuple(label for k in numbers for label in network.variables[k].labels)
        mine = np.concatenate([np.zeros(0, np.intp), *(every[network.part(k)] for k in numbers)])
        return Adjustment(name, labels, values[mine], scaled[mine], None if m0 is None else m0 * np.sqrt(scaled[mine]))

    points, spread = built.start.copy(), np.zeros_like(built.start)
    for j, k in built.point_variables.items():
        points[j], spread[j] = values[network.part(k)], scaled[network.part(k)]
    interiors, rotations, centres = built.oriented(state)
    return BundleResult(
        tuple(of_variables(p.name, ks) for p, ks in zip(built.photos, built.photo_variables, strict=True)),
        tuple(of_variables(name, [k]) for name, k in built.camera_variables.items()),
        tuple(interiors), tuple(rotations), tuple(centres), built.ids, points,
        None if m0 is None else m0 * np.sqrt(spread),
        tuple(of_variables(network.variables[k].name, [k]) for k in built.figure_variables),
        rows.residual[: 2 * len(of)].reshape(-1, 2) * sigma, state, tuple(network.labels), cofactors, m0,
        network.redundancy, len(run.log), engine.name, quality_of(built, rows, whole, rotations, run.log),
    )  # fmt: skip
