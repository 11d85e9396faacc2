"""Bundle of close range: self-calibration, observed unknowns, constraints, as a block of the common adjustment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.constraint_rows import ConstraintObservation, FittedFigure
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.loop import Callback, IterationRecord
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import bundle_checks as checks
from fg_orient.closerange.bundle_block import CENTRE, POINT, TURNS, Built, build
from fg_orient.closerange.corrections import NAMES
from fg_orient.closerange.fitting import as_points, require_sigmas, unit_weight
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.block import Options
from fg_orient.model.constraint import Constraint
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import Status
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.sensors.frame import opk_of_rotation

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Residual = Literal["image", "condition"]

BACKENDS: Final = ("auto", "dense", "graph")
MAX_ITERATIONS: Final = 100


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
    solution : Solution
        Of the common adjustment, whose images are the photos.
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
    solution: Solution

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
    residual: Residual = "image", backend: str = "auto", optimizer: str = "levenberg-marquardt",
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
    backend : "auto", "dense" or "graph"
        Full matrices, or GTSAM; auto: full matrices up to 2000 unknowns.
    optimizer : str
        "levenberg-marquardt", "gauss-newton" or "dogleg".
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
        their direction; hard constraints that depend on or contradict each other; more than 2000 unknowns of
        full matrices.
    NoSolutionError
        The iteration does not converge, or a point lies behind a photo.
    """
    if backend not in BACKENDS:
        raise InputError.of("closerange.backend", place="backend", value=backend, known=", ".join(BACKENDS))
    measured = as_points(image, 2, "image")
    given = np.broadcast_to(np.asarray(sigma, float), measured.shape)
    require_sigmas(given)
    which, of = np.asarray(photo, np.intp), np.asarray(point, np.intp)
    n_unknowns = 3 * len(ids) + sum(6 + len(p.unknown) for p in photos)
    chosen = backend if backend != "auto" else "dense" if n_unknowns <= MAX_UNKNOWNS else "graph"
    options = Options(backend=chosen, optimizer=optimizer, priors=False, max_iterations=MAX_ITERATIONS)  # type: ignore[arg-type]
    with one_blas_thread():
        start = as_points(start_m, 3, "points")
        built = build(photos, tuple(ids), start, which, of, measured, given, control or {}, constraints,
                      residual == "condition", options)  # fmt: skip
        return _result(built, _solved(built, callback), given)


def _solved(built: Built, callback: Callback | None) -> Solution:
    """Solution of the block; start and end must determine all unknowns."""
    checks.require_rays(built)
    problem = built.problem
    few = problem.n_unknowns <= MAX_UNKNOWNS
    if few:
        checks.require_determined(built, problem.start)
    solution = adjust(built.block, callback=callback)
    if solution.status is Status.NOT_CONVERGED:
        raise NoSolutionError.of("closerange.not_converged", place="bundle", reason=solution.ended + built.missed())
    if few:
        checks.require_determined(built, solution.state)
    if solution.cofactors is None:
        raise NoSolutionError(*solution.unavailable)
    built.require_in_front(solution.state)
    return solution


def _result(built: Built, solution: Solution, sigma: Array) -> BundleResult:
    problem, state, m0 = solution.problem, solution.state, unit_weight(solution.chi2, solution.redundancy)
    figures, z = built.figures(problem, state), len(built.owners)
    orientation = _orientation(built, solution, figures)
    origin = dict(zip("xyz", problem.origin_m.tolist(), strict=True))
    shapes = [f.values + [origin.get(name, 0.0) for name in f.names] for f in figures]
    labels = [*built.labels[:z], *(f"{f.label} {name}" for f in figures for name in f.names)]
    units = _units(built, solution, figures)
    checks.require_figures(labels[z:], np.sqrt(np.abs(orientation.diagonal()[z:])) / units[z:])
    variance = dict(zip(labels, np.maximum(orientation.diagonal(), 0.0).tolist(), strict=True))

    def adjusted(owner: str, names: Sequence[str], values: Sequence[float]) -> Adjustment:
        q = np.array([variance[f"{owner} {name}"] for name in names])
        name = owner.partition(" ")[2] if owner.startswith(("photo ", "camera ")) else owner
        return Adjustment(name, tuple(names), np.array(values, float), q, None if m0 is None else m0 * np.sqrt(q))

    def camera(k: int, names: Sequence[str]) -> list[float]:
        return [built.parameter(k, name, state) for name in names]

    rotations = [built.rotation(k, state) for k in range(len(built.photos))]
    centres, photos, cameras = [built.centre(k, state) for k in range(len(built.photos))], [], dict[str, Adjustment]()
    of_angles = np.zeros((len(rotations), 3, 3))
    for k, photo in enumerate(built.photos):
        place = () if photo.held else (*TURNS, *CENTRE)
        turns = [] if photo.held else [*built.turn(k, state), *centres[k]]
        photos.append(adjusted(f"photo {photo.name}", (*photo.unknown, *place), [*camera(k, photo.unknown), *turns]))
        if photo.shared and photo.key not in cameras:
            cameras[photo.key] = adjusted(f"camera {photo.key}", photo.shared, camera(k, photo.shared))
        if not photo.held:
            by, rows = (
                np.degrees(opk_of_rotation(rotations[k])[1]),
                [labels.index(f"photo {photo.name} {t}") for t in TURNS],
            )
            of_angles[k] = by @ orientation[np.ix_(rows, rows)] @ by.T
    points, of_points = solution.ground_m.copy(), np.zeros((len(built.ids), 3, 3))
    active = np.flatnonzero(problem.active)
    assert solution.cofactors is not None  # required before
    of_points[active] = solution.cofactors.points(active)
    spread = np.maximum(np.einsum("nii->ni", of_points), 0.0)
    residuals = solution.residual_cofactors
    others, whitened, redundancy = _others(built, solution)
    steps, shape_values = built.steps, np.concatenate([np.zeros(0), *shapes])
    shape_variance = np.array([variance[label] for label in labels[z:]])
    return BundleResult(
        photos=tuple(photos), cameras=tuple(cameras.values()),
        figures=tuple(adjusted(f.label, f.names, values.tolist()) for f, values in zip(figures, shapes, strict=True)),
        interiors=tuple(built.interior(k, state) for k in range(len(rotations))), rotations=tuple(rotations),
        centres_m=tuple(centres), ids=built.ids, points_m=points, sigma_m=None if m0 is None else m0 * np.sqrt(spread),
        residuals=residuals.v_image[:, ::-1] * sigma,
        state=np.concatenate([problem.image_vector(state), state.ground[active].ravel(), shape_values]),
        labels=(*built.labels, *labels[z:]),
        cofactors=np.concatenate([np.maximum(orientation.diagonal()[:z], 0.0) / steps[:z] ** 2, spread[active].ravel(),
                                  shape_variance]),
        m0=m0, redundancy=solution.redundancy, iterations=len(solution.log), backend=solution.backend,
        history=solution.log, redundancy_numbers=np.einsum("nii->ni", residuals.image)[:, ::-1],
        others=others, others_whitened=whitened, others_redundancy=redundancy, point_cofactors=of_points,
        angle_cofactors=of_angles, orientation=orientation, orientation_labels=tuple(labels),
        orientation_units=units, solution=solution,
    )  # fmt: skip


