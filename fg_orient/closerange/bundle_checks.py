"""Refusals of a bundle: points without rays, undetermined unknowns, contradicting or dependent hard constraints."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.cameras.extended_collinearity import EXTENDED_COLLINEARITY
from fg_orient.adjustment.network import DEPENDENT, Network, NetworkRows, Observation, dependent
from fg_orient.closerange.bundle_network import Built
from fg_orient.closerange.fitting import RANK_LIMIT, UNDETERMINED
from fg_orient.model.errors import InputError, finding

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Elements of a direction above this share of the largest are named.
NAMED: Final = 0.3
#: Motions of a coordinate system: shifts, rotations, scale.
MOTIONS: Final = ("shift X", "shift Y", "shift Z", "turn about X", "turn about Y", "turn about Z", "scale")
#: Weight of a hard condition relative to observations in units of their accuracy.
HARD: Final = 1e6
#: Largest misclosure of a hard condition (m, or a sine): rounding of coordinates of 1e6 m.
HELD: Final = 1e-9
#: Conditions with this share of the largest misclosure are named.
CONFLICTING: Final = 0.1
#: Conditions have merged two points if their distance, relative to the start, is smaller.
MERGED: Final = 1e-3
_STEPS: Final = 300
#: Relative change of squares and unknowns, and gradient, at rounding level.
ROUNDING: Final = 1e-15


def require_rays(built: Built, which: Index, of: Index) -> None:
    """Refuse points in fewer than two photos without other observations; photo and point (m,) of each image point.

    A control point or a point of a constraint is checked with all other unknowns, by :func:`require_determined`.
    """
    others = {u for o in built.observations if o.equation is not EXTENDED_COLLINEARITY
              for u in o.unknowns if not isinstance(u, np.ndarray)}  # fmt: skip
    faults = []
    for j in (j for j, variable in built.point_variables.items() if variable not in others):
        photos = np.unique(which[of == j])
        if not len(photos):
            faults.append(finding("closerange.no_ray", place=f"point {built.ids[j]}"))
        elif len(photos) == 1:
            where = f"point {built.ids[j]}, photo {built.photos[photos[0]].name}"
            faults.append(finding("closerange.one_ray", place=where))
    if faults:
        raise InputError(*faults)


def require_determined(built: Built, rows: NetworkRows) -> None:
    """Refuse unknowns that the rows do not determine.

    Hard conditions allow a space of motions Z. The singular values of J Z, with unknowns in units of the accuracy of
    their observations, measure how well the observations determine the unknowns. A figure has the unit of its points.
    The error names undetermined motions of the coordinate system; otherwise the unknowns and the direction.
    """
    unit = built.units(rows)
    border = rows.border * unit
    basis = np.eye(len(unit))
    if len(border):
        basis = np.linalg.svd(border / np.linalg.norm(border, axis=1, keepdims=True))[2][len(border) :].T
    design = np.linalg.qr(rows.design * unit, mode="r") @ basis  # its singular values, in a tenth of the time
    _, values, right = np.linalg.svd(design, full_matrices=len(design) < design.shape[1])
    values = np.concatenate([values, np.zeros(design.shape[1] - len(values))])
    if not len(values):
        return
    free = np.array([not known for known in built.observed])
    if values[-1] > RANK_LIMIT * values[0]:
        deviation = np.sqrt(np.sum((basis @ right.T / values) ** 2, axis=1))
        if not (deviation * free > UNDETERMINED).any():
            return
    require_datum(built, rows, unit)
    weak = basis @ right[-1]
    share = np.abs(weak) / np.abs(weak).max()
    names = [built.network.labels[k] for k in np.flatnonzero(share >= NAMED)]
    top = int(np.argmax(share))
    terms = (f"{weak[k] * unit[k] / (weak[top] * unit[top]):+.3g} {built.network.labels[k]}"
             for k in np.argsort(-share)[:4])  # fmt: skip
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    raise InputError.of("closerange.undetermined", place="bundle", names=shown, direction=" ".join(terms),
                        limit=UNDETERMINED)  # fmt: skip


def require_datum(built: Built, rows: NetworkRows, unit: Array) -> None:
    """Refuse a bundle that can be moved as a whole without an effect on the observations.

    The figures follow the seven motions. With hard conditions as observations of large weight, small singular values
    belong to open motions.
    """
    length = np.linalg.norm(rows.border * unit, axis=1, keepdims=True)
    design = np.vstack([rows.design * unit, HARD * rows.border * unit / np.where(length > 0.0, length, 1.0)])
    moved = motions(built) / unit[:, None]
    figures = built.elements(built.figure_variables)
    effect = design @ moved
    if len(figures):  # the figures follow a motion without a misclosure
        follow, _ = np.linalg.qr(design[:, figures])
        effect = effect - follow @ (follow.T @ effect)
    size = np.linalg.norm(moved, axis=0)
    if not (size > 0.0).all():  # all points and photos are held fixed
        return
    moved, effect = moved / size, effect / size
    _, values, right = np.linalg.svd(np.linalg.qr(effect, mode="r"))
    count = int(np.sum(np.abs(moved @ right.T).max(axis=0) > UNDETERMINED * values))
    if count:
        alone = np.abs(moved).max(axis=0) > UNDETERMINED * np.linalg.norm(effect, axis=0)
        words = [name for name, is_open in zip(MOTIONS, alone, strict=True) if is_open]
        raise InputError.of("closerange.datum", place="bundle", count=count,
                            words=f" ({', '.join(words)})" if words else "")  # fmt: skip


def motions(built: Built) -> Array:
    """Changes (u, 7) of the unknowns if the block is shifted, rotated or scaled about its origin; 0 for figures.

    A point P moves by e, e x P or P; a photo that rotates with the block by e rotates by -R e in its own axes.
    """
    state, out = built.network.start, np.zeros((built.network.n_unknowns, 7))
    for k in [*built.centres, *built.point_variables.values()]:
        if not isinstance(k, np.ndarray):
            part = built.network.part(k)
            at = state[part]
            out[part, :3], out[part, 3:6], out[part, 6] = np.eye(3), np.cross(np.eye(3), at).T, at
    for photo, k in enumerate(built.turns):
        if not isinstance(k, np.ndarray):
            out[built.network.part(k), 3:6] = -built.rotation(photo, state)
    return out


# --- hard constraints ------------------------------------------------------------------------------


def require_consistent(network: Network) -> None:
    """Refuse hard conditions without a common solution near the start.

    Their sum of squares is minimised in a trust region, without observations; the misclosure of a condition there
    is its part in a conflict. Conditions that vanish only if points merge (points of a plumb line on a horizontal
    circle) are a conflict as well if the points were measured apart. A condition that follows from the others where all
    hold is refused, too.
    """
    hard = _hard(network)
    if not hard.observations:
        return
    try:
        left, state = _least(hard)
    except NotFiniteError:
        return
    largest = float(np.abs(left).max())
    if largest > HELD:
        named = [label for label, c in zip(_labels(hard), left, strict=True) if abs(c) >= CONFLICTING * largest]
        raise InputError.of("closerange.contradiction", place="bundle", value=f"{largest:.3g} left",
                            names="; ".join(dict.fromkeys(named)))  # fmt: skip
    merged = _merged(hard, state)
    if merged:
        named = [o.label.partition(": ")[0] for o in hard.observations if merged & {*_points(hard, o)}]
        points = ", ".join(hard.variables[k].name.removeprefix("point ") for k in sorted(merged))
        raise InputError.of("closerange.merged", place="bundle", names="; ".join(dict.fromkeys(named)), points=points)
    require_independent(hard, hard.rows(state))


def require_independent(network: Network, rows: NetworkRows) -> None:
    """Refuse a hard constraint that depends on those before it: redundancy and cofactors would count it twice."""
    label = dependent(network, rows)
    if label:
        raise InputError.of("closerange.dependent", place=label)


def require_slopes(network: Network, rows: NetworkRows) -> None:
    """Refuse an unsatisfied hard condition with zero derivatives: perpendicular lines that must be parallel."""
    length = np.linalg.norm(rows.border, axis=1)
    stuck = (length <= DEPENDENT * length.max(initial=0.0)) & (np.abs(rows.condition) > HELD)
    if stuck.any():
        k = int(np.argmax(stuck))
        raise InputError.of("closerange.saddle", place=_labels(_hard(network))[k], value=f"{rows.condition[k]:.3g}")


def _points(hard: Network, observation: Observation) -> list[int]:
    """Numbers of the variables of an observation that are points."""
    numbers = (u for u in observation.unknowns if not isinstance(u, np.ndarray))
    return [k for k in numbers if hard.variables[k].is_point]


def _merged(hard: Network, state: Array) -> set[int]:
    """Points in conditions that are apart at the start and merged at a state."""
    numbers = np.array(sorted({k for o in hard.observations for k in _points(hard, o)}), np.intp)
    first, second = np.triu_indices(len(numbers), 1)
    before, after = (
        np.linalg.norm(at[first] - at[second], axis=1)
        for at in (np.array([x[hard.part(k)] for k in numbers]).reshape(-1, 3) for x in (hard.start, state))
    )
    one = after < MERGED * before
    return set(numbers[np.concatenate([first[one], second[one]])].tolist())


def missed_most(network: Network) -> str:
    """Words on the hard condition with the largest misclosure at the start; "" without conditions."""
    hard = _hard(network)
    if not hard.observations:
        return ""
    away = np.abs(hard.rows(hard.start, jacobian=False).condition)
    return f" (the start misses the hard constraint {_labels(hard)[int(np.argmax(away))]} by {away.max():.3g})"


def _hard(network: Network) -> Network:
    return Network(network.variables, tuple(o for o in network.observations if o.hard))


def _labels(hard: Network) -> list[str]:
    """Label of each condition (h,)."""
    return [o.label for o in hard.observations for _ in range(o.n_residuals)]


def _least(hard: Network) -> tuple[Array, Array]:
    """Misclosures (h,) of the conditions at the minimum of their sum of squares, and the state (u,) there."""
    from scipy.optimize import least_squares

    def misclosures(x: Array) -> Array:
        return hard.rows(x, jacobian=False).condition

    def slopes(x: Array) -> Array:
        return hard.rows(x).border

    run = least_squares(misclosures, hard.start, slopes, ftol=ROUNDING, xtol=ROUNDING, gtol=ROUNDING, max_nfev=_STEPS)
    return np.asarray(run.fun), np.asarray(run.x)
