"""The reduction of camera parameters keeps significant terms and removes others, but never a pose."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.distributions import sidak
from fg_orient.orientation.reduction import LEVEL, reduce_unknowns
from tests.support.calibration import POSE, calibration_block

TERMS = ("k1", "k2", "k3", "p1", "p2")


@pytest.mark.truth
@pytest.mark.parametrize("priors", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("direction", ["backward", "forward"])
def test_true_terms_stay_and_the_others_go(direction: str, priors: bool) -> None:
    block = calibration_block((-0.05, 0, 0, 0, 0), unknown=TERMS, seed=4, priors=priors)
    found = reduce_unknowns(block, direction=direction)  # type: ignore[arg-type]
    assert found.kept == tuple(POSE)
    assert set(found.unknowns) == {*POSE, "k1"}
    assert found.solution.block.options.image_unknowns == found.unknowns
    first = found.steps[0].unknowns
    assert set(first) == ({*POSE, *TERMS} if direction == "backward" else {*POSE})
    assert all(POSE.keys().isdisjoint(test.group for test in step.tests) for step in found.steps)
    for one, other in pairwise(found.steps):
        assert set(one.unknowns) ^ set(other.unknowns) == {other.changed}
    test = found.steps[-1].tests[0]
    assert test.probability < sidak(LEVEL, len(found.steps[-1].tests))


@pytest.mark.truth
def test_no_term_is_left_of_a_camera_without_distortion() -> None:
    """At most 3 of 12 calibrations without distortion keep a term; the pose is always kept.

    Five terms at 5 % together keep more with a probability of 0.2 %.
    """
    kept = 0
    for seed in range(12):
        found = reduce_unknowns(calibration_block((0, 0, 0, 0, 0), unknown=TERMS, seed=seed, n=40))
        kept += set(found.unknowns) != set(POSE)
        assert set(POSE) <= set(found.unknowns)
    assert kept <= 3


@pytest.mark.consistency
def test_the_last_model_is_an_adjustment_of_its_unknowns() -> None:
    block = calibration_block((-0.05, 0, 0, 2e-3, 0), unknown=TERMS, seed=4)
    found = reduce_unknowns(block)
    own = fg.adjust(replace(block, options=replace(block.options, image_unknowns=found.unknowns)))
    assert own.chi2 == pytest.approx(found.solution.chi2, rel=1e-12)
    assert np.array_equal(own.state.ground, found.solution.state.ground)


@pytest.mark.behaviour
def test_poses_with_priors_are_reduced_if_no_camera_parameter_is_unknown() -> None:
    found = reduce_unknowns(calibration_block((0, 0, 0, 0, 0), unknown=(), n=40))
    assert found.kept == ()
    assert {test.group for test in found.steps[0].tests} == {*POSE}
    free = reduce_unknowns(calibration_block((0, 0, 0, 0, 0), unknown=(), n=40, priors=False))
    assert free.kept == free.unknowns == tuple(POSE)
    assert len(free.steps) == 1
