"""Data snooping in a block: connects an adjustment with the loop of ``fg_orient.quality.rejection``.

After each adjustment every excluded observation is predicted from the others with its covariance. Observations that fit
at the level of their exclusion are included again, the most probable first, as long as each fits together with the
earlier ones. The given block keeps all observations; the record names each excluded observation with its test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from factors.arrays import Index
from fg_orient.adjustment.problem import Problem, State, compile_problem, participates
from fg_orient.adjustment.robust import NONE
from fg_orient.model.block import Block
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.model.names import Role, Status
from fg_orient.orientation.adjusted import AdjustmentResult
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.observation_groups import groups_of, scaled
from fg_orient.quality.outlier_records import GroupTest
from fg_orient.quality.prediction import ConsistencyTest, Excluded, Misclosures, consistency_in_turn, misclosures
from fg_orient.quality.rejection import MOST, ExcludedObservation, Rejection, Round, Search, reject
from fg_orient.quality.successive import Exclusion, successive
from fg_orient.quality.variance_components import VarianceComponents, least_freedom
from fg_orient.sensors import initial
from fg_orient.sensors.lines import on_features

#: Function that adjusts a block. It receives a start state and the problem of the last round, from
#: which the block differs in some observations.
Run = Callable[[Block, State, Problem], AdjustmentResult]

#: Maximum number of observations that a round excludes or includes again.
ROUND: Final[int] = 1000
#: ``place`` of the finding that states why a search ended.
GIVEN_UP: Final = "snooping was given up"


def search(block: Block, first: AdjustmentResult, run: Run) -> tuple[AdjustmentResult, Search]:
    """Search for gross errors among image points and control points.

    Parameters
    ----------
    block : Block
        Block whose options name the test and the kind of excluded observations. Only coordinates of control points are
        tested; coordinates of check points stay sealed.
    first : AdjustmentResult
        Adjustment of the whole block.
    run : callable
        Function that adjusts the further rounds.

    Returns
    -------
    end : AdjustmentResult
        Adjustment of the last round.
    record : Search

    Raises
    ------
    InputError
        The options name a loss (:func:`require_possible_search`).
    NoSolutionError
        The covariance, which the test requires, cannot be computed.
    """
    rounds = _Rounds(block, first)
    end = reject(
        first,
        lambda out, last: run(*rounds.start(out, last.state), last.problem),
        rounds.worst,
        max(1, int(MOST * len(first.problem.observations))),
        returning=rounds.returning,
        impossible=(InputError, NoSolutionError),
    )
    return end.fit, rounds.concluded(end)


def require_possible_search(block: Block) -> None:
    """Raise InputError for a block with a loss, before the first adjustment."""
    if block.options.loss != NONE:
        raise InputError.of("statistics.snoop_loss", option="snoop", value=block.options.loss)


@dataclass
class _Removal:
    """Observations excluded together: ``rows`` of the given block's image points.

    ``control``: also the point's coordinates.

    ``test``, ``with_it`` and ``fit``: see :class:`ExcludedObservation`. ``rivals`` are excluded with it, because the
    data do not show which of them is wrong.
    """

    point: int
    rows: tuple[int, ...]
    control: bool
    test: GroupTest = field(compare=False)
    with_it: tuple[str, ...] = field(default=(), compare=False)
    fit: ConsistencyTest | None = field(default=None, compare=False)
    rivals: tuple[_Removal, ...] = field(default=(), compare=False, repr=False)

    @property
    def probability(self) -> float:
        """Probability of its test against the other observations; 0 if it does not fit."""
        p = 0.0 if self.fit is None else self.fit.probability or 0.0
        return p if p > self.test.level else 0.0


class _Rounds:
    """Observations of a block for :func:`reject`, with the record of each round."""

    def __init__(self, block: Block, first: AdjustmentResult) -> None:
        self._block, self._full = block, first.problem
        self._place = np.cumsum(participates(block)) - 1  # for each row of the block, its row in the full problem
        point = block.observations.point
        self._order = np.argsort(point, kind="stable")  # rows sorted by point, ascending within a point
        self._first = np.concatenate([[0], np.cumsum(np.bincount(point, minlength=len(block.points.ids)))])
        self._rounds: list[Round] = []

    def returning(
        self, solution: AdjustmentResult, out: Sequence[_Removal], may: Sequence[_Removal]
    ) -> Sequence[_Removal]:
        """Test an adjustment; return the excluded observations that fit together."""
        self._tests = tests = solution.outlier_tests(kind=self._block.options.snoop_kind)
        self._rounds.append(
            Round(
                len(self._rounds) + 1,
                solution.sigma0,
                solution.redundancy,
                tests.n_tested,
                tests.n_suspicious,
            )
        )
        if solution.status is Status.NOT_CONVERGED or solution.cofactors is None or not out:
            return ()
        known = self._predict(solution, solution.cofactors, out)
        # a rival returns only if no other rival fits
        fitting = [r for r in may if r.probability and not any(rival.probability for rival in r.rivals)]
        fitting.sort(key=lambda r: -r.probability)
        fitting = list({r.point: r for r in reversed(fitting)}.values())[::-1]  # keep one observation per point
        fitting = fitting[: 1 if solution.components is not None else ROUND]
        if len(fitting) < 2:
            return fitting
        tests_of = consistency_in_turn(
            [known[id(r)] for r in fitting],
            [r.test.level for r in fitting],
            solution.problem,
            solution.cofactors,
            solution.chi2,
            self._block.options.outlier_test,
        )
        return [r for r, fit in zip(fitting, tests_of, strict=True) if (fit.probability or 0.0) > r.test.level]

    def worst(self, solution: AdjustmentResult, out: Sequence[_Removal]) -> list[_Removal]:
        """Return the observations of the adjustment tested last that are to be excluded, the worst first."""
        if solution.status is Status.NOT_CONVERGED:
            return []
        found = [Exclusion(0, self._tests[0])] if self._tests.n_suspicious else []
        if solution.components is None:
            found = successive(
                solution.residual_cofactors, self._tests, solution.chi2, self._block.options.snoop_kind, ROUND
            )
        kept, before = self._kept(out)
        taking_part = kept[participates(before)]
        of_point = _by_point(out)
        removals = list[_Removal]()
        for one in found:
            point, row = int(self._tests.point[one.place]), int(self._tests.row[one.place])
            mine = of_point.setdefault(point, [])
            rows = taking_part[[row]].tolist() if row >= 0 else []
            if self._tests.parts[self._tests.part[one.place]] == "point":
                rows = self._staying(point, mine)
            control = row < 0 and before.points.roles[point] is Role.CONTROL
            removal = _Removal(point, tuple(rows), control, one.test)
            after = {*self._staying(point, [*mine, removal]), *rows}
            gone = [row for row in self._staying(point, mine) if row not in after]
            removals.append(replace(removal, with_it=tuple(self._name(row) for row in gone)))
            mine.append(removals[-1])
        together = dict[int, list[_Removal]]()
        for removal, one in zip(removals, found, strict=True):
            together.setdefault(one.number, []).append(removal)
        for rivals in together.values():
            for removal in rivals:
                removal.rivals = tuple(r for r in rivals if r is not removal)
        return removals

    def _name(self, row: int) -> str:
        """Name an image point of the given block."""
        o = self._block.observations
        return f"point {self._block.points.ids[o.point[row]]} in image {self._block.images[o.image[row]].id}"

    def _pixel(self, one: _Removal) -> tuple[float, float]:
        """Return the measured line and sample of an image point; nan for other observations."""
        if one.test.part != "image":
            return math.nan, math.nan
        o, row = self._block.observations, one.rows[0]
        return float(o.line[row]), float(o.sample[row])

    def _predict(
        self, solution: AdjustmentResult, cofactors: Cofactors, out: Sequence[_Removal]
    ) -> dict[int, Misclosures]:
        """Test all excluded observations against the others; return misclosures of the tested ones, by their id."""
        components, full, test = solution.components, self._full, self._block.options.outlier_test
        if components is not None:  # excluded observations get the current sigmas of their group
            full = compile_problem(rescaled(self._block, self._full, components))
        of_point, tested, excluded = _by_point(out), list[_Removal](), list[Excluded]()
        for removal in out:
            j, removal.fit = removal.point, None
            others = [r for r in of_point[j] if r is not removal]
            stay = self._staying(j, [removal, *others])
            back = [row for row in self._staying(j, others) if row not in stay]
            if not back and not removal.control:  # its rivals are also excluded, so no other observation can test it
                continue
            known = self._is_control(j, others) and self._full.observed[j] and not solution.problem.observed[j]
            part = removal.test.part
            row = int(self._place[removal.rows[0]]) if part == "image" else -1
            tested.append(removal)
            excluded.append(Excluded(j, tuple(self._place[back].tolist()), bool(known), part, row))
        of = misclosures(full, solution.problem, solution.state, excluded)
        for removal, one in zip(tested, of, strict=True):
            removal.fit = ConsistencyTest(0.0, 0, None, None)
            if one is not None:
                removal.fit = one.consistency(cofactors, solution.chi2, solution.redundancy, test)
            if components is not None:
                removal.fit = removal.fit.with_freedom(least_freedom(components), test)
        return {id(removal): one for removal, one in zip(tested, of, strict=True) if one is not None}

    def _is_control(self, j: int, removals: Sequence[_Removal]) -> bool:
        """Return whether a point keeps its control coordinates if these of its observations are excluded."""
        return self._block.points.roles[j] is Role.CONTROL and not any(r.control for r in removals)

    def _staying(self, j: int, removals: Sequence[_Removal]) -> list[int]:
        """Return the rows of the image points of a point that remain without these observations."""
        gone = {row for removal in removals for row in removal.rows}
        rows = [row for row in self._order[self._first[j] : self._first[j + 1]].tolist() if row not in gone]
        alone = len(rows) == 1 and not self._is_control(j, removals)
        return [] if alone else rows  # a single ray does not determine a point

    def _kept(self, removals: Sequence[_Removal]) -> tuple[Index, Block]:
        """Return the remaining rows of the given block's image points, and their block."""
        o, points = self._block.observations, self._block.points
        keep = np.ones(len(o), bool)
        without = [removal.point for removal in removals if removal.control]
        if without:
            points = points.without_coordinates(np.isin(np.arange(len(points.ids)), without), Role.TIE)
        for j, mine in _by_point(removals).items():
            keep[self._order[self._first[j] : self._first[j + 1]]] = False
            keep[self._staying(j, mine)] = True
        # without its image point, a ground point on a control feature is not in the block
        on, seen = on_features(self._block.extra), {points.ids[j] for j in o.point[keep]}
        gone = {f"point:{name}" for name in on if name not in seen}
        extra = tuple(e for e in self._block.extra if not (gone and e.unknowns[0] in gone))
        return np.flatnonzero(keep), replace(self._block, points=points, observations=o.take(keep), extra=extra)

    def start(self, out: Sequence[_Removal], last: State) -> tuple[Block, State]:
        """Return the block without excluded observations, and the start of its adjustment.

        The adjustment starts at the end of the last one; further points start as in the first adjustment. Points
        outside the adjustment have no coordinates.
        """
        block = self._kept(out)[1]
        ground = np.where(initial.missing_rows(last.ground)[:, None], self._full.start.ground, last.ground)
        part = np.isin(np.arange(len(ground)), block.observations.point[participates(block)])
        return block, State(last.image, np.where(part[:, None], ground, np.nan))

    def concluded(self, end: Rejection[AdjustmentResult, _Removal]) -> Search:
        """Return the record of the search."""
        kept, block = self._kept(end.out)
        o, points = self._block.observations, self._block.points
        out = np.concatenate([kept, *(np.array(removal.rows, np.intp) for removal in end.out)])
        single = np.setdiff1d(np.arange(len(o)), out)
        lost = [j for j in points.where(Role.CHECK) if j in o.point and j not in block.observations.point]
        changes = list(zip(self._rounds, end.changes, strict=True))
        readmitted = {id(one): r.number for r, change in changes for one in change.put_back}
        return Search(
            tuple(
                replace(
                    r,
                    left_out="; ".join(one.test.name for one in c.left_out),
                    put_back="; ".join(one.test.name for one in c.put_back),
                )
                for r, c in changes
            ),
            tuple(
                ExcludedObservation(one.test, r.number, one.with_it, one.fit, readmitted.get(id(one)), self._pixel(one))
                for r, change in changes
                for one in change.left_out
            ),
            _given_up(end),
            tuple(self._name(r) for r in single.tolist()),
            tuple(points.ids[j] for j in lost),
            tuple(kept.tolist()),
        )


def _by_point(removals: Sequence[_Removal]) -> dict[int, list[_Removal]]:
    """Return the excluded observations of each ground point."""
    out = dict[int, list[_Removal]]()
    for removal in removals:
        out.setdefault(removal.point, []).append(removal)
    return out


def _given_up(end: Rejection[AdjustmentResult, _Removal]) -> Finding | None:
    """Return the reason why a search ended with suspicious observations; None if no observation is suspicious."""
    if end.fit.status is Status.NOT_CONVERGED:
        return finding("search.not_converged", place=GIVEN_UP)
    if end.worst is None:
        return None
    if isinstance(end.error, (InputError, NoSolutionError)):
        why = end.error.problems[0].message
        return finding("search.impossible", place=GIVEN_UP, name=end.worst.test.name, why=why)
    return finding("search.too_many", place=GIVEN_UP, percent=100.0 * MOST)


def rescaled(block: Block, full: Problem, components: VarianceComponents) -> Block:
    """Return the given block with its sigmas multiplied by variance components; ``full`` is its problem."""
    groups = groups_of(full, full.block.options.variance_components)
    known = {c.group: c.factor for c in components.components}
    return scaled(block, groups, np.array([known.get(name, 1.0) for name in groups.names]))
