"""Data snooping: adjust, test, leave out the worst observation, look who may come back, again.

One observation per round (Baarda 1968): a gross error raises the statistics of its neighbours, too. After each
adjustment every observation left out is predicted from the rest with its covariance and put back if it fits at the
level at which it was left out: an early choice among suspects need not be right. Each may come back once. So every
round but the last takes one of at most three changes from an observation (out, back, out again), and the search ends.

Nothing is deleted: the block that is adjusted loses observations, the given one stays as it is, and each is named with
its test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient import initial
from fg_orient.adjusted import Adjusted
from fg_orient.adjustment.problem import Problem, State, compile_problem, participates
from fg_orient.adjustment.robust import NONE
from fg_orient.block import Block, Coordinates, GroundPoints
from fg_orient.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.names import Role, Status
from fg_orient.quality.freedom import least_freedom, with_freedom
from fg_orient.quality.observation_groups import groups_of, scaled
from fg_orient.quality.outliers import OutlierTests
from fg_orient.quality.prediction import Suspect, prediction
from fg_orient.quality.search import Found, Round, Search
from fg_orient.quality.suspects import Kind
from fg_orient.quality.variance_components import VarianceComponents

Index = npt.NDArray[np.intp]
#: Adjusts a block from a state; the problem is that of the round before, which differs in some observations.
Run = Callable[[Block, State, Problem], Adjusted]

#: More than this share of the image points cannot be gross errors: then it is the model that is wrong.
MOST: Final = 0.25
#: Place of what ended a search.
GIVEN_UP: Final = "snooping was given up"


def search(block: Block, first: Adjusted, run: Run, *, kind: Kind = "groups") -> tuple[Adjusted, Search]:
    """Search for gross errors among image points and control points.

    Parameters
    ----------
    block : Block
        Its options say how to test. Points to be judged with their coordinates must have the role control:
        coordinates of check points stay sealed.
    first : Adjusted
        The adjustment of the whole block.
    run : callable
        Makes those of the rounds.
    kind : str
        What is left out: "groups", image points and coordinates of control points, or "points", all of a point.

    Returns
    -------
    end : Adjusted
        The last round.
    found : Search

    Raises
    ------
    InputError
        A loss; another kind (:func:`require_possible_search`).
    NoSolutionError
        The covariance, on which the test rests, cannot be computed.
    """
    last, rounds = first, _Rounds(block, first.problem)
    while rounds.change(last, last.outlier_tests(kind=kind)):
        try:
            last = run(rounds.block(), rounds.state(last.state), last.problem)
        except (InputError, NoSolutionError) as error:
            rounds.undo(error)
            break
    return last, rounds.concluded()


def require_possible_search(block: Block, kind: Kind) -> None:
    """Refuse what cannot be searched, before anything is adjusted.

    Raises
    ------
    InputError
        A loss; another kind.
    """
    if block.options.loss != NONE:
        raise InputError.of("statistics.snoop_loss", place="snoop", value=block.options.loss)
    if kind not in ("groups", "points"):
        raise InputError.of("options.value", place="kind", value=repr(kind), expected='"groups" or "points"')


@dataclass(frozen=True)
class _Removal:
    """What is left out together: rows of the given block's image points, and the coordinates of the point."""

    point: int
    rows: tuple[int, ...]
    control: bool


