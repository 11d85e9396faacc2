"""Many errors in one round of the search give the result of one error per round."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.problem import compile_problem
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.orientation import outlier_search
from fg_orient.quality.prediction import Excluded, consistency_in_turn, misclosures
from fg_orient.quality.rejection import Search
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block


def moved(block: Block, pixels: dict[int, tuple[float, float]], enu_m: dict[int, tuple[float, float, float]]) -> Block:
    """Add pixels to image points, and metres to the coordinates of control points."""
    o, known = block.observations, block.points.known
    line, sample, ecef = o.line.copy(), o.sample.copy(), known.ecef_m.copy()
    for row, (dl, ds) in pixels.items():
        line[row], sample[row] = line[row] + dl, sample[row] + ds
    for j, error in enu_m.items():
        lon, lat, _ = ecef_to_geodetic(ecef[j][None])
        ecef[j] += enu_from_ecef(lon, lat)[0].T @ np.array(error)
    return replace(
        block, observations=replace(o, line=line, sample=sample),
        points=replace(block.points, known=replace(known, ecef_m=ecef)),
    )  # fmt: skip


def searched(block: Block, most: int, monkeypatch: pytest.MonkeyPatch) -> Search:
    """Search with at most so many observations in a round."""
    monkeypatch.setattr(outlier_search, "ROUND", most)
    found = fg.adjust(block, snoop=True).snooping
    assert found is not None and found.complete
    return found


@pytest.mark.consistency
@pytest.mark.parametrize("largest_px", [30.0, 600.0])
def test_all_in_one_round_are_those_of_one_by_one(largest_px: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search with many errors per round rejects the observations of one error per round, in at most four rounds.

    Errors are in image points, two in one point, height and position of control points; rows have any order.
    """
    whole, _ = grid_block(BlockOptions(rows=1, columns=4, points=300, control_share=0.1, seed=2))
    rng = np.random.default_rng(3)
    block = replace(whole, observations=whole.observations.take(rng.permutation(len(whole.observations))))
    o, control = block.observations, block.points.where(Role.CONTROL)
    rays = np.bincount(o.point)
    both = np.flatnonzero(o.point == int(np.flatnonzero(rays == rays.max())[0]))[:2]
    rows = rng.choice(np.flatnonzero(~np.isin(o.point, [*control, o.point[both[0]]])), 12, replace=False)
    size, angle = rng.uniform(3.0, largest_px, 14), rng.uniform(0.0, 2.0 * np.pi, 14)
    pixels = {int(r): (s * np.cos(a), s * np.sin(a)) for r, s, a in zip([*rows, *both], size, angle, strict=True)}
    wrong = moved(block, pixels, {int(control[3]): (0.0, 0.0, 40.0), int(control[7]): (25.0, -9.0, 0.0)})
    single, together = searched(wrong, 1, monkeypatch), searched(wrong, 1000, monkeypatch)
    assert together.kept == single.kept
    # of two rays that are left of a point either is named first
    ends = [{frozenset((f.test.name, *f.with_it)): f for f in found.left_out} for found in (single, together)]
    assert ends[0].keys() == ends[1].keys()
    assert {"image", "position", "height"} == {f.test.part for f in together.left_out}
    assert len(single.left_out) >= 14 and len(single.rounds) >= 14
    assert len(together.found) == len(single.found)  # no observation is rejected that must be restored
    assert len(together.rounds) <= 4
    point = block.points.ids[o.point[both[0]]]
    compared = [(one.fit, ends[1][name].fit) for name, one in ends[0].items() if one.test.point != point]
    assert sum(fit is not None for fit, _ in compared) >= 10  # if all rivals are rejected, no observation can test them
    for fit, other in compared:
        assert (fit and fit.dimension) == (other and other.dimension)
        assert fit is None or other is None or other.statistic == pytest.approx(fit.statistic, rel=1e-6)


@pytest.mark.oracle
def test_what_is_put_back_together_is_tested_as_after_each_adjustment() -> None:
    """Tests of several restored observations equal those after an adjustment for each in turn."""
    block = replace(zonguldak_block(ZonguldakOptions(seed=4))[0])
    control, o = block.points.where(Role.CONTROL), block.observations
    out = [Excluded(int(j), (int(np.flatnonzero(o.point == j)[0]),), False, "image") for j in control[:2]]
    out = [replace(one, row=one.rows[0]) for one in out]
    out += [Excluded(int(j), (), True, "height") for j in control[2:4]]

    def without(some: list[Excluded]) -> Block:
        gone = [row for one in some for row in one.rows]
        ties = np.isin(np.arange(len(block.points.ids)), [one.point for one in some if one.control])
        points = block.points.without_coordinates(ties, Role.TIE) if ties.any() else block.points
        return replace(block, points=points, observations=o.take(~np.isin(np.arange(len(o)), gone)))

    full, ends = compile_problem(block), [fg.adjust(without(out[k:])) for k in range(len(out))]
    first = ends[0]
    assert first.cofactors is not None
    groups = [one for one in misclosures(full, first.problem, first.state, out) if one is not None]
    turns = consistency_in_turn(groups, [0.0] * len(out), first.problem, first.cofactors, first.chi2, "t")
    alone = [one.consistency(first.cofactors, first.chi2, first.redundancy, "t") for one in groups]
    for k, (end, turn) in enumerate(zip(ends, turns, strict=True)):
        again = misclosures(full, end.problem, end.state, out[k : k + 1])[0]
        assert again is not None and end.cofactors is not None
        with_others = again.consistency(end.cofactors, end.chi2, end.redundancy, "t")
        assert turn.dimension == with_others.dimension
        assert turn.statistic == pytest.approx(with_others.statistic, rel=2e-3)
    # the observations before it have an influence
    assert alone[-1].statistic != pytest.approx(turns[-1].statistic, rel=2e-2)
