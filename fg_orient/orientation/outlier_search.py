"""Data snooping in a block: observations of an adjustment for the loop of ``fg_orient.quality.rejection``.

After each adjustment every excluded observation is predicted from the others with its covariance. It is readmitted if
it fits at the level at which it was excluded. The given block keeps all observations; the record names each excluded
observation with its test.
"""

from __future__ import annotations

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
from fg_orient.quality.freedom import least_freedom
from fg_orient.quality.observation_groups import groups_of, scaled
from fg_orient.quality.outlier_records import GroupTest
from fg_orient.quality.prediction import ConsistencyTest, Suspect, prediction
from fg_orient.quality.rejection import MOST, ExcludedObservation, Rejection, Round, Search, reject
from fg_orient.quality.successive import Exclusion, successive
from fg_orient.quality.variance_components import VarianceComponents
from fg_orient.sensors import initial

#: Adjusts a block from a state and the problem of the last round, which differs in some observations.
Run = Callable[[Block, State, Problem], AdjustmentResult]

#: Largest number of observations that a round excludes.
ROUND: Final = 50
#: Place of the finding that ended a search.
GIVEN_UP: Final = "snooping was given up"


def search(block: Block, first: AdjustmentResult, run: Run) -> tuple[AdjustmentResult, Search]:
    """Search for gross errors among image points and control points.

    Parameters
    ----------
    block : Block
        Its options name the test and the kind of excluded observations. Only coordinates of control points are tested;
        coordinates of check points stay sealed.
    first : AdjustmentResult
        Adjustment of the whole block.
    run : callable
        Adjusts the further rounds.

    Returns
    -------
    end : AdjustmentResult
        The last round.
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
        first, lambda out, last: run(rounds.block(out), rounds.state(out, last.state), last.problem), rounds.worst,
        max(1, int(MOST * len(first.problem.observations))), returning=rounds.returning,
        impossible=(InputError, NoSolutionError),
    )  # fmt: skip
    return end.fit, rounds.concluded(end)


def require_possible_search(block: Block) -> None:
    """Raise InputError for a block with a loss, before the first adjustment."""
    if block.options.loss != NONE:
        raise InputError.of("statistics.snoop_loss", option="snoop", value=block.options.loss)


@dataclass
class _Removal:
    """Observations excluded together: ``rows`` of the given block's image points; ``control``: the point's coordinates.

    ``test``, ``with_it`` and ``fit``: see :class:`ExcludedObservation`; ``rivals``: excluded with it, because nothing
    tells which of them is wrong.
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
        """Probability of the test against the others, 0 if it does not fit."""
        p = 0.0 if self.fit is None else self.fit.probability or 0.0
        return p if p > self.test.level else 0.0


