"""Constraints between ground points or images as extra observations: relations, and figures through points.

:mod:`fg_orient.adjustment.constraint_rows` contains their rows and figures. A constraint with a sigma has the weight w
= 1/sigma and no correlates.

A hard constraint has a large weight w and correlates k (Lagrange multipliers). They are
improved by ``k + w c`` at the solution until c is zero (method of multipliers: Hestenes
1969, Powell 1969). Therefore every backend, loss and datum accepts it, and the result
does not depend on w. Cofactors refer to the finite weight: they deviate by about
:data:`HARD` squared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.constraint_rows import (
    DEPENDENT,
    FRAMES,
    HEAD,
    ROWS,
    ConstraintObservation,
    Place,
    constraint_observation,
    figure_of,
    relation_record,
    whole_rows,
)
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import ExtraArgument, Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.constraint import OF_PHOTOS, SIZES
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import FrameSensor

if TYPE_CHECKING:
    from fg_orient.adjustment.solve import Estimate


#: Unknowns of a frame image that a constraint between images depends on.
CENTRE: Final = ("centre_x", "centre_y", "centre_z")
ROTATION: Final = ("rotation_x", "rotation_y", "rotation_z")
#: Minimum sigma of a constraint in the first adjustment. The unit is the smallest sigma of its points
#: with the images held fixed. With a smaller sigma at the start, the cost function would be a narrow
#: curved valley. An observed constraint keeps its own sigma if it is not far below the sigma of the
#: points.
FIRST: Final = 1.0
FIRST_OBSERVED: Final = 0.1
#: Sigma of a hard constraint after the first adjustment, in the same unit.
HARD: Final = 1e-3
#: The correlates are improved at most ROUNDS times. This ends earlier if the misclosure of each hard constraint is
#: below HELD sigma, or if a round does not reduce the misclosure by the factor SLOW. The adjustment itself ends with a
#: step of 1e-8 m.
ROUNDS: Final = 12
HELD: Final = 1e-5
SLOW: Final = 0.5
#: Hard constraints contradict each other if a misclosure, relative to the extent of the members, exceeds this.
CONTRADICTION: Final = 1e-9
#: Constraints have merged two points if their distance, relative to the distance at the start, is below this.
MERGED: Final = 1e-2
#: A message names constraints whose misclosure is at least this share of the largest one.
NAMED: Final = 0.1
_FITS: Final = 100


def has_constraints(block: Block) -> bool:
    """Return whether any extra observation of a block is a constraint.

    :func:`hold` completes these.
    """
    return any(isinstance(e, ConstraintObservation) for e in block.extra)


def _has_hard(problem: Problem) -> bool:
    return any(isinstance(e, ConstraintObservation) and e.hard and e.n_residuals for e in problem.block.extra)


def prepared(problem: Problem) -> Problem:
    """Compute the weights, axes and frames of the constraints of a problem from its start.

    Correlates are zero.
    """
    extra = problem.block.extra
    if not has_constraints(problem.block):
        return problem
    extra = tuple(_placed(problem, e) if isinstance(e, ConstraintObservation) else e for e in extra)
    problem = _with_extra(problem, extra)
    named = problem.named_points()
    rays = np.flatnonzero(np.isin(problem.observations.point, named))
    normal = problem.point_normals(problem.observations.point[rays], linearised(problem, problem.start, rays).ground)
    sigma = np.full(len(normal), np.inf)
    sigma[named] = np.linalg.eigvalsh(normal[named])[:, -1] ** -0.5
    extra = tuple(_prepared(problem, e, sigma) if isinstance(e, ConstraintObservation) else e for e in extra)
    problem = _with_extra(problem, extra)
    if not _has_hard(problem):
        return problem
    # if the constraints were not met, the motions of a free network would change the misclosures
    return replace(problem, start=_on_constraints(problem, problem.start))


def _placed(problem: Problem, extra: ConstraintObservation) -> ConstraintObservation:
    """Return the constraint with the places of its images.

    Raise InputError for an image without projection centre.
    """
    constraint = extra.constraint
    if constraint.kind not in OF_PHOTOS:
        return extra
    names, places = CENTRE if constraint.kind == "base" else ROTATION, []
    for argument in problem.extra_arguments(extra):
        sensor, own = problem.block.images[argument.index].sensor, problem.parameters[argument.index]
        if not isinstance(sensor, FrameSensor):
            raise constraint.fault("members", problem.block.images[argument.index].id, "frame images")
        by = np.array([[s * (n == name) for n, s in zip(own.names, own.sigma, strict=True)] for name in names])
        base = sensor.camera.centre_m - problem.origin_m if constraint.kind == "base" else np.zeros(3)
        places.append(Place(base, by.reshape(3, len(own))))
    return replace(constraint_observation(constraint, tuple(places)), label=extra.label)


def _columns(problem: Problem, extra: ConstraintObservation) -> list[int]:
    """Return the columns of the unknowns that a constraint depends on."""
    out: list[int] = []
    for k, a in enumerate(problem.extra_arguments(extra)):
        if a.is_image:
            out += (problem.first[a.index] + np.flatnonzero(extra.places[k].by.any(axis=0))).tolist()
        elif a.constant is None:
            out += range(problem.n_columns)[problem.point_slice(a.index)]
    return out


def _on_constraints(problem: Problem, state: State) -> State:
    """Move a state onto the hard constraints, by the smallest movements of their points or images.

    InputError: the constraints contradict each other, or depend on each other.
    """
    hard = [e for e in problem.block.extra if isinstance(e, ConstraintObservation) and e.hard]
    columns = np.unique([c for e in hard for c in _columns(problem, e)]).astype(np.intp)

    def at(step: Array) -> State:
        whole = np.zeros(problem.n_columns)
        whole[columns] = step
        return problem.moved(state, whole)

    x, least = np.zeros(len(columns)), np.inf
    for k in range(_FITS):
        try:
            rows, design, labels = linear_rows(problem, at(x))
        except InputError:
            _require_apart(problem, state, at(x))
            raise
        if not k:
            _require_slopes(rows, design, labels)
        size, before = float(np.abs(rows).max()), least
        if not size < before and size < HELD:
            break
        least, x = min(size, least), x - np.linalg.lstsq(design[:, columns], rows, rcond=DEPENDENT)[0]
    else:  # no convergence: name the constraints with the largest misclosures at the least sum of squares
        from scipy.optimize import least_squares

        def rows_at(x: Array) -> Array:
            return linear_rows(problem, at(x))[0]

        def slopes_at(x: Array) -> Array:
            return linear_rows(problem, at(x))[1][:, columns]

        x = least_squares(rows_at, 0.0 * x, slopes_at).x
    _require_held(problem, at(x))
    return at(x)


def _require_slopes(rows: Array, design: Array, labels: list[str]) -> None:
    """Refuse an unmet hard constraint with zero derivatives, such as parallel lines that are at right angles."""
    length = np.linalg.norm(design, axis=1)
    stuck = (length <= DEPENDENT * length.max()) & (np.abs(rows) > HELD)
    if stuck.any():
        k = int(np.argmax(stuck))
        raise InputError.of("closerange.saddle", place=labels[k], value=f"{rows[k]:.3g} sigmas")


def _require_apart(problem: Problem, before: State, after: State) -> None:
    """Refuse hard constraints that can be met only if different points move to one place."""
    hard = [e for e in problem.block.extra if isinstance(e, ConstraintObservation) and e.hard and not e.places]
    numbers = np.unique([a.index for e in hard for a in problem.extra_arguments(e)]).astype(np.intp)
    first, second = np.triu_indices(len(numbers), 1)
    apart, left = (
        np.linalg.norm(s.ground[numbers[first]] - s.ground[numbers[second]], axis=1) for s in (before, after)
    )
    one = left < MERGED * apart
    merged = np.unique([numbers[first[one]], numbers[second[one]]])
    if len(merged):
        points = ", ".join(problem.block.points.ids[j] for j in merged)
        names = [e.label for e in hard if {a.index for a in problem.extra_arguments(e)} & {*merged.tolist()}]
        raise InputError.of("closerange.merged", place="constraints", names="; ".join(names), points=points)


def _sigma_of_image(problem: Problem, argument: ExtraArgument, place: Place) -> float:
    """Return the smallest sigma of three numbers of an image, with its points and other unknowns held fixed."""
    rows = linearised(problem, problem.start, np.flatnonzero(problem.observations.image == argument.index)).image
    scale = place.by.sum(axis=1)
    if not scale.any():
        return np.inf
    design = rows[:, :, : len(place.by.T)] @ place.by.T / np.where(scale > 0.0, scale, 1.0) ** 2
    return 1.0 / float(np.linalg.norm(design.reshape(-1, 3), 2))


def _prepared(problem: Problem, extra: ConstraintObservation, sigma: Array) -> ConstraintObservation:
    c, found, at = extra.constraint, problem.extra_arguments(extra), extra.members(problem, problem.start)
    start, own = np.array(at), np.zeros(0)
    least = min((_sigma_of_image(problem, a, p) for a, p in zip(found, extra.places, strict=False)), default=np.inf)
    least = min(least, float(sigma[[a.index for a in found if not a.is_image]].min(initial=np.inf)))
    scale, frame, axes = 1.0, np.zeros(9), problem.axes(start.mean(axis=0)[None] + problem.origin_m)[0]
    if c.kind in SIZES:
        figure = figure_of(c, start @ axes.T)
        scale = figure.scale
        if c.kind in FRAMES:
            frame = np.concatenate([figure.record[part] for part in (FRAMES[c.kind].normal, FRAMES[c.kind].e_1,
                                                                     FRAMES[c.kind].e_2)])  # fmt: skip
        total = len(at) * SIZES[c.kind][0] + len(c.observed)
    else:
        if c.kind == "equal attitude":
            sensors = [problem.block.images[a.index].sensor for a in found]
            start = np.array([sensor.camera.rotation for sensor in sensors if isinstance(sensor, FrameSensor)])
        total, own = ROWS.get(c.kind, 1), relation_record(c, start)
        if c.kind in ("parallel", "perpendicular"):
            least /= float(np.linalg.norm(start[1::2] - start[::2], axis=1).max())
    last = c.sigma or HARD * least
    first = max(last, (FIRST if extra.hard else FIRST_OBSERVED) * least)
    head = HEAD.pack(weight=1.0 / first, scale=scale, axes=axes.ravel(), frame=frame)
    record = np.concatenate([head, own, np.zeros(total)])
    return replace(extra, record=record, final_weight=1.0 / last)


def _with_extra(problem: Problem, extra: Sequence[ExtraObservation]) -> Problem:
    return replace(problem, block=replace(problem.block, extra=tuple(extra))) if extra else problem


def linear_rows(problem: Problem, state: State) -> tuple[Array, Array, list[str]]:
    """Return the rows (c,) of the hard constraints, derivatives (c, u) by all unknowns, and labels."""
    values, parts, labels = [np.zeros(0)], [np.zeros((0, problem.n_columns))], list[str]()
    for e in (e for e in problem.block.extra if isinstance(e, ConstraintObservation) and e.hard):
        value, blocks = extra_blocks(problem, e, state, jacobian=True)
        wide = np.zeros((len(value), problem.n_columns))
        for a, block in blocks:
            wide[:, problem.image_slice(a.index) if a.is_image else problem.point_slice(a.index)] += block
        values.append(value)
        parts.append(wide)
        labels += [e.label] * len(value)
    return np.concatenate(values), np.vstack(parts), labels


def _tightened(extra: ConstraintObservation, correlates: Array) -> ConstraintObservation:
    """Return the constraint with its final weight, and the correlates (r,) of the present weight."""
    record, present = extra.record.copy(), extra.record[HEAD.weight]
    record[HEAD.weight] = extra.final_weight
    record[len(record) - len(correlates) :] = correlates * (present / record[HEAD.weight])
    return replace(extra, record=record)


def _constraints(problem: Problem, state: State) -> list[tuple[int, ConstraintObservation, Array, Array]]:
    """Return the number, observation, misclosures (c,) and new correlates (r,) of each constraint."""
    out = []
    for n, e in enumerate(problem.block.extra):
        if isinstance(e, ConstraintObservation):
            points, total = e.members(problem, state), e.n_residuals + SIZES.get(e.constraint.kind, (0, 0))[1]
            closed, value = total - len(e.constraint.observed), whole_rows(e.constraint, e.record, points, total).value
            misclosures = (value - e.record[-total:])[:closed] / e.record[HEAD.weight]
            out.append((n, e, misclosures, np.where(np.arange(total) < (closed if e.hard else 0), value, 0.0)))
    return out


def misclosures(problem: Problem, state: State) -> list[tuple[ConstraintObservation, Array]]:
    """Return constraints with their misclosures (c,) at a state, in m or as sines; for a figure, of its points."""
    return [(e, c) for _, e, c, _ in _constraints(problem, state)]


def missed_most(problem: Problem, state: State) -> tuple[str, float]:
    """Return the hard constraint with the largest misclosure at a state, m or a sine; "" and 0 without one."""
    away = [(e.label, float(np.abs(c).max())) for e, c in misclosures(problem, state) if e.hard]
    return max(away, key=lambda one: one[1], default=("", 0.0))


def tightened(problem: Problem) -> Problem:
    """Return the problem whose constraints have their final weights, without correlates."""
    return _with_extra(
        problem,
        [_tightened(e, np.zeros(0)) if isinstance(e, ConstraintObservation) else e for e in problem.block.extra],
    )


def hold(
    problem: Problem, estimate: Estimate, run: Callable[[Problem, State, int], Estimate]
) -> tuple[Problem, Estimate]:
    """Improve the correlates of hard constraints until the constraints are met.

    ``run`` adjusts a problem from a state after a number of iterations.

    InputError: hard constraints depend on each other, or contradict each other.
    """
    last = np.inf
    for _ in range(ROUNDS):
        stated, extra = _constraints(problem, estimate.state), list(problem.block.extra)
        if not stated or not estimate.converged:
            break
        for n, e, _, correlates in stated:
            extra[n] = _tightened(e, correlates)
        tight = all(e.record[HEAD.weight] == e.final_weight for _, e, _, _ in stated)
        size = max((np.abs(c).max() * e.final_weight for _, e, c, _ in stated if e.hard), default=0.0)
        if tight and (size < HELD or size > SLOW * last):
            break
        problem, last = _with_extra(problem, extra), size if tight else np.inf
        estimate = _continued(problem, estimate, run)
    damped = problem.block.options.optimizer != "gauss-newton"
    if _has_hard(problem) and estimate.converged and damped and not problem.least_damping:
        # damping is relative to the large weights of the constraints, so the last damped steps are
        # too short
        ahead = _continued(undamped(problem), estimate, run)
        estimate = ahead if ahead.converged else estimate
    return problem, estimate


def undamped(problem: Problem) -> Problem:
    """Replace the optimiser of a problem by Gauss-Newton: damped steps along a weak motion converge too slowly."""
    options = replace(problem.block.options, optimizer="gauss-newton")
    return replace(problem, block=replace(problem.block, options=options))


def _continued(problem: Problem, before: Estimate, run: Callable[[Problem, State, int], Estimate]) -> Estimate:
    """Return the estimate of a problem from the state of an earlier one, with the log of both."""
    n = len(before.log)
    estimate = run(problem, before.state, n)
    log = tuple(replace(record, iteration=n + k) for k, record in enumerate(estimate.log, start=1))
    return replace(
        estimate,
        log=before.log + log,
        iterations=before.iterations + estimate.iterations,
        solve_s=before.solve_s + estimate.solve_s,
    )


def _require_held(problem: Problem, state: State) -> None:
    """Raise InputError for hard constraints that are not met, or depend on each other."""
    hard, (_, rows, labels) = [s for s in _constraints(problem, state) if s[1].hard], linear_rows(problem, state)
    away = np.nan_to_num([np.abs(c).max() for _, _, c, _ in hard], nan=np.inf)
    if away.max() > CONTRADICTION:
        names = [e.label for (_, e, _, _), size in zip(hard, away, strict=True) if size >= NAMED * away.max()]
        raise InputError.of(
            "closerange.contradiction", place="constraints", value=f"{away.max():.3g} left", names="; ".join(names)
        )
    diagonal = np.zeros(len(labels))
    triangle = np.linalg.qr((rows / np.linalg.norm(rows, axis=1, keepdims=True)).T, mode="r")
    diagonal[: len(triangle)] = np.abs(np.diag(triangle))
    if (diagonal <= DEPENDENT).any():
        raise InputError.of("closerange.dependent", place=labels[int(np.argmax(diagonal <= DEPENDENT))])


def released(problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate]:
    """Return the problem without correlates, and the state on the hard constraints with its weighted sum of squares."""
    extra, chi2 = list(problem.block.extra), estimate.chi2
    for n, e, _, correlates in (s for s in _constraints(problem, estimate.state) if s[1].hard):
        extra[n] = replace(e, record=np.concatenate([e.record[: -len(correlates)], np.zeros(len(correlates))]))
        value, left = (extra_blocks(problem, one, estimate.state, jacobian=False)[0] for one in (e, extra[n]))
        # first remove the rows from chi2, then add the change that the movement onto the constraints
        # causes
        chi2 += float(value @ (2.0 * left - value))
    problem = _with_extra(problem, extra)
    if not _has_hard(problem) or not estimate.converged:
        return problem, replace(estimate, chi2=chi2)
    return problem, replace(estimate, chi2=chi2, state=_on_constraints(problem, estimate.state))
