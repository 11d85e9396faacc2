"""Assessment of a solution: status, reason and the most important findings.

A converged solution with a finding of the severity "doubt" is not trustworthy (exit code 4):

- its datum is free (damped steps without priors and control);
- it has no covariance, and no priors determine the weak directions;
- ``sigma0`` is above the upper end of its two-sided 99.9 % interval: model and weights contradict the observations;
- a robust loss down-weights more than half of all image points, or of the image points of one image;
- a test suspects a gross error, a correction is too large for its prior, or a required accuracy is not reached
  (``fg_orient.quality.doubts``);
- check points contradict the adjusted points.

``sigma0`` below the lower end of the interval means that the sigmas are too large. This is reported and does not change
the status.

Likely causes of a doubt are in ``fg_orient.quality.causes``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.robust import DOWN, UNWEIGHED, Weights, are_information
from fg_orient.adjustment.rows import linearised, rows_by_image
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.distributions import chi_square_interval
from fg_orient.model.errors import DECISIVE, Finding, finding
from fg_orient.model.names import Role, Status
from fg_orient.quality import conditioning, regularisation, vendor_datum
from fg_orient.quality.accuracy import ASPRS_MINIMUM, Accuracy
from fg_orient.quality.doubts import SIGMA0_LEVEL, explains_all, with_accepted
from fg_orient.quality.observability import BlockObservability, ImageObservability

#: Maximum share of down-weighted image points in a trustworthy solution.
MOST_DOWN = 0.5
#: Maximum number of images that are named.
NAMED = 10
#: GTSAM's time is reported if it eliminates more unknowns together than the first number. The second number
#: is its seconds divided by the cube of the number of unknowns (measured with 3060 unknowns).
WIDE = 1500
GTSAM_S = 1.1e-10
NO_INTERVAL = (float("nan"), float("nan"))


@dataclass(frozen=True)
class SolutionAssessment:
    """Status, its reason, and the 99.9 % interval of sigma0 (nan if there is none)."""

    status: Status
    finding: Finding
    interval: tuple[float, float]


def assess_solution(problem: Problem, estimate: Estimate, unavailable: tuple[Finding, ...]) -> SolutionAssessment:
    """Assess the status by convergence, covariance and the global test of sigma0."""
    f = problem.redundancy
    if not estimate.converged or not np.isfinite(estimate.chi2):
        return SolutionAssessment(Status.NOT_CONVERGED, estimate.end, NO_INTERVAL)
    interval = sigma0_interval(f) if f > 0 and estimate.weights is None else NO_INTERVAL
    doubt = _doubt(problem, estimate, unavailable, interval[1])
    if doubt is not None:
        return SolutionAssessment(Status.NOT_TRUSTWORTHY, doubt, interval)
    end = estimate.end if f > 0 else finding("verdict.no_redundancy")
    return SolutionAssessment(Status.CONVERGED, end, interval)


def decided(
    assessment: SolutionAssessment, end: Finding, findings: Sequence[Finding], accept: Sequence[str]
) -> tuple[Status, Finding, tuple[Finding, ...]]:
    """Return the status, its reason and all findings, the most serious first; accepted doubts do not decide.

    A gross error that alone explains sigma0 is before the doubts that follow from it.
    """
    ordered = tuple(with_accepted(sorted(findings, key=lambda f: not explains_all(f)), accept))
    if assessment.status is Status.NOT_CONVERGED:
        return assessment.status, assessment.finding, ordered
    worst = next((f for f in ordered if f.severity in DECISIVE), None)
    if worst is not None:
        return Status.NOT_TRUSTWORTHY, worst, ordered
    return Status.CONVERGED, assessment.finding if assessment.status is Status.CONVERGED else end, ordered


def _doubt(problem: Problem, estimate: Estimate, unavailable: tuple[Finding, ...], limit: float) -> Finding | None:
    """Return the reason not to trust a converged solution, or None; ``limit``: upper end of the interval of sigma0."""
    options, weights, f = problem.block.options, estimate.weights, problem.redundancy
    if problem.least_damping > 0.0:
        return finding("verdict.free_datum")
    plain = weights is None or are_information(options.loss, weights)
    if unavailable and plain and not options.holds_unknowns and options.datum != "inner":
        return finding("verdict.weak_control")
    if f > 0 and weights is not None:
        return _doubt_of_weights(problem, weights)
    sigma0 = float(np.sqrt(estimate.chi2 / f)) if f > 0 else 0.0
    if not sigma0 > limit:  # written with not, because the limit is nan without redundancy
        return None
    share = regularisation.share_of_penalty(problem, estimate.state, estimate.chi2)
    if share is None:
        return finding("verdict.sigma0", size=sigma0, limit=limit)
    return finding("verdict.sigma0_regularised", size=sigma0, limit=limit, share=share)


def _doubt_of_weights(problem: Problem, weights: Weights) -> Finding | None:
    """Return the reason not to trust a solution under a loss, by the number of down-weighted image points.

    Sigma0 is not chi-square distributed under a loss. If most image points of an image are down-weighted, it is
    oriented by its other points or by its priors alone. Least absolute values are not assessed, because their weights
    decrease from the smallest residual on.
    """
    if problem.block.options.loss in UNWEIGHED:
        return None
    down, n = int(np.count_nonzero(weights.image < DOWN)), len(weights.image)
    if down > MOST_DOWN * n:
        return finding("verdict.loss", down=down, n=n, limit=DOWN)
    images = [f"image {name}: {bad} of {all_}" for name, bad, all_ in turned_down_images(problem, weights)]
    return finding("verdict.loss_of_images", count=len(images), limit=DOWN, images=images) if images else None


def turned_down_images(problem: Problem, weights: Weights) -> list[tuple[str, int, int]]:
    """List images with more than half of their image points down-weighted: id, number down-weighted, number of all."""
    o, m = problem.observations, problem.n_images
    if problem.block.options.loss in UNWEIGHED:
        return []
    n, bad = np.bincount(o.image, minlength=m), np.bincount(o.image[weights.image < DOWN], minlength=m)
    return [(problem.block.images[k].id, int(bad[k]), int(n[k])) for k in np.flatnonzero(bad > MOST_DOWN * n)]


def points_with_rays(problem: Problem, weights: Weights, rays: int) -> list[int]:
    """List unknown points without control that have exactly this number of rays (0 or 1) with full weight.

    A control observation counts only if it is not down-weighted. Without a ray no observation checks the
    position. With one ray the position along it is not determined.
    """
    o, n = problem.observations, len(problem.active)
    if problem.block.options.loss in UNWEIGHED:
        return []
    good, every = np.bincount(o.point[weights.image >= DOWN], minlength=n), np.bincount(o.point, minlength=n)
    lost = problem.active & (good == rays) & (every > rays)
    lost &= ~problem.observed | (weights.control < DOWN)
    return np.flatnonzero(lost).tolist()


def _lost(problem: Problem, weights: Weights) -> list[Finding]:
    """Report points whose rays, except at most one, are down-weighted by the loss, including check points."""
    out, points = [], problem.block.points
    for rays, code in ((0, "weights.no_ray"), (1, "weights.one_ray")):
        lost = points_with_rays(problem, weights, rays)
        if lost:
            check = [points.ids[j] for j in lost if points.roles[j] is Role.CHECK]
            out.append(finding(code, n=len(lost), points=[points.ids[j] for j in lost], check=check))
    return out


def _of_weights(problem: Problem, weights: Weights) -> Finding:
    """Report the down-weighted observations of a robust adjustment."""
    options = problem.block.options
    down, control = (int(np.count_nonzero(w < DOWN)) for w in (weights.image, weights.control))
    counts = {"loss": options.loss, "down": down, "n": len(weights.image), "control": control}
    if options.loss in UNWEIGHED:
        return finding("weights.beyond", **counts, limit=1.0 / DOWN)
    scale = weights.scale if options.robust_scale != "prior" else (None, None)
    return finding("weights.below", **counts, limit=DOWN, scale_image=scale[0], scale_control=scale[1])


def sigma0_interval(redundancy: float) -> tuple[float, float]:
    """Return the two-sided 99.9 % interval of sigma0: ``sqrt(chi2_p(f) / f)``."""
    low, high = chi_square_interval(redundancy, 1.0 - SIGMA0_LEVEL)
    return float(np.sqrt(low / redundancy)), float(np.sqrt(high / redundancy))


def findings(
    problem: Problem,
    estimate: Estimate,
    verdict: SolutionAssessment,
    observability: tuple[ImageObservability, ...],
    block: BlockObservability | None,
    accuracy: Accuracy,
) -> tuple[Finding, ...]:
    """Return the findings, the most serious first."""
    f = problem.redundancy
    out = [] if verdict.status is Status.CONVERGED and f > 0 else [verdict.finding]
    if estimate.weights is not None:
        out += [_of_weights(problem, estimate.weights), *_lost(problem, estimate.weights)]
    if f > 0 and np.sqrt(estimate.chi2 / f) < verdict.interval[0]:
        out.append(finding("solution.sigmas_large", limit=verdict.interval[0]))
    if block is not None:
        if block.weak and not problem.block.options.holds_unknowns:
            out.append(finding("solution.weak_directions", n=block.weak))
        if block.relative:
            axes = ", ".join(problem.axis_names)
            out.append(
                finding(
                    "solution.relative",
                    moved_m=_moved(problem, estimate),
                    axes=axes,
                    disagreement_m=disagreement_m(problem),
                )
            )
        held = vendor_datum.of_problem(problem)
        out += [held.finding()] if held is not None else []
        out += block.deficiencies(problem)
    out += [*regularisation.findings(problem), *conditioning.findings(problem, estimate)]
    dead = sum(o.rank_defect for o in observability)
    if dead:
        holder = "their priors" if problem.block.options.priors else "the regularisation"
        out.append(finding("solution.unobservable", n=dead, holder=holder))
        named = [o for o in observability if o.rank_defect][:NAMED]
        out += [finding("solution.unobservable_image", image=o.image, summary=o.summary) for o in named]
    if any(name.startswith("psi_") for p in problem.parameters for name in p.names):
        out.append(finding("solution.look_angles"))
    if estimate.widest > WIDE:
        out.append(finding("solution.wide_factor", n=estimate.widest, seconds=GTSAM_S * estimate.widest**3))
    out += _outside(problem, estimate)
    n = len(accuracy.check)
    if not n:
        out.append(finding("solution.no_check"))
    elif n < ASPRS_MINIMUM:
        out.append(finding("solution.few_check", n=n, least=ASPRS_MINIMUM))
    return tuple(out)


def _moved(problem: Problem, estimate: Estimate) -> tuple[float, float, float]:
    """Return the mean movement of the unknown points from their start East, North, Up (or local axes), to 0.1 m."""
    j = problem.active
    mean = (estimate.state.ground[j] - problem.start.ground[j]).mean(axis=0)
    # adding zero avoids a negative zero
    east, north, up = np.round(problem.axes(problem.origin_m[None])[0] @ mean, 1) + 0.0
    return float(east), float(north), float(up)


def disagreement_m(problem: Problem) -> float:
    """Return RMS distance on the ground, m, by which the rays of the unknown points miss each other at the metadata.

    With the distance d of two rays each residual is d/2; hence ``d^2 = 2 sum(v^2) / (rays - 1)``.
    """
    rows, o = linearised(problem, problem.start), problem.observations
    per_metre = np.linalg.norm(rows.ground, ord=2, axis=(1, 2))  # sigmas
    squares = np.sum(rows.residual**2, axis=1) / per_metre**2
    rays = np.bincount(o.point, minlength=len(problem.active))
    total = np.bincount(o.point, squares, len(problem.active))
    seen = problem.active & ~problem.observed & (rays > 1)
    return float(np.sqrt(np.mean(2.0 * total[seen] / (rays[seen] - 1)))) if seen.any() else 0.0


def _outside(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Return the findings on adjusted points outside the validity of an image model, one per image."""
    out = []
    for image, model, rows in zip(problem.block.images, problem.models, rows_by_image(problem), strict=True):
        points = np.flatnonzero(np.bincount(problem.observations.point[rows]))
        valid = model.is_valid(estimate.state.ground[points] + problem.origin_m)
        if not valid.all():
            names = [problem.block.points.ids[int(j)] for j in points[~valid]]
            out.append(finding("solution.outside_validity", image=image.id, n=int((~valid).sum()), points=names))
    return out
