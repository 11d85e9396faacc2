"""``simulate block`` is tested: files, counts, roles, and an adjustment of its block."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.project import read_project
from fg_orient.model.block import Block
from fg_orient.model.names import Role, Status
from fg_orient.orientation.orient import adjust
from fg_orient.simulate.block import BlockOptions, grid_block, simulate_block
from fg_orient.simulate.simulation import Truth
from tests.support.published_rays import misses_m

OPTIONS = BlockOptions(rows=2, columns=3, points=150, seed=7, control_share=0.1, check_share=0.2)


@pytest.fixture(scope="module")
def made() -> tuple[Block, Truth]:
    return grid_block(OPTIONS)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_block(tmp_path_factory.mktemp("block") / "block", OPTIONS)


@pytest.mark.behaviour
def test_counts(made: tuple[Block, Truth]) -> None:
    block, _ = made
    assert len(block.images) == 6
    assert [len(block.points.where(role)) for role in (Role.CONTROL, Role.CHECK, Role.TIE)] == [15, 30, 105]
    rays = np.bincount(block.observations.point, minlength=150)
    assert rays.min() >= 2 and rays.max() >= 4
    assert np.bincount(block.observations.image).min() > 20, "every image takes part"
    assert len(grid_block(BlockOptions(points=12, control_share=0.0))[0].points.where(Role.CONTROL)) == 6


@pytest.mark.truth
def test_neighbours_look_from_opposite_sides(made: tuple[Block, Truth]) -> None:
    mirror = [np.degrees(image.sensor.look_angles(5999.5)[1][0]) for image in made[0].images]
    # the middle of the chord is not the middle of the angle: 12 (1 - cos 2.06 deg) is below 0.01 degrees
    np.testing.assert_allclose(mirror, [-12, 12, -12, 12, -12, 12], atol=0.01)


@pytest.mark.consistency
def test_the_block_in_memory_is_the_block_of_the_files(made: tuple[Block, Truth], written: Path) -> None:
    block, read = made[0], read_project(written)
    for a, b in zip(block.images, read.images, strict=True):
        assert a.id == b.id
        np.testing.assert_array_equal(a.sensor.metadata.look.psi_y_rad, b.sensor.metadata.look.psi_y_rad)
        np.testing.assert_array_equal(a.sensor.metadata.ephemeris.position_m, b.sensor.metadata.ephemeris.position_m)
        np.testing.assert_array_equal(a.sensor.metadata.attitude.angles_rad, b.sensor.metadata.attitude.angles_rad)
    assert block.points.ids == read.points.ids and block.points.roles == read.points.roles
    np.testing.assert_array_equal(block.points.known.ecef_m, read.points.known.ecef_m)
    np.testing.assert_array_equal(block.withheld.open().ecef_m, read.withheld.open().ecef_m)
    for name in ("image", "point", "line", "sample", "sigma_line_px", "sigma_sample_px"):
        np.testing.assert_array_equal(getattr(block.observations, name), getattr(read.observations, name))


@pytest.mark.behaviour
def test_same_seed_same_bytes(written: Path, tmp_path: Path) -> None:
    again = simulate_block(tmp_path / "block", OPTIONS)
    files = sorted(p.relative_to(written.parent) for p in written.parent.rglob("*") if p.is_file())
    assert len(files) == 6 + 3 + 3
    for name in files:
        assert (again.parent / name).read_bytes() == (written.parent / name).read_bytes(), name
    metadata = [p.stat().st_size for p in written.parent.glob("*.DIM")]
    assert max(metadata) < 100_000, "the look table is compact: with 12000 rows a file has 1.4 MB"


@pytest.mark.oracle
def test_true_unknowns_give_the_noise_free_pixels(made: tuple[Block, Truth]) -> None:
    block, truth = made
    for k, (image, correction) in enumerate(zip(block.images, truth.corrections, strict=True)):
        rows = block.observations.image == k
        seen = np.stack(image.sensor.project(truth.ecef_m[block.observations.point[rows]], correction), axis=1)
        np.testing.assert_allclose(seen, truth.pixels[rows], rtol=0.0, atol=1e-8)  # one digit of the time: 5e-9 px
        ground = truth.ecef_m[block.observations.point[rows]]
        assert misses_m(image.sensor.metadata, *truth.pixels[rows].T, ground, correction).max() < 1e-6


@pytest.mark.oracle
def test_it_can_be_adjusted(made: tuple[Block, Truth]) -> None:
    block, truth = made
    solution = adjust(block, eop_set=15)
    # errors also in the velocity (1e-2 m/s, 1.3e-6 rad of yaw): not in the set, far below the noise
    assert solution.status is Status.CONVERGED and solution.iterations <= 5
    assert solution.sigma0_interval[0] < solution.sigma0 < solution.sigma0_interval[1]
    tie = block.points.where(Role.TIE)
    error = np.linalg.norm(solution.ground_m - truth.ecef_m, axis=1)[tie]
    assert np.sqrt(np.mean(error**2)) < 8.0  # 0.3 px of 5 m at B/H 0.45: 1.5 m per ray, 5 m in height
