"""The verdict on a solution: status, reason, and what a reader must know first.

``sigma0`` above the upper end of its two-sided 99.9 % interval makes a solution not
trustworthy: model and weights contradict the observations. Below the lower end the sigmas
are too large, which is said but spoils nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.robust import UNWEIGHED, Weights, are_information
from fg_orient.adjustment.solve import Estimate
from fg_orient.distributions import chi_square_interval
from fg_orient.names import Role, Status
from fg_orient.quality import conditioning
from fg_orient.quality.accuracy import ASPRS_MINIMUM, Accuracy, PointDifferences
from fg_orient.quality.observability import BlockObservability, ImageObservability

#: Probability of the two-sided interval of sigma0.
SIGMA0_LEVEL = 0.999
#: Image points with a smaller weight count as turned down; more than this share of them, and nothing is to be trusted.
DOWN = 0.5
MOST_DOWN = 0.5
#: Points named in one sentence.
NAMED = 10
NO_INTERVAL = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Verdict:
    """Status, the reason in words, and the 99.9 % interval of sigma0 (nan where there is none)."""

    status: Status
    reason: str
    interval: tuple[float, float]


def judge(problem: Problem, estimate: Estimate, withheld: tuple[str, ...]) -> Verdict:
    """Status from convergence, covariance and the global test of sigma0."""
    f = problem.redundancy
    if not estimate.converged or not np.isfinite(estimate.chi2):
        return Verdict(Status.NOT_CONVERGED, estimate.reason, NO_INTERVAL)
    interval = sigma0_interval(f) if f > 0 and estimate.weights is None else NO_INTERVAL
    if problem.least_damping > 0.0:
        reason = "the datum is free: position, orientation and scale of the block are those of its start values"
        return Verdict(Status.NOT_TRUSTWORTHY, f"{reason}, only its shape is determined", interval)
    plain = estimate.weights is None or are_information(problem.block.options.loss, estimate.weights)
    if withheld and plain and not problem.block.options.priors and problem.block.options.datum != "inner":
        reason = "without priors the control points determine some directions too weakly for a covariance"
        return Verdict(Status.NOT_TRUSTWORTHY, f"{reason}: coordinates must not be trusted", interval)
    if f <= 0:
        return Verdict(Status.CONVERGED, "no redundancy: nothing was checked", interval)
    if estimate.weights is not None:
        return _judge_weights(problem, estimate, estimate.weights)
    sigma0 = float(np.sqrt(estimate.chi2 / f))
    if sigma0 > interval[1]:
        reason = (
            f"sigma0 = {sigma0:.2f} lies above {interval[1]:.2f}, the upper end of its 99.9 % interval: the "
            "observations do not fit the model within their sigmas. The unknowns cannot take up the errors present, "
            "or the sigmas are too small, or there are gross errors; standard deviations and coordinates must not "
            "be trusted"
        )
        return Verdict(Status.NOT_TRUSTWORTHY, reason, interval)
    return Verdict(Status.CONVERGED, estimate.reason, interval)


def _judge_weights(problem: Problem, estimate: Estimate, weights: Weights) -> Verdict:
    """Under a loss sigma0 follows no chi-square; a loss that turns most of the observations down fits too few.

    So does one that turns most image points of one image down: what is left, or its priors, orient it. Least absolute
    values turn nothing down: their weights fall from the first residual on.
    """
    if problem.block.options.loss in UNWEIGHED:
        return Verdict(Status.CONVERGED, estimate.reason, NO_INTERVAL)
    down = int(np.count_nonzero(weights.image < DOWN))
    if down > MOST_DOWN * len(weights.image):
        reason = f"{down} of {len(weights.image)} image points have a weight below {DOWN}: the model does not hold"
        return Verdict(Status.NOT_TRUSTWORTHY, f"{reason}, or the sigmas are too small", NO_INTERVAL)
    given_up = turned_down_images(problem, weights)
    if given_up:
        named = "; ".join(f"image {name}: {bad} of {n}" for name, bad, n in given_up[:NAMED])
        reason = (
            f"most image points of {len(given_up)} image(s) have a weight below {DOWN} ({named}): their orientation "
            "rests on the rest and on the priors. Wrong metadata, wrong point numbers, or most control there is wrong"
        )
        return Verdict(Status.NOT_TRUSTWORTHY, reason, NO_INTERVAL)
    return Verdict(Status.CONVERGED, estimate.reason, NO_INTERVAL)


def turned_down_images(problem: Problem, weights: Weights) -> list[tuple[str, int, int]]:
    """Images most of whose image points a loss has turned down: id, how many, of how many."""
    o, m = problem.observations, problem.n_images
    if problem.block.options.loss in UNWEIGHED:
        return []
    n, bad = np.bincount(o.image, minlength=m), np.bincount(o.image[weights.image < DOWN], minlength=m)
    return [(problem.block.images[k].id, int(bad[k]), int(n[k])) for k in np.flatnonzero(bad > MOST_DOWN * n)]


def points_without_ray(problem: Problem, weights: Weights) -> list[str]:
    """Ids of unknown points all of whose rays a loss has turned down: they lie where these rays meet, unchecked."""
    return [problem.block.points.ids[j] for j in _left_with(problem, weights, 0)]


def points_on_one_ray(problem: Problem, weights: Weights) -> list[str]:
    """Ids of unknown points all but one of whose rays a loss has turned down: next to nothing holds them along it."""
    return [problem.block.points.ids[j] for j in _left_with(problem, weights, 1)]


def _left_with(problem: Problem, weights: Weights, rays: int) -> list[int]:
    """Unknown points without control, or whose control is turned down, that a loss has left so many of more rays."""
    o, n = problem.observations, len(problem.active)
    if problem.block.options.loss in UNWEIGHED:
        return []
    good, every = np.bincount(o.point[weights.image >= DOWN], minlength=n), np.bincount(o.point, minlength=n)
    lost = problem.active & (good == rays) & (every > rays)
    lost &= ~problem.observed | (weights.control < DOWN)
    return np.flatnonzero(lost).tolist()


def _lost_sentences(problem: Problem, weights: Weights) -> list[str]:
    """Name the points that a loss has left without a ray, or on one; check points among them, too."""
    out, points = [], problem.block.points
    for rays, told in (
        (0, "the loss has turned down all rays of {n} point(s), whose place nothing checks"),
        (1, "the loss has turned down all but one ray of {n} point(s), which nothing holds along it"),
    ):
        lost = _left_with(problem, weights, rays)
        if lost:
            check = [points.ids[j] for j in lost if points.roles[j] is Role.CHECK]
            also = f"; check points among them: {_named(check)}" if check else ""
            out.append(f"{told.format(n=len(lost))}: {_named([points.ids[j] for j in lost])}{also}")
    return out


def _named(ids: Sequence[str]) -> str:
    return ", ".join(ids[:NAMED]) + (" ..." if len(ids) > NAMED else "")


def weight_sentence(problem: Problem, weights: Weights) -> str:
    """Say what the figures of a robust adjustment are."""
    loss = problem.block.options.loss
    scale = ""
    if problem.block.options.robust_scale == "mad":
        image, control = weights.scale
        scale = f"; its unit is {image:.2f} sigmas of image points and {control:.2f} of control points"
    down, control = (int(np.count_nonzero(w < DOWN)) for w in (weights.image, weights.control))
    if loss in UNWEIGHED:
        return (
            f"robust loss {loss}: {down} of {len(weights.image)} image points and {control} control points lie beyond "
            f"{1.0 / DOWN:g} sigmas; their weights fall from the first residual on, so none is turned down, and sigma0 "
            "is not that of sigmas that hold"
        )
    return (
        f"robust loss {loss}: {down} of {len(weights.image)} image points and {control} control points have a weight "
        f"below {DOWN}{scale}; chi2, sigma0 and standard deviations (prior scale) take the weights at the solution as "
        "given, and sigma0 is not tested"
    )


def sigma0_interval(redundancy: int) -> tuple[float, float]:
    """Two-sided 99.9 % interval of sigma0: ``sqrt(chi2_p(f) / f)``."""
    low, high = chi_square_interval(redundancy, 1.0 - SIGMA0_LEVEL)
    return float(np.sqrt(low / redundancy)), float(np.sqrt(high / redundancy))


def warnings(
    problem: Problem,
    estimate: Estimate,
    verdict: Verdict,
    observability: tuple[ImageObservability, ...],
    block: BlockObservability | None,
    accuracy: Accuracy,
) -> tuple[str, ...]:
    """Problems first, in the order a reader should meet them."""
    f = problem.redundancy
    out = [] if verdict.status is Status.CONVERGED and f > 0 else [verdict.reason]
    if estimate.weights is not None:
        out.append(weight_sentence(problem, estimate.weights))
        out += _lost_sentences(problem, estimate.weights)
    if f > 0 and np.sqrt(estimate.chi2 / f) < verdict.interval[0]:
        out.append(
            f"sigma0 lies below {verdict.interval[0]:.2f}, the lower end of its 99.9 % interval: the sigmas are too "
            "large, so the standard deviations in prior scale are too"
        )
    if block is not None and block.weak and not problem.block.options.priors:
        out.append(
            f"without priors {block.weak} direction(s) of the block are determined 100 times worse than their prior "
            "sigma: results along them are not reliable"
        )
    if block is not None and block.relative:
        east, north, up = _moved(problem, estimate)
        out.append(
            "relative adjustment: no control point tells where the block lies; it moved by "
            f"{east:+.1f}, {north:+.1f}, {up:+.1f} m {', '.join(problem.axis_names)}. No figure of it is an accuracy; "
            "if it moved farther than the vendor's own location error, give that error as prior sigma"
        )
    if block is not None:
        out += block.deficiencies(problem)
    out += conditioning.sentences(problem, estimate)
    dead = sum(o.rank_defect for o in observability)
    if dead:
        out.append(f"{dead} direction(s) of the orientation are not observable and are held by their priors alone")
        out += [o.summary for o in observability if o.rank_defect][:NAMED]
    if any(name.startswith("psi_") for p in problem.parameters for name in p.names):
        out.append(
            "the constant and linear look-angle terms nearly duplicate roll, pitch and yaw: judge their sum, "
            "not each alone"
        )
    out += _outside(problem, estimate)
    out += beyond_sentences(accuracy.check)
    n = len(accuracy.check)
    if not n:
        out.append("no check points: the accuracy is not verified independently")
    elif n < ASPRS_MINIMUM:
        out.append(f"{n} check point{'s' if n > 1 else ''}: ASPRS (2023) asks for at least {ASPRS_MINIMUM}")
    return tuple(out)


def beyond_sentences(check: PointDifferences) -> list[str]:
    """Name check points beyond 3 standard deviations, if they are more than chance gives or one is too far for it."""
    found = check.beyond()
    if found.by_chance:
        return []
    if found.count <= found.limit:
        far = f"check points beyond {found.largest_limit:.1f} standard deviations of the difference"
        return [f"{far}, which chance hardly gives among {found.n} coordinates: {_named(found.far)}"]
    points = list(dict.fromkeys(row[0] for row in check.suspicious()))
    more = f" ... ({len(points)} of {len(check)})" if len(points) > NAMED else ""
    told = "check points beyond 3 standard deviations of the difference"
    return [f"{told}: {', '.join(points[:NAMED])}{more}; {found.sentence}"]


def _moved(problem: Problem, estimate: Estimate) -> tuple[float, float, float]:
    """Mean movement East, North, Up (or along the local axes) of the unknown points from their start, to 0.1 m."""
    j = problem.active
    mean = (estimate.state.ground[j] - problem.start.ground[j]).mean(axis=0)
    east, north, up = np.round(problem.axes(problem.origin_m[None])[0] @ mean, 1) + 0.0  # no minus before a zero
    return float(east), float(north), float(up)


def _outside(problem: Problem, estimate: Estimate) -> list[str]:
    """Name adjusted points at which the model of one of their images may not be used, per image."""
    out = []
    for k, (image, model) in enumerate(zip(problem.block.images, problem.models, strict=True)):
        points = np.unique(problem.observations.point[problem.observations.image == k])
        valid = model.is_valid(estimate.state.ground[points] + problem.origin_m)
        if not valid.all():
            names = [problem.block.points.ids[int(j)] for j in points[~valid]]
            told = f"outside the validity range of the model of image {image.id}: {len(names)} point(s)"
            out.append(f"{told}: {_named(names)}")
    return out
