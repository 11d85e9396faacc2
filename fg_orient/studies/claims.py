"""The claims a faithful reproduction must satisfy, each judged on one seed of the twin.

A claim is a function ``study -> Outcome``: whether it holds, and the figure that says how clearly.
:func:`run_claims` runs them over seeds and gives pass rates with Wilson's interval; a claim is met at
90 % or more. Nothing here knows a published value: the bounds are those of the claims themselves
(docs/reproduce.md), so a claim that fails is reported, not adapted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.parts.study import study
from fg_orient.studies.study import Study
from fg_orient.studies.switches import TEXT, Switches

MET_AT = 0.9
#: Quantile of the normal distribution of a 95 % interval.
Z_95 = 1.959963984540054


@dataclass(frozen=True)
class Outcome:
    """One claim on one seed: ``holds``, the parts that do not, and the figures behind it by name."""

    holds: bool
    failed: tuple[str, ...]
    figures: dict[str, float]


@dataclass(frozen=True)
class Claim:
    """A claim: id ("C5"), what it says, and its judge."""

    id: str
    text: str
    judge: Callable[[Study], Outcome]


@dataclass(frozen=True)
class ClaimResult:
    """A claim over seeds.

    Parameters
    ----------
    id, text : str
    passed, of : int
        Seeds that meet it, seeds in all.
    interval : (float, float)
        Wilson's 95 % interval of the pass rate.
    met : bool
        Rate of 90 % or more.
    reason : str
        Which part failed in how many seeds; "" if none did.
    figures : dict
        Name to (smallest, median, largest) over the seeds.
    """

    id: str
    text: str
    passed: int
    of: int
    interval: tuple[float, float]
    met: bool
    reason: str
    figures: dict[str, tuple[float, float, float]]


def outcome(checks: dict[str, bool], **figures: float) -> Outcome:
    """Outcome of several parts: part name to whether it holds."""
    failed = tuple(name for name, holds in checks.items() if not holds)
    return Outcome(not failed, failed, {name: float(value) for name, value in figures.items()})


def wilson(passed: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a proportion (Wilson 1927).

    Raises
    ------
    ValueError
        No trials.
    """
    if of < 1:
        raise ValueError("a proportion needs at least one trial")
    p, z2 = passed / of, Z_95**2
    centre = (p + z2 / (2 * of)) / (1.0 + z2 / of)
    half = Z_95 / (1.0 + z2 / of) * math.sqrt(p * (1.0 - p) / of + z2 / (4.0 * of * of))
    return (0.0 if passed == 0 else centre - half), (1.0 if passed == of else centre + half)


def all_claims() -> tuple[Claim, ...]:
    """C1-C22 in order."""
    from fg_orient.studies import claims_geometry, claims_rfm, claims_solvers

    claims = (*claims_geometry.CLAIMS, *claims_solvers.CLAIMS, *claims_rfm.CLAIMS)
    return tuple(sorted(claims, key=lambda claim: int(claim.id[1:])))


def run_claims(
    seeds: Sequence[int],
    callback: Callable[[int, int], None] | None = None,
    claims: Sequence[Claim] | None = None,
    workers: int = 0,
    cluster: Any = None,
    switches: Switches = TEXT,
) -> list[ClaimResult]:
    """Judge claims over seeds.

    Parameters
    ----------
    seeds : sequence of int
    callback : callable, optional
        Called with (seeds done, seeds in all) after each seed.
    claims : sequence of Claim, optional
        Default: all of them.
    workers, cluster : optional
        Processes, or a cluster, that share the seeds; see ``fg_orient.adjustment.parts.study``.
    switches : Switches
        Departures of the authors' program. The claims are about the equations of the text; some fail with them.
    """
    chosen = all_claims() if claims is None else tuple(claims)

    def tell(done: int, of: int, _: object) -> None:
        if callback:
            callback(done, of)

    found = study(partial(_judged, chosen, switches), list(seeds), workers=workers, cluster=cluster, callback=tell)
    outcomes = [[Outcome(o["holds"], tuple(o["failed"]), o["figures"]) for o in of_seed] for of_seed in found]
    return [_summary(claim, [row[k] for row in outcomes]) for k, claim in enumerate(chosen)]


def _judged(claims: Sequence[Claim], switches: Switches, seed: int) -> list[dict[str, Any]]:
    """Outcome of each claim on one seed."""
    at = Study(seed, switches)
    with one_blas_thread():  # rounding noise is what some claims are about
        return [asdict(claim.judge(at)) for claim in claims]


def _summary(claim: Claim, outcomes: list[Outcome]) -> ClaimResult:
    passed, of = sum(o.holds for o in outcomes), len(outcomes)
    failures: dict[str, int] = {}
    for o in outcomes:
        for name in o.failed:
            failures[name] = failures.get(name, 0) + 1
    reason = "; ".join(f"{name}: not in {count} of {of}" for name, count in failures.items())
    figures = {}
    for name in outcomes[0].figures:
        values = np.array([o.figures[name] for o in outcomes])
        figures[name] = (float(values.min()), float(np.median(values)), float(values.max()))
    return ClaimResult(claim.id, claim.text, passed, of, wilson(passed, of), passed >= MET_AT * of, reason, figures)
