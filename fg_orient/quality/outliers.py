"""Outlier tests: each observation is tested against all others with the covariance of the residuals.

A suspect is an image point (line, sample), the position of a control point (East, North) or its height (Up); or a
single coordinate; or a whole ground point. Its error may have any size and direction. With whitened residuals v of the
suspect's rows, their cofactors ``Q = I - J N^-1 J^T`` and the columns E of the error in these rows, the weighted sum of
squares decreases by

    T = (E^T v)^T (E^T Q E)^+ (E^T v)

if the error becomes an unknown, and ``(E^T Q E)^+ E^T v`` is its estimate (Baarda 1968; Kok 1984). d, the rank of
``E^T Q E``, is the number of directions that the other observations check; without any the suspect cannot be tested.

Tests and control of multiple tests: ``fg_orient.quality.hypotheses``. Inseparable suspects (position of a control point
and its only image point) are one hypothesis and are named together. The search that leaves observations out is
``fg_orient.orientation.outlier_search``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, overload

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import linearised
from fg_orient.model.errors import InputError
from fg_orient.quality import hypotheses
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.elimination import PointRows, eliminated_points, free_cofactors
from fg_orient.quality.observation_groups import groups_of
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.variance_components import GroupedResiduals, VarianceComponents, freedoms

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Image points, positions and heights; single coordinates; ground points with all their observations.
Kind = Literal["groups", "coordinates", "points"]
KINDS: Final = ("groups", "coordinates", "points")

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


# --- suspects -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Suspects:
    """Suspects of one part.

    Parameters
    ----------
    part : str
        "image", "position", "height"; "line", "sample", "east", "north", "up"; "point".
    unit : str
        Of the error: "px line, sample", "m East, North", ...; "" for a whole point, whose error has several units.
    point : (n,) int array
        Ground points.
    row : (n,) int array
        Rows of ``problem.observations``; -1 for suspects that are not image points.
    rows : (n, m) int array
        Rows of v among all rows: image points, then control points in East, North, Up.
    v : (n, m) array
        Whitened residuals.
    q : (n, m, m) array
        Cofactors of v.
    columns : (n, m, k) array
        Change of the whitened residuals with the error.
    """

    part: str
    unit: str
    point: Index
    row: Index
    rows: Index
    v: Array
    q: Array
    columns: Array

    def quadratic(self) -> tuple[Array, Index, Array]:
        """T (n,), its degrees of freedom d (n,) and the estimated error (n, k), zero in unchecked directions."""
        length = np.linalg.norm(self.columns, axis=-2)
        e = self.columns / length[..., None, :]
        turned = np.swapaxes(e, -1, -2)
        t, d, error = hypotheses.quadratic(np.einsum("...km,...m->...k", turned, self.v), turned @ self.q @ e)
        return t, d, error / length


def suspects(known: ResidualCofactors, kind: Kind = "groups") -> list[Suspects]:
    """All suspects of a kind.

    Parameters
    ----------
    known : ResidualCofactors
        Of a solution of least squares.
    kind : str
        "groups": image points (line and sample), positions (East and North) and heights of weighted control points;
        "coordinates": each coordinate alone; "points": a ground point with all its image points and its coordinates.
    """
    if kind == "points":
        return _whole_points(known)
    problem = known.problem
    o, given = problem.observations, np.flatnonzero(problem.observed)
    place, n = np.arange(len(o)), 2 * len(o)
    image = (o.point, place, 2 * place[:, None] + np.arange(2), known.v_image, known.image)
    rows = n + 3 * np.arange(len(given))[:, None] + np.arange(3)
    control = (given, np.full(len(given), -1), rows, known.v_control, known.control)
    # the residuals are adjusted minus observed
    pixel = -np.eye(2) / np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)[:, None]
    metre = -np.eye(3) * np.linalg.norm(known.control_rows, axis=2)[:, None]
    east, north, up = problem.axis_names
    if kind == "coordinates":
        names = (("east", east), ("north", north), ("up", up))
        return [
            Suspects("line", "px line", *image, pixel[:, :, :1]),
            Suspects("sample", "px sample", *image, pixel[:, :, 1:]),
            *(Suspects(part, f"m {axis}", *control, metre[:, :, [k]]) for k, (part, axis) in enumerate(names)),
        ]  # fmt: skip
    return [
        Suspects("image", "px line, sample", *image, pixel),
        Suspects("position", f"m {east}, {north}", *control, metre[:, :, :2]),
        Suspects("height", f"m {up}", *control, metre[:, :, 2:]),
    ]


def _whole_points(known: ResidualCofactors) -> list[Suspects]:
    """Ground points with all their observations; points with the same number of rows are one family."""
    problem, cofactors = known.problem, known.cofactors
    v = np.concatenate([known.v_image.ravel(), known.v_control.ravel()])
    rays, named = linearised(problem, known.state), problem.named_points()
    whole = free_cofactors(problem, cofactors.joint, named) if problem.n_image_unknowns <= WHOLE_LIMIT else None
    by_size: dict[int, list[tuple[Index, Index, Array]]] = {}
    for part in eliminated_points(problem, rays, named, groups=1):
        joint = _joint_of_each(problem, cofactors, part, named) if whole is None else whole
        q = part.free - part.quadratic(joint)
        by_size.setdefault(part.rows.shape[1], []).append((part.point, part.rows, q))
    out = []
    for size, parts in sorted(by_size.items()):
        point, rows, q = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        order = np.argsort(point)
        unit = np.tile(np.eye(size), (len(point), 1, 1))
        out.append(Suspects("point", "", point[order], np.full(len(point), -1), rows[order], v[rows[order]], q[order],
                            unit))  # fmt: skip
    return out


def _joint_of_each(problem: Problem, cofactors: Cofactors, part: PointRows, named: list[int]) -> Array:
    """Joint cofactors (P, c, c) of the columns of each ground point, where those of all images are too many."""
    own, size, c = part.point[0] in named, np.diff(problem.first), part.columns.shape[1]
    out = np.empty((len(part.point), c, c))
    for place, images in enumerate(part.kind[:, : part.kind.shape[1] - own].tolist()):
        seen = tuple(dict.fromkeys(images))
        first = np.cumsum([0, *size[list(seen)]])
        begin = dict(zip(seen, first.tolist(), strict=False))
        at = [begin[k] + np.minimum(np.arange(size.max()), size[k] - 1) for k in images]
        columns = np.concatenate([*at, first[-1] + np.arange(3 * own)])
        out[place] = cofactors.joint(seen, (int(part.point[place]),) if own else ())[np.ix_(columns, columns)]
    return out
