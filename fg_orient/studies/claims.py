"""Claims that a faithful reproduction must satisfy, each assessed on the synthetic blocks of several seeds.

A claim is a function ``study -> Outcome``: whether the claim holds, with its figures. :class:`Study` is one seed and
computes each result once. :func:`run_claims` runs the claims over seeds and gives pass rates with Wilson's interval; a
claim is met at 90 % or more. No published value is used here. The bounds are those of the claims (docs/reproduce.md),
so a claim that fails is reported, not adapted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.parts.study import study
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from fg_orient.studies.switches import TEXT, Switches
from fg_orient.studies.two_stage import TwoStage

#: Synthetic block of the published experiments: 1 px of image noise, look angles bent by 3 microrad.
TWIN = ZonguldakOptions(point_set="H-10", image_noise_px=1.0, distortion_rad=3e-6)
#: The same block for the program, with the radial velocity and the attitude of real SPOT-5 scenes. On a circular orbit
#: without attitude the program's matrices are orthonormal, and its constant residual is zero.
AS_RUN_TWIN = replace(TWIN, radial_velocity_m_s=8.0, attitude_rad=(-1.6e-4, -7.2e-4, 9e-4))
#: Sets with redundant unknowns; the thesis calls them ill-conditioned.
ILL_CONDITIONED = (5, 13, 15, 17, 19, 20)
#: Those with the velocity: least squares gives very large errors.
WITH_VELOCITY = (5, 13, 17, 19, 20)
TARGET_M = 5.0
#: Solvers of N x = b without threshold and regularisation, except Cramer's rule: the minors of a matrix in raw units
#: lose more digits than any elimination (claims C8 and C11 give its figures).
EXACT = ("pivot_inverse", "gauss_inverse", "cholesky_inverse", "gauss_elimination", "gauss_partial_pivot_elimination",
         "cholesky_elimination")  # fmt: skip


class Study:
    """The published procedure on the synthetic block of one seed.

    Parameters
    ----------
    seed : int
    switches : Switches
        Differences of the authors' program; with any the block has the radial velocity and attitude of a real scene.
    twin : ZonguldakOptions, optional
        Options of another block.
    """

    def __init__(self, seed: int, switches: Switches = TEXT, twin: ZonguldakOptions | None = None) -> None:
        self.seed, self.switches = seed, switches
        self.twin = twin or (TWIN if switches == TEXT else AS_RUN_TWIN)
        self.bundle = cache(lambda *what: self.two_stage.bundle(*what))
        self.pre_adjust = cache(lambda *what: self.two_stage.pre_adjust(*what))

    def options(self, **changes: object) -> ZonguldakOptions:
        """Options of the block of this seed, with these changes."""
        return replace(self.twin, seed=self.seed, **changes)  # type: ignore[arg-type]

    def procedure(self, **changes: object) -> TwoStage:
        """The procedure on the block with these options."""
        return TwoStage(zonguldak_block(self.options(**changes))[0], as_run=self.switches)

    @cached_property
    def two_stage(self) -> TwoStage:
        """The procedure on the block as published: H-10, 1 px."""
        return self.procedure()

    def control_jacobian(self, eop_set: int) -> Array:
        """Jacobian A (r, u) of step 2 of the first image, raw units."""
        design, _ = self.pre_adjust(0, eop_set, EXACT[-2]).system.require_design("A")
        return design

    @cached_property
    def icp_without_eop(self) -> tuple[Array, Array]:
        """Check-point RMSE (3,) of the bundle with held EOPs, and of the intersection before it."""
        return self.bundle(None, 1, EXACT[-2]).accuracy.icp_rmse, self.two_stage.look_only().icp_rmse


MET_AT = 0.9
#: Quantile of the normal distribution of a 95 % interval.
Z_95 = 1.959963984540054


@dataclass(frozen=True)
class Outcome:
    """One claim on one seed: the parts that do not hold, and its figures by name."""

    failed: tuple[str, ...]
    figures: dict[str, float]


@dataclass(frozen=True)
class Claim:
    """A claim: id ("C5"), its text, and its test."""

    id: str
    text: str
    assess: Callable[[Study], Outcome]


@dataclass(frozen=True)
class ClaimResult:
    """A claim over seeds.

    Parameters
    ----------
    id, text : str
    passed, of : int
        Seeds that meet it, number of seeds.
    interval : (float, float)
        Wilson's 95 % interval of the pass rate.
    met : bool
        Rate of 90 % or more.
    reason : str
        Parts that failed, with their numbers of seeds; "" if none failed.
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
    """Outcome of several parts, from the name of a part to True if it holds."""
    failed = tuple(name for name, holds in checks.items() if not holds)
    return Outcome(failed, {name: float(value) for name, value in figures.items()})


def or_inf(value: float) -> float:
    """Value of a figure; inf without a result, so that no upper bound is met."""
    return float(value) if math.isfinite(value) else math.inf


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


_REGISTRY: dict[str, Claim] = {}


def claim(id: str, text: str) -> Callable[[Callable[[Study], Outcome]], Callable[[Study], Outcome]]:
    """Decorator: register a function as a claim."""

    def add(assess: Callable[[Study], Outcome]) -> Callable[[Study], Outcome]:
        _REGISTRY[id] = Claim(id, text, assess)
        return assess

    return add


def all_claims() -> tuple[Claim, ...]:
    """C1-C22 in order."""
    from fg_orient.studies import claims_geometry, claims_solvers  # noqa: F401  # they register their claims

    return tuple(sorted(_REGISTRY.values(), key=lambda one: int(one.id[1:])))


def run_claims(
    seeds: Sequence[int],
    callback: Callable[[int, int], None] | None = None,
    claims: Sequence[Claim] | None = None,
    switches: Switches = TEXT,
) -> list[ClaimResult]:
    """Assess claims over seeds.

    Parameters
    ----------
    seeds : sequence of int
    callback : callable, optional
        Called with (seeds done, number of seeds) after each seed.
    claims : sequence of Claim, optional
        Default: all of them.
    switches : Switches
        Differences of the authors' program. The claims are about the equations of the text; some fail with switches.
    """
    chosen = all_claims() if claims is None else tuple(claims)
    report = (lambda done, of, _: callback(done, of)) if callback else None
    task = partial(_assessed, chosen, switches)
    results = study(task, list(seeds), callback=report)
    return [_summary(claim, [of_seed[k] for of_seed in results]) for k, claim in enumerate(chosen)]


def _assessed(claims: Sequence[Claim], switches: Switches, seed: int) -> list[dict[str, Any]]:
    """Outcome of each claim on one seed."""
    at = Study(seed, switches)
    with one_blas_thread():  # some claims are about rounding noise
        return [asdict(claim.assess(at)) for claim in claims]


def _summary(claim: Claim, outcomes: list[dict[str, Any]]) -> ClaimResult:
    passed, of = sum(not o["failed"] for o in outcomes), len(outcomes)
    failures = Counter(name for o in outcomes for name in o["failed"])
    reason = "; ".join(f"{name}: not in {count} of {of}" for name, count in failures.items())
    figures = {}
    for name in outcomes[0]["figures"]:
        values = np.array([o["figures"][name] for o in outcomes])
        figures[name] = (float(values.min()), float(np.median(values)), float(values.max()))
    return ClaimResult(claim.id, claim.text, passed, of, wilson(passed, of), passed >= MET_AT * of, reason, figures)