def _orientation(built: Built, solution: Solution, figures: Sequence[FittedFigure]) -> Array:
    """Joint cofactors (o, o) of the unknowns of the photos, shared ones once, and of the figures, in their units."""
    problem, z = solution.problem, len(built.owners)
    named = tuple(sorted({j for f in figures for j in f.points if problem.active[j]}))
    assert solution.cofactors is not None
    joint = solution.cofactors.joint(tuple(range(problem.n_images)), named)
    rows = np.arange(z) if problem.ties is None else problem.ties.place
    rows = np.concatenate([rows, problem.n_image_unknowns + np.arange(3 * len(named))]).astype(np.intp)
    size = z + sum(len(f.names) for f in figures)
    by, own, first = np.zeros((size, len(rows))), np.zeros((size, size)), z
    by[:z, :z] = np.diag(built.steps[:z])
    for f in figures:
        part = slice(first, first + len(f.names))
        for i, j in enumerate(f.points):
            if problem.active[j]:
                by[part, z + 3 * named.index(j) :][:, :3] = f.by[:, 3 * i : 3 * i + 3]
        own[part, part], first = f.own, part.stop
    return np.asarray(own + by @ joint[np.ix_(rows, rows)] @ by.T)


def _units(built: Built, solution: Solution, figures: Sequence[FittedFigure]) -> Array:
    """Accuracy (o,) of the orientation from one image point; a figure has that of its points."""
    z, units = len(built.owners), built.units(solution.state)
    typical = float(np.median(units[z:])) if len(units) > z else 1.0
    away = solution.ground_m - solution.ground_m.mean(axis=0)
    extent = float(np.linalg.norm(away, axis=1).max()) or 1.0
    shapes = [typical / extent if name.startswith(("tilt", "slope")) else typical for f in figures for name in f.names]
    return np.concatenate([units[:z] * built.steps[:z], shapes])


def _others(built: Built, solution: Solution) -> tuple[tuple[str, ...], Array, Array]:
    """Names of the soft observations that are no image points, whitened residuals and redundancy numbers (k,)."""
    problem, residuals = solution.problem, solution.residual_cofactors
    parts: dict[bool, list[tuple[str, float, float]]] = {False: [], True: []}
    for e, numbers in zip(problem.block.extra, residuals.extra, strict=True):
        if isinstance(e, ConstraintObservation) and e.hard:
            continue
        value, _ = extra_blocks(problem, e, solution.state, jacobian=False)
        names = [e.label] if e.n_residuals == 1 else [f"{e.label}, {k + 1}" for k in range(e.n_residuals)]
        parts[isinstance(e, ConstraintObservation)] += zip(names, value.tolist(), numbers.tolist(), strict=True)
    control = [f"point {built.ids[j]}: control, {axis}" for j in np.flatnonzero(problem.observed) for axis in POINT]
    of_control = zip(control, residuals.v_control.ravel().tolist(),
                     np.einsum("nii->ni", residuals.control).ravel().tolist(), strict=True)  # fmt: skip
    every = [*parts[False], *of_control, *parts[True]]
    return tuple(name for name, _, _ in every), np.array([v for _, v, _ in every]), np.array([r for *_, r in every])
