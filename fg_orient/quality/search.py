"""What a search for gross errors found, round by round (``fg_orient.orientation.outlier_search``)."""

from __future__ import annotations

from dataclasses import dataclass

from fg_orient.model.errors import Finding, finding
from fg_orient.quality.outliers import GroupTest
from fg_orient.quality.prediction import Fit


@dataclass(frozen=True)
class Found:
    """An observation that was left out.

    Parameters
    ----------
    test : GroupTest
        Its test in the adjustment with it.
    round : int
        Adjustment in which it was found, from 1.
    with_it : tuple of str
        What nothing determined any more without it, and went with it: the other ray of a point seen twice.
    fit : Fit
        How it fits to the adjustment without it: when it was put back, else in the last round.
    readmitted : int or None
        Adjustment after which it was put back; None: it stays out.
    """

    test: GroupTest
    round: int
    with_it: tuple[str, ...] = ()
    fit: Fit | None = None
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
    found : tuple of Found
        All that was ever left out, in the order of the rounds.
    given_up : Finding or None
        Why the search ended although something is suspicious; None if it came to its end.
    went_with : tuple of str
        Image points that stay out because they would be the single ray of a point.
    check_points : tuple of str
        Ids of check points that have no ray any more: they are not in the accuracy.
    """

    rounds: tuple[Round, ...]
    found: tuple[Found, ...]
    given_up: Finding | None = None
    went_with: tuple[str, ...] = ()
    check_points: tuple[str, ...] = ()

    @property
    def left_out(self) -> tuple[Found, ...]:
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
