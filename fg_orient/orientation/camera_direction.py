"""Test whether the other direction of the distortion polynomial fits better with the same terms.

Brown's polynomial converts measured to ideal coordinates or ideal to measured coordinates. The same terms do
not describe the same lenses in both directions: the inverse of a polynomial has infinitely many terms. If
sigma0 is larger than chance allows, the block is adjusted once more with the other direction. Neither model
contains the other, so Vuong's test (1989) compares them. It tests whether the mean difference of the squared
residuals of the image points is far from 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from factors._preparation import working_clock
from factors.arrays import Array
from factors.conditions.constraints import ELEMENT, OBSERVED_ELEMENT
from factors.conditions.navigation import ANTENNA_POSITION, INERTIAL_ATTITUDE
from fg_orient.adjustment.cofactors import full_statistics
from fg_orient.adjustment.constraint_rows import ConstraintObservation
from fg_orient.model.block import Block, ExtraObservation, Image
from fg_orient.model.distributions import chi_square_limit, normal_quantile
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.model.names import Status
from fg_orient.orientation.solution import Solution
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL, FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import FURTHER, NAMES

#: Level of the tests.
LEVEL: Final = 0.001
#: Terms of the polynomial, and for each term the power of the length unit of the coordinates.
POWERS: Final = {"k1": 2, "k2": 4, "k3": 6, "p1": 1, "p2": 1}
_WORDS: Final = {MEASURED_TO_IDEAL: "measured to ideal", IDEAL_TO_MEASURED: "ideal to measured"}


def with_direction(solution: Solution, block: Block, run: Callable[[Block], Solution]) -> Solution:
    """Add a note to a solution if the other direction of the polynomials fits significantly better.

    Parameters
    ----------
    solution : Solution
    block : Block
        Block before the adjustment, with the observations and sigmas of the solution.
    run : callable
        Function that adjusts a block once.
    """
    begin = working_clock()
    own = replace(block, observations=solution.block.observations, points=solution.block.points)
    found = _better_direction(solution, own, run)
    if not found:
        return solution
    seconds = replace(solution.seconds, statistics=solution.seconds.statistics + working_clock() - begin)
    return replace(solution, findings=(*solution.findings, *found), seconds=seconds)


def _better_direction(solution: Solution, block: Block, run: Callable[[Block], Solution]) -> tuple[Finding, ...]:
    """Return a note on a better direction; None if sigma0 gives no reason for a comparison."""
    problem = solution.problem
    judged = solution.weights is None and solution.components is None and solution.status is not Status.NOT_CONVERGED
    if not judged or not full_statistics(block.options, len(problem.observations), problem.n_image_unknowns):
        return ()
    whole = solution.global_test(level=LEVEL)
    other = None if whole is None or whole.accepted or solution.sigma0 < 1.0 else turned_block(block)
    if other is None:
        return ()
    try:
        turned = run(other)
    except (InputError, NoSolutionError):
        return ()
    if turned.status is Status.NOT_CONVERGED or not is_better(solution, turned):
        return ()
    models = {i.sensor.camera.model for i in block.images if isinstance(i.sensor, FrameSensor) and _is_turned(i)}
    here = " and ".join(_WORDS[m] for m in sorted(models))
    there = " and ".join(_WORDS[m] for m in (IDEAL_TO_MEASURED, MEASURED_TO_IDEAL) if {m} != models)
    return (finding(
        "camera.direction (note): the same distortion terms fit significantly better from {there} coordinates: sigma0 "
        "is {other:.4g}, from {here} {own:.4g}\n"
        "    -> choose the other direction of the polynomial (docs/frame-cameras.md), or more terms",
        here=here, there=there, own=solution.sigma0, other=turned.sigma0,
    ),)  # fmt: skip


def is_better(one: Solution, other: Solution) -> bool:
    """Return whether the other of two solutions fits significantly better; both have equally many unknowns.

    The likelihood must increase by more than one useless additional unknown would cause, and by more than
    chance explains (Vuong 1989). Residuals refer to measured coordinates. Residuals in corrected coordinates
    would not be comparable, because the correction changes their scale.
    """
    squares, others = _squares(one), _squares(other)
    scale = float(others.sum()) / max(other.redundancy, 1)
    if one.redundancy != other.redundancy or not np.isfinite(scale) or scale == 0.0:
        return False
    gain = 0.5 * (squares - others) / scale
    least = max(-float(normal_quantile(LEVEL)) * np.sqrt(len(gain)) * gain.std(), 0.5 * chi_square_limit(1, LEVEL))
    return bool(gain.sum() > least)


def _squares(solution: Solution) -> Array:
    """Return the squared residuals (n,) of the image points in measured coordinates; nan behind a camera."""
    o, out = solution.problem.observations, np.zeros(len(solution.problem.observations))
    for k, image in enumerate(solution.block.images):
        rows = np.flatnonzero(o.image == k)
        line, sample = image.sensor.project(solution.ground_m[o.point[rows]], solution.correction(image.id))
        out[rows] = ((line - o.line[rows]) / o.sigma_line_px[rows]) ** 2
        out[rows] += ((sample - o.sample[rows]) / o.sigma_sample_px[rows]) ** 2
    return out


def turned_block(block: Block) -> Block | None:
    """Return the block with the other direction of Brown's polynomial.

    None without unknown terms, or with other terms.
    """
    turned = {image.id for image in block.images if _is_turned(image)}
    if not turned:
        return None
    for extra in block.extra:
        names = {name.removeprefix("image:") for name in extra.unknowns if name.startswith("image:")}
        if names & turned and not _is_of_pose(extra):
            return None
    images = [
        replace(i, sensor=i.sensor.with_camera(turned_camera(i.sensor.camera), i.sensor.file))
        if i.id in turned and isinstance(i.sensor, FrameSensor) else i
        for i in block.images
    ]  # fmt: skip
    return replace(block, images=tuple(images))


def _is_of_pose(extra: ExtraObservation) -> bool:
    """Return whether an observation of an image does not depend on the terms of its polynomial."""
    if extra.equation is OBSERVED_ELEMENT:
        return NAMES[int(extra.record[ELEMENT.number])] not in POWERS
    return isinstance(extra, ConstraintObservation) or extra.equation in (ANTENNA_POSITION, INERTIAL_ATTITUDE)


def _is_turned(image: Image) -> bool:
    """Return whether an image has unknown terms of Brown's polynomial, and no others."""
    sensor = image.sensor
    if not isinstance(sensor, FrameSensor):
        return False
    camera = sensor.camera
    terms = any(camera.further.values()) or not camera.sigma.keys().isdisjoint(FURTHER) or camera.aspect != 0.0
    other = terms or camera.is_fisheye or camera.is_condition
    return not other and not POWERS.keys().isdisjoint(camera.sigma)


def turned_camera(camera: FrameCamera) -> FrameCamera:
    """Return the camera with the other direction of the polynomial: the same correction to the first order."""
    unit = float(camera.unit_px or camera.focal_px)
    scale = camera.focal_px / unit if camera.corrects_measured else unit / camera.focal_px
    factor = {name: scale**power for name, power in POWERS.items()}
    return replace(
        camera, model=IDEAL_TO_MEASURED if camera.corrects_measured else MEASURED_TO_IDEAL,
        distortion=-camera.distortion * np.array(list(factor.values())),
        sigma={name: sigma * factor.get(name, 1.0) for name, sigma in camera.sigma.items()},
    )  # fmt: skip
