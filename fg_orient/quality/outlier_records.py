"""Records of the outlier tests: the test of one suspect, and the tests of all suspects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem
from fg_orient.quality import hypotheses

# 32 bits are sufficient for positions and small numbers, and need half the memory
Small = npt.NDArray[np.int32]


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
        w, tau or t for d = 1; T, T/m0^2 or F for more. None if not tested; then ``critical`` and ``probability`` are
        also None.
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
        """True if the statistic is above its limit."""
        return self.statistic is not None and self.critical is not None and self.statistic > self.critical

    @property
    def name(self) -> str:
        """Name of the suspect."""
        return _name(self.part, self.image, self.point)

    def sentence(self) -> str:
        """Describe the suspect, its error and the test in a sentence."""
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
    """Tests of all suspects: most suspicious first, untested last. They are stored by columns.

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
        Number of tested hypotheses; a class of inseparable suspects counts once.
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
    part: Small
    point: Small
    row: Small
    dimension: Small
    quadratic: Array
    statistic: Array
    critical: Array
    probability: Array
    error: Array
    of_class: Small

    def __len__(self) -> int:
        return len(self.part)

    @overload
    def __getitem__(self, place: int) -> GroupTest: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[GroupTest, ...]: ...
    def __getitem__(self, place: int | slice) -> GroupTest | tuple[GroupTest, ...]:
        """Return one test, or several tests; suspicious tests include their inseparable suspects."""
        if isinstance(place, slice):
            return tuple(self[k] for k in range(*place.indices(len(self))))
        k = range(len(self))[place]
        d = int(self.dimension[k])
        error = self.error[k, ~np.isnan(self.error[k])] if d else self.error[k]
        statistic, critical, probability = (
            float(a[k]) if d else None for a in (self.statistic, self.critical, self.probability)
        )
        return GroupTest(
            *self._where(k),
            d,
            statistic,
            critical,
            probability,
            error,
            self._inseparable(k),
            hypotheses.SYMBOLS[self.test][d > 1],
            self.level_each,
            self.units[self.part[k]],
        )

    def suspicious(self) -> tuple[GroupTest, ...]:
        """Return the suspicious tests."""
        return self[: self.n_suspicious]

    @property
    def n_suspicious(self) -> int:
        """Number of suspicious tests."""
        return int(np.count_nonzero(self.statistic > self.critical))

    def _inseparable(self, k: int) -> tuple[str, ...]:
        """Return other suspects that may contain the error of a suspicious one."""
        if not self.statistic[k] > self.critical[k]:
            return ()
        same = self.of_class == self.of_class[k]
        same[k] = False
        return tuple(_name(*self._where(int(i))) for i in np.flatnonzero(same))

    def _where(self, k: int) -> tuple[str, str, str]:
        """Return part, image and point of a suspect."""
        block, row = self.problem.block, int(self.row[k])
        image = "" if row < 0 else block.images[int(self.problem.observations.image[row])].id
        return self.parts[self.part[k]], image, block.points.ids[self.point[k]]


def _name(part: str, image: str, point: str) -> str:
    """Return the name of a suspect."""
    if part == "point":
        return f"point {point} with all its observations"
    seen = f"point {point} in image {image}" if image else f"point {point}"
    return seen if part == "image" else f"{part} of {seen}"
