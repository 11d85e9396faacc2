"""Adjust a block without jitter, choose the jitter curves for which there is evidence, and adjust with these curves.

Gross errors imitate jitter, and jitter imitates gross errors. If gross errors are
searched for, the choice is therefore repeated without the observations that the search
left out, until the choice does not change any more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from fg_orient.adjustment.robust import NONE
from fg_orient.adjustment.rows import replaced
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.orientation.solution import Solution
from fg_orient.quality.jitter import choose
from fg_orient.quality.jitter_record import Jitter, jitter_of
from fg_orient.quality.jitter_system import jitter_system

#: Maximum number of times that curves are chosen if gross errors are searched for.
MAX_ROUNDS: Final = 4


def adjust_with_jitter(block: Block, run: Callable[[Block], Solution]) -> Solution:
    """Adjust a block with the jitter for which there is evidence.

    Parameters
    ----------
    block : Block
        Block whose option ``jitter`` is "auto"; its ``jitter_curves`` are replaced.
    run : callable
        Function that adjusts a block with its options.

    Returns
    -------
    Solution
        Its attribute ``jitter`` contains the evidence. If there is no evidence for
        jitter, it is the solution without jitter.

    Raises
    ------
    InputError
        An option excludes the choice, or no image has the unknowns that jitter needs.
    """
    _require_possible(block)
    plain = _with(block, snoop=False, jitter_curves=())
    jitter: Jitter | None = None
    for _ in range(MAX_ROUNDS):
        solution = run(plain)
        if solution.status is Status.NOT_CONVERGED:
            return _concluded(solution, None, block)
        before = jitter
        jitter = jitter_of(choose(jitter_system(solution.problem, solution.state)), solution.block)
        names = tuple(map(str, jitter.curves))
        if names or block.options.snoop:
            solution = run(_with(block, jitter_curves=names))
        if not block.options.snoop or (before is not None and before.curves == jitter.curves):
            break
        plain = _with(solution.block, snoop=False, jitter_curves=())
    return _concluded(solution, jitter, block)


def _concluded(solution: Solution, jitter: Jitter | None, block: Block) -> Solution:
    """Return the solution with the evidence, and with the options as the user gave them."""
    options = replace(solution.block.options, jitter="auto", snoop=block.options.snoop)
    problem = replaced(solution.problem, "records", block=replace(solution.block, options=options))
    more = () if jitter is None else jitter.findings()
    return replace(solution, problem=problem, jitter=jitter, findings=(*solution.findings, *more))


def _with(block: Block, **options: Any) -> Block:
    return replace(block, options=replace(block.options, jitter="none", **options))


def _require_possible(block: Block) -> None:
    """Raise InputError if an option makes the choice of jitter impossible."""
    options = block.options
    excluded = {
        "loss": options.loss != NONE,
        "regularisation": options.regularisation != "none",
        "variance_components": bool(options.variance_components),
        "curve_intervals": bool(options.curve_intervals),
    }
    for name, given in excluded.items():
        if given:
            raise InputError.of("jitter.excluded", option=name, value=getattr(options, name))
    if not options.priors or options.datum in ("inner", "free"):
        raise InputError.of("jitter.priors", option="priors" if not options.priors else "datum", value=options.datum)
