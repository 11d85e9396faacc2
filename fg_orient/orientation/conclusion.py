"""Computation of the statistics of a solution: cofactors, accuracy at check points, findings and status.

The coordinates of the check points are opened here, after the solution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors._preparation import working_clock
from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_cofactors import SummedSystem
from fg_orient.adjustment.resection import LocatedPoints, locate_points
from fg_orient.adjustment.robust import are_information, weighted_problem
from fg_orient.adjustment.schur import SchurSystem
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.block import Coordinates
from fg_orient.model.errors import Finding, finding
from fg_orient.model.machine import return_memory
from fg_orient.model.names import Role, Status
from fg_orient.orientation.solution import Seconds, Solution
from fg_orient.quality import camera, causes, doubts, vendor_datum, verdict
from fg_orient.quality.accuracy import Accuracy, Joint, PointDifferences, differences
from fg_orient.quality.cofactors import Cofactors, PointCofactors
from fg_orient.quality.covariance import Indeterminate, cofactors_of
from fg_orient.quality.free_network import FreeNetwork
from fg_orient.quality.observability import BlockObservability, ImageObservability
from fg_orient.sensors import initial


def conclude(
    compiled: Problem,
    observability: tuple[ImageObservability, ...],
    block_view: BlockObservability | None,
    estimate: Estimate,
    structure_s: float,
) -> Solution:
    """Return the statistics after convergence, with the accuracy at the check points, whose coordinates are opened."""
    start = working_clock()
    weighted = compiled if estimate.weights is None else weighted_problem(compiled, estimate.weights)
    cofactors, unavailable = cofactors_at(weighted, estimate)
    return_memory(len(compiled.observations))
    ground, located = _adjusted_ground(compiled, estimate.state)
    on_earth = vendor_datum.absolute(compiled, cofactors)
    accuracy = _assess(compiled, ground, located, on_earth)
    assessment = verdict.assess_solution(compiled, estimate, unavailable)
    findings = [one for one in compiled.block.notes if one.severity == "doubt"]  # on its input
    findings += verdict.findings(compiled, estimate, assessment, observability, block_view, accuracy)
    choice = None
    if isinstance(estimate.linear, SchurSystem | SummedSystem):
        choice = estimate.linear.choice if estimate.backend == "schur" else None
    if isinstance(estimate.linear, SchurSystem):
        estimate.linear.release()  # its memory is freed for the statistics
    return_memory(len(compiled.observations))
    examined = doubts.Examined([])
    if assessment.status is not Status.NOT_CONVERGED:
        examined = doubts.of_solution(compiled, estimate, ground, cofactors, accuracy.check)
        findings += examined.findings
        if cofactors is not None:
            findings += camera.inseparable(camera.frame_cofactors(compiled, estimate.state, cofactors))
    if located is not None and len(located.lost):
        names = [compiled.block.points.ids[j] for j in located.lost]
        findings.append(finding("solution.check_not_located", n=len(names), points=names))
    accept = compiled.block.options.accept
    status, reason, ordered = verdict.decided(assessment, estimate.end, findings, accept)
    whitened = None if examined.residuals is None else examined.residuals.v_image
    ordered, supposed = causes.added(ordered, compiled, estimate, on_earth, examined, accuracy.check)
    return Solution(
        problem=compiled,
        status=status,
        verdict=reason,
        end=estimate.end,
        residuals=examined.residuals,
        residuals_px=compiled.pixel_residuals(estimate.state, whitened),
        tests=examined.tests,
        backend=estimate.backend,
        solver=estimate.solver,
        optimizer=compiled.block.options.optimizer,
        state=estimate.state,
        ground_m=ground,
        chi2=estimate.chi2,
        sigma0_interval=assessment.interval,
        log=estimate.log,
        iterations=estimate.iterations,
        observability=observability,
        block_view=block_view,
        accuracy=accuracy,
        cofactors=cofactors,
        sigmas=examined.sigmas,
        unavailable=unavailable,
        findings=ordered,
        reduced_system=choice,
        weights=estimate.weights,
        resumed_at=estimate.resumed_at,
        supposed=supposed,
        seconds=Seconds(0.0, structure_s + estimate.structure_s, 0.0, estimate.solve_s, working_clock() - start),
    )


def cofactors_at(compiled: Problem, estimate: Estimate) -> tuple[Cofactors | None, tuple[Finding, ...]]:
    """Return the cofactors of a solution, or the reason why they do not exist."""
    if compiled.least_damping > 0.0:
        return None, (finding("unavailable.free_datum"),)
    loss = compiled.block.options.loss
    if estimate.weights is not None and not are_information(loss, estimate.weights):
        return None, (finding("unavailable.loss", loss=loss),)
    try:
        cofactors = cofactors_of(compiled, estimate)
        inner = compiled.block.options.datum == "inner"
        return (FreeNetwork.of(compiled, estimate.state, cofactors) if inner else cofactors), ()
    except Indeterminate as reason:
        return None, (finding("unavailable.indeterminate", why=reason),)


def accuracy_at(compiled: Problem, state: State) -> Accuracy:
    """Return the differences at control and check points of a state, without cofactors."""
    return _assess(compiled, *_adjusted_ground(compiled, state), None)


def _adjusted_ground(compiled: Problem, state: State) -> tuple[Array, LocatedPoints | None]:
    """Return the ground points (N, 3) in ECEF, and the check points among them that were located afterwards."""
    located = _located_afterwards(compiled, state)
    ground = state.ground + compiled.origin_m
    if located is not None:
        ground[located.index] = located.ground_m
    return ground, located


def _located_afterwards(compiled: Problem, state: State) -> LocatedPoints | None:
    """Return the excluded check points, located with the adjusted orientation; None without such points."""
    missing = initial.missing_rows(state.ground)
    o = compiled.block.observations
    rows = missing[o.point]
    if not rows.any():
        return None
    seen, unknown = np.unique(o.point[rows]), np.zeros_like(state.ground)
    unknown[seen] = np.nan
    start = initial.ground_points(
        compiled.block.images, o.take(rows), compiled.block.points.ids, unknown, compiled.corrections(state)
    )
    return locate_points(compiled, state, start, seen)


def _assess(
    compiled: Problem, ground: Array, located: LocatedPoints | None, cofactors: PointCofactors | None
) -> Accuracy:
    """Return the differences at control points and, after opening their coordinates, at check points."""
    points = compiled.block.points
    used = ~initial.missing_rows(ground)
    control, check = (rows[used[rows]] for rows in (points.where(Role.CONTROL), points.where(Role.CHECK)))
    adjusted = control[compiled.active[control]]  # a fixed point is a constant, so it has no difference
    opened = compiled.block.withheld.open() if len(check) else None
    place = {name: k for k, name in enumerate(compiled.block.withheld.ids)}
    order = [place[points.ids[j]] for j in check]
    at_control = _differences(compiled, ground, adjusted, points.known, adjusted, located, cofactors)
    return Accuracy(
        replace(at_control, n_fixed=len(control) - len(adjusted)),
        _differences(compiled, ground, check, opened or points.known, np.array(order, np.intp), located, cofactors),
    )


def _differences(
    compiled: Problem,
    ground: Array,
    index: Index,
    measured: Coordinates,
    rows: Index,
    located: LocatedPoints | None,
    cofactors: PointCofactors | None,
) -> PointDifferences:
    """Return the differences of points ``index`` from the ``rows`` of the measured coordinates ``measured``."""
    ids = tuple(compiled.block.points.ids[j] for j in index)
    measured_m = measured.ecef_m[rows].reshape(-1, 3)
    q = np.full((len(index), 3, 3), np.nan)
    if cofactors is not None:
        after = np.zeros(len(index), bool) if located is None else np.isin(index, located.index)
        q[~after] = cofactors.points(index[~after])
        if located is not None and after.any():
            own = replace(located, index=index[after])
            q[after] = own.cofactors(cofactors.blocks)
    sigma = measured.sigma_enu_m[rows].reshape(-1, 3)
    # axes at the adjusted point, because no estimated sigma may depend on a check coordinate
    axes = compiled.axes(ground[index].reshape(-1, 3))
    found = differences(ids, index, ground[index], measured_m, sigma, q, axes)
    if cofactors is None or not compiled.active[index].all():
        return found
    place = (ground[index].reshape(-1, 3) - compiled.origin_m) @ compiled.axes(compiled.origin_m[None])[0, :2].T
    return replace(found, joint=Joint(cofactors, index, axes, 1e-3 * place))
