"""Search for gross errors as one call; the loop is ``fg_orient.orientation.outlier_search``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fg_orient.model.block import Block
from fg_orient.model.options import SnoopKind
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.quality.outliers import GroupTest
from fg_orient.quality.search import Search


@dataclass(frozen=True)
class Snooping:
    """What the search found.

    Parameters
    ----------
    solution : Solution
        Of the last round: nothing in it is suspicious, unless the search was given up.
    search : Search
        All rounds, and all that was ever left out.
    """

    solution: Solution
    search: Search

    @property
    def found(self) -> tuple[GroupTest, ...]:
        """Tests of the observations that stay out, in the order in which they were found."""
        return tuple(found.test for found in self.search.left_out)

    @property
    def complete(self) -> bool:
        """Whether nothing is suspicious any more."""
        return not self.search.given_up

    @property
    def points(self) -> tuple[str, ...]:
        """Ids of the points with a suspicious observation."""
        return tuple(dict.fromkeys(test.point for test in self.found))


def snoop(
    block: Block, *, level: float | None = None, test: str | None = None, control: str | None = None,
    kind: SnoopKind | None = None, **options: Any,
) -> Snooping:  # fmt: skip
    """Find gross errors among image points and control-point coordinates.

    Parameters
    ----------
    block : Block
        Points to be judged with their coordinates must have the role control: coordinates of check points
        stay sealed.
    level, test, control, kind : optional
        Options ``outlier_level``, ``outlier_test``, ``multiple_testing`` and ``snoop_kind``; those of the block if not
        given.
    **options
        Of :func:`fg_orient.adjust`.

    Returns
    -------
    Snooping

    Raises
    ------
    InputError, RankDeficientError
        See :func:`fg_orient.adjust`; a loss.
    NoSolutionError
        The covariance, on which the test rests, cannot be computed.
    """
    solution = adjust(
        block, snoop=True, snoop_kind=kind, outlier_level=level, outlier_test=test, multiple_testing=control, **options
    )
    assert solution.snooping is not None  # asked for above
    return Snooping(solution, solution.snooping)
