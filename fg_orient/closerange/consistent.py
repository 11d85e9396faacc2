"""Whether hard conditions can hold together: a search for a state that meets them all, observations left aside."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from fg_orient.adjustment.network import DEPENDENT, Network, NetworkRows, Observation, dependent
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: A condition (m, or a sine) holds if no more than this is left: rounding of coordinates of 1e6 m.
HELD: Final = 1e-9
#: What ends the search: well below, so that dependence shows in the derivatives.
_FOUND: Final = 1e-12
#: Conditions with this share of the largest misfit are named.
NAMED: Final = 0.1
#: Distance of two points by that at the start, below which conditions have made them one.
MERGED: Final = 1e-3
_STEPS: Final = 300
#: Smallest damping, by the square of the largest singular value.
_DAMPING: Final = 1e-12
#: Steps by the unknowns that are rounding.
ROUNDING: Final = 1e-15


def require_consistent(network: Network) -> None:
    """Refuse hard conditions without a common solution near the start.

    The least sum of their squares (Levenberg-Marquardt): what is left of a condition there is its part in a conflict.
    Conditions that vanish only where points become one (points of a plumb line on a horizontal circle) are a conflict
    as well, for points that were measured apart.

    Raises
    ------
    InputError
        Names the conditions that stay unmet, the points that would be one, or a condition that follows from the others
        where all hold.
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
        named = [label for label, c in zip(_labels(hard), left, strict=True) if abs(c) >= NAMED * largest]
        raise InputError.of("closerange.contradiction", place="bundle", value=f"{largest:.3g} left",
                            names="; ".join(dict.fromkeys(named)))  # fmt: skip
    merged = _merged(hard, state)
    if merged:
        named = [o.label.partition(": ")[0] for o in hard.observations if merged & {*_points(hard, o)}]
        points = ", ".join(hard.variables[k].name.removeprefix("point ") for k in sorted(merged))
        raise InputError.of("closerange.merged", place="bundle", names="; ".join(dict.fromkeys(named)), points=points)
    label = dependent(hard, hard.rows(state))
    if label:
        raise InputError.of("closerange.dependent", place=label)


def require_slopes(network: Network, rows: NetworkRows) -> None:
    """Refuse a hard condition that is not met and that no small change mends: lines at right angles, to be parallel.

    Raises
    ------
    InputError
        Names the condition and what it misses.
    """
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
    """Points in conditions that are apart at the start and one at a state."""
    numbers = np.array(sorted({k for o in hard.observations for k in _points(hard, o)}), np.intp)
    first, second = np.triu_indices(len(numbers), 1)
    before, after = (
        np.linalg.norm(at[first] - at[second], axis=1)
        for at in (np.array([x[hard.part(k)] for k in numbers]).reshape(-1, 3) for x in (hard.start, state))
    )
    one = after < MERGED * before
    return set(numbers[np.concatenate([first[one], second[one]])].tolist())


def missed_most(network: Network) -> str:
    """Words on the hard condition that the start is farthest from; "" without any."""
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
    """Conditions (h,) where their sum of squares is least, which tell by how much each is in conflict; state there."""
    state, damping = hard.start, _DAMPING
    rows = hard.rows(state)
    for _ in range(_STEPS):
        if np.abs(rows.condition).max() <= _FOUND:
            break
        # of the scaled conditions, the least ones with the shortest way
        size = float(np.linalg.norm(rows.border, 2))
        square = rows.border @ rows.border.T + damping * size**2 * np.eye(len(rows.condition))
        step = -rows.border.T @ np.linalg.solve(square, rows.condition)
        trial = hard.rows(state + step)
        if trial.condition @ trial.condition < rows.condition @ rows.condition:
            state, rows, damping = state + step, trial, max(0.1 * damping, _DAMPING)
        else:
            damping *= 10.0
        if np.linalg.norm(step) <= ROUNDING * np.linalg.norm(state):
            break
    return rows.condition, state
