"""The main job: block in, solution out.

``adjust`` compiles the problem, judges observability **before** anything is solved, runs
the backend, and only then opens the coordinates of the check points.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from fg_orient import initial
from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.problem import Problem, State, compile_problem, enu_from_ecef
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.block import Block, Coordinates
from fg_orient.errors import RankDeficientError, problem
from fg_orient.names import Role, Status
from fg_orient.parameters import eop_set_number
from fg_orient.quality.accuracy import ASPRS_MINIMUM, Accuracy, PointDifferences, differences
from fg_orient.quality.covariance import Cofactors, propagated_point
from fg_orient.quality.observability import ImageObservability, analyse
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.solution import Seconds, Solution

Array = npt.NDArray[np.float64]

#: Probability of the two-sided interval of sigma0 beyond which a solution is not trusted.
SIGMA0_LEVEL = 0.999


def adjust(
    block: Block,
    *,
    eop_set: int | str | None = None,
    look_polynomial: int | None = None,
    priors: bool | None = None,
    backend: str | None = None,
    optimizer: str | None = None,
    max_iterations: int | None = None,
    check_points: str | None = None,
    callback: Callback | None = None,
) -> Solution:
    """Adjust a block; arguments override the options of its project file.

    Parameters
    ----------
    block : Block
    eop_set : int or str, optional
        Number 1-20 or name ("PUA").
    look_polynomial : int, optional
        Degree of the look-angle correction polynomial.
    priors : bool, optional
        False leaves the image unknowns without prior observations.
    backend, optimizer, max_iterations, check_points : optional
        See :class:`fg_orient.block.Options`.
    callback : callable, optional
        Called with an ``IterationRecord`` after each iteration.

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        The block cannot be adjusted (exit code 2).
    RankDeficientError
        Without priors some directions are not observable; one problem per direction (exit code 3).
    """
    given: dict[str, Any] = {
        "eop_set": None if eop_set is None else eop_set_number(eop_set),
        "look_polynomial": look_polynomial, "priors": priors, "backend": backend, "optimizer": optimizer,
        "max_iterations": max_iterations, "check_points": check_points,
    }  # fmt: skip
    options = replace(block.options, **{k: v for k, v in given.items() if v is not None})
    start = time.perf_counter()
    compiled = compile_problem(replace(block, options=options))
    observability = judge_observability(compiled)
    refuse_deficient(compiled, observability)
    structure = time.perf_counter() - start
    estimate = solve(compiled, callback)
    return conclude(compiled, observability, estimate, structure)


def judge_observability(compiled: Problem, state: State | None = None) -> tuple[ImageObservability, ...]:
    """Singular values of each image's whitened Jacobian at a state (default: the start)."""
    _, j_image, _ = compiled.image_residuals(state or compiled.start, jacobian=True)
    out = []
    for k, image in enumerate(compiled.block.images):
        rows = np.flatnonzero(compiled.observations.image == k)
        width = len(compiled.parameters)
        jacobian = np.vstack([j_image[r] for r in rows]) if len(rows) else np.zeros((0, width))
        frame, speed = _central_frame(image.sensor)
        out.append(
            analyse(image.id, jacobian, compiled.parameters, frame, speed if image.sensor.follows_orbit else None)
        )
    return tuple(out)


def _central_frame(sensor: PushbroomSensor) -> tuple[Array, float]:
    """Orbital frame at the image centre (columns across, along, radial) and the speed along it."""
    from factors.rotations import orbital_frames

    state = sensor.states((sensor.n_lines - 1) / 2.0)
    frame = orbital_frames(state.position_m, state.velocity_m_s)[0]
    return frame, float(state.velocity_m_s[0] @ frame[:, 1])


def refuse_deficient(compiled: Problem, observability: tuple[ImageObservability, ...]) -> None:
    """Refuse a block whose unknowns nothing determines.

    Raises
    ------
    RankDeficientError
        One problem per dead direction.
    """
    if compiled.block.options.priors:
        return
    defect = {o.image: o.rank_defect for o in observability}
    sentences = [sentence for o in observability for sentence in o.sentences]
    if sentences:
        problems = [problem("adjust.rank_deficient", place=sentence) for sentence in sentences]
        raise RankDeficientError(*problems, rank_defect=defect)
    if compiled.redundancy < 0:
        raise RankDeficientError(problem(
            "adjust.negative_redundancy", place=compiled.block.name, value=compiled.redundancy,
            observations=compiled.n_observations, unknowns=compiled.n_unknowns,
        ), rank_defect=defect)  # fmt: skip


def conclude(
    compiled: Problem, observability: tuple[ImageObservability, ...], estimate: Estimate, structure_s: float
) -> Solution:
    """Statistics after convergence; the check points' coordinates are opened here and nowhere before."""
    start = time.perf_counter()
    cofactors, withheld = _cofactors(compiled, estimate)
    ground = _all_ground_points(compiled, estimate.state)
    accuracy = _assess(compiled, estimate.state, ground, cofactors)
    status, reason, interval = _judge(compiled, estimate)
    warnings = _warnings(compiled, observability, accuracy, status, reason)
    return Solution(
        problem=compiled, status=status, reason=reason, backend="graph", optimizer=compiled.block.options.optimizer,
        state=estimate.state, ground_m=ground, chi2=estimate.chi2, sigma0_interval=interval, log=estimate.log,
        iterations=estimate.iterations, residuals_px=compiled.pixel_residuals(estimate.state),
        observability=observability, accuracy=accuracy, cofactors=cofactors, withheld=withheld, warnings=warnings,
        seconds=Seconds(0.0, structure_s + estimate.structure_s, estimate.jit_s, estimate.solve_s,
                        time.perf_counter() - start),
    )  # fmt: skip


