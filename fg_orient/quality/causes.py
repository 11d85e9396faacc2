"""Likely causes of a doubt: mistakes in tables and metadata that explain the residuals better than "no mistake".

Mistakes that move points by thousands of pixels are found from the start values (``fg_orient.quality.mix_ups``).

Other mistakes are tested at the solution (:func:`of_solution`). Notation: e = W E theta is
the whitened error of measured coordinates (c: control points, k: check points). v_c are the
residuals of control points. k are the innovations of check points: adjusted minus measured
coordinates, which are not observations. With
``H = W Q W^T``, ``R = I - H_cc`` and ``S = I + H_kk``::

    v_c ~ -R e_c,   k ~ H_kc e_c - e_k = G theta,   cov(v_c) = R,  cov(k) = S,  cov(v_c, k) = 0
    M = e_c^T R e_c + G^T S^-1 G,   g = G^T S^-1 k - e_c^T v_c,   T = g^T M^+ g ~ chi2(p)

(score test; Rao 1973, 6e). A mistake without free parameter (feet, exchanged ids) has theta = 1. Twice the
logarithm of its likelihood ratio is ``2 g - M``. Suppose that n such mistakes are tested and there is no
mistake. The probability that any of the n ratios exceeds ``2 ln(n / alpha)`` is then at most alpha (Markov's
inequality). Errors of image points also change the innovations, by G theta; their sums are in
``fg_orient.quality.image_causes``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.memory import EXACT_RAYS
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.distributions import chi_square_limit, chi_square_tail, sidak
from fg_orient.model.errors import DECISIVE, Finding, finding
from fg_orient.model.names import Role
from fg_orient.quality import mended
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.cause import Cause, Supposed
from fg_orient.quality.cofactors import PointCofactors
from fg_orient.quality.doubts import Examined
from fg_orient.quality.ground_causes import GroundErrors
from fg_orient.quality.image_causes import ImageErrors, image_causes, single_rays
from fg_orient.quality.mix_ups import id_mix_ups, mix_ups, undone, with_right_ids
from fg_orient.quality.reliability import noncentrality
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.stated_sigmas import StatedSigma

#: Probability that a cause is named although there is no mistake, if causes are tested.
ALPHA: Final = 0.001
#: Two causes cannot be distinguished if their scores differ by less than this: twice the
#: logarithm of a likelihood ratio of 100.
APART: Final = 2.0 * np.log(100.0)
#: Causes are not tested if there are more control points than this. The second number is the
#: maximum number of causes named together.
MOST: Final = 300
NAMED: Final = 3
#: If sigmas would be wrong by more than this factor, the large residuals have another reason.
LARGEST: Final = 100.0


def added(
    ordered: tuple[Finding, ...],
    problem: Problem,
    estimate: Estimate,
    cofactors: PointCofactors | None,
    examined: Examined,
    check: PointDifferences,
) -> tuple[tuple[Finding, ...], Supposed | None]:
    """Return the findings of a result with the likely causes of its doubts, and the most likely mistake."""
    # a mix-up moves points by thousands of pixels: it causes more doubts than wrong sigmas of a group
    doubted = {f.code for f in ordered if f.severity in DECISIVE}
    if estimate.converged and not doubted:
        return ordered, None
    at_start = not estimate.converged or doubted != {"verdict.sigmas"}
    mixed = mix_ups(problem.block) if at_start else ()
    if mixed:
        found = tuple(one.finding(problem.block) for one in mixed)
        return (*ordered[:1], *found, *ordered[1:]), Supposed(partial(undone, found=mixed), None)
    exchanged = id_mix_ups(problem.block) if at_start else ()
    if exchanged:
        found = tuple(one.finding(problem.block) for one in exchanged)
        return (*ordered[:1], *found, *ordered[1:]), Supposed(partial(with_right_ids, found=exchanged), None)
    if not estimate.converged:
        return ordered, None
    named, first = of_solution(problem, estimate, cofactors, examined.sigmas, check, examined.residuals)
    return (*ordered[:1], *named, *ordered[1:]), first


def of_solution(
    problem: Problem,
    estimate: Estimate,
    cofactors: PointCofactors | None,
    sigmas: Sequence[StatedSigma],
    check: PointDifferences,
    residuals: ResidualCofactors | None = None,
) -> tuple[tuple[Finding, ...], Supposed | None]:
    """Name the most likely cause and similar causes in a note; return nothing if an error of one point explains more.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
        Result of a least-squares adjustment; nothing is tested under a loss.
    cofactors : PointCofactors or None
    sigmas : sequence of StatedSigma
        Stated and estimated sigmas of groups of observations.
    check : PointDifferences
        Differences at the check points.
    residuals : ResidualCofactors, optional
        Cofactors of the residuals; without them mistakes in image points are not tested.
    """
    n = int(problem.observed.sum())
    if cofactors is None or estimate.weights is not None or problem.block.options.datum == "inner" or n > MOST:
        return (), None
    system = GroundErrors.of(problem, estimate.state, cofactors, check)
    errors = None if residuals is None else ImageErrors.of(residuals)
    tried = [*(() if residuals is None else single_rays(residuals)), *(() if system is None else system.causes())]
    tried += [] if system is None or errors is None else image_causes(errors, partial(system.image_normal, errors))
    singles = [c for c in tried if c.kind == "single"]
    named = [*_factors(sigmas, singles), *(c for c in tried if c.kind != "single")]
    fixed, free = sum(c.free == 0 for c in named), sum(c.free > 0 for c in named)

    def limit(c: Cause) -> float:
        return float(chi_square_limit(c.free, sidak(ALPHA / 2, free))) if c.free else 2.0 * np.log(2 * fixed / ALPHA)

    best: dict[str, Cause] = {}
    for c in sorted(named, key=lambda c: -c.score):
        if c.gain >= limit(c) and c.kind not in best:
            best[c.kind] = c
    first = next(iter(best.values()), None)
    if first is None:
        return (), None
    # a free error of the same point always fits at least as well, so it is not an alternative cause
    rival = max((c.score + APART * (c.point != first.point) for c in singles), default=-np.inf)
    if first.score <= rival:
        return (), None
    alike = [c.words for c in list(best.values())[1:NAMED] if c.score > first.score - APART]
    note = finding(
        "verdict.cause", what=first.words, gain=first.gain, before="", after="", left="", also=alike, cure=first.cure
    )
    least = max(limit(first), rival + first.gain - first.score) + first.volume
    return (note,), None if first.mend is None else Supposed(first.mend, least, bool(first.volume))


def _factors(sigmas: Sequence[StatedSigma], singles: Sequence[Cause]) -> Iterator[Cause]:
    """Yield sigmas of a group that are wrong by a factor f: likelihood of its residuals with the redundancy r.

    ``r (f^2 - 1 - ln f^2)`` is twice the logarithm of the likelihood ratio of r independent normal residuals. The
    factor is contradicted by an observation that would have a gross error with the larger sigmas, too.
    """
    for one in sigmas:
        r, q = one.redundancy, max(one.factor, 1e-6) ** 2
        own = [chi_square_tail(c.free, c.gain / q) for c in singles if one.group.startswith(c.what)]
        if one.factor > LARGEST or (own and min(own) <= sidak(ALPHA, len(own))):
            continue
        gain, size = r * (q - 1.0 - np.log(q)), "small" if q > 1 else "large"
        text = f"sigmas of {one.group} too {size}: factor {one.factor:.2f} +- {one.sd:.2f}"
        yield Cause(
            text,
            "let option variance_components estimate the sigmas",
            gain,
            1,
            gain - np.log(r),
            f"sigma {one.group}",
            partial(mended.with_sigmas, group=one.group, factor=one.factor),
            r * np.log(q),
        )


#: Level and power of the test, sizes of the mistakes, maximum number of measured points.
LEVEL: Final = 0.001
POWER: Final = 0.2
ORIGINS_PX: Final = (0.5, 1.0)
HEIGHT_M: Final = 30.0
SHIFT_M: Final = 0.5
MOST_POINTS: Final = 100


@dataclass(frozen=True)
class UnseenMistake:
    """Mistake that no test of this block detects.

    Parameters
    ----------
    mistake, assumption : str
    noncentrality : float
    limit : float
        Non-centrality below which the mistake cannot be detected.
    """

    mistake: str
    assumption: str
    noncentrality: float
    limit: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the record of a run."""
        return asdict(self)


