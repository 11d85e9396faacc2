"""Columns of image points that stand for something else are named by what fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.model.names import Status
from fg_orient.quality.mix_ups import mix_ups
from fg_orient.simulate.block import BlockOptions, grid_block


@pytest.fixture(scope="module")
def block() -> Block:
    made, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, control_share=0.5))
    return made


def misread(block: Block, kind: str) -> Block:
    o, sensor = block.observations, block.images[0].sensor
    first = o.image == 0
    line, sample = o.line.copy(), o.sample.copy()
    if kind == "exchanged":
        line[first], sample[first] = o.sample[first], o.line[first]
    elif kind == "lines counted":
        line[first] = sensor.last_line - o.line[first]
    elif kind == "half a turn":
        line[first], sample[first] = sensor.last_line - o.line[first], sensor.last_sample - o.sample[first]
    elif kind == "a quarter":
        line[first], sample[first] = o.sample[first], sensor.last_line - o.line[first]
    else:
        sample[first] = sensor.last_sample - o.sample[first]
    return replace(block, observations=replace(o, line=line, sample=sample))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["exchanged", "lines counted", "samples counted", "half a turn", "a quarter"])
def test_what_fits_is_named(block: Block, kind: str) -> None:
    wrong = misread(block, kind)
    (sentence,) = (str(one.finding(wrong)) for one in mix_ups(wrong))
    assert kind in sentence
    assert f"image {block.images[0].id}:" in sentence


@pytest.mark.behaviour
def test_columns_as_they_should_be_are_not_doubted(block: Block) -> None:
    assert mix_ups(block) == ()
    rng = np.random.default_rng(5)
    o = block.observations
    noisy = replace(o, line=o.line + rng.normal(0.0, 500.0, len(o)), sample=o.sample + rng.normal(0.0, 500.0, len(o)))
    assert mix_ups(replace(block, observations=noisy)) == ()


@pytest.mark.behaviour
def test_the_adjustment_says_it_after_its_verdict(block: Block) -> None:
    solution = fg.adjust(misread(block, "exchanged"))
    assert solution.status is Status.NOT_TRUSTWORTHY
    assert "line and sample exchanged" in solution.warnings[1]