def _cofactors(compiled: Problem, estimate: Estimate) -> tuple[Cofactors | None, tuple[str, ...]]:
    try:
        return Cofactors(compiled, estimate.state, estimate.linear, estimate.zero), ()
    except RuntimeError as error:
        return None, (f"covariance withheld: GTSAM finds the normal equations indeterminate ({str(error)[:120]})",)


def _all_ground_points(compiled: Problem, state: State) -> Array:
    """ECEF coordinates of all points; excluded check points intersected with the adjusted orientation."""
    ground = state.ground + compiled.origin_m
    missing = initial.missing_rows(ground)
    o = compiled.block.observations
    rows = missing[o.point]
    if rows.any():
        seen = np.unique(o.point[rows])
        wanted = np.zeros_like(ground)
        wanted[seen] = np.nan
        found = initial.ground_points(
            compiled.block.images, o.take(rows), compiled.block.points.ids, wanted, compiled.corrections(state)
        )
        ground[seen] = found[seen]
    return ground


def _assess(compiled: Problem, state: State, ground: Array, cofactors: Cofactors | None) -> Accuracy:
    """Differences at control points and, after opening their coordinates, at check points."""
    points = compiled.block.points
    used = ~initial.missing_rows(ground)
    control = np.array([j for j in points.where(Role.CONTROL) if used[j]], dtype=np.intp)
    check = np.array([j for j in points.where(Role.CHECK) if used[j]], dtype=np.intp)
    opened = compiled.block.withheld.open() if len(check) else None
    order = [compiled.block.withheld.ids.index(points.ids[j]) for j in check]
    return Accuracy(
        _differences(compiled, state, ground, control, points.known, control, cofactors),
        _differences(compiled, state, ground, check, opened or points.known, np.array(order, np.intp), cofactors),
    )


def _differences(
    compiled: Problem, state: State, ground: Array, index: npt.NDArray[np.intp], measured: Coordinates,
    rows: npt.NDArray[np.intp], cofactors: Cofactors | None,
) -> PointDifferences:  # fmt: skip
    ids = tuple(compiled.block.points.ids[j] for j in index)
    measured_m = measured.ecef_m[rows].reshape(-1, 3)
    q = np.full((len(index), 3, 3), np.nan)
    if cofactors is not None:
        for k, j in enumerate(index):
            excluded = not compiled.active[j] and compiled.block.points.roles[j] is Role.CHECK
            q[k] = (
                propagated_point(compiled, state, ground[j], int(j), cofactors) if excluded else cofactors.point(int(j))
            )
    sigma = np.where(measured.fixed[rows][:, None], 0.0, measured.sigma_enu_m[rows]).reshape(-1, 3)
    return differences(ids, index, ground[index], measured_m, sigma, q, enu_from_ecef(measured_m))


def _judge(compiled: Problem, estimate: Estimate) -> tuple[Status, str, tuple[float, float]]:
    """Status from convergence and the global test of sigma0."""
    f = compiled.redundancy
    if not estimate.converged or not np.isfinite(estimate.chi2):
        return Status.NOT_CONVERGED, estimate.reason, (float("nan"), float("nan"))
    if f <= 0:
        return Status.CONVERGED, "no redundancy: nothing was checked", (float("nan"), float("nan"))
    tail = 0.5 * (1.0 - SIGMA0_LEVEL)
    low, high = (float(np.sqrt(2.0 * gammaincinv(0.5 * f, p) / f)) for p in (tail, 1.0 - tail))  # chi-square / f
    sigma0 = float(np.sqrt(estimate.chi2 / f))
    if sigma0 > high:
        reason = (
            f"sigma0 = {sigma0:.2f} lies above {high:.2f}, the upper end of its 99.9 % interval: the observations do "
            "not fit the model within their sigmas. The unknowns cannot take up the errors present, or the sigmas "
            "are too small, or there are gross errors; standard deviations and coordinates must not be trusted"
        )
        return Status.NOT_TRUSTWORTHY, reason, (low, high)
    return Status.CONVERGED, estimate.reason, (low, high)


def _warnings(
    compiled: Problem, observability: tuple[ImageObservability, ...], accuracy: Accuracy, status: Status, reason: str
) -> tuple[str, ...]:
    """Problems first, in the order a reader should meet them."""
    out = [] if status is Status.CONVERGED and compiled.redundancy > 0 else [reason]
    if any(o.rank_defect for o in observability):
        count = sum(o.rank_defect for o in observability)
        out.append(f"{count} direction(s) of the orientation are not observable and are held by their priors alone")
    if compiled.parameters.n_eop < len(compiled.parameters):
        out.append(
            "the constant and linear look-angle terms nearly duplicate roll, pitch and yaw: judge their sum, "
            "not each alone"
        )
    suspicious = accuracy.check.suspicious()
    if suspicious:
        names = ", ".join(dict.fromkeys(row[0] for row in suspicious))
        out.append(f"check points beyond 3 standard deviations of the difference: {names}")
    if 0 < len(accuracy.check) < ASPRS_MINIMUM:
        out.append(f"{len(accuracy.check)} check points: ASPRS (2023) asks for at least {ASPRS_MINIMUM}")
    if not len(accuracy.check):
        out.append("no check points: the accuracy is not verified independently")
    return tuple(out)
