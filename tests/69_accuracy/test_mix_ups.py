"""Columns of image points with another meaning are named by the meaning that fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block, Coordinates, GroundPoints
from fg_orient.model.names import Role, Status
from fg_orient.quality.mix_ups import mix_ups, undone
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.pinhole import pinhole_block


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


@pytest.mark.oracle
def test_exchanged_coordinates_of_a_local_system_are_named_and_put_right() -> None:
    block, truth = pinhole_block(4, 25, views=3, seed=2)
    control = np.arange(0, 25, 2)
    xyz, sigma = block.points.known.ecef_m.copy(), np.full((25, 3), np.nan)
    xyz[control], sigma[control] = truth.ground_m[control][:, [1, 0, 2]], 0.01
    roles = tuple(Role.CONTROL if j in control else Role.TIE for j in range(25))
    points = GroundPoints(block.points.ids, roles, Coordinates(xyz, sigma, np.zeros(25, bool)))
    wrong = replace(block, points=points, options=replace(block.options, datum="control"))
    found = mix_ups(wrong)
    assert {one.reading for one in found} == {"X and Y exchanged"}
    assert "X and Y exchanged" in str(found[0].finding(wrong))
    right = undone(wrong, found).points.known.ecef_m[control]
    assert right == pytest.approx(truth.ground_m[control], abs=1e-12)


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
