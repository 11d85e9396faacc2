"""Models of other programs are adjusted and written back with the residuals and poses of the solution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.exchange.colmap_text import read_colmap_text, write_colmap_text
from fg_orient.formats.frame_model import FrameModel, Pose, adjusted_model, frame_block
from fg_orient.sensors.frame import MEASURED_TO_IDEAL
from fg_orient.sensors.frame_unknowns import UNKNOWNS
from tests.support.frame_models import frame_model

pytestmark = pytest.mark.consistency

NOISE_PX = 0.3


def shaken(model: FrameModel) -> FrameModel:
    """Return start values that are off by centimetres."""
    rng = np.random.default_rng(8)
    poses = tuple(Pose(p.name, p.camera, p.rotation, p.centre_m + rng.normal(scale=0.02, size=3)) for p in model.poses)
    return replace(model, poses=poses, points_m=model.points_m + rng.normal(scale=0.02, size=model.points_m.shape))


def test_a_model_is_adjusted_and_written_with_the_residuals_of_the_solution(tmp_path: Path) -> None:
    alone = frame_model(noise_px=NOISE_PX)
    # a thirteenth point in one image only: nothing determines it
    model = replace(
        alone, point_ids=(*alone.point_ids, "13"), points_m=np.vstack([alone.points_m, np.zeros(3)]),
        image=np.append(alone.image, 2), point=np.append(alone.point, 12), line=np.append(alone.line, 500.0),
        sample=np.append(alone.sample, 700.0),
    )  # fmt: skip
    block = frame_block(shaken(model), "scene", sigma_px=NOISE_PX)
    assert tuple(map(str, block.notes)) == ("left out: 1 point measured in one image only",)
    solution = fg.adjust(block)
    assert 0.7 < solution.sigma0 < 1.3
    adjusted = adjusted_model(shaken(model), [solution.correction(p.name) for p in model.poses], solution.ground_m)
    assert tuple(map(str, adjusted.notes)) == ("1 unadjusted point is left out",)
    assert set(adjusted.cameras) == set(model.cameras)
    # the longest distance to a camera is 6 m: rounding of coordinates moves pixels by less than 1e-9
    assert np.abs(adjusted.residuals_px() - solution.residuals_px).max() < 1e-9
    write_colmap_text(tmp_path, adjusted)
    again = read_colmap_text(tmp_path)
    squares = np.sum(again.residuals_px() ** 2)
    assert squares / NOISE_PX**2 == pytest.approx(solution.chi2, rel=1e-9)


@pytest.mark.parametrize("model_name", ["brown_ideal_to_measured", MEASURED_TO_IDEAL])
def test_an_adjusted_interior_orientation_is_a_camera_of_the_image(model_name: str) -> None:
    model = frame_model(("brown",))
    model = replace(model, cameras={"1": replace(model.cameras["1"], model=model_name)})
    correction = np.zeros(len(UNKNOWNS))
    for name, value in {"focal": 3.0, "principal_line": 1.5, "principal_sample": -2.5, "k1": 1e-3, "p2": 1e-4}.items():
        correction[UNKNOWNS.index(name)] = value
    if model_name == MEASURED_TO_IDEAL:
        correction[UNKNOWNS.index("aspect")] = 1e-4
    found = adjusted_model(model, [correction, np.zeros(len(UNKNOWNS))], model.points_m)
    assert [pose.camera for pose in found.poses] == ["1 of 0.jpg", "1"]
    line, sample = model.sensors[0].project(model.points_m, correction)
    other = found.sensors[0].project(model.points_m)
    assert np.abs(other[0] - line).max() < 1e-9
    assert np.abs(other[1] - sample).max() < 1e-9
