"""Adjustment and variance components in turn, until the components stand.

Sigmas decide on weights, weights on residuals, residuals on sigmas: each round adjusts with the sigmas of the round
before (``fg_orient.quality.variance_components``). The fixed point does not depend on the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from fg_orient.adjustment.problem import State
from fg_orient.adjustment.robust import NONE
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError, NoSolutionError, finding
from fg_orient.model.names import Status
from fg_orient.model.options import USUAL_GROUPS
from fg_orient.orientation.solution import Solution
from fg_orient.quality.observation_groups import Groups, groups_of, require_groups, scaled
from fg_orient.quality.variance_components import (
    Method,
    Residuals,
    Round,
    VarianceComponents,
    components_of,
    one_round,
    require_method,
)
from fg_orient.quality.verdict import NO_INTERVAL

#: Variances that change by less in a round stand: far below their standard deviations.
STANDS: Final = 1e-5
#: Rounds after which a component that does not stand is refused.
MAX_ROUNDS: Final = 100
#: Rounds in which no component is judged: given sigmas may be wrong by orders of magnitude.
FIRST_ROUNDS: Final = 2
#: So many rounds with a variance below zero are no accident of the start.
NEGATIVE_ROUNDS: Final = 8
#: Factors of sigmas beyond which a component runs away.
RANGE: Final = (1e-3, 1e4)


def adjust_with_components(
    block: Block,
    run: Callable[[Block, State | None], Solution],
    begin: State | None = None,
    *,
    method: Method = "helmert",
) -> Solution:
    """Iterate adjustment and variance components.

    Parameters
    ----------
    block : Block
        Its options name the groups; none: image points, position and height.
    run : callable
        Adjusts a block as it is, from a state if one is given.
    begin : State, optional
        Where the first adjustment begins.
    method : str
        See ``fg_orient.quality.variance_components``.

    Returns
    -------
    Solution
        Of the last round; its block has the sigmas found, ``components`` tells what they are.

    Raises
    ------
    InputError
        Groups or method do not exist; a loss.
    NoSolutionError
        There is no covariance; a component is negative, runs away or does not stand.
    """
    require_method(method)
    if block.options.loss != NONE:
        raise InputError.of("statistics.components_loss", option="loss", value=block.options.loss)
    groups = block.options.variance_components or USUAL_GROUPS
    require_groups(groups)
    block = replace(block, options=replace(block.options, variance_components=()))
    state: _Rounds | None = None
    for rounds in range(1, MAX_ROUNDS + 1):
        solution = run(block if state is None else scaled(block, state.groups, np.sqrt(state.variance)), begin)
        cofactors = solution.required_cofactors()
        state = state or _Rounds(groups_of(solution.problem, groups))
        residuals = Residuals(solution.problem, solution.state, cofactors, state.groups)
        judge = rounds > FIRST_ROUNDS
        found = one_round(residuals, method, keep=state.kept, judge=judge)
        if judge and state.stands(found):
            components = components_of(state.groups, found, state.variance, rounds, method)
            return _untested(solution, components, _with_groups(solution.block, groups))
        state.move(found)
        _refuse(block, state, found)
    worst = state.groups.names[state.worst] if state is not None else ""
    raise NoSolutionError.of("statistics.component_unsettled", place=f"{block.name}, group {worst}", value=MAX_ROUNDS)


def _untested(solution: Solution, components: VarianceComponents, block: Block) -> Solution:
    """The last solution with its components: sigma0 no longer tells anything of the model."""
    by_construction = finding("verdict.components")
    return replace(
        solution, components=components, sigma0_interval=NO_INTERVAL,
        verdict=by_construction if solution.status is Status.CONVERGED else solution.verdict,
        findings=(*solution.findings, by_construction, *components.findings),
        problem=replace(solution.problem, block=block),
    )  # fmt: skip


def _with_groups(block: Block, groups: tuple[str, ...]) -> Block:
    """The block with the groups that were estimated in its options."""
    return replace(block, options=replace(block.options, variance_components=groups))


class _Rounds:
    """What one round hands to the next: factors of the variances, and which are kept at those given.

    A component is judged anew in each round, as weights decide on its redundancy; one that was estimated and then
    has too little of it stays held, so that the rounds come to an end.
    """

    def __init__(self, groups: Groups) -> None:
        size = len(groups.names)
        self.groups, self.variance, self.kept = groups, np.ones(size), [False] * size
        self.negative, self.worst = np.zeros(size, int), 0

    def stands(self, found: Round) -> bool:
        """Whether nothing would move any more."""
        change = np.abs(found.variance - 1.0)
        self.worst = int(np.argmax(change))
        free = np.array([not text for text in found.held], bool)
        return bool(change.max() < STANDS and (free | (self.variance == 1.0)).all())

    def move(self, found: Round) -> None:
        """Take over what a round found."""
        held = np.array([bool(text) for text in found.held], bool)
        reset = held & (self.variance != 1.0)
        self.kept = [bool(k or again) for k, again in zip(self.kept, reset, strict=True)]
        self.variance = np.where(held, 1.0, self.variance * found.variance)
        self.negative = np.where(found.negative, self.negative + 1, 0)


def _refuse(block: Block, state: _Rounds, found: Round) -> None:
    """Refuse components that are negative or run away.

    Raises
    ------
    NoSolutionError
        Names the first group.
    """
    factor = np.sqrt(state.variance)
    for g, name in enumerate(state.groups.names):
        place = f"{block.name}, group {name}"
        if state.negative[g] >= NEGATIVE_ROUNDS or factor[g] < RANGE[0]:
            raise NoSolutionError.of("statistics.component_negative", place=place, value=f"{found.redundancy[g]:.1f}")
        if factor[g] > RANGE[1]:
            raise NoSolutionError.of("statistics.component_explodes", place=place, value=f"{factor[g]:.3g}")
