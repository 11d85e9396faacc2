"""Tests of parts and workers share this small block."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block


@lru_cache
def block() -> Block:
    """Return six images, 60 ground points."""
    found, _ = grid_block(BlockOptions(rows=2, columns=3, points=60, seed=5))
    return replace(found, options=replace(found.options, eop_set=15, backend="schur"))
