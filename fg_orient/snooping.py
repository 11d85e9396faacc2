"""Data snooping: adjust, test, leave out the worst observation, again, until none is suspicious.

One observation per round (Baarda 1968): a gross error raises the statistics of its neighbours, too. Nothing is deleted:
the block that is adjusted loses the observation, the given one stays as it is, and each is named with its test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fg_orient.block import Block, Coordinates, GroundPoints
from fg_orient.names import Role
from fg_orient.orient import adjust
from fg_orient.quality.outliers import LEVEL, GroupTest
from fg_orient.solution import Solution

#: More than this share of the observations cannot be gross errors: then it is the model that is wrong.
MOST: Final = 0.25


@dataclass(frozen=True)
class Snooping:
    """What the search found.

    Parameters
    ----------
    solution : Solution
        Of the last round: nothing in it is suspicious, unless ``complete`` is False.
    found : tuple of GroupTest
        The observations left out, in the order in which they were found.
    complete : bool
        False if a quarter of the observations is suspicious: no gross errors, the model does not hold.
    """

    solution: Solution
    found: tuple[GroupTest, ...]
    complete: bool

    @property
    def points(self) -> tuple[str, ...]:
        """Ids of the points with a suspicious observation."""
        return tuple(dict.fromkeys(test.point for test in self.found))


def snoop(block: Block, *, level: float = LEVEL, **options: Any) -> Snooping:
    """Find gross errors among image points and control-point coordinates.

    Parameters
    ----------
    block : Block
        Points to be judged with their coordinates must have the role control: coordinates of check points
        stay sealed.
    level : float
        Probability of a false alarm among all observations, per round.
    **options
        Of :func:`fg_orient.adjust`.

    Returns
    -------
    Snooping

    Raises
    ------
    InputError, RankDeficientError
        See :func:`fg_orient.adjust`.
    NoSolutionError
        The covariance, on which the test rests, cannot be computed.
    """
    found: list[GroupTest] = []
    most = int(MOST * len(block.observations))
    while True:
        solution = adjust(block, **options)
        tests = solution.outlier_tests(level=level)
        if not tests or not tests[0].suspicious or len(found) >= most:
            return Snooping(solution, tuple(found), not (tests and tests[0].suspicious))
        found.append(tests[0])
        block = without(block, tests[0])


def without(block: Block, test: GroupTest) -> Block:
    """Leave one tested observation out; points that nothing determines any more go with it."""
    j = block.points.ids.index(test.point)
    o, points = block.observations, block.points
    if test.image:
        o = o.take(~((o.point == j) & (o.image == block.image_index(test.image))))
    else:
        points = _as_tie(points, j)
    if points.roles[j] is not Role.CONTROL and np.count_nonzero(o.point == j) == 1:
        o = o.take(o.point != j)
    return replace(block, points=points, observations=o)


def _as_tie(points: GroundPoints, j: int) -> GroundPoints:
    """Give up the coordinates of a control point."""
    roles = tuple(Role.TIE if k == j else role for k, role in enumerate(points.roles))
    keep = (np.arange(len(roles)) != j)[:, None]
    known = points.known
    return GroundPoints(points.ids, roles, Coordinates(
        np.where(keep, known.ecef_m, np.nan), np.where(keep, known.sigma_enu_m, np.nan), known.fixed & keep[:, 0],
    ))  # fmt: skip