def unseen_mistakes(known: ResidualCofactors, check: PointDifferences) -> tuple[UnseenMistake, ...]:
    """List mistakes that this block cannot show, and the assumptions made instead.

    The unknowns of the block absorb these mistakes.
    The non-centrality of a mistake is the decrease of the weighted sum of squares that a mistake of this size causes
    without noise (M of this module). Below the limit a test at a level of 0.1 % finds it in fewer than 20 % of cases.
    Blocks too large for their cofactors have no list.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of a solution without a loss.
    check : PointDifferences
        Differences at the check points.
    """
    problem = known.problem
    small = len(problem.observations) <= EXACT_RAYS and int(problem.observed.sum()) + len(check) <= MOST_POINTS
    errors = ImageErrors.of(known) if small and problem.block.options.datum != "inner" else None
    system = None if errors is None else GroundErrors.of(problem, known.state, known.cofactors, check)
    if errors is None or system is None:
        return ()
    every = tuple(range(problem.n_images))
    pixels = np.stack([errors.shifted(every, shift) for shift in ORIGINS_PX], axis=1)
    found = [
        (f"an origin of lines and samples that differs by {shift:g} px", "(0, 0) is the centre of the first pixel", m)
        for shift, m in zip(ORIGINS_PX, np.diag(system.image_normal(errors, pixels)[1]).tolist(), strict=True)
    ]
    axes = np.swapaxes(problem.axes(system.given_m), 1, 2)
    of = "control and check points" if Role.CHECK in problem.block.points.roles else "control points"
    east, north, up = np.diag(system.normal(axes)[1]).tolist()
    found.append(
        (
            f"an offset of {HEIGHT_M:g} m of the heights of all {of}",
            "their heights have the vertical datum that the table states, else they are ellipsoidal",
            HEIGHT_M**2 * up,
        )
    )
    found.append(
        (
            f"a shift of {SHIFT_M:g} m of all {of}, as between epochs of ITRF",
            "they have the reference frame of the metadata",
            SHIFT_M**2 * min(east, north),
        )
    )
    limit = noncentrality(LEVEL, POWER, 1)
    return tuple(UnseenMistake(*one, limit) for one in found if one[2] < limit)
