"""The fixture is the H-10 twin of seed 1, made once per session."""

from __future__ import annotations

import pytest

from fg_orient.model.block import Block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block


@pytest.fixture(scope="session")
def twin() -> Block:
    """Return the default twin as a block (constant errors, 0.3 px)."""
    return zonguldak_block(ZonguldakOptions(seed=1))[0]
