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
from fg_orient.adjustment.constraint_kinds import Constraint
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.loop import OPTIMIZERS, Callback, IterationRecord, LoopResult
from fg_orient.adjustment.network import DenseNetwork, GraphNetwork, Network, NetworkRows, bordered_inverse
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import bundle_checks as checks
from fg_orient.closerange.bundle_network import Built, build
from fg_orient.closerange.constraints import FITTED_FIRST
from fg_orient.closerange.fitting import as_points, require_sigmas, unit_weight
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError
from fg_orient.sensors.frame import opk_of_rotation

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


@dataclass(frozen=True, eq=False)
class BundleResult:
    """Result of :func:`adjust_bundle`; cofactors are for the given sigmas.

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
        Diagonal.
    m0 : float or None
    redundancy, iterations : int
        Iterations with all constraints; iterations without spheres and spheroids are not counted.
    backend : str
    history : tuple of IterationRecord
    redundancy_numbers : (m, 2) array
        Of the image coordinates.
    others, others_whitened, others_redundancy
        Names (k) of other soft observations, element by element; their whitened residuals and redundancy numbers (k,).
    point_cofactors, angle_cofactors : (n, 3, 3), (p, 3, 3) arrays
        Of the points, m^2; of omega, phi, kappa of the photos, deg^2; 0 for fixed ones.
    orientation, orientation_labels : (o, o) array, tuple of str
        Cofactors and names of all unknowns except those of points.
    orientation_units : (o,) array
        Accuracy of these from one image point; an unknown that is 1000 times less accurate is not determined.
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
    history: tuple[IterationRecord, ...]
    redundancy_numbers: Array
    others: tuple[str, ...]
    others_whitened: Array
    others_redundancy: Array
    point_cofactors: Array
    angle_cofactors: Array
    orientation: Array
    orientation_labels: tuple[str, ...]
    orientation_units: Array

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
    checks.require_rays(built, which, of)


def _solved(built: Built, engine: Any, optimizer: str, callback: Callback | None) -> LoopResult[Array]:
    """Result of the loop; start and end must determine all unknowns."""
    network = built.network
    try:
        _require_regular(built, network.rows(network.start))
        run: LoopResult[Array] = OPTIMIZERS[optimizer](
            engine, network.start, MAX_ITERATIONS, callback, tolerance=TOLERANCE
        )
        if not run.converged:
            raise _not_converged(network, run.end.message)
        rows = network.rows(run.state)
        if len(rows.condition) and np.abs(rows.condition).max() > checks.HELD:
            raise _not_converged(network, "hard constraints are not satisfied where the steps end")
        _require_regular(built, rows)
    except (NotFiniteError, RuntimeError) as error:
        raise _not_converged(network, str(error)) from error
    return run


def _require_regular(built: Built, rows: NetworkRows) -> None:
    """Refuse dependent constraints and undetermined unknowns.

    Some constraints depend on others only at a state that satisfies these: start and end are checked.
    """
    checks.require_slopes(built.network, rows)
    checks.require_independent(built.network, rows)
    checks.require_determined(built, rows)


def _not_converged(network: Network, reason: str) -> NoSolutionError:
    """Error with the reason and the hard constraint of the largest misclosure; InputError if they are contradictory."""
    checks.require_consistent(network)
    reason += checks.missed_most(network)
    return NoSolutionError.of("closerange.not_converged", place="bundle", reason=reason)  # type: ignore[return-value]


def _result(built: Built, engine: Any, run: LoopResult[Array], which: Index, of: Index, sigma: Array) -> BundleResult:
    network, state, n = built.network, run.state, 2 * len(of)
    rows = network.rows(state)
    built.require_in_front(state, which, of)
    m0 = unit_weight(float(rows.residual @ rows.residual), network.redundancy)
    whole = bordered_inverse(rows)
    is_dense = isinstance(engine, DenseNetwork)
    variances = whole.diagonal() if is_dense else np.concatenate([q.diagonal() for q in engine.cofactors(state)])
    cofactors = np.maximum(variances, 0.0)  # hard conditions give variances of 0, which rounding can make negative
    scaled, values = cofactors * built.steps**2, built.values(state)

    def adjusted(name: str, numbers: Sequence[int]) -> Adjustment:
        labels = tuple(label for k in numbers for label in network.variables[k].labels)
        mine = built.elements(numbers)
        return Adjustment(name, labels, values[mine], scaled[mine], None if m0 is None else m0 * np.sqrt(scaled[mine]))

    points, spread = built.start.copy(), np.zeros_like(built.start)
    of_points = np.zeros((len(points), 3, 3))
    for j, k in built.point_variables.items():
        part = network.part(k)
        points[j], spread[j], of_points[j] = values[part], scaled[part], whole[part, part]
    interiors, rotations, centres = built.oriented(state)
    of_angles = np.zeros((len(rotations), 3, 3))
    for j, (turn, rotation) in enumerate(zip(built.turns, rotations, strict=True)):
        if not isinstance(turn, np.ndarray):
            by, part = np.degrees(opk_of_rotation(rotation)[1]), network.part(turn)
            of_angles[j] = by @ whole[part, part] @ by.T
    numbers = 1.0 - np.einsum("ij,ij->i", rows.design @ whole, rows.design)
    others = [o.label if o.n_residuals == 1 else f"{o.label}, {element}" for o in network.observations if not o.hard
              for element in ("XYZ" if o.n_residuals == 3 else range(1, o.n_residuals + 1))][n:]  # fmt: skip
    where = built.elements(sorted({*range(len(network.variables))} - {*built.point_variables.values()}))
    steps = built.steps[where]
    return BundleResult(
        photos=tuple(adjusted(p.name, ks) for p, ks in zip(built.photos, built.photo_variables, strict=True)),
        cameras=tuple(adjusted(name, [k]) for name, k in built.camera_variables.items()),
        figures=tuple(adjusted(network.variables[k].name, [k]) for k in built.figure_variables),
        interiors=tuple(interiors), rotations=tuple(rotations), centres_m=tuple(centres),
        ids=built.ids, points_m=points, sigma_m=None if m0 is None else m0 * np.sqrt(spread),
        residuals=rows.residual[:n].reshape(-1, 2) * sigma, state=state, labels=tuple(network.labels),
        cofactors=cofactors, m0=m0, redundancy=network.redundancy, iterations=len(run.log),
        backend=engine.name, history=run.log, redundancy_numbers=numbers[:n].reshape(-1, 2),
        others=tuple(others), others_whitened=rows.residual[n:], others_redundancy=numbers[n:],
        point_cofactors=of_points, angle_cofactors=of_angles,
        orientation=whole[np.ix_(where, where)] * np.outer(steps, steps),
        orientation_labels=tuple(network.labels[k] for k in where),
        orientation_units=built.units(rows)[where] * steps,
    )  # fmt: skip
