"""The conditions of the published procedure agree with the formulas written out in numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factors.cameras.pushbroom import RECORD
from fg_orient.model.block import Block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from fg_orient.studies import conditions
from fg_orient.studies.switches import PROGRAM, TEXT, Switches
from tests.support import published_conditions as oracle
from tests.support.published_rays import state

ALL = tuple(range(27))
ATTITUDE = (-1.6e-4, -7.2e-4, 9e-4)
#: The program's equations with x and derivatives as the formulas have them.
SHORT = PROGRAM.without("centred_lines", "look_quotients")
#: The two equations, and whether the matrices of the second argument of the oracle are those of the program.
BOTH = pytest.mark.parametrize(("switches", "as_run"), [(TEXT, False), (SHORT, True)], ids=["text", "program"])
#: 1e-8 m of rounding in parabolas through an orbit of 7e6 m, seen from 8e5 m.
ROUNDING = 2e-14


@pytest.fixture(scope="module")
def block() -> Block:
    """Return a twin with radial velocity, attitude and distortion, in which no term vanishes."""
    options = ZonguldakOptions(point_set="H-0", radial_velocity_m_s=8.0, attitude_rad=ATTITUDE, distortion_rad=3e-6)
    return zonguldak_block(options)[0]


def nothing(block: Block, codes: tuple[int, ...] = ALL) -> np.ndarray:
    return np.zeros((len(block.images), len(codes)))


def look_of(block: Block) -> np.ndarray:
    """Return the look angles psi_x, psi_y of the files: linear in the tangent between the detectors."""
    o = block.observations
    out = np.empty((len(o), 2))
    for k, image in enumerate(block.images):
        table, rows = image.sensor.metadata.look, o.image == k
        for c, psi in enumerate((table.psi_x_rad, table.psi_y_rad)):
            out[rows, c] = np.arctan(np.interp(o.sample[rows], table.sample, np.tan(psi)))
    return out


def deviation(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference relative to the largest element of each column (last axis)."""
    axes = tuple(range(found.ndim - 1))
    scale = np.abs(expected).max(axis=axes)
    return float((np.abs(found - expected).max(axis=axes)[scale > 0.0] / scale[scale > 0.0]).max())


