"""Rejection of gross errors: fit, test, exclude the worst observation, fit again.

The observations are excluded one after the other (Baarda 1968), because a gross error also increases the statistics of
its neighbours. Each domain supplies its fit and its tests. The tests may name several observations of a round in their
order (``fg_orient.quality.successive``). This loop decides which observations are excluded or included again, and when
the search ends.

An early choice among suspects may be wrong. After each fit the excluded observations are therefore predicted
from the others. Observations that fit are included again before another observation is excluded. An
observation can be included again only once. Every round except the last changes an observation, and each
observation changes at most three times (excluded, included, excluded). Therefore the search ends.

The record of a search in an adjustment (``fg_orient.orientation.outlier_search``) is :class:`Search`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from fg_orient.model.errors import Finding, finding

if TYPE_CHECKING:
    from fg_orient.quality.outlier_records import GroupTest
    from fg_orient.quality.prediction import ConsistencyTest

F = TypeVar("F")
T = TypeVar("T")

#: Maximum share of gross errors among the observations. If there are more, the model must be wrong.
MOST: Final = 0.25

#: Parts of suspects that are coordinates of control points.
COORDINATES: Final = ("position", "height", "east", "north", "up")


@dataclass(frozen=True)
class Change(Generic[T]):
    """Observations that were excluded or included again after a fit; empty after the last fit."""

    left_out: tuple[T, ...] = ()
    put_back: tuple[T, ...] = ()


@dataclass(frozen=True)
class Rejection(Generic[F, T]):
    """Result of :func:`reject`.

    Parameters
    ----------
    fit : object
        Fit of the last round.
    changes : tuple of Change
        One per fit.
    out : tuple
        Observations that stay excluded, in the order of their exclusion.
    worst : object or None
        Most suspicious observation of the last fit; None: no observation is suspicious.
    error : Exception or None
        Error of the fit without ``worst``. None: ``worst`` remains because too many observations are excluded.
    """

    fit: F
    changes: tuple[Change[T], ...]
    out: tuple[T, ...]
    worst: T | None
    error: Exception | None = None


def reject(
    first: F,
    fit: Callable[[Sequence[T], F], F],
    worst: Callable[[F, Sequence[T]], Sequence[T]],
    most: int,
    *,
    returning: Callable[[F, Sequence[T], Sequence[T]], Sequence[T]] = lambda *_: (),
    impossible: tuple[type[Exception], ...] = (),
) -> Rejection[F, T]:
    """Exclude the worst observation and fit again until no observation is suspicious.

    Parameters
    ----------
    first : object
        Fit of all observations.
    fit : callable
        Function that fits without the excluded observations, given these and the previous fit.
    worst : callable
        Function that returns observations to exclude, the most suspicious first, given a fit and the excluded
        observations; empty if no observation is suspicious.
    most : int
        Maximum number of excluded observations.
    returning : callable, optional
        Function that returns observations to include again together, given a fit, the excluded
        observations, and the excluded observations that may return. Without this function no
        observation returns.
    impossible : tuple of exception classes
        Errors of a fit whose observations do not determine it. If several observations were excluded at once,
        the second half of them is then included again, and so on. If the fit is still impossible without the
        first observation alone, the search ends.
    """
    last, out, changes, returned = first, list[T](), list[Change[T]](), list[T]()
    while True:
        back = tuple(returning(last, out, [one for one in out if one not in returned]))
        if back:
            out = [one for one in out if one not in back]
            returned += back
            changes.append(Change(put_back=back))
            last = fit(out, last)
            continue
        suspects, error = tuple(worst(last, out)), None
        if not suspects or len(out) >= most:
            return Rejection(last, (*changes, Change()), tuple(out), suspects[0] if suspects else None)
        some = suspects[: most - len(out)]
        while some:
            try:
                last = fit([*out, *some], last)
            except impossible as why:
                error, some = why, some[: len(some) // 2]
            else:
                out, error = [*out, *some], None
                changes.append(Change(left_out=some))
                break
        if error is not None:
            return Rejection(last, (*changes, Change()), tuple(out), suspects[0], error)


# --- record of a search ---------------------------------------------------------------------------


@dataclass(frozen=True)
class ExcludedObservation:
    """Observation that the search excluded.

    Parameters
    ----------
    test : GroupTest
        Test in the adjustment with the observation.
    round : int
        Number of this adjustment, counted from 1.
    with_it : tuple of str
        Observations that are excluded with it because they are useless alone, such as the other image point
        of a point measured twice.
    fit : ConsistencyTest
        Consistency with the adjustment without it: when it was included again, otherwise in the last round.
    readmitted : int or None
        Adjustment after which it was included again; None: it stays excluded.
    pixel : (float, float)
        Measured line and sample; nan for observations other than image points.
    """

    test: GroupTest
    round: int
    with_it: tuple[str, ...] = ()
    fit: ConsistencyTest | None = None
    readmitted: int | None = None
    pixel: tuple[float, float] = (math.nan, math.nan)

    def sentence(self) -> str:
        """Describe the observation, its test, and its return in a sentence."""
        also = f"; with it {', '.join(self.with_it)}" if self.with_it else ""
        back = "" if self.readmitted is None else f"; put back after round {self.readmitted}: it fits to the rest"
        return f"{self.test.sentence()}{also}{back}"


@dataclass(frozen=True)
class Round:
    """One adjustment of the search.

    Parameters
    ----------
    number : int
        Number, counted from 1.
    sigma0 : float
    redundancy : float
    n_tested : int
    n_suspicious : int
    left_out, put_back : str
        Names of the observations changed after this adjustment; "" if none.
    """

    number: int
    sigma0: float
    redundancy: float
    n_tested: int
    n_suspicious: int
    left_out: str = ""
    put_back: str = ""


@dataclass(frozen=True)
class Search:
    """Record of a search for gross errors.

    Parameters
    ----------
    rounds : tuple of Round
    found : tuple of ExcludedObservation
        All observations that were left out, in the order of the rounds.
    given_up : Finding or None
        Reason why the search ended with suspicious observations; None if no observation is suspicious.
    went_with : tuple of str
        Image points that stay excluded because they would be the only image point of a point.
    check_points : tuple of str
        Ids of check points without remaining image points: they are not included in the accuracy.
    kept : tuple of int
        Rows of the given block's image points that are kept.
    """

    rounds: tuple[Round, ...]
    found: tuple[ExcludedObservation, ...]
    given_up: Finding | None = None
    went_with: tuple[str, ...] = ()
    check_points: tuple[str, ...] = ()
    kept: tuple[int, ...] = ()

    @property
    def left_out(self) -> tuple[ExcludedObservation, ...]:
        """Observations that stay excluded."""
        return tuple(one for one in self.found if one.readmitted is None)

    @property
    def tests(self) -> tuple[GroupTest, ...]:
        """Tests of the observations that stay excluded, in the order of their exclusion."""
        return tuple(one.test for one in self.left_out)

    @property
    def points(self) -> tuple[str, ...]:
        """Ids of the points of these observations."""
        return tuple(dict.fromkeys(test.point for test in self.tests))

    @property
    def complete(self) -> bool:
        """True if no observation is suspicious any more."""
        return not self.given_up

    def findings(self) -> tuple[Finding, ...]:
        """Return the findings on excluded observations and on an incomplete search."""
        out = []
        if self.left_out:
            names = [one.test.name for one in self.left_out]
            coordinates = [one for one in self.left_out if one.test.part in COORDINATES and not one.with_it]
            ties = list(dict.fromkeys(one.test.point for one in coordinates))
            out.append(
                finding("search.left_out", n=len(names), rounds=len(self.rounds), names=names, ties=ties,
                        with_them=self.went_with)
            )  # fmt: skip
            out.append(finding("search.conditional"))
            if self.check_points:
                out.append(finding("search.check_points", n=len(self.check_points), points=self.check_points))
        return (*out, self.given_up) if self.given_up else tuple(out)
