"""Outlier tests: each observation is tested against all others with the covariance of the residuals.

Suspects and their T: ``fg_orient.quality.suspects``. Tests and control of multiple tests:
``fg_orient.quality.hypotheses``. Inseparable suspects (position of a control point and its only image point) are one
hypothesis and are named together. The search that leaves observations out is ``fg_orient.orientation.outlier_search``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, overload

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem
from fg_orient.model.errors import InputError
from fg_orient.quality import hypotheses
from fg_orient.quality.freedom import freedoms
from fg_orient.quality.observation_groups import groups_of
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import KINDS, Kind, Suspects, suspects
from fg_orient.quality.variance_components import GroupedResiduals, VarianceComponents

Array = npt.NDArray[np.float64]

Index = npt.NDArray[np.intp]

#: Two suspects are inseparable if their T agree to this relative difference.
SAME: Final = 1e-6


@dataclass(frozen=True)
class GroupTest:
    """Test of one suspect.

    Parameters
    ----------
    part : str
        "image", "position" or "height"; "line", "sample", "east", "north" or "up"; "point".
    image : str
        Image id; "" for suspects that are not image points.
    point : str
    dimension : int
        d; 0 if the other observations do not check the suspect.
    statistic : float or None
        w, tau or t for d = 1; T, T/m0^2 or F for more. None if not tested, as ``critical`` and ``probability``.
    critical : float or None
        Limit of the statistic; above it a gross error is suspected.
    probability : float or None
        Probability of this or a larger statistic without a gross error; ranks suspects of different d.
    error : array
        Estimated gross error in ``unit``, observed minus true; empty for a whole point.
    inseparable : tuple of str
        Other suspects that may contain the same error.
    symbol : str
        Name of the statistic.
    level : float
        Probability of a false alarm of this test.
    unit : str
        Unit and axes of the error.
    """

    part: str
    image: str
    point: str
    dimension: int
    statistic: float | None
    critical: float | None
    probability: float | None
    error: Array
    inseparable: tuple[str, ...]
    symbol: str
    level: float
    unit: str

    @property
    def suspicious(self) -> bool:
        """Whether the statistic is above its limit."""
        return self.statistic is not None and self.critical is not None and self.statistic > self.critical

    @property
    def name(self) -> str:
        """Name of the suspect."""
        return _name(self.part, self.image, self.point)

    def sentence(self) -> str:
        """Sentence on the suspect, its error and the test."""
        if self.statistic is None or self.critical is None:
            return f"{self.name}: not tested, the other observations do not check it"
        size = ", ".join(f"{value:+.2f}" for value in self.error)
        error = f"gross error of about {size} {self.unit}" if len(self.error) else "gross errors"
        shown = self.inseparable[:5]
        more = f" and {len(self.inseparable) - 5} more" if len(self.inseparable) > 5 else ""
        also = f" (or {', '.join(shown)}{more}: not to be told apart)" if shown else ""
        return f"{self.name}{also}: {error}; {self.symbol} = {self.statistic:.1f}, limit {self.critical:.1f}"


@dataclass(frozen=True)
class OutlierTests(Sequence[GroupTest]):
    """Tests of all suspects, most suspicious first, untested ones last; stored by columns, rows on demand.

    Parameters
    ----------
    problem : Problem
    test, control : str
        See ``fg_orient.quality.hypotheses``.
    level : float
        Level of all tests, as defined by the control.
    level_each : float
        Level of each test: a suspect is suspicious if its probability is not larger.
    n_tested : int
        Number of tested hypotheses; inseparable suspects are one.
    parts, units : tuple of str
    part : (n,) int array
        Positions in ``parts``.
    point, row : (n,) int arrays
        Ground points; rows of the image points, or -1.
    dimension : (n,) int array
        d; 0: not tested.
    quadratic, statistic, critical, probability : (n,) arrays
        T, statistic, limit and probability; nan, nan, nan and 1 if not tested.
    error : (n, 2) array
        Estimated errors; the second is nan for errors of one axis.
    of_class : (n,) int array
        Class of inseparable suspects; -1 if not tested.
    """

    problem: Problem
    test: str
    control: str
    level: float
    level_each: float
    n_tested: int
    parts: tuple[str, ...]
    units: tuple[str, ...]
    part: Index
    point: Index
    row: Index
    dimension: Index
    quadratic: Array
    statistic: Array
    critical: Array
    probability: Array
    error: Array
    of_class: Index

    def __len__(self) -> int:
        return len(self.part)

    @overload
    def __getitem__(self, place: int) -> GroupTest: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[GroupTest, ...]: ...
    def __getitem__(self, place: int | slice) -> GroupTest | tuple[GroupTest, ...]:
        """One test, or some; suspicious ones with their inseparable suspects."""
        if isinstance(place, slice):
            return tuple(self[k] for k in range(*place.indices(len(self))))
        k = range(len(self))[place]
        d = int(self.dimension[k])
        error = self.error[k, ~np.isnan(self.error[k])] if d else self.error[k]
        statistic, critical, probability = (
            float(a[k]) if d else None for a in (self.statistic, self.critical, self.probability)
        )
        return GroupTest(
            *self._where(k), d, statistic, critical, probability, error, self._inseparable(k),
            hypotheses.SYMBOLS[self.test][d > 1], self.level_each, self.units[self.part[k]],
        )  # fmt: skip

    def suspicious(self) -> tuple[GroupTest, ...]:
        """Suspicious tests."""
        return self[: self.n_suspicious]

    @property
    def n_suspicious(self) -> int:
        """Number of suspicious tests."""
        return int(np.count_nonzero(self.statistic > self.critical))

    def _inseparable(self, k: int) -> tuple[str, ...]:
        """Other suspects that may contain the error of a suspicious one."""
        if not self.statistic[k] > self.critical[k]:
            return ()
        same = self.of_class == self.of_class[k]
        same[k] = False
        return tuple(_name(*self._where(int(i))) for i in np.flatnonzero(same))

    def _where(self, k: int) -> tuple[str, str, str]:
        """Part, image and point of a suspect."""
        block, row = self.problem.block, int(self.row[k])
        image = "" if row < 0 else block.images[int(self.problem.observations.image[row])].id
        return self.parts[self.part[k]], image, block.points.ids[self.point[k]]


def _name(part: str, image: str, point: str) -> str:
    """Name of a suspect."""
    if part == "point":
        return f"point {point} with all its observations"
    seen = f"point {point} in image {image}" if image else f"point {point}"
    return seen if part == "image" else f"{part} of {seen}"


def outlier_tests(
    known: ResidualCofactors, chi2: float, *, level: float, test: str, control: str, kind: Kind = "groups",
    components: VarianceComponents | None = None,
) -> OutlierTests:  # fmt: skip
    """Test all suspects of a kind at a least-squares solution.

    Parameters
    ----------
    known : ResidualCofactors
        Of the solution.
    chi2 : float
        Weighted sum of squares of all residuals.
    level, test, control, kind
        See ``fg_orient.quality.hypotheses`` and :func:`suspects`; InputError for an unknown name or invalid level.
    components : VarianceComponents, optional
        Variance components in the sigmas of the problem; the degrees of freedom then differ from test to test
        (``fg_orient.quality.variance_components``).
    """
    hypotheses.require_names(test, control, level)
    if kind not in KINDS:
        raise InputError.of("options.value", place="kind", value=repr(kind), expected=", ".join(KINDS))
    problem, families, freedom = known.problem, suspects(known, kind), None
    if components is not None:
        groups = groups_of(problem, problem.block.options.variance_components)
        freedom = freedoms(GroupedResiduals(known, groups), families, components)
    return assess_suspects(problem, families, chi2, level=level, test=test, control=control, freedom=freedom)


def assess_suspects(
    problem: Problem, families: Sequence[Suspects], chi2: float, *, level: float, test: str, control: str,
    freedom: Array | None = None,
) -> OutlierTests:  # fmt: skip
    """Test suspects and sort them; see :func:`outlier_tests`. ``freedom`` (n,) is both v^T v and f of each."""
    sizes = [len(s.point) for s in families]
    results = [s.quadratic() for s in families]
    t, d = np.concatenate([r[0] for r in results]), np.concatenate([r[1] for r in results])
    error = np.full((len(t), 2), np.nan)
    for end, s, (_, _, own) in zip(np.cumsum(sizes), families, results, strict=True):
        if s.unit:
            error[end - len(own) : end, : own.shape[1]] = own
    part, point, row = np.repeat(np.arange(len(families)), sizes), _column(families, "point"), _column(families, "row")
    f: Array = np.full(len(t), float(problem.redundancy)) if freedom is None else freedom
    squares = np.full(len(t), chi2) if freedom is None else freedom
    tested = hypotheses.can_be_tested(d, f, test)
    d = np.where(tested, d, 0)
    error[~tested] = np.nan
    classes, of_class = _classes(point, d, t, tested)
    probability, statistic, critical = np.ones(len(t)), np.full(len(t), np.nan), np.full(len(t), np.nan)
    probability[tested] = hypotheses.probabilities(t[tested], d[tested], squares[tested], f[tested], test)
    each = hypotheses.level_of_each(probability[classes], level, control)
    statistic[tested] = hypotheses.statistics(t[tested], d[tested], squares[tested], f[tested], test)
    critical[tested] = hypotheses.limits(each, d[tested], f[tested], test)
    first = np.arange(len(t))
    first[tested] = classes[of_class[tested]]
    order = np.lexsort((row < 0, -t[first], np.where(tested, probability[first], np.inf)))
    return OutlierTests(
        problem, test, control, level, each, len(classes),
        tuple(s.part for s in families), tuple(s.unit for s in families),
        part[order], point[order], row[order], d[order], t[order], statistic[order], critical[order],
        probability[order], error[order], of_class[order],
    )  # fmt: skip


def _column(families: Sequence[Suspects], name: str) -> Index:
    """One column of all suspects."""
    return np.concatenate([getattr(s, name) for s in families])


def _classes(point: Index, d: Index, t: Array, tested: npt.NDArray[np.bool_]) -> tuple[Index, Index]:
    """First member of each class of inseparable suspects, and class (n,) of each suspect; -1: not tested.

    Suspects of one point with the same d and, apart from rounding, the same T are inseparable.
    """
    of_class = np.full(len(t), -1, np.intp)
    order = np.flatnonzero(tested)
    order = order[np.lexsort((t[order], d[order], point[order]))]
    if not len(order):
        return order, of_class
    after, before = order[1:], order[:-1]
    new = (point[after] != point[before]) | (d[after] != d[before]) | (t[after] - t[before] > SAME * t[after])
    starts = np.concatenate([[True], new])
    of_class[order] = np.cumsum(starts) - 1
    return order[starts], of_class
