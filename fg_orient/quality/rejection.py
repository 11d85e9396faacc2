"""Rejection of gross errors: fit, test, leave out the worst observation, fit again.

One observation per round (Baarda 1968), because a gross error raises the statistics of its neighbours, too. A domain
gives its fit and its tests; this loop decides what is left out, what comes back and when the search ends.

An early choice among suspects need not be right. After each fit the observations that are out are therefore predicted
from the others, and the one that fits best is put back before anything else is left out. Each may come back once. So
every round but the last takes one of at most three changes from an observation (out, back, out again), and the search
ends.

The record of a search in an adjustment (``fg_orient.orientation.outlier_search``) is :class:`Search`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Generic, TypeVar

import numpy as np

from fg_orient.model.errors import Finding, finding

if TYPE_CHECKING:
    from fg_orient.quality.outliers import GroupTest
    from fg_orient.quality.prediction import ConsistencyTest

F = TypeVar("F")
T = TypeVar("T")

#: More than this share of the observations cannot be gross errors: then it is the model that is wrong.
MOST: Final = 0.25


@dataclass(frozen=True)
class Change(Generic[T]):
    """Observation that was left out or put back after a fit; neither after the last."""

    left_out: T | None = None
    put_back: T | None = None


@dataclass(frozen=True)
class Rejection(Generic[F, T]):
    """Result of :func:`reject`.

    Parameters
    ----------
    fit : object
        Of the last round.
    changes : tuple of Change
        One per fit.
    out : tuple
        Observations that stay out, in the order in which they were left out.
    worst : object or None
        The most suspicious observation of those that are in; None: nothing is suspicious.
    error : Exception or None
        Reason why there is no fit without ``worst``; None: ``worst`` is in because too many are out.
    """

    fit: F
    changes: tuple[Change[T], ...]
    out: tuple[T, ...]
    worst: T | None
    error: Exception | None = None


def reject(
    first: F,
    fit: Callable[[Sequence[T], F], F],
    worst: Callable[[F, Sequence[T]], T | None],
    most: int,
    *,
    returning: Callable[[F, Sequence[T]], Sequence[float]] = lambda _, out: [0.0] * len(out),
    impossible: tuple[type[Exception], ...] = (),
) -> Rejection[F, T]:
    """Leave out the worst observation and fit again until nothing is suspicious.

    Parameters
    ----------
    first : object
        Fit of all observations.
    fit : callable
        Fits without the observations that are out; it also takes the fit before.
    worst : callable
        Most suspicious observation of a fit, None if none is suspicious; it also takes the observations that are out.
    most : int
        Number of observations that may be out.
    returning : callable, optional
        For each observation that is out the probability of its test in the fit without it; 0 where it does not fit.
        Without this function nothing comes back.
    impossible : tuple of exception classes
        Raised where the observations that are left do not determine a fit. The last one is taken back in, and the
        search ends. Other exceptions pass.
    """
    last, out, changes, returned = first, list[T](), list[Change[T]](), list[T]()
    while True:
        probabilities = [0.0 if one in returned else p for one, p in zip(out, returning(last, out), strict=True)]
        back = max(probabilities, default=0.0) > 0.0
        suspect = None if back else worst(last, out)
        if back:
            returned.append(out.pop(int(np.argmax(probabilities))))
            changes.append(Change(put_back=returned[-1]))
        elif suspect is None or len(out) >= most:
            return Rejection(last, (*changes, Change()), tuple(out), suspect)
        else:
            out.append(suspect)
            changes.append(Change(left_out=suspect))
        try:
            last = fit(out, last)
        except impossible as error:
            if back:
                raise
            return Rejection(last, (*changes[:-1], Change()), tuple(out[:-1]), out[-1], error)


# --- record of a search ---------------------------------------------------------------------------


@dataclass(frozen=True)
class ExcludedObservation:
    """Observation that the search excluded.

    Parameters
    ----------
    test : GroupTest
        Its test in the adjustment with it.
    round : int
        Adjustment in which it was found, from 1.
    with_it : tuple of str
        What nothing determined any more without it, and went with it: the other ray of a point seen twice.
    fit : ConsistencyTest
        How it fits to the adjustment without it: when it was put back, else in the last round.
    readmitted : int or None
        Adjustment after which it was put back; None: it stays out.
    """

    test: GroupTest
    round: int
    with_it: tuple[str, ...] = ()
    fit: ConsistencyTest | None = None
    readmitted: int | None = None

    def sentence(self) -> str:
        """Name it, its test and what became of it."""
        also = f"; with it {', '.join(self.with_it)}" if self.with_it else ""
        back = "" if self.readmitted is None else f"; put back after round {self.readmitted}: it fits to the rest"
        return f"{self.test.sentence()}{also}{back}"


@dataclass(frozen=True)
class Round:
    """One adjustment of the search.

    Parameters
    ----------
    number : int
        From 1.
    sigma0 : float
    redundancy : int
    n_tested : int
    n_suspicious : int
    left_out, put_back : str
        Name of what was changed after it; "" for nothing.
    """

    number: int
    sigma0: float
    redundancy: int
    n_tested: int
    n_suspicious: int
    left_out: str = ""
    put_back: str = ""


@dataclass(frozen=True)
class Search:
    """A search for gross errors.

    Parameters
    ----------
    rounds : tuple of Round
    found : tuple of ExcludedObservation
        All that was ever left out, in the order of the rounds.
    given_up : Finding or None
        Why the search ended although something is suspicious; None if it came to its end.
    went_with : tuple of str
        Image points that stay out because they would be the single ray of a point.
    check_points : tuple of str
        Ids of check points that have no ray any more: they are not in the accuracy.
    """

    rounds: tuple[Round, ...]
    found: tuple[ExcludedObservation, ...]
    given_up: Finding | None = None
    went_with: tuple[str, ...] = ()
    check_points: tuple[str, ...] = ()

    @property
    def left_out(self) -> tuple[ExcludedObservation, ...]:
        """Observations that stay out."""
        return tuple(found for found in self.found if found.readmitted is None)

    @property
    def tests(self) -> tuple[GroupTest, ...]:
        """Tests of the observations that stay out, in the order in which they were left out."""
        return tuple(found.test for found in self.left_out)

    @property
    def points(self) -> tuple[str, ...]:
        """Ids of the points of these observations."""
        return tuple(dict.fromkeys(test.point for test in self.tests))

    @property
    def complete(self) -> bool:
        """Whether no observation is suspicious any more."""
        return not self.given_up

    def findings(self) -> tuple[Finding, ...]:
        """What was left out, and whether the search came to an end."""
        out = []
        if self.left_out:
            names = [found.test.name for found in self.left_out]
            out.append(finding("search.left_out", n=len(names), rounds=len(self.rounds), names=names,
                               with_them=self.went_with))  # fmt: skip
            if self.check_points:
                out.append(finding("search.check_points", n=len(self.check_points), points=self.check_points))
        return (*out, self.given_up) if self.given_up else tuple(out)
