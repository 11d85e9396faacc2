"""The pixels of simulated images move by the stated waves of jitter, and the table contains these waves."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from fg_orient.model.errors import InputError
from fg_orient.sensors.correction import Correction
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.jitter import PIXEL_RAD
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak, zonguldak_block

WAVES = ZonguldakOptions(jitter_px=1.5, jitter_cycles=2.5, jitter_phase_deg=30.0, jitter_images=("right",))


@pytest.mark.oracle
def test_each_pixel_has_the_attitude_of_its_line() -> None:
    """A pixel of an image with jitter is the projection with the wave's rotation at its line, within 1e-6 px."""
    block, truth = zonguldak_block(WAVES)
    _, still = zonguldak_block(ZonguldakOptions())
    o, sensor = block.observations, block.images[1].sensor
    assert np.array_equal(truth.pixels[o.image == 0], still.pixels[o.image == 0])
    rows = np.flatnonzero(o.image == 1)
    for row in rows[:12].tolist():
        line, eop = truth.pixels[row, 0], np.array(truth.corrections[1].eop)
        value = 1.5 * PIXEL_RAD * np.sin(2.0 * np.pi * 2.5 * line / 11999.0 + np.radians(30.0))
        eop[6:8, 0] += value
        pixel = sensor.project(truth.ecef_m[o.point[row]][None], Correction(eop))
        assert np.abs(np.ravel(pixel) - truth.pixels[row]).max() < 1e-6
    moved = truth.pixels[rows] - still.pixels[rows]
    assert 1.3 < np.abs(moved).max() < 1.7  # 1.5 px of a detector element


@pytest.mark.consistency
def test_jitter_changes_no_other_random_number() -> None:
    """Jitter changes no point, role or noise of a simulated block, and each angle has its own phase."""
    options = BlockOptions(points=60, jitter_px=0.8, jitter_axis="both")
    (block, truth), (plain, still) = grid_block(options), grid_block(BlockOptions(points=60))
    assert np.array_equal(truth.ecef_m, still.ecef_m) and block.points.roles == plain.points.roles
    noise = [
        np.stack([b.observations.line, b.observations.sample], axis=1) - t.pixels
        for b, t in ((block, truth), (plain, still))
    ]
    np.testing.assert_allclose(*noise, atol=1e-9)
    phases = [wave.phase_rad for correction in truth.corrections for wave in correction.waves]
    assert len(set(phases)) == len(phases) == 8
    roll, _ = grid_block(BlockOptions(points=60, jitter_px=0.8, jitter_axis="roll"))
    assert not np.array_equal(roll.observations.sample, plain.observations.sample)


@pytest.mark.behaviour
def test_table_of_the_truth(tmp_path: Path) -> None:
    simulate_zonguldak(tmp_path / "waves", WAVES)
    with (tmp_path / "waves" / "truth" / "jitter.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["image"], row["component"]) for row in rows] == [("right", "roll"), ("right", "pitch")]
    for row in rows:
        assert float(row["amplitude_px"]) == pytest.approx(1.5, rel=1e-12) and float(row["cycles"]) == 2.5
        assert float(row["amplitude_rad"]) == 1.5 * PIXEL_RAD
        assert float(row["phase_rad"]) == pytest.approx(np.pi / 6.0, rel=1e-12)
    simulate_zonguldak(tmp_path / "still", ZonguldakOptions())
    assert not (tmp_path / "still" / "truth" / "jitter.csv").exists()


@pytest.mark.behaviour
def test_an_unknown_image_is_refused() -> None:
    with pytest.raises(InputError, match="left, right"):
        zonguldak_block(ZonguldakOptions(jitter_px=1.0, jitter_images=("middle",)))
