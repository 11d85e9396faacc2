"""Options of the simulators are checked, and each error is one line."""

from __future__ import annotations

import pytest

from fg_orient.model.errors import InputError
from fg_orient.simulate.block import BlockOptions
from fg_orient.simulate.zonguldak import ZonguldakOptions

pytestmark = pytest.mark.behaviour


@pytest.mark.parametrize(
    ("options", "change", "name"),
    [
        (ZonguldakOptions, {"seed": -1}, "seed"),
        (ZonguldakOptions, {"point_set": "H-11"}, "point_set"),
        (ZonguldakOptions, {"image_noise_px": -0.1}, "image_noise_px"),
        (ZonguldakOptions, {"image_noise_px": float("nan")}, "image_noise_px"),
        (ZonguldakOptions, {"errors": "big"}, "errors"),
        (ZonguldakOptions, {"distortion_rad": 1e-3}, "distortion_rad"),
        (ZonguldakOptions, {"radial_velocity_m_s": float("inf")}, "radial_velocity_m_s"),
        (ZonguldakOptions, {"attitude_rad": (0.0, 1.0, 0.0)}, "attitude_rad"),
        (ZonguldakOptions, {"attitude_rad": (0.0, 0.0)}, "attitude_rad"),
        (ZonguldakOptions, {"ground_noise_m": (0.1, -0.1, 1.0)}, "ground_noise_m"),
        (BlockOptions, {"rows": 1, "columns": 1}, "rows, columns"),
        (BlockOptions, {"rows": 0}, "rows"),
        (BlockOptions, {"points": 5}, "points"),
        (BlockOptions, {"seed": -1}, "seed"),
        (BlockOptions, {"spacing_m": 60e3}, "spacing_m"),
        (BlockOptions, {"roll_deg": 40.0}, "roll_deg"),
        (BlockOptions, {"control_share": 0.9, "check_share": 0.2}, "control_share, check_share"),
        (BlockOptions, {"image_noise_px": 99.0}, "image_noise_px"),
        (BlockOptions, {"errors": "big"}, "errors"),
        (BlockOptions, {"ground_noise_m": (1.0, 1.0)}, "ground_noise_m"),
        (BlockOptions, {"max_height_m": -1.0}, "max_height_m"),
    ],
)
def test_impossible_options(options: type, change: dict[str, object], name: str) -> None:
    with pytest.raises(InputError) as caught:
        options(**change)
    (problem,) = caught.value.problems
    assert problem.code == "options.value" and problem.option == name and problem.remedy.startswith("give ")