class _Rounds:
    """What is left out, and what was done in each round."""

    def __init__(self, block: Block, full: Problem) -> None:
        self._block, self._full = block, full
        self._most = max(1, int(MOST * len(full.observations)))
        self._place = np.cumsum(participates(block)) - 1  # rows of the block among those of the full problem
        self._rows: list[list[int]] = [[] for _ in block.points.ids]
        for row, j in enumerate(block.observations.point.tolist()):
            self._rows[j].append(row)
        self._out: list[tuple[_Removal, int]] = []  # with the place in _found
        self._been_back: set[_Removal] = set()
        self._found: list[Found] = []
        self._rounds: list[Round] = []
        self._given_up: Finding | None = None

    def change(self, solution: Adjusted, tests: OutlierTests) -> bool:
        """Put the observation back that fits best, or else leave the worst one out; False if nothing is to change."""
        suspicious, number = tests.n_suspicious, len(self._rounds) + 1
        self._rounds.append(Round(
            number, solution.sigma0, solution.redundancy, tests.n_tested, suspicious,
        ))  # fmt: skip
        if solution.status is Status.NOT_CONVERGED:
            self._given_up = finding("search.not_converged", place=GIVEN_UP)
            return False
        self._predict(solution)
        back = self._fitting()
        if back is not None:
            removal, place = self._out.pop(back)
            self._been_back.add(removal)
            self._found[place] = replace(self._found[place], readmitted=number)
            self._rounds[-1] = replace(self._rounds[-1], put_back=self._found[place].test.name)
            return True
        if suspicious and len(self._out) >= self._most:
            self._given_up = finding("search.too_many", place=GIVEN_UP, percent=100.0 * MOST)
        if not suspicious or self._given_up:
            return False
        self._leave_out(tests, number)
        return True

    def undo(self, error: InputError | NoSolutionError) -> None:
        """Take the last observation back in: without it the block cannot be adjusted."""
        if not self._rounds[-1].left_out:
            raise error
        self._out.pop()
        last, self._rounds[-1] = self._found.pop(), replace(self._rounds[-1], left_out="")
        why = error.problems[0].message
        self._given_up = finding("search.impossible", place=GIVEN_UP, name=last.test.name, why=why)

    def _leave_out(self, tests: OutlierTests, number: int) -> None:
        """Leave the worst observation out."""
        kept, before = self._kept()
        point, row = int(tests.point[0]), int(tests.row[0])
        taking_part = kept[participates(before)]
        rows = taking_part[[row]] if row >= 0 else taking_part[:0]
        if tests.parts[tests.part[0]] == "point":
            rows = kept[before.observations.point == point]
        control = row < 0 and before.points.roles[point] is Role.CONTROL
        removal = _Removal(point, tuple(rows.tolist()), control)
        self._out.append((removal, len(self._found)))
        after, _ = self._kept()
        gone = np.setdiff1d(kept, np.concatenate([after, rows]))
        test, with_it = tests[0], tuple(self._name(r) for r in gone.tolist())
        self._found.append(Found(test, number, with_it))
        self._rounds[-1] = replace(self._rounds[-1], left_out=test.name)

    def _name(self, row: int) -> str:
        """Name an image point of the given block."""
        o = self._block.observations
        return f"point {self._block.points.ids[o.point[row]]} in image {self._block.images[o.image[row]].id}"

    def _predict(self, solution: Adjusted) -> None:
        """Judge everything left out by the rest."""
        if solution.cofactors is None or not self._out:
            return
        components, full = solution.components, self._full
        if components is not None:  # what is out gets the sigmas that its group has now
            full = compile_problem(rescaled(self._block, self._full, components))
        for removal, place in self._out:
            j = removal.point
            others = [r for r, _ in self._out if r is not removal and r.point == j]
            stay = self._staying(j, [removal, *others])
            back = [row for row in self._staying(j, others) if row not in stay]
            known = self._is_control(j, others) and self._full.observed[j]
            fit = prediction(
                full, solution.problem, solution.state, solution.cofactors, solution.chi2,
                self._block.options.outlier_test, j, self._place[back].tolist(),
                bool(known and not solution.problem.observed[j]), self._suspect(removal, place),
            )  # fmt: skip
            if components is not None:
                fit = with_freedom(fit, least_freedom(components), self._block.options.outlier_test)
            self._found[place] = replace(self._found[place], fit=fit)

    def _suspect(self, removal: _Removal, place: int) -> Suspect:
        """Where in what is left out the error is suspected."""
        part = self._found[place].test.part
        return Suspect(part, int(self._place[removal.rows[0]]) if part == "image" else -1)

    def _fitting(self) -> int | None:
        """Position in ``_out`` of the observation that fits best, of those that have not been back."""
        best, highest = None, 0.0
        for n, (removal, place) in enumerate(self._out):
            fit, level = self._found[place].fit, self._found[place].test.level
            p = 0.0 if fit is None or fit.probability is None else fit.probability
            if removal not in self._been_back and p > max(level, highest):
                best, highest = n, p
        return best

    def _is_control(self, j: int, removals: list[_Removal]) -> bool:
        """Whether a point keeps its coordinates without these of its observations."""
        return self._block.points.roles[j] is Role.CONTROL and not any(r.control for r in removals)

    def _staying(self, j: int, removals: list[_Removal]) -> list[int]:
        """Rows of the given block's image points of a point that stay without these of its observations."""
        gone = {row for removal in removals for row in removal.rows}
        rows = [row for row in self._rows[j] if row not in gone]
        alone = len(rows) == 1 and not self._is_control(j, removals)
        return [] if alone else rows  # a single ray determines no point

    def _kept(self) -> tuple[Index, Block]:
        """Rows of the given block's image points that stay, and the block of them."""
        removals = [removal for removal, _ in self._out]
        o, points = self._block.observations, self._block.points
        keep = np.ones(len(o), bool)
        without = [removal.point for removal in removals if removal.control]
        points = _as_tie(points, without) if without else points
        for j in {removal.point for removal in removals}:
            keep[self._rows[j]] = False
            keep[self._staying(j, [r for r in removals if r.point == j])] = True
        return np.flatnonzero(keep), replace(self._block, points=points, observations=o.take(keep))

    def block(self) -> Block:
        """Give the block without what is left out."""
        return self._kept()[1]

    def state(self, last: State) -> State:
        """Where the next adjustment begins: the last one's end, the first start for points that were not in it.

        Points that are not in it either stay without coordinates.
        """
        ground = np.where(initial.missing_rows(last.ground)[:, None], self._full.start.ground, last.ground)
        block = self.block()
        part = np.isin(np.arange(len(ground)), block.observations.point[participates(block)])
        return State(last.image, np.where(part[:, None], ground, np.nan))

    def concluded(self) -> Search:
        """Give what was found."""
        kept, block = self._kept()
        o, points = self._block.observations, self._block.points
        out = np.concatenate([kept, *(np.array(removal.rows, np.intp) for removal, _ in self._out)])
        single = np.setdiff1d(np.arange(len(o)), out)
        lost = [j for j in points.where(Role.CHECK) if j in o.point and j not in block.observations.point]
        return Search(
            tuple(self._rounds), tuple(self._found), self._given_up, tuple(self._name(r) for r in single.tolist()),
            tuple(points.ids[j] for j in lost),
        )  # fmt: skip


def rescaled(block: Block, full: Problem, components: VarianceComponents) -> Block:
    """The given block with the sigmas that variance components found; ``full`` is its problem."""
    groups = groups_of(full, full.block.options.variance_components)
    known = {c.group: c.factor for c in components.components}
    return scaled(block, groups, np.array([known.get(name, 1.0) for name in groups.names]))


def _as_tie(points: GroundPoints, without: list[int]) -> GroundPoints:
    """Give up the coordinates of control points."""
    gone = np.isin(np.arange(len(points.ids)), without)
    roles = tuple(Role.TIE if away else role for away, role in zip(gone, points.roles, strict=True))
    known, keep = points.known, ~gone[:, None]
    return GroundPoints(points.ids, roles, Coordinates(
        np.where(keep, known.ecef_m, np.nan), np.where(keep, known.sigma_enu_m, np.nan), known.fixed & ~gone,
    ))  # fmt: skip
