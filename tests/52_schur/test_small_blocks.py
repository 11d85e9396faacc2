"""For few points and images ``auto`` chooses the Schur backend, with the results of numpy and the graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.loop import STEP_TOLERANCE
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import Full, step_of_numpy

pytestmark = pytest.mark.oracle


@pytest.fixture(scope="module")
def twin() -> Block:
    """Return two images, 37 control points and 10 check points."""
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


def thinned(block: Block, n_control: int, images: tuple[int, ...], rng: np.random.Generator) -> Block:
    """Return the block with so many control points and the rays of these images only.

    With two images check points stay, too.
    """
    points = block.points
    control = rng.permutation(points.where(Role.CONTROL))[:n_control]
    kept = control if len(images) == 1 else np.concatenate([control, points.where(Role.CHECK)])
    rows = np.isin(block.observations.point, kept) & np.isin(block.observations.image, images)
    return replace(block, observations=block.observations.take(np.flatnonzero(rows)))


@pytest.mark.parametrize("images", [(0, 1), (0,)])
@pytest.mark.parametrize("n_control", [1, 3, 12])
@pytest.mark.parametrize("eop_set", [1, 10, 20])
def test_auto_says_what_the_schur_backend_says(
    twin: Block, eop_set: int, n_control: int, images: tuple[int, ...], rng: np.random.Generator
) -> None:
    block = thinned(twin, n_control, images, rng)
    auto, schur = (fg.adjust(block, eop_set=eop_set, backend=backend) for backend in ("auto", "schur"))
    assert (auto.backend, schur.backend) == ("graph", "schur")
    assert step_of_numpy(auto.problem, auto.state)[0] <= STEP_TOLERANCE
    assert (auto.status, auto.warnings, auto.redundancy) == (schur.status, schur.warnings, schur.redundancy)
    assert np.abs(auto.state.image - schur.state.image).max() <= STEP_TOLERANCE  # where each of the loops may end
    full = Full.of(auto.problem, auto.state)
    for image in images:
        own = full.problem.image_slice(image)
        sigma = auto.problem.parameters[image].sigma
        expected = auto.scale**2 * full.unknowns[own, own] * np.outer(sigma, sigma)
        for found in (s.covariance(f"image:{block.images[image].id}").values for s in (auto, schur)):
            assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()