def tangents_of(eop: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return f1/f3 and f2/f3 as run (n, 2)."""
    f = oracle.f_vector(eop, ground, True)
    return f[:, :2] / f[:, 2:]


def shortening_derivatives(eop: np.ndarray) -> np.ndarray:
    """Return the derivatives (n, 9) of ln |V x P|/(|V| |P|) with respect to the nine EOPs, by complex step."""
    columns = []
    for k in range(9):
        moved = eop + 1j * oracle.STEP * np.eye(9)[k]
        p, v = moved[:, 0:3], moved[:, 3:6]
        columns.append(np.log(oracle.norm(np.cross(v, p)) / oracle.norm(v) / oracle.norm(p))[:, 0].imag / oracle.STEP)
    return np.stack(columns, axis=1)


@pytest.mark.oracle
@BOTH
def test_values_and_derivatives_are_those_of_the_formulas(block: Block, switches: Switches, as_run: bool) -> None:
    ground = block.points.known.ecef_m
    at = conditions.build(block.images, block.observations, ground, switches=switches)
    lin = at.linearise(ALL, nothing(block))
    eop, look, o = oracle.all_eop(block), look_of(block), block.observations
    value = oracle.conditions(eop, look, ground[o.point], as_run)
    assert np.abs(value).max() > 1e-5  # the compared values are not zero
    assert np.abs(lin.value - value).max() < ROUNDING
    d_eop, d_ground, d_look = oracle.derivatives(eop, look, ground[o.point], as_run)
    assert deviation(lin.ground, d_ground) < 1e-12
    assert np.allclose(lin.look, np.einsum("nii->ni", d_look), rtol=1e-13, atol=0.0)
    assert not (d_look[:, 0, 1].any() or d_look[:, 1, 0].any())  # B is diagonal
    design = oracle.coefficient_columns(d_eop, o.line, ALL)
    assert deviation(lin.eop, design) < 1e-11


@pytest.mark.oracle
def test_a_length_that_stays_leaves_out_its_own_derivative(block: Block) -> None:
    """Without D5 the derivatives lack (f1/f3, f2/f3) dln s, within 2e-5 of their size.

    The remainder is s - 1 = 6e-7, and attitude (1e-3) times the missing term.
    """
    ground, o = block.points.known.ecef_m, block.observations
    at = conditions.build(block.images, o, ground, switches=SHORT.without("length_follows"))
    eop = oracle.all_eop(block)
    d_eop = oracle.derivatives(eop, look_of(block), ground[o.point], True)[0]
    left_out = tangents_of(eop, ground[o.point])[:, :, None] * shortening_derivatives(eop)[:, None, :]
    assert np.abs(left_out).max() > 1e-8
    assert deviation(at.linearise(ALL, nothing(block)).eop[:, :, ::3] + left_out, d_eop) < 2e-5


@pytest.mark.oracle
def test_quotients_of_the_look_angles_add_the_misclosure(block: Block) -> None:
    """With D8 the matrix A exceeds the derivative by F df3/f3, which is zero where the condition is met."""
    ground, o, look = block.points.known.ecef_m, block.observations, look_of(block)
    at = conditions.build(block.images, o, ground, switches=SHORT.with_("look_quotients"))
    eop, g = oracle.all_eop(block), ground[o.point]
    f = oracle.f_vector(eop, g, True)
    third = [oracle.f_vector(eop + 1j * oracle.STEP * np.eye(9)[k], g, True)[:, 2].imag / oracle.STEP for k in range(9)]
    value = oracle.conditions(eop, look, g, True)
    added = value[:, :, None] * (np.stack(third, axis=1) / f[:, 2:])[:, None, :]
    d_eop = oracle.derivatives(eop, look, g, True)[0]
    lin = at.linearise(ALL, nothing(block))
    assert deviation(added, np.zeros_like(added) + d_eop) > 1e-6  # the difference is not zero
    assert np.abs(lin.eop[:, :, ::3] - d_eop - added).max() < 1e-12 * np.abs(d_eop).max()
    closed = at.with_look(oracle.back_projected(eop, g, True)).linearise(ALL, nothing(block))
    assert deviation(closed.eop[:, :, ::3], d_eop) < 1e-11


@pytest.mark.oracle
def test_lines_are_counted_from_the_centre_of_the_scene(block: Block) -> None:
    """With D1 lines are counted from -6000 to 6000, and columns of degree 0 do not change."""
    ground = block.points.known.ecef_m
    first, centred = (
        conditions.build(block.images, block.observations, ground, switches=switches).linearise(ALL, nothing(block)).eop
        for switches in (TEXT, TEXT.with_("centred_lines"))
    )
    x = block.observations.line - 6000.0
    by_eop, _, _ = oracle.derivatives(oracle.all_eop(block), look_of(block), ground[block.observations.point], False)
    assert deviation(centred, oracle.coefficient_columns(by_eop, x, ALL)) < 1e-9
    assert np.array_equal(centred[:, :, ::3], first[:, :, ::3])
    assert np.allclose(centred[:, :, 1::3], first[:, :, ::3] * x[:, None, None], rtol=1e-14, atol=0.0)
    assert np.allclose(centred[:, :, 2::3], first[:, :, ::3] * x[:, None, None] ** 2, rtol=1e-14, atol=0.0)


@pytest.mark.oracle
def test_line_exact_orbits_differ_from_polynomials_by_centimetres(block: Block) -> None:
    """With D3 positions are interpolated as in the sensor, and differ from polynomials by 1 mm to 10 cm."""
    ground, o = block.points.known.ecef_m, block.observations
    at = conditions.build(block.images, o, ground, line_exact=True)
    smooth = conditions.build(block.images, o, ground)
    for k, image in enumerate(block.images):
        rows = o.image == k
        assert np.array_equal(at.records[rows, RECORD.position], image.sensor.states(o.line[rows]).position_m)
        m = image.sensor.metadata
        time_s = m.timing.reference_time_s + (o.line[rows] - m.timing.reference_line) * m.timing.line_period_s
        assert (
            np.abs(at.records[rows, RECORD.position] - state(m.ephemeris, time_s)[0]).max() < 1e-7
        )  # polynomials by scipy
    apart = np.linalg.norm(at.records[:, RECORD.position] - smooth.records[:, RECORD.position], axis=1)
    assert 1e-3 < apart.max() < 0.1
    joined = at.with_orbit(smooth)
    assert np.array_equal(joined.records, smooth.records)


@pytest.mark.oracle
def test_columns_are_per_line_and_per_line_squared(block: Block) -> None:
    at = conditions.build(block.images, block.observations, block.points.known.ecef_m)
    a = at.linearise(ALL, nothing(block)).eop.reshape(-1, 2, 9, 3)
    by_eop, _, _ = oracle.derivatives(oracle.all_eop(block), at.look_rad, block.points.known.ecef_m[at.point], False)
    assert deviation(a[..., 0], by_eop) < 1e-9
    line = block.observations.line[:, None, None]
    assert np.allclose(a[..., 1], a[..., 0] * line, rtol=1e-14, atol=0.0)
    assert np.allclose(a[..., 2], a[..., 0] * line**2, rtol=1e-14, atol=0.0)


@pytest.mark.oracle
def test_written_out_derivatives_of_the_publication(block: Block) -> None:
    """The printed derivatives equal those of the kernel with small-angle attitude within 1e-11."""
    ground = block.points.known.ecef_m
    at = conditions.build(block.images, block.observations, ground)
    records = at.records.copy()
    records[:, RECORD.small_angle] = 1.0
    lin = replace(at, records=records).linearise(ALL, nothing(block))
    printed = oracle.published_derivatives(oracle.all_eop(block), ground[block.observations.point])
    assert deviation(lin.eop[:, :, ::3], printed) < 1e-11


@pytest.mark.oracle
@BOTH
def test_corrections_of_the_orbit_are_polynomials_of_the_line(
    block: Block, switches: Switches, as_run: bool, rng: np.random.Generator
) -> None:
    size = np.repeat([10.0, 1e-2, 5e-5], 9) * np.tile([1.0, 1e-4, 1e-8], 9)
    x = rng.standard_normal((2, 27)) * size
    ground, o = block.points.known.ecef_m, block.observations
    at = conditions.build(block.images, o, ground, switches=switches)
    powers = o.line[:, None] ** np.arange(3)
    eop = oracle.all_eop(block) + np.einsum("nck,nk->nc", x.reshape(2, 9, 3)[o.image], powers)
    value = oracle.conditions(eop, look_of(block), ground[o.point], as_run)
    assert np.abs(at.linearise(ALL, x).value - value).max() < ROUNDING


@pytest.mark.oracle
@BOTH
def test_velocity_acts_through_its_direction_only(block: Block, switches: Switches, as_run: bool) -> None:
    """dF/dV . V = 0, and dF/dV . P = 0 unless the length of the short axis follows (D5): V is a yaw."""
    at = conditions.build(block.images, block.observations, block.points.known.ecef_m, switches=switches)
    a = at.linearise((9, 12, 15), nothing(block, (9, 12, 15))).eop
    ground = block.points.known.ecef_m[at.point]
    by_eop, _, _ = oracle.derivatives(oracle.all_eop(block), at.look_rad, ground, as_run)
    assert deviation(a, by_eop[:, :, 3:6]) < 1e-6
    p, v = at.records[:, RECORD.position], at.records[:, RECORD.velocity]
    for direction, alive in ((p, as_run), (v, False)):
        unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        effect = np.abs(np.einsum("nij,nj->ni", a, unit)).max() / np.abs(a).max()
        assert 1e-4 < effect < 1e-2 if alive else effect < 1e-13


@pytest.mark.oracle
def test_velocity_across_track_is_a_yaw() -> None:
    """Without roll and pitch dF/dV . X equals -(dF/d yaw)/V within 1e-14, with V normal to P."""
    level = zonguldak_block(ZonguldakOptions(point_set="H-0", errors="none", radial_velocity_m_s=8.0))[0]
    at = conditions.build(level.images, level.observations, level.points.known.ecef_m)
    lin = at.linearise((9, 12, 15, 24), nothing(level, (9, 12, 15, 24)))
    p, v = at.records[:, RECORD.position], at.records[:, RECORD.velocity]
    by_eop, _, _ = oracle.derivatives(oracle.all_eop(level), at.look_rad, level.points.known.ecef_m[at.point], False)
    assert deviation(lin.eop, by_eop[:, :, [3, 4, 5, 8]]) < 1e-6
    across = np.einsum("nij,nj->ni", lin.eop[:, :, :3], oracle.frame(p, v, False)[:, :, 0])
    normal = np.linalg.norm(np.cross(v, p), axis=1) / np.linalg.norm(p, axis=1)
    yaw = lin.eop[:, :, 3]
    assert np.abs(yaw).max() > 0.3
    assert np.abs(across * normal[:, None] + yaw).max() < 1e-14


@pytest.mark.oracle
@pytest.mark.parametrize("corrected", [False, True])
def test_points_of_a_ray_fulfil_the_conditions(block: Block, corrected: bool, rng: np.random.Generator) -> None:
    at = conditions.build(block.images, block.observations, block.points.known.ecef_m)
    size = np.repeat([10.0, 1e-2, 5e-5], 9) * np.tile([1.0, 1e-4, 1e-8], 9)
    x = rng.standard_normal((2, 27)) * size if corrected else nothing(block)
    centre, direction = at.rays(ALL, x)
    assert np.allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-15)
    eop, line = oracle.all_eop(block), block.observations.line[:, None]
    for degree in range(3):
        eop = eop + x[block.observations.image, degree::3] * line**degree
    assert np.abs(direction - oracle.ray(eop, at.look_rad, False)).max() < 1e-13
    assert np.abs(centre - eop[:, :3]).max() < 1e-7
    for distance in (7e5, 9e5):
        on_ray = at.with_ground(centre + distance * direction)
        assert np.abs(on_ray.linearise(ALL, x).value).max() < 5e-15


@pytest.mark.oracle
@BOTH
@pytest.mark.parametrize("third", [-1.0, 1.0])
def test_rays_are_those_of_the_formulas(block: Block, switches: Switches, as_run: bool, third: float) -> None:
    at = conditions.build(block.images, block.observations, block.points.known.ecef_m, switches=switches)
    centre, direction = at.rays((), nothing(block, ()), look_sign=third)
    eop = oracle.all_eop(block)
    assert np.abs(centre - eop[:, 0:3]).max() < 1e-8
    assert np.abs(direction - oracle.ray(eop, look_of(block), as_run, third)).max() < 1e-14


@pytest.mark.oracle
def test_metadata_position_keeps_the_centre_and_turns_the_camera(block: Block) -> None:
    at = conditions.build(block.images, block.observations, block.points.known.ecef_m)
    codes, x = (0, 3, 6), np.full((2, 3), 50.0)
    moved, turned = at.rays(codes, x)
    held, same = at.rays(codes, x, metadata_position=True)
    given, straight = at.rays((), nothing(block, ()))
    eop = oracle.all_eop(block)
    assert np.abs(held - eop[:, :3]).max() < 1e-7
    assert np.abs(same - oracle.ray(eop + 50.0 * (np.arange(9) < 3), at.look_rad, False)).max() < 1e-13
    assert np.array_equal(held, given)
    assert np.allclose(moved - given, 50.0, rtol=0.0, atol=1e-8)
    assert np.array_equal(turned, same)
    assert np.abs(turned - straight).max() > 1e-6


@pytest.mark.oracle
@BOTH
def test_moving_the_reference_changes_no_condition(
    block: Block, switches: Switches, as_run: bool, rng: np.random.Generator
) -> None:
    """``with_ground``, ``with_look`` and ``take`` give the conditions of a new build with the same data."""
    ground = block.points.known.ecef_m
    other = ground + 100.0 * rng.standard_normal(ground.shape)
    at = conditions.build(block.images, block.observations, ground, switches=switches)
    anew = conditions.build(block.images, block.observations, other, switches=switches)
    moved = at.with_ground(other[at.point])
    a, b = (c.linearise(ALL, nothing(block)) for c in (moved, anew))
    written_out = oracle.conditions(oracle.all_eop(block), at.look_rad, other[at.point], as_run)
    assert np.abs(a.value - written_out).max() < ROUNDING
    assert np.abs(a.value - b.value).max() < 1e-14
    assert np.allclose(a.eop, b.eop, rtol=1e-12, atol=0.0)
    back = moved.with_ground(at.approximate_m).linearise(ALL, nothing(block)).value
    assert np.abs(back - at.linearise(ALL, nothing(block)).value).max() < 1e-14
    look = at.look_rad + np.array([1e-3, 2e-3])
    turned = at.with_look(look)
    assert np.array_equal(turned.look_rad, look)
    found = turned.linearise((), nothing(block, ())).value
    expected = oracle.conditions(oracle.all_eop(block), look, ground[at.point], as_run)
    assert np.abs(found - expected).max() < ROUNDING
    rows = np.array([3, 60, 7])
    assert np.array_equal(turned.take(rows).linearise((), nothing(block, ())).value, found[rows])
