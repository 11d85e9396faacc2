"""Alternating adjustment and estimation of variance components until the components have converged.

Each round adjusts with the sigmas of the last round (``fg_orient.quality.variance_components``). The result does not
depend on the start.
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
from fg_orient.quality.doubts import gross_errors
from fg_orient.quality.observation_groups import GroupedResiduals, Groups, groups_of, require_groups, scaled
from fg_orient.quality.variance_components import (
    Method,
    Round,
    VarianceComponents,
    components_of,
    one_round,
    require_method,
)
from fg_orient.quality.verdict import NO_INTERVAL, SolutionAssessment, decided

#: Largest relative change of a variance at convergence. It is far below the standard deviation of the variance.
CONVERGED: Final = 1e-5
#: Maximum number of rounds.
MAX_ROUNDS: Final = 100
#: Components are assessed only after this number of rounds, because given sigmas may be wrong by orders of magnitude.
FIRST_ROUNDS: Final = 2
#: Number of rounds with a negative variance after which the component is refused.
NEGATIVE_ROUNDS: Final = 8
#: Smallest and largest factor of sigmas. A component outside this range is regarded as divergent.
RANGE: Final = (1e-3, 1e4)


def adjust_with_components(
    block: Block,
    run: Callable[[Block, State | None], Solution],
    begin: State | None = None,
    *,
    method: Method = "helmert",
) -> Solution:
    """Iterate adjustment and estimation of variance components.

    Parameters
    ----------
    block : Block
        Block whose options name the groups; default: image points, position and height.
    run : callable
        Function that adjusts a block with its sigmas, from a state if given.
    begin : State, optional
        Start of the first adjustment.
    method : str
        See ``fg_orient.quality.variance_components``.

    Returns
    -------
    Solution
        Solution of the last round; its block has the estimated sigmas, which ``components`` describes.

    Raises
    ------
    InputError
        The groups or the method are unknown, or there is a loss.
    NoSolutionError
        There is no covariance; a component is negative, diverges or does not converge.
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
        state = state or _Rounds(groups_of(solution.problem, groups))
        residuals = GroupedResiduals(solution.residual_cofactors, state.groups)
        assessed = rounds > FIRST_ROUNDS
        estimated = one_round(residuals, method, keep=state.kept, judge=assessed)
        if assessed and state.converged(estimated):
            components = components_of(state.groups, estimated, state.variance, rounds, method)
            return _with_components(solution, components, groups)
        state.move(estimated)
        state.refuse(block, estimated)
    worst = state.groups.names[state.worst] if state is not None else ""
    raise NoSolutionError.of("statistics.component_unsettled", place=f"{block.name}, group {worst}", value=MAX_ROUNDS)


def _with_components(solution: Solution, components: VarianceComponents, groups: tuple[str, ...]) -> Solution:
    """Return the last solution with its components; its sigma0 is not a test of the model.

    The tests of gross errors are repeated with the degrees of freedom of the components.
    """
    by_construction, block = finding("verdict.components"), solution.block
    block = replace(block, options=replace(block.options, variance_components=groups))
    whole = replace(
        solution, components=components, sigma0_interval=NO_INTERVAL, problem=replace(solution.problem, block=block)
    )
    findings = [f for f in solution.findings if f.code != "verdict.gross_error"]
    if len(findings) < len(solution.findings):
        findings += gross_errors(whole.outlier_tests(), block.options.accept)
    converged = SolutionAssessment(Status.CONVERGED, by_construction, NO_INTERVAL)
    status, reason, ordered = decided(
        converged if solution.status is not Status.NOT_CONVERGED else replace(converged, status=solution.status),
        by_construction,
        [*findings, by_construction, *components.findings],
        block.options.accept,
    )
    reason = solution.verdict if status is Status.NOT_CONVERGED else reason
    return replace(whole, status=status, verdict=reason, findings=ordered)


class _Rounds:
    """Factors of the variances from round to round, and components that are fixed at their given sigmas.

    A component is assessed in each round, because weights change its redundancy. A component that was estimated and has
    too little redundancy in a later round stays fixed, so that the rounds end.
    """

    def __init__(self, groups: Groups) -> None:
        size = len(groups.names)
        self.groups, self.variance, self.kept = groups, np.ones(size), [False] * size
        self.negative, self.worst = np.zeros(size, int), 0

    def converged(self, estimated: Round) -> bool:
        """Return whether the variances have converged."""
        change = np.abs(estimated.variance - 1.0)
        self.worst = int(np.argmax(change))
        free = np.array([not text for text in estimated.held], bool)
        return bool(change.max() < CONVERGED and (free | (self.variance == 1.0)).all())

    def move(self, estimated: Round) -> None:
        """Apply the variances of a round."""
        held = np.array([bool(text) for text in estimated.held], bool)
        reset = held & (self.variance != 1.0)
        self.kept = [bool(k or again) for k, again in zip(self.kept, reset, strict=True)]
        self.variance = np.where(held, 1.0, self.variance * estimated.variance)
        self.negative = np.where(estimated.negative, self.negative + 1, 0)

    def refuse(self, block: Block, estimated: Round) -> None:
        """Raise NoSolutionError for the first component that is negative or diverges."""
        for g, (name, factor) in enumerate(zip(self.groups.names, np.sqrt(self.variance), strict=True)):
            place = f"{block.name}, group {name}"
            if self.negative[g] >= NEGATIVE_ROUNDS or factor < RANGE[0]:
                value = f"{estimated.redundancy[g]:.1f}"
                raise NoSolutionError.of("statistics.component_negative", place=place, value=value)
            if factor > RANGE[1]:
                raise NoSolutionError.of("statistics.component_explodes", place=place, value=f"{factor:.3g}")
