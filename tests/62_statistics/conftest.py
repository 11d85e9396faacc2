"""Fixtures are small blocks with tie, control and check points."""

from __future__ import annotations

import pytest

from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import options


@pytest.fixture(scope="session")
def twin() -> Block:
    """Return the H-10 twin of seed 1."""
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


@pytest.fixture(scope="session")
def grid() -> Block:
    """Return four images, 60 points of 2 to 4 rays, 10 of them control points."""
    chosen = BlockOptions(rows=2, columns=2, points=60, control_share=0.16, check_share=0.0)
    return options(grid_block(chosen)[0], eop_set=10)