class _Rounds:
    """Observations of a block for :func:`reject`; record of each round."""

    def __init__(self, block: Block, first: AdjustmentResult) -> None:
        self._block, self._full = block, first.problem
        self._place = np.cumsum(participates(block)) - 1  # rows of the block among those of the full problem
        self._rows: list[list[int]] = [[] for _ in block.points.ids]
        for row, j in enumerate(block.observations.point.tolist()):
            self._rows[j].append(row)
        self._rounds: list[Round] = []

    def returning(self, solution: AdjustmentResult, out: Sequence[_Removal]) -> list[float]:
        """Test an adjustment; return the probability of each excluded observation, 0 if it does not fit."""
        self._tests = tests = solution.outlier_tests(kind=self._block.options.snoop_kind)
        self._rounds.append(Round(
            len(self._rounds) + 1, solution.sigma0, solution.redundancy, tests.n_tested, tests.n_suspicious,
        ))  # fmt: skip
        if solution.status is Status.NOT_CONVERGED:
            return [0.0] * len(out)
        self._predict(solution, out)
        # of rivals one returns only where another one does not fit
        return [r.probability if all(not rival.probability for rival in r.rivals) else 0.0 for r in out]

    def worst(self, solution: AdjustmentResult, out: Sequence[_Removal]) -> list[_Removal]:
        """Observations of the adjustment tested last that are to be excluded, the worst first."""
        if solution.status is Status.NOT_CONVERGED:
            return []
        most = 1 if solution.components is not None else ROUND
        found = successive(
            solution.residual_cofactors, self._tests, solution.chi2, self._block.options.snoop_kind, most
        )  # fmt: skip
        kept, before = self._kept(out)
        removals = list[_Removal]()
        for one in found:
            removals.append(self._removal(one, kept, before, [*out, *removals]))
        for removal, one in zip(removals, found, strict=True):
            removal.rivals = tuple(
                r for r, other in zip(removals, found, strict=True) if other.number == one.number and r is not removal
            )
        return removals

    def _removal(self, one: Exclusion, kept: Index, before: Block, out: Sequence[_Removal]) -> _Removal:
        """Observations to be excluded for a test of the block ``before``, whose image points are ``kept``."""
        tests, still = self._tests, self._kept(out)[0]
        point, row = int(tests.point[one.place]), int(tests.row[one.place])
        taking_part = kept[participates(before)]
        rows = taking_part[[row]] if row >= 0 else taking_part[:0]
        if tests.parts[tests.part[one.place]] == "point":
            rows = kept[before.observations.point == point]
        control = row < 0 and before.points.roles[point] is Role.CONTROL
        removal = _Removal(point, tuple(rows.tolist()), control, one.test)
        after, _ = self._kept([*out, removal])
        gone = np.setdiff1d(still, np.concatenate([after, rows]))
        return replace(removal, with_it=tuple(self._name(r) for r in gone.tolist()))

    def _name(self, row: int) -> str:
        """Name an image point of the given block."""
        o = self._block.observations
        return f"point {self._block.points.ids[o.point[row]]} in image {self._block.images[o.image[row]].id}"

    def _predict(self, solution: AdjustmentResult, out: Sequence[_Removal]) -> None:
        """Test all excluded observations against the others."""
        if solution.cofactors is None or not out:
            return
        components, full = solution.components, self._full
        if components is not None:  # excluded observations have the present sigmas of their group
            full = compile_problem(rescaled(self._block, self._full, components))
        for removal in out:
            j = removal.point
            others = [r for r in out if r is not removal and r.point == j]
            stay = self._staying(j, [removal, *others])
            back = [row for row in self._staying(j, others) if row not in stay]
            known = self._is_control(j, others) and self._full.observed[j]
            if not back and not removal.control:  # its rivals are out, too: nothing is left to test it
                removal.fit = None
                continue
            part = removal.test.part
            suspect = Suspect(part, int(self._place[removal.rows[0]]) if part == "image" else -1)
            fit = prediction(
                full, solution.problem, solution.state, solution.cofactors, solution.chi2,
                self._block.options.outlier_test, j, self._place[back].tolist(),
                bool(known and not solution.problem.observed[j]), suspect,
            )  # fmt: skip
            if components is not None:
                fit = fit.with_freedom(least_freedom(components), self._block.options.outlier_test)
            removal.fit = fit

    def _is_control(self, j: int, removals: Sequence[_Removal]) -> bool:
        """Whether a point keeps its coordinates without these of its observations."""
        return self._block.points.roles[j] is Role.CONTROL and not any(r.control for r in removals)

    def _staying(self, j: int, removals: Sequence[_Removal]) -> list[int]:
        """Remaining rows of the given block's image points of a point without these of its observations."""
        gone = {row for removal in removals for row in removal.rows}
        rows = [row for row in self._rows[j] if row not in gone]
        alone = len(rows) == 1 and not self._is_control(j, removals)
        return [] if alone else rows  # a single ray determines no point

    def _kept(self, removals: Sequence[_Removal]) -> tuple[Index, Block]:
        """Remaining rows of the given block's image points, and their block."""
        o, points = self._block.observations, self._block.points
        keep = np.ones(len(o), bool)
        without = [removal.point for removal in removals if removal.control]
        if without:
            points = points.without_coordinates(np.isin(np.arange(len(points.ids)), without), Role.TIE)
        for j in {removal.point for removal in removals}:
            keep[self._rows[j]] = False
            keep[self._staying(j, [r for r in removals if r.point == j])] = True
        return np.flatnonzero(keep), replace(self._block, points=points, observations=o.take(keep))

    def block(self, out: Sequence[_Removal]) -> Block:
        """The block without excluded observations."""
        return self._kept(out)[1]

    def state(self, out: Sequence[_Removal], last: State) -> State:
        """Start of the next adjustment: the end of the last; further points start as in the first adjustment.

        Points outside the adjustment have no coordinates.
        """
        ground = np.where(initial.missing_rows(last.ground)[:, None], self._full.start.ground, last.ground)
        block = self.block(out)
        part = np.isin(np.arange(len(ground)), block.observations.point[participates(block)])
        return State(last.image, np.where(part[:, None], ground, np.nan))

    def concluded(self, end: Rejection[AdjustmentResult, _Removal]) -> Search:
        """Record of the search."""
        kept, block = self._kept(end.out)
        o, points = self._block.observations, self._block.points
        out = np.concatenate([kept, *(np.array(removal.rows, np.intp) for removal in end.out)])
        single = np.setdiff1d(np.arange(len(o)), out)
        lost = [j for j in points.where(Role.CHECK) if j in o.point and j not in block.observations.point]
        changes = list(zip(self._rounds, end.changes, strict=True))
        readmitted = {id(change.put_back): r.number for r, change in changes if change.put_back is not None}
        return Search(
            tuple(
                replace(r, left_out="; ".join(one.test.name for one in c.left_out),
                        put_back=c.put_back.test.name if c.put_back else "")
                for r, c in changes
            ),
            tuple(
                ExcludedObservation(one.test, r.number, one.with_it, one.fit, readmitted.get(id(one)))
                for r, change in changes for one in change.left_out
            ),
            _given_up(end), tuple(self._name(r) for r in single.tolist()), tuple(points.ids[j] for j in lost),
            tuple(kept.tolist()),
        )  # fmt: skip


def _given_up(end: Rejection[AdjustmentResult, _Removal]) -> Finding | None:
    """Reason for an end of the search with remaining suspicious observations; None otherwise."""
    if end.fit.status is Status.NOT_CONVERGED:
        return finding("search.not_converged", place=GIVEN_UP)
    if end.worst is None:
        return None
    if isinstance(end.error, (InputError, NoSolutionError)):
        why = end.error.problems[0].message
        return finding("search.impossible", place=GIVEN_UP, name=end.worst.test.name, why=why)
    return finding("search.too_many", place=GIVEN_UP, percent=100.0 * MOST)


def rescaled(block: Block, full: Problem, components: VarianceComponents) -> Block:
    """The given block with its sigmas multiplied by variance components; ``full`` is its problem."""
    groups = groups_of(full, full.block.options.variance_components)
    known = {c.group: c.factor for c in components.components}
    return scaled(block, groups, np.array([known.get(name, 1.0) for name in groups.names]))
