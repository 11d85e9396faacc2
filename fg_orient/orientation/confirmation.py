"""Confirmation of a likely cause: the block without the mistake is adjusted once.

Two conditions must be met by the decrease of the weighted sums of squares of observations and check points.
It must reach the limit of the test of the cause. It must also be more than half of the excess of these sums
over their expectation. Otherwise another cause explains more, and this cause is withdrawn. The linearised
test that found the cause is not used for this decision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from fg_orient.model.block import Block
from fg_orient.model.errors import DECISIVE, FgOrientError, Finding
from fg_orient.model.names import Status
from fg_orient.orientation.solution import Solution

#: Codes of findings that name a mistake.
CAUSES: Final = ("verdict.cause", "solution.mix_up", "solution.id_mix_up", "solution.id_copied")
#: Doubts that must disappear if sigmas that are wrong by a factor are the cause.
OF_SIGMAS: Final = ("verdict.sigma0", "verdict.gross_error")


def confirmed(solution: Solution, run: Callable[[Block], Solution]) -> Solution:
    """Complete a solution with the result of a further adjustment on its likely cause.

    Parameters
    ----------
    solution : Solution
    run : callable
        Function that adjusts a block once.
    """
    supposed, solution = solution.supposed, replace(solution, supposed=None)
    doubted = any(f.severity in DECISIVE and f.code not in CAUSES for f in solution.findings)
    # the doubt has disappeared, for instance by estimated sigmas
    if solution.status is Status.CONVERGED and not doubted:
        return _without_causes(solution)
    if supposed is None:
        return solution
    options = replace(solution.block.options, snoop=False, variance_components=())
    try:
        after = run(replace(supposed.mend(solution.block), options=options))
    except FgOrientError:
        return _without_causes(solution)
    if after.status is Status.NOT_CONVERGED or not _is_better(solution, after, supposed.least):
        return _without_causes(solution)
    if supposed.whole and any(f.code in OF_SIGMAS for f in after.findings):
        return _without_causes(solution)
    left = [f for f in after.findings if f.severity in DECISIVE]
    words = {
        "before": f"{solution.sigma0:.3g}",
        "after": f"{after.sigma0:.3g}",
        "left": "no doubt remains" if not left else f"{len(left)} doubt(s) remain: {left[0].code.partition('.')[2]}",
    }
    found = tuple(_extended(f, words) if f.code in CAUSES else f for f in solution.findings)
    seconds = replace(solution.seconds, statistics=solution.seconds.statistics + after.seconds.total)
    return replace(solution, findings=found, seconds=seconds)


def _is_better(before: Solution, after: Solution, least: float | None) -> bool:
    """Return whether the decrease of the sums of squares confirms a mistake; ``least``: see ``Supposed``."""
    if least is None:
        return before.status is Status.NOT_CONVERGED or bool(after.sigma0 < before.sigma0)
    (first, freedom), (second, _) = _squares(before), _squares(after)
    return bool(first - second >= max(least, 0.5 * (first - freedom)))


def _squares(solution: Solution) -> tuple[float, float]:
    """Return the weighted sum of squares of observations and differences at check points, and its expectation."""
    check = solution.accuracy.check
    covariance = check.covariance_m2
    if covariance is None:
        return solution.chi2, solution.redundancy
    e = check.enu_m[check.selected].ravel()
    return solution.chi2 + float(e @ np.linalg.solve(covariance, e)), solution.redundancy + len(e)


def _extended(found: Finding, words: dict[str, str]) -> Finding:
    return replace(found, data={**found.data, **words})


def _without_causes(solution: Solution) -> Solution:
    return replace(solution, findings=tuple(f for f in solution.findings if f.code not in CAUSES))
