"""Likely causes of a doubt: mistakes planted in simulated blocks are named, clean blocks have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.quality.causes import _System
from fg_orient.report.html import render
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

Array = npt.NDArray[np.float64]
Reading = Callable[[Array, Array, Array], tuple[Array, Array, Array]]


@pytest.fixture(scope="module", params=["twin", "grid"])
def block(request: pytest.FixtureRequest) -> Block:
    if request.param == "twin":
        return zonguldak_block(ZonguldakOptions())[0]
    return grid_block(BlockOptions(points=60, control_share=0.2, check_share=0.2, seed=1))[0]


def with_control(block: Block, change: Callable[[Array], Array]) -> Block:
    """Block with other coordinates (n, 3), ECEF, of its control points."""
    ecef, rows = block.points.known.ecef_m.copy(), block.points.where(Role.CONTROL)
    ecef[rows] = change(ecef[rows])
    return replace(block, points=replace(block.points, known=replace(block.points.known, ecef_m=ecef)))


def written(reading: Reading) -> Callable[[Array], Array]:
    return lambda ecef: geodetic_to_ecef(*reading(*ecef_to_geodetic(ecef)))


def cause(solution: fg.Solution) -> str:
    """Text of the likely cause, "" if none is named."""
    return next((str(f) for f in solution.findings if f.code == "verdict.cause"), "")


def exchanged(ecef: Array) -> Array:
    out = ecef.copy()
    out[[1, 4]] = ecef[[4, 1]]
    return out


@pytest.mark.truth
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (written(lambda x, y, h: (x, y, h - 36.0)), "heights of the control points look orthometric"),
        (written(lambda x, y, h: (x + 1e-3, y + 1e-3, h)), "a constant shift of the control points"),
        (written(lambda x, y, h: (x, y, h / 1000.0)), "heights of the control points in kilometres"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_control_points_is_named(block: Block, change: Callable[[Array], Array], named: str) -> None:
    assert f"likely cause: {named}" in cause(fg.adjust(with_control(block, change)))


@pytest.mark.truth
def test_exchanged_ids_are_named(block: Block) -> None:
    rows = block.points.where(Role.CONTROL)
    a, b = (block.points.ids[rows[k]] for k in (1, 4))
    assert f"ids of the control points {a} and {b} exchanged" in cause(fg.adjust(with_control(block, exchanged)))


@pytest.mark.truth
def test_units_that_cannot_be_told_apart_are_named_together(block: Block) -> None:
    text = cause(fg.adjust(with_control(block, written(lambda x, y, h: (x, y, h / 0.3048)))))
    first, _, also = text.partition("cannot be told apart from: ")
    assert "feet" in first
    assert "feet" in also


@pytest.mark.truth
def test_wrong_sigmas_are_named(block: Block) -> None:
    o = block.observations
    small = replace(o, sigma_line_px=o.sigma_line_px / 3.0, sigma_sample_px=o.sigma_sample_px / 3.0)
    assert "likely cause: sigmas of image points too small" in cause(fg.adjust(replace(block, observations=small)))


@pytest.mark.truth
@pytest.mark.parametrize(
    ("reading", "named"),
    [
        (lambda x, y, h: (y, x, h), "longitude and latitude exchanged"),
        (lambda x, y, h: (x / 0.9, y / 0.9, h), "longitude and latitude in gon"),
    ],
)  # fmt: skip
def test_misread_angles_are_named(block: Block, reading: Reading, named: str) -> None:
    solution = fg.adjust(with_control(block, written(reading)))
    mixed = [str(f) for f in solution.findings if f.code == "solution.mix_up"]
    assert len(mixed) == len(block.images)
    assert all(named in text for text in mixed)
    assert not cause(solution)


@pytest.mark.behaviour
def test_exchanged_metadata_are_named_first_in_the_report() -> None:
    block = zonguldak_block(ZonguldakOptions())[0]
    left, right = block.images
    turned = (replace(left, sensor=right.sensor), replace(right, sensor=left.sensor))
    page = render(fg.adjust(replace(block, images=turned)).result)
    assert f"with the metadata of image {right.id}" in page[page.index("Not trustworthy") : page.index("<nav")]


@pytest.mark.behaviour
def test_the_cause_is_on_the_first_screen(block: Block) -> None:
    wrong = with_control(block, written(lambda x, y, h: (x, y, h - 36.0)))
    page = render(fg.adjust(wrong).result)
    assert "look orthometric" in page[: page.index("<nav")]


@pytest.mark.behaviour
def test_an_error_of_one_point_is_no_cause() -> None:
    block = zonguldak_block(ZonguldakOptions())[0]

    def moved(ecef: Array) -> Array:
        out = ecef.copy()
        out[3, 0] += 9.0
        return out

    solution = fg.adjust(with_control(block, moved))
    assert solution.verdict.code == "verdict.gross_error"
    assert not cause(solution)


@pytest.mark.truth
def test_clean_blocks_have_no_cause(block: Block) -> None:
    assert not cause(fg.adjust(block))


@pytest.mark.oracle
def test_score_is_the_decrease_of_the_full_least_squares_problem() -> None:
    """T of a height offset equals the decrease of v^T v with the offset as a further column of the whole Jacobian."""
    solution = fg.adjust(zonguldak_block(ZonguldakOptions())[0], backend="dense")
    problem, cofactors = solution.problem, solution.cofactors
    assert cofactors is not None
    system = _System.of(problem, solution.state, cofactors, solution.accuracy.control)
    assert system is not None
    alone = replace(system, whitening=system.whitening[: system.n_control], k=np.zeros(0),
                    gain=np.zeros((0, len(system.v))), inverse=np.zeros((0, 0)))  # fmt: skip
    rows = np.flatnonzero(problem.observed)
    up = np.swapaxes(problem.axes(problem.control_records[rows, POINT.place] + problem.origin_m), 1, 2)[:, :, 2:]
    g, normal = alone.normal(up)
    v, design = assemble(problem, solution.state)
    error = np.zeros((len(v), 1))
    begin = 2 * len(problem.observations)
    error[begin : begin + 3 * len(rows)] = (problem.control_weights(rows) @ up).reshape(-1, 1)
    design = design / np.linalg.norm(design, axis=0)

    def least(columns: Array) -> float:
        return float(np.sum((v - columns @ np.linalg.lstsq(columns, v)[0]) ** 2))

    decrease = least(design) - least(np.hstack([design, error]))
    assert g[0] ** 2 / normal[0, 0] == pytest.approx(decrease, rel=1e-5)
    assert decrease > 1e-3
