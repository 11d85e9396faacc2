"""Rejection of gross errors: fit, test, leave out the worst observation, fit again.

One observation per round (Baarda 1968), because a gross error raises the statistics of its neighbours, too. A domain
gives its fit and its tests; this loop decides what is left out, what comes back and when the search ends.

An early choice among suspects need not be right. After each fit the observations that are out are therefore predicted
from the others, and the one that fits best is put back before anything else is left out. Each may come back once. So
every round but the last takes one of at most three changes from an observation (out, back, out again), and the search
ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

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
