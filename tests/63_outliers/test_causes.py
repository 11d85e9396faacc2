"""Mistakes planted in simulated blocks are named as likely causes; blocks without mistakes have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import numpy.typing as npt
import pyproj
import pytest

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.geodesy.geoid import world_undulation_m
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.confirmation import confirmed
from fg_orient.quality import mended
from fg_orient.quality.cause import Supposed
from fg_orient.quality.ground_causes import GroundErrors, _best_part
from fg_orient.quality.image_causes import ImageErrors
from fg_orient.report.html import render
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import turned_rows

Array = npt.NDArray[np.float64]
Reading = Callable[[Array, Array, Array], tuple[Array, Array, Array]]


@pytest.fixture(scope="module", params=["twin", "grid"])
def block(request: pytest.FixtureRequest) -> Block:
    if request.param == "twin":
        return zonguldak_block(ZonguldakOptions())[0]
    return grid_block(BlockOptions(points=60, control_share=0.2, check_share=0.2, seed=1))[0]


def with_control(block: Block, change: Callable[[Array], Array]) -> Block:
    """Return the block with other coordinates (n, 3), ECEF, of its control points."""
    ecef, rows = block.points.known.ecef_m.copy(), block.points.where(Role.CONTROL)
    ecef[rows] = change(ecef[rows])
    return replace(block, points=replace(block.points, known=replace(block.points.known, ecef_m=ecef)))


def written(reading: Reading) -> Callable[[Array], Array]:
    return lambda ecef: geodetic_to_ecef(*reading(*ecef_to_geodetic(ecef)))


def cause(solution: fg.Solution) -> str:
    """Return the text of the likely cause, "" if none is named."""
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


def named_mistake(solution: fg.Solution) -> str:
    """Return the text of the finding that names a mistake found at the start, "" if there is none."""
    return next((str(f) for f in solution.findings if f.code.startswith("solution.id_")), "")


def shown_again(block: Block, a: int, b: int) -> Block:
    """Return the block in which the image points of point a are those of point b, measured again."""
    o, noise = block.observations, np.random.default_rng(1)
    line, sample, keep = o.line.copy(), o.sample.copy(), o.point != a
    for k in range(len(block.images)):
        mine, other = (np.flatnonzero((o.image == k) & (o.point == j)) for j in (a, b))
        if len(mine) and len(other):
            line[mine], sample[mine] = (x[other] + 0.3 * noise.standard_normal() for x in (o.line, o.sample))
            keep[mine] = True
    return replace(block, observations=replace(o, line=line, sample=sample).take(keep))


@pytest.mark.truth
def test_mistaken_ids_are_named(block: Block) -> None:
    rows = block.points.where(Role.CONTROL)
    a, b = (block.points.ids[rows[k]] for k in (1, 4))
    text = named_mistake(fg.adjust(with_control(block, exchanged)))
    assert f"ids of the control points {a} and {b} exchanged" in text
    assert "no doubt remains" in text
    text = named_mistake(fg.adjust(shown_again(block, rows[4], rows[1])))
    assert f"one control point under two ids: the image points of {b} show the place of {a}" in text
    assert "no doubt remains" in text
    text = named_mistake(fg.adjust(mended.with_coordinates_of(block, {a: b})))
    assert f"point {a}: it has the coordinates of control point {b}" in text
    assert "no doubt remains" in text


@pytest.mark.truth
def test_ids_of_points_near_each_other_are_named() -> None:
    """Exchanged ids of control points twelve metres apart are named as likely cause.

    Only the solution shows the exchange, which is about a pixel.
    """
    block = zonguldak_block(ZonguldakOptions())[0]
    a, b = block.points.where(Role.CONTROL)[[1, 4]]
    truth = block.points.known.ecef_m[a] + [8.0, -8.0, 4.0]
    sensors, o = [image.sensor for image in block.images], block.observations
    line, sample, noise = o.line.copy(), o.sample.copy(), np.random.default_rng(2)
    for k, sensor in enumerate(sensors):  # point b becomes a neighbour of point a
        mine, other = (np.flatnonzero((o.image == k) & (o.point == j)) for j in (b, a))
        away = np.ravel(sensor.project(truth[None])) - np.ravel(sensor.project(block.points.known.ecef_m[[a]]))
        line[mine], sample[mine] = np.stack([o.line[other], o.sample[other]]) + away[:, None] + 0.1 * noise.normal(
            size=(2, 1))  # fmt: skip
    ecef = block.points.known.ecef_m.copy()
    ecef[b] = truth
    ecef[[a, b]] = ecef[[b, a]]
    known = replace(block.points.known, ecef_m=ecef)
    near = replace(block, points=replace(block.points, known=known),
                   observations=replace(o, line=line, sample=sample))  # fmt: skip
    ids = block.points.ids
    text = cause(fg.adjust(near))
    assert f"likely cause: ids of the control points {ids[a]} and {ids[b]} exchanged" in text
    assert "no doubt remains" in text


@pytest.mark.truth
def test_two_points_under_one_id_are_named() -> None:
    """If two of four images show another point under one id, the cause names the point and the images.

    The points are 100 m apart.
    """
    block = grid_block(BlockOptions(points=60, control_share=0.2, check_share=0.2, seed=1))[0]
    o, tie = block.observations, block.points.where(Role.TIE)
    j = int(tie[np.bincount(o.point)[tie] >= 4][0])
    rows = np.flatnonzero(o.point == j)
    clean = fg.adjust(block)
    places = clean.ground_m[j] + np.array([[0.0, 0.0, 0.0], [70.0, -50.0, 50.0]])
    line, sample = o.line.copy(), o.sample.copy()
    for row in rows[2:]:
        image = block.images[o.image[row]]
        pixels = np.stack(image.sensor.project(places, clean.correction(image.id)))
        line[row], sample[row] = np.array([line[row], sample[row]]) + pixels[:, 1] - pixels[:, 0]
    text = cause(fg.adjust(replace(block, observations=replace(o, line=line, sample=sample))))
    seen = ", ".join(block.images[k].id for k in o.image[rows[2:]])
    assert f"two points under the id {block.points.ids[j]}: images {seen} show another one" in text
    assert "no doubt remains" in text


@pytest.mark.truth
def test_an_origin_of_pixels_is_named_where_nothing_takes_it_up() -> None:
    """Another pixel origin is named if priors are tight, else the record lists it as not visible.

    Tight priors have sigmas of a centimetre and a nanoradian.
    """
    block = grid_block(BlockOptions(points=60, control_share=0.2, check_share=0.2, errors="none"))[0]
    wrong = mended.with_shifted_pixels(block, range(len(block.images)), (1.0, 1.0))
    held = fg.adjust(wrong, position_sigma_m=(1e-2,) * 3, attitude_sigma_rad=(1e-9,) * 3)
    assert "another origin of the pixels of all images: lines and samples are 1 px too large" in cause(held)
    assert "no doubt remains" in cause(held)
    unseen = held.result.record["reliability"]["unseen_mistakes"]
    assert not [one for one in unseen if "1 px" in one["mistake"]]
    usual = fg.adjust(wrong)
    assert usual.status == "converged"
    unseen = usual.result.record["reliability"]["unseen_mistakes"]
    assert [one["assumption"] for one in unseen if "1 px" in one["mistake"]] == [
        "(0, 0) is the centre of the first pixel"
    ]
    assert "an origin of lines and samples that differs by 1 px" in render(usual.result)


@pytest.mark.truth
def test_a_known_datum_is_named(block: Block) -> None:
    """Control points in ED50 instead of WGS 84 are named as a shift that ED50 gives.

    In Turkey ED50 differs by -84.1, -101.8, -129.7 m ECEF and a small rotation (EPSG:1784), here 31 m East and 105 m
    North.
    """
    ed50 = "EPSG:4230"

    def read_as_wgs84(ecef: Array) -> Array:
        lon, lat, height = ecef_to_geodetic(ecef)
        x, y = pyproj.Transformer.from_crs("EPSG:4326", ed50, always_xy=True).transform(lon, lat)
        return geodetic_to_ecef(x, y, height)

    text = cause(fg.adjust(with_control(block, read_as_wgs84)))
    assert "likely cause: a constant shift of the control points, as from another datum: +3" in text
    assert "; ED50 gives +31." in text


@pytest.mark.behaviour
def test_a_cause_that_the_adjustment_does_not_confirm_is_withdrawn(block: Block) -> None:
    """A likely cause is withdrawn if the corrected block is not better or cannot be adjusted."""
    wrong = fg.adjust(with_control(block, written(lambda x, y, h: (x, y, h - 36.0))))
    assert "no doubt remains" in cause(wrong)
    assert wrong.supposed is None

    def refused(_: Block) -> Block:
        raise InputError.of("block.no_control")

    for mend in (lambda b: b, refused):
        again = confirmed(replace(wrong, supposed=Supposed(mend, 10.0)), fg.adjust)
        assert not cause(again)
        assert again.status is wrong.status


@pytest.mark.behaviour
def test_gross_errors_of_image_points_are_no_wrong_sigmas() -> None:
    block = zonguldak_block(ZonguldakOptions())[0]
    o = block.observations
    line = o.line.copy()
    line[[3, 20]] += 0.3 * 30.0
    solution = fg.adjust(replace(block, observations=replace(o, line=line)))
    assert "verdict.gross_error" in [f.code for f in solution.findings]
    assert not cause(solution)


@pytest.mark.truth
def test_units_that_cannot_be_told_apart_are_named_together(block: Block) -> None:
    text = cause(fg.adjust(with_control(block, written(lambda x, y, h: (x, y, h / 0.3048)))))
    first, _, also = text.partition("cannot be distinguished from: ")
    assert "feet" in first
    assert "feet" in also


@pytest.mark.truth
def test_wrong_sigmas_are_named(block: Block) -> None:
    o = block.observations
    small = replace(o, sigma_line_px=o.sigma_line_px / 3.0, sigma_sample_px=o.sigma_sample_px / 3.0)
    assert "likely cause: sigmas of image points too small" in cause(fg.adjust(replace(block, observations=small)))


def packed(angle: Array, decimals: int) -> Array:
    """Return the degrees in whole degrees, with minutes (2 decimals) or minutes and seconds (4) in the decimals."""
    degrees = np.floor(angle)
    minutes = 60.0 * (angle - degrees)
    whole = minutes if decimals == 2 else np.floor(minutes) + 0.6 * (minutes - np.floor(minutes))
    return degrees + whole / 100.0


@pytest.mark.truth
@pytest.mark.parametrize(
    ("reading", "named"),
    [
        (lambda x, y, h: (y, x, h), "longitude and latitude exchanged"),
        (lambda x, y, h: (x / 0.9, y / 0.9, h), "longitude and latitude in gon"),
        (lambda x, y, h: (np.radians(x), np.radians(y), h), "longitude and latitude in radians"),
        (lambda x, y, h: (packed(x, 2), packed(y, 2), h), "longitude and latitude in packed degrees and minutes"),
        (lambda x, y, h: (packed(x, 4), packed(y, 4), h), "in packed degrees, minutes and seconds"),
    ],
)  # fmt: skip
def test_misread_angles_are_named(block: Block, reading: Reading, named: str) -> None:
    solution = fg.adjust(with_control(block, written(reading)))
    mixed = [str(f) for f in solution.findings if f.code == "solution.mix_up"]
    assert len(mixed) == len(block.images)
    assert all(named in text and "no doubt remains" in text for text in mixed)
    assert not cause(solution)


@pytest.mark.truth
def test_a_part_of_the_points_with_a_mistake_is_named(block: Block) -> None:
    """A mistake in every third control point is named with the number of points: kilometres, or ED50."""
    rows = block.points.where(Role.CONTROL)
    n = f"{len(rows[::3])} of {len(rows)} control points"
    east, north = 31.27, 105.49
    for change, named in (
        (written(lambda x, y, h: (x, y, h / 1000.0)), f"heights of {n} in kilometres"),
        (lambda ecef: moved_by(ecef, np.array([east, north, 0.0])), f"coordinates of {n} in ED50"),
    ):

        def some(ecef: Array, change: Callable[[Array], Array] = change) -> Array:
            out = ecef.copy()
            out[::3] = change(ecef[::3])
            return out

        text = cause(fg.adjust(with_control(block, some)))
        assert f"likely cause: {named}" in text
        assert "no doubt remains" in text


def moved_by(ecef: Array, enu: Array) -> Array:
    lon, lat, _ = ecef_to_geodetic(ecef)
    return np.asarray(ecef + np.einsum("nji,j->ni", enu_from_ecef(lon, lat), enu))


@pytest.mark.oracle
def test_the_best_part_is_that_of_all_subsets() -> None:
    """The best part of six errors is that of all 64 subsets by brute force.

    M is a projection, and the errors of two members are in the residuals.
    """
    rng = np.random.default_rng(4)
    for _ in range(20):
        design = np.linalg.qr(rng.standard_normal((12, 4)))[0]
        errors = np.diag(np.full(6, 20.0))
        normal = errors @ (np.eye(12) - design @ design.T)[:6, :6] @ errors
        true = np.isin(np.arange(6), rng.choice(6, 2, replace=False))
        g = normal @ true + errors @ rng.standard_normal(6)
        chosen, gain = _best_part(g, normal)
        every = [np.array(s, bool) for s in product((False, True), repeat=6)]
        gains = [2.0 * g[s].sum() - normal[np.ix_(s, s)].sum() for s in every]
        assert gain == pytest.approx(max(gains))
        assert (chosen == every[int(np.argmax(gains))]).all()


@pytest.mark.truth
def test_a_part_of_a_table_that_is_misread_is_named(block: Block) -> None:
    """Every second control point in gon, or with line and sample exchanged, is named as likely cause."""
    rows = block.points.where(Role.CONTROL)

    def some(ecef: Array) -> Array:
        out = ecef.copy()
        out[::2] = written(lambda x, y, h: (x / 0.9, y / 0.9, h))(ecef[::2])
        return out

    solution = fg.adjust(with_control(block, some))
    texts = [str(f) for f in solution.findings if f.code == "solution.mix_up"]
    assert texts
    assert all("longitude and latitude in gon" in text and "no doubt remains" in text for text in texts)
    o = block.observations
    wrong = (o.image == 0) & np.isin(o.point, rows[::2])
    line, sample = np.where(wrong, o.sample, o.line), np.where(wrong, o.line, o.sample)
    solution = fg.adjust(replace(block, observations=replace(o, line=line, sample=sample)))
    (text,) = (str(f) for f in solution.findings if f.code == "solution.mix_up")
    seen = int(np.isin(o.point[o.image == 0], rows).sum())
    assert f"the median misclosure of {wrong.sum()} of its {seen} control points" in text
    assert "line and sample exchanged" in text and "no doubt remains" in text


@pytest.mark.behaviour
def test_exchanged_metadata_are_named_first_in_the_report() -> None:
    block = zonguldak_block(ZonguldakOptions())[0]
    left, right = block.images
    turned = (replace(left, sensor=right.sensor), replace(right, sensor=left.sensor))
    page = render(fg.adjust(replace(block, images=turned)).result)
    assert f"with the metadata of image {right.id}" in page[page.index("Not trustworthy") : page.index("<nav")]


@pytest.mark.behaviour
def test_a_refusal_names_exchanged_metadata() -> None:
    """If rays do not meet because metadata are exchanged, the refusal names both images."""
    block = grid_block(BlockOptions(points=60, control_share=0.25, check_share=0.2))[0]
    one, two, *rest = block.images
    turned = (replace(one, sensor=two.sensor), replace(two, sensor=one.sensor), *rest)
    with pytest.raises(InputError) as caught:
        fg.adjust(replace(block, images=turned))
    assert caught.value.problems[0].code.startswith("initial.")
    mixed = [p for p in caught.value.problems if not p.code.startswith("initial.")]
    assert [f"image {a.id}:" in str(f) and f"the metadata of image {b.id}" in str(f)
            for f, a, b in zip(mixed, (one, two), (two, one), strict=True)] == [True, True]  # fmt: skip


@pytest.mark.behaviour
def test_the_cause_is_on_the_first_screen(block: Block) -> None:
    wrong = with_control(block, written(lambda x, y, h: (x, y, h - 36.0)))
    solution = fg.adjust(wrong)
    page = render(solution.result)
    assert "look orthometric" in page[: page.index("<nav")]
    control = block.points.known.ecef_m[block.points.where(Role.CONTROL)]
    geoid = world_undulation_m(*ecef_to_geodetic(control)[:2]).mean()
    told = f"the Earth's geoid is there at about {geoid:+.0f} m"
    assert told in cause(solution) or "EGM96 gives" in cause(solution)  # with its grid


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
    """T of a height offset is the decrease of v^T v with the offset as a further unknown, by numpy."""
    solution = fg.adjust(zonguldak_block(ZonguldakOptions())[0], backend="dense")
    problem, cofactors = solution.problem, solution.cofactors
    assert cofactors is not None
    system = GroundErrors.of(problem, solution.state, cofactors, solution.accuracy.control)
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


@pytest.mark.oracle
def test_errors_of_image_points_by_the_full_least_squares_problem() -> None:
    """``-e^T v``, ``e^T R e`` and the movement of a point equal those of the whole Jacobian, by numpy."""
    solution = fg.adjust(grid_block(BlockOptions(points=30, control_share=0.3, check_share=0.2))[0], backend="dense")
    problem = solution.problem
    errors = ImageErrors.of(solution.residual_cofactors)
    assert errors is not None
    error = np.random.default_rng(1).standard_normal((len(errors.v), 2))
    check = problem.block.points.where(Role.CHECK)
    g, normal, moved = errors.normal(error, check)
    v, design = turned_rows(problem, solution.state)
    e = np.zeros((len(v), 2))
    e[: len(error)] = error
    length = np.linalg.norm(design, axis=0)
    x = np.linalg.lstsq(design / length, e)[0] / length[:, None]
    columns = problem.point_columns[check][:, None] + np.arange(3)
    assert g == pytest.approx(-e.T @ v, rel=1e-6)
    assert normal == pytest.approx(e.T @ (e - design @ x), rel=1e-6)
    assert moved == pytest.approx(x[columns], rel=1e-4, abs=1e-6 * np.abs(x[columns]).max())
