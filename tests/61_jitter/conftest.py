"""Fixtures are a pair with jitter in pitch of its first image, its solution without jitter, and the linear model."""

from __future__ import annotations

import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.orientation.solution import Solution
from fg_orient.quality.jitter_system import JitterSystem, jitter_system
from fg_orient.simulate.options import ZonguldakOptions
from fg_orient.simulate.simulation import Truth
from fg_orient.simulate.zonguldak import zonguldak_block

#: Amplitude of four times the noise; with 37 control points.
OPTIONS = ZonguldakOptions(
    jitter_px=1.2, jitter_cycles=3.0, jitter_axis="pitch", jitter_images=("left",), errors="prior", seed=3
)


@pytest.fixture(scope="package")
def made() -> tuple[Block, Truth]:
    return zonguldak_block(OPTIONS)


@pytest.fixture(scope="package")
def plain(made: tuple[Block, Truth]) -> Solution:
    return fg.adjust(made[0])


@pytest.fixture(scope="package")
def system(plain: Solution) -> JitterSystem:
    return jitter_system(plain.problem, plain.state)
