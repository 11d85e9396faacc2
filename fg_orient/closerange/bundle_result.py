"""Result of a bundle: photos, cameras, points and figures with cofactors, image points with residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.adjustment.constraint_rows import ConstraintObservation, FittedFigure
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.closerange import bundle_checks as checks
from fg_orient.closerange.bundle_block import CENTRE, POINT, TURNS, Built
from fg_orient.closerange.fitting import unit_weight
from fg_orient.closerange.photo import NAMES, Photo, PhotoInterior
from fg_orient.model.errors import InputError
from fg_orient.orientation.solution import Solution
from fg_orient.quality.elimination import control_residuals
from fg_orient.sensors.frame import opk_of_rotation


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
        """Return the value and standard deviation of one number."""
        k = self.names.index(name)
        return float(self.values[k]), None if self.sigma is None else float(self.sigma[k])


@dataclass(frozen=True, eq=False)
class BundleResult:
    """Result of :func:`adjust_bundle`; cofactors are for the given sigmas.

    Parameters
    ----------
    photos : tuple of Adjustment
        Camera parameters by name, then ``turn_x, turn_y, turn_z`` (rad, about the
        camera's axes, from the start) and ``X0, Y0, Z0`` (m).
    cameras : tuple of Adjustment
        Shared parameters of the cameras.
    interiors, rotations, centres_m
        Interior orientations, rotations and projection centres of the photos. An interior
        contains the corrections of :class:`PhotoInterior`: k1 to affinity_b.
    ids : tuple of str
        Ids of the points.
    points_m, sigma_m : (n, 3) arrays
        Coordinates and standard deviations of the points; ``sigma_m`` is None without
        redundancy, and 0 for a fixed point.
    figures : tuple of Adjustment
    residuals : (m, 2) array
        Computed minus ideal image coordinates, in the order of the observations and in
        their unit (times metres for residuals of conditions). Residuals of rejected
        observations are predicted; nan if their point has no position.
    image_sigma : (m, 2) array
        Standard deviations of the image coordinates: as given, or estimated by variance components.
    weights : (m,) array
        Weights of the image points: weights of the loss, 1 without a loss, 0 for observations that the
        search rejected.
    state : (u,) array
    labels : tuple of str
        Names of the unknowns.
    cofactors : (u,) array
        Diagonal of the cofactor matrix.
    m0 : float or None
        None without redundancy. Under a loss it is the scale of the loss: standard deviations are based
        on the given sigmas, or with ``robust_scale="mad"`` on the scatter of the residuals.
    redundancy, iterations : int
        Redundancy; number of iterations with all constraints (iterations without spheres
        and spheroids are not counted).
    backend : str
    history : tuple of IterationRecord
    redundancy_numbers : (m, 2) array
        Redundancy numbers of the image coordinates; nan for rejected ones.
    others, others_whitened, others_redundancy
        Names (k) of other soft observations, element by element; their whitened residuals
        and redundancy numbers (k,).
    point_cofactors, angle_cofactors : (n, 3, 3), (p, 3, 3) arrays
        Cofactors of the points, m^2, and of omega, phi, kappa of the photos, deg^2; 0 for fixed ones.
    orientation, orientation_labels : (o, o) array, tuple of str
        Cofactors and names of all unknowns except coordinates of points.
    orientation_units : (o,) array
        Accuracy of these unknowns from one image point; an unknown that is 1000 times
        less accurate is not determined.
    solution : Solution
        Solution of the common adjustment, whose images are the photos.
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
    image_sigma: Array
    weights: Array
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
    def rejected(self) -> Mask:
        """Image points (m,) that the search for gross errors rejected."""
        return np.asarray(self.weights == 0.0)

    @property
    def beyond(self) -> list[str]:
        """Camera parameters that a photo file cannot contain."""
        names = (name for part in (*self.photos, *self.cameras) for name in part.names)
        return list(dict.fromkeys(name for name in names if name in NAMES[10:]))

    def oriented(self) -> list[Photo]:
        """Return the photos for intersection.

        Raises
        ------
        InputError
            Cameras have parameters that a photo file cannot contain.
        """
        if self.beyond:
            raise InputError.of(
                "closerange.bundle",
                place="photos",
                value=", ".join(self.beyond),
                expected="corrections that a photo file can hold: k1 to affinity_b",
            )
        parts = zip(self.photos, self.interiors, self.rotations, self.centres_m, strict=True)
        return [Photo.of(photo.name, interior, turn, centre) for photo, interior, turn, centre in parts]


def without_rejected(built: Built, solution: Solution) -> Built:
    """Return the bundle of the last adjustment of a solution: without rejected observations, with estimated sigmas."""
    same = solution.block.observations is built.block.observations
    own = replace(built.block, observations=solution.block.observations, points=solution.block.points)
    return built if same else replace(built, block=own)


def _image_points(given: Built, solution: Solution) -> dict[str, Array]:
    """Return the fields of the result about all given image points."""
    o, kept = given.block.observations, np.arange(len(given.block.observations))
    if solution.snooping is not None:
        kept = np.array(solution.snooping.kept, np.intp)
    residuals, sigma = np.zeros((len(o), 2)), np.column_stack([o.sigma_sample_px, o.sigma_line_px])
    if len(kept) < len(o):
        residuals = given.problem.pixel_residuals(solution.state)[:, ::-1]
    weights, redundancy, used = np.zeros(len(o)), np.full((len(o), 2), np.nan), solution.problem.observations
    residuals[kept] = solution.residuals_px[:, ::-1]
    sigma[kept] = np.column_stack([used.sigma_sample_px, used.sigma_line_px])
    weights[kept] = 1.0 if solution.weights is None else solution.weights.image
    redundancy[kept] = np.einsum("nii->ni", solution.residual_cofactors.image)[:, ::-1]
    return {"residuals": residuals, "image_sigma": sigma, "weights": weights, "redundancy_numbers": redundancy}


def result_of(given: Built, solution: Solution) -> BundleResult:
    """Return the result of a bundle from the solution of its block."""
    problem, state, built = solution.problem, solution.state, without_rejected(given, solution)
    freedom = int(solution.redundancy)  # a whole number, because photos have no penalty
    m0 = unit_weight(solution.chi2, freedom)
    if m0 is not None and solution.weights is not None:
        m0 = solution.weights.scale[0]
    figures, z = built.figures(problem, state), len(built.owners)
    orientation = _orientation(built, solution, figures)
    origin = dict(zip("xyz", problem.origin_m.tolist(), strict=True))
    shapes = [f.values + [origin.get(name, 0.0) for name in f.names] for f in figures]
    labels = [*built.labels[:z], *(f"{f.label} {name}" for f in figures for name in f.names)]
    units = _units(built, solution, figures)
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
            by = np.degrees(opk_of_rotation(rotations[k])[1])
            rows = [labels.index(f"photo {photo.name} {t}") for t in TURNS]
            of_angles[k] = by @ orientation[np.ix_(rows, rows)] @ by.T
    points, of_points = solution.ground_m.copy(), np.zeros((len(built.ids), 3, 3))
    active = np.flatnonzero(problem.active)
    assert solution.cofactors is not None  # an earlier check has raised an error otherwise
    of_points[active] = solution.cofactors.points(active)
    spread = np.maximum(np.einsum("nii->ni", of_points), 0.0)
    found = np.concatenate([np.maximum(orientation.diagonal(), 0.0), spread[active].ravel()])
    free = ~np.concatenate([built.is_observed[:z], np.zeros(len(labels) - z, bool), built.is_observed[z:]])
    checks.require_determined([*labels, *built.labels[z:]], free * np.sqrt(found) / units)
    others, whitened, redundancy = _others(built, solution)
    steps, shape_values = built.steps, np.concatenate([np.zeros(0), *shapes])
    shape_variance = np.array([variance[label] for label in labels[z:]])
    return BundleResult(
        photos=tuple(photos), cameras=tuple(cameras.values()),
        figures=tuple(adjusted(f.label, f.names, values.tolist()) for f, values in zip(figures, shapes, strict=True)),
        interiors=tuple(built.interior(k, state) for k in range(len(rotations))), rotations=tuple(rotations),
        centres_m=tuple(centres), ids=built.ids, points_m=points, sigma_m=None if m0 is None else m0 * np.sqrt(spread),
        state=np.concatenate([problem.image_vector(state), state.ground[active].ravel(), shape_values]),
        labels=(*built.labels, *labels[z:]),
        cofactors=np.concatenate([np.maximum(orientation.diagonal()[:z], 0.0) / steps[:z] ** 2, spread[active].ravel(),
                                  shape_variance]),
        m0=m0, redundancy=freedom, iterations=len(solution.log), backend=solution.backend,
        history=solution.log, others=others, others_whitened=whitened, others_redundancy=redundancy,
        point_cofactors=of_points, angle_cofactors=of_angles, orientation=orientation, orientation_labels=tuple(labels),
        orientation_units=units[: len(labels)], solution=solution, **_image_points(given, solution),
    )  # fmt: skip


def _orientation(built: Built, solution: Solution, figures: Sequence[FittedFigure]) -> Array:
    """Return joint cofactors (o, o) of unknowns of photos, shared ones once, and of figures, in their units."""
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
    """Return the accuracy that one image point gives, for the unknowns of the orientation, then for the points.

    A figure has the accuracy of its points.
    """
    z, units = len(built.owners), built.units(solution.state)
    typical = float(np.median(units[z:])) if len(units) > z else 1.0
    away = solution.ground_m - solution.ground_m.mean(axis=0)
    extent = float(np.linalg.norm(away, axis=1).max()) or 1.0
    shapes = [typical / extent if name.startswith(("tilt", "slope")) else typical for f in figures for name in f.names]
    return np.concatenate([units[:z] * built.steps[:z], shapes, units[z:]])


def _others(built: Built, solution: Solution) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, whitened residuals and redundancy numbers (k,) of soft observations that are not image points."""
    problem, residuals = solution.problem, solution.residual_cofactors
    parts: dict[bool, list[tuple[str, float, float]]] = {False: [], True: []}
    for e, numbers in zip(problem.block.extra, residuals.extra, strict=True):
        if isinstance(e, ConstraintObservation) and e.hard:
            continue
        value, _ = extra_blocks(problem, e, solution.state, jacobian=False)
        names = [e.label] if e.n_residuals == 1 else [f"{e.label}, {k + 1}" for k in range(e.n_residuals)]
        parts[isinstance(e, ConstraintObservation)] += zip(names, value.tolist(), numbers.tolist(), strict=True)
    control = [f"point {built.ids[j]}: control, {axis}" for j in np.flatnonzero(problem.observed) for axis in POINT]
    of_control = zip(
        control,
        control_residuals(problem, solution.state).ravel().tolist(),
        np.einsum("nii->ni", residuals.control).ravel().tolist(),
        strict=True,
    )
    every = [*parts[False], *of_control, *parts[True]]
    return tuple(name for name, _, _ in every), np.array([v for _, v, _ in every]), np.array([r for *_, r in every])
