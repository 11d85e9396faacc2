"""Earlier result as start values of an adjustment, and as prior with its full covariance.

The prior is one linear observation of all common unknowns x, of images and ground points together. Let
x_1 be the adjusted values and Q = L L^T the joint cofactors of the earlier result. The observation has
the information ``Q^-1 - P`` and the same gradient as the earlier adjustment. P is the information of
earlier observations that this block contains again: priors of the images (x = 0) and control
coordinates. It is subtracted, because these observations would otherwise count twice. From the
eigenvalues 1 - w and the eigenvectors V of ``L^T P L`` follows the whitened residual ::

    W^T L^-1 (x - x_1) - c,    W = V sqrt(w),    c = V^T L^T P (x_1 - x_0) / sqrt(w)

where x_0 are the observed values of P, and w in [0, 1] is the share of the earlier observations in the information. It
has one row for each direction with w > 0. Apart from linearisation at x_1, a block adjusted in two steps equals the
block adjusted in one step (Helmert blocking: normal equations of the first step, reduced to the common unknowns).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Argument, Equation
from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State, participates
from fg_orient.adjustment.rows import image_models
from fg_orient.model.arrays import wrong
from fg_orient.model.block import Block, Coordinates, ExtraObservation
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role, Status
from fg_orient.model.parameters import ImageParameters
from fg_orient.orientation.solution import Solution
from fg_orient.result.joint import LIMIT, JointCofactors, joint_cofactors_of, points_within, unknown_names
from fg_orient.result.record import COVARIANCE_FILE, Result, doubts_about, read_result
from fg_orient.sensors import initial

#: The prior has a row for a direction only if the share of the earlier observations in its information is at
#: least this.
LEAST_SHARE: Final = 1e-9
_ARGUMENTS: Final = {"image": Argument("image", "prior sigma"), "point": Argument("point", "m", True)}


@dataclass(frozen=True)
class EarlierResult:
    """Values of a result by the names of their unknowns.

    Parameters
    ----------
    place : str
        Result folder, or name of the block.
    result : Result
    joint : JointCofactors or None
        Joint cofactors; None if the result has none.
    """

    place: str
    result: Result
    joint: JointCofactors | None

    @staticmethod
    def of(given: Solution | Result | str | Path, points: Collection[str]) -> EarlierResult:
        """Read a result folder, or use a result from memory; it raises the same errors as :func:`read_result`.

        ``points``: ids of the points of a solution that its joint cofactors contain, if they are not too many.
        """
        if isinstance(given, Solution):
            ids = given.block.points.ids
            common = np.array([j for j, name in enumerate(ids) if name in points], np.intp)
            chosen = points_within(given, LIMIT, common) if points else None
            joint = None if chosen is None else joint_cofactors_of(given, chosen)
            return EarlierResult(given.block.name, given.result, joint)
        if not isinstance(given, Result | str | Path):
            raise wrong("start", repr(given), "a Solution, a Result or the path of a result folder")
        result = given if isinstance(given, Result) else read_result(given)
        place = str(result.record.get("name")) if isinstance(given, Result) else str(given)
        return EarlierResult(place, result, result.joint)

    def images(self) -> dict[str, dict[str, float]]:
        """Return the unknowns of each image in physical units, by name."""
        table, out = self.result.eop, {image: dict[str, float]() for image in self.result.images}
        words = (table.words[name] for name in ("image", "parameter"))
        for image, name, value in zip(*words, table.numbers("value_per_tau").ravel().tolist(), strict=True):
            out[image][name] = value
        return out

    def ground_m(self) -> dict[str, Array]:
        """Return the ECEF coordinates (3,) of the adjusted points by id."""
        table = self.result.points
        ground = table.numbers("x_m", "y_m", "z_m")
        return {name: place for name, place in zip(table.words["id"], ground, strict=True) if np.isfinite(place).all()}


def continued(
    block: Block, given: Solution | Result | str | Path, *, with_prior: bool
) -> tuple[Block, Callable[[Problem], State]]:
    """Return the block that continues an earlier result, and a function that returns the start of its problem.

    Parameters
    ----------
    block : Block
        Block whose options choose the unknowns.
    given : Solution, Result or path of a result folder
    with_prior : bool
        Add the joint cofactors of the common unknowns as an observation.

    Raises
    ------
    InputError
        No common image; a common image with other unknowns, size or metadata; for the prior: the earlier result has no
        covariance or did not converge, or one of its control points is a check point of this block.
    """
    earlier = EarlierResult.of(given, set(block.points.ids) if with_prior else ())
    images, ground = earlier.images(), earlier.ground_m()
    parameters = tuple(model.parameters for model in image_models(block.images, block.options))
    faults = list(_faults(block, parameters, earlier, images))
    if faults:
        raise InputError(*faults)
    if with_prior:
        block = _with_prior(block, parameters, earlier, ground)
        block = replace(block, notes=(*block.notes, *_doubts(earlier)))

    def begin(problem: Problem) -> State:
        return _start(problem, images, ground)

    return block, begin


def _doubts(earlier: EarlierResult) -> list[Finding]:
    """Return the doubt on a prior from a result that is not trustworthy: it makes the new result doubtful, too."""
    return [
        finding(
            "verdict.doubtful_prior (doubt): the prior comes from a result that is not trustworthy + : {reason} -> "
            'correct the earlier adjustment, omit <start_prior>, or accept the doubt with <accept> "doubtful_prior"',
            file=earlier.place, reason=one.data["reason"],
        )
        for one in doubts_about(earlier.result.record, earlier.place)
    ]  # fmt: skip


def _faults(
    block: Block, parameters: tuple[ImageParameters, ...], earlier: EarlierResult, images: dict[str, dict[str, float]]
) -> Iterator[Finding]:
    """Yield findings for images whose id occurs in both blocks, but with another image or other unknowns."""
    facts = {str(image["id"]): image for image in earlier.result.record["images"]}
    if not any(image.id in images for image in block.images):
        yield finding("earlier.no_image", file=earlier.place, place="images", value=", ".join(list(images)[:5]))
    for image, own in zip(block.images, parameters, strict=True):
        if image.id not in images:
            continue
        place = f"image {image.id}"
        before, now = (facts[image.id]["n_lines"], facts[image.id]["n_samples"]), image.sensor
        if (now.n_lines, now.n_samples) != before:
            yield finding(
                "earlier.size",
                file=earlier.place,
                place=place,
                value=f"{before[0]} x {before[1]}",
                lines=now.n_lines,
                samples=now.n_samples,
            )
        other = sorted(set(own.names) ^ images[image.id].keys())
        if other:
            yield finding("earlier.unknowns", file=earlier.place, place=place, value=", ".join(other[:8]))
        if _changed(block, Path(image.sensor.file).name, earlier.result):
            yield finding("earlier.metadata", file=earlier.place, place=place, value=Path(image.sensor.file).name)


def _changed(block: Block, name: str, result: Result) -> bool:
    """Return whether every metadata file of this name has another content than in the earlier run."""
    inputs = result.record["provenance"]["inputs"]
    before = {entry["sha256"] for entry in inputs[1:] if Path(entry["file"]).name == name}
    now = {source.sha256 for source in block.sources[1:] if Path(source.path).name == name}
    return bool(before and now and not before & now)


def _start(problem: Problem, images: dict[str, dict[str, float]], ground: dict[str, Array]) -> State:
    """Return a start with the earlier values; new points are intersected with the orientation of these values."""
    block = problem.block
    image, place = problem.start.image.copy(), problem.start.ground.copy()
    for k, (one, own) in enumerate(zip(block.images, problem.parameters, strict=True)):
        if one.id in images:
            image[k, : len(own)] = [images[one.id][name] for name in own.names] / own.sigma
    common = np.array([j for j in np.flatnonzero(problem.active) if block.points.ids[j] in ground], np.intp)
    state = State(image, place)
    new = problem.active & initial.missing_rows(block.points.known.ecef_m)
    new[common] = False
    o = problem.observations
    rows, wanted = new[o.point], np.where(new[:, None], np.nan, np.zeros_like(place))
    with contextlib.suppress(InputError):  # points that do not intersect keep their position
        found = initial.ground_points(block.images, o.take(rows), block.points.ids, wanted, problem.corrections(state))
        place[new] = found[new] - problem.origin_m
    for j in common:
        place[j] = ground[block.points.ids[j]] - problem.origin_m
    return state


# --- prior -----------------------------------------------------------------------------------------


def _with_prior(
    block: Block, parameters: tuple[ImageParameters, ...], earlier: EarlierResult, ground: dict[str, Array]
) -> Block:
    """Add the observation of the common unknowns to a block."""
    joint, points = earlier.joint, block.points
    if Status(earlier.result.record["status"]) is Status.NOT_CONVERGED:
        raise InputError.of("earlier.not_converged", file=earlier.place, option="start_prior")
    if joint is None:
        raise InputError.of(
            "earlier.no_covariance", file=earlier.place, option="start_prior", name=COVARIANCE_FILE, limit=LIMIT
        )
    if "priors" in block.options.variance_components:
        raise InputError.of("earlier.components", option="variance_components", value="priors")
    if block.options.datum == "inner":
        raise InputError.of("earlier.inner", option="datum", value="inner")
    checks = {points.ids[j] for j in points.where(Role.CHECK)} & set(joint.control)
    if checks:
        raise InputError.of("earlier.check", file=earlier.place, place="points", value=", ".join(sorted(checks)[:5]))
    seen = np.bincount(block.observations.point[participates(block)], minlength=len(points.ids))
    column = {name: n for n, name in enumerate(joint.names)}
    names: list[str] = []  # names of the vectors of the observation
    # for each unknown: its place in the earlier result, its unit and its origin in this block
    at, unit, reference = list[int](), list[float](), list[float]()
    # for each vector, the rows of ``at`` of its unknowns; -1 for a shared unknown that occurred before
    places: list[Index] = []
    taken: dict[int, int] = {}
    for image, own in zip(block.images, parameters, strict=True):
        known = [column.get(name, -1) for name in unknown_names(image.id, own.names, own.shared)]
        if image.id not in earlier.result.images or not known:
            continue
        if -1 in known:
            raise InputError.of(
                "earlier.shared", file=earlier.place, place=f"image {image.id}", value=own.names[known.index(-1)]
            )
        rows = np.full(len(known), -1)
        for i, (n, sigma) in enumerate(zip(known, own.sigma.tolist(), strict=True)):
            if n not in taken:
                taken[n] = rows[i] = len(at)
                at, unit, reference = [*at, n], [*unit, sigma], [*reference, 0.0]
        names.append(f"image:{image.id}")
        places.append(rows.astype(np.intp))
    origin, single = initial.local_origin(block.images), list[int]()
    for j in np.flatnonzero(seen).tolist():
        n = column.get(f"point:{points.ids[j]}.x", -1)
        if n >= 0:
            names.append(f"point:{points.ids[j]}")
            places.append(len(at) + np.arange(3))
            at, unit, reference = [*at, n, n + 1, n + 2], [*unit, 1.0, 1.0, 1.0], [*reference, *origin.tolist()]
            if seen[j] == 1 and np.isnan(points.known.ecef_m[j]).any():
                single.append(j)
    index, scale = np.array(at, np.intp), np.array(unit)
    value = (joint.values[index] - reference) / scale
    again, offset = _observed_again(block, joint, index, scale, value)
    try:
        rows_, right = reduced_rows(joint.cofactors[np.ix_(index, index)] / np.outer(scale, scale), again, offset)
    except np.linalg.LinAlgError:
        raise InputError.of("earlier.singular", file=earlier.place, option="start_prior") from None
    label = f"prior of {earlier.place}"
    observation = _observation(label, names, places, rows_, value, right)
    return replace(block, extra=(*block.extra, observation), points=_with_starts(block, single, ground))


def _with_starts(block: Block, points: list[int], ground: dict[str, Array]) -> Any:
    """Return the ground points, with start values for points with one image point, which cannot be intersected."""
    known = block.points.known
    ecef_m = known.ecef_m.copy()
    for j in points:
        ecef_m[j] = ground[block.points.ids[j]]
    return replace(block.points, known=Coordinates(ecef_m, known.sigma_enu_m, known.fixed))


def _observed_again(
    block: Block, joint: JointCofactors, index: Index, scale: Array, value: Array
) -> tuple[Array, Array]:
    """Return the information P (n, n) of earlier observations that this block contains again, and ``P (x_1 - x_0)``."""
    information, offset = np.zeros((len(index), len(index))), np.zeros(len(index))
    if block.options.priors:
        weight = np.nan_to_num(scale / joint.prior_sigma[index]) ** 2
        information[np.diag_indices(len(index))], offset = weight, weight * value
    points = block.points
    control = {points.ids[j] for j in points.where(Role.CONTROL) if not points.known.fixed[j]}
    column = {joint.names[n]: k for k, n in enumerate(index.tolist())}
    for name, place, weight in zip(joint.control, joint.control_m, joint.control_information, strict=True):
        k = column.get(f"point:{name}.x", -1)
        if k >= 0 and name in control:
            part = slice(k, k + 3)
            information[part, part] = weight
            offset[part] = weight @ (joint.values[index[part]] - place)
    return information, offset


def reduced_rows(cofactors: Array, again: Array, offset: Array) -> tuple[Array, Array]:
    """Return the rows R (r, n) and c (r,) of the module docstring: the residual is ``R (x - x_1) - c``.

    Parameters
    ----------
    cofactors : (n, n) array
        Q.
    again : (n, n) array
        P.
    offset : (n,) array
        ``P (x_1 - x_0)``.

    Raises
    ------
    LinAlgError
        Q is not positive definite.
    """
    from scipy.linalg import solve_triangular

    sigma = np.sqrt(np.diag(cofactors))
    root = np.linalg.cholesky(cofactors / np.outer(sigma, sigma)) * sigma[:, None]
    held, vectors = np.linalg.eigh(root.T @ again @ root)
    keep = 1.0 - held > LEAST_SHARE
    share, vectors = np.sqrt(1.0 - held[keep]), vectors[:, keep]
    rows = solve_triangular(root, vectors * share, lower=True, trans="T").T
    return np.ascontiguousarray(rows), (vectors.T @ (root.T @ offset)) / share


def _observation(
    label: str, names: list[str], places: list[Index], rows: Array, value: Array, right: Array
) -> ExtraObservation:
    """Return the linear observation of the vectors ``names``."""
    blocks = tuple(np.ascontiguousarray(np.where(place >= 0, rows[:, np.maximum(place, 0)], 0.0)) for place in places)
    centres = tuple(np.where(place >= 0, value[np.maximum(place, 0)], 0.0) for place in places)

    def residual(_record: Array, _setup: Array, *x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        moved = (block @ (own - centre) for block, own, centre in zip(blocks, x, centres, strict=True))
        return np.asarray(sum(moved, -right))

    def kernel(record: Array, setup: Array, *x_and_want: Any) -> tuple[Array, ...]:
        *x, want = x_and_want
        return residual(record, setup, *x), *(blocks if want else (np.empty((0, 0)),) * len(blocks))

    arguments = tuple(_ARGUMENTS[name.partition(":")[0]] for name in names)
    equation = Equation(label, kernel, residual, arguments, "Helmert 1880: blocks")
    record = np.concatenate([rows.ravel(), value, right])  # the record identifies the observation in a checkpoint
    return ExtraObservation(equation, tuple(names), record, np.zeros((0, 0)), len(rows), label)
