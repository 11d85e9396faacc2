"""Line-scan images of other bodies: the tests cover a second evaluator of ISD, an adjustment, and states."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.metadata.csm_state import write_compared
from fg_orient.geodesy.bodies import Body
from fg_orient.model.errors import InputError, OutOfTimeRange
from fg_orient.sensors.general import GeneralPushbroom
from tests.support import csm_line_scan
from tests.support import isd_lines as twin

MARS = Body("Mars", (3396190.0, 3396190.0, 3376200.0))


def write(folder: Path, isd: twin.Isd, name: str = "a.json") -> Path:
    path = folder / name
    path.write_text(json.dumps(isd))
    return path


def pixels(sensor: GeneralPushbroom, n: int = 5) -> np.ndarray:
    """Return the pixels (n * n, 2) over the image."""
    return np.stack(sensor.grid(n), axis=1)


@pytest.mark.oracle
@pytest.mark.parametrize("fields", [
    {},
    {"backwards": True},
    {"optical_distortion": {"transverse": {
        "x": [0.01, 1.0002, 1e-4, 1e-6, 0.0, 2e-6, 3e-8, 0.0, 1e-8, 0.0],
        "y": [-0.02, 2e-5, 0.9999, 2e-6, 1e-6, 0.0, 0.0, 3e-8, 0.0, -1e-8]}}},
    {"optical_distortion": {"radtan": {"coefficients": [-2e-3, 4e-3, 3e-4, -5e-4, 1e-3]}}, "backwards": True},
    {"detector_sample_summing": 2, "starting_detector_sample": 7, "starting_detector_line": 3,
     "detector_center": {"line": 12.0, "sample": 810.0}, "focal2pixel_lines": [0.5, -0.7, -140.0]},
    {"focal2pixel_lines": [0.0, 140.0, 0.0], "focal2pixel_samples": [0.0, 0.0, -140.0]},
])  # fmt: skip
def test_features_of_an_isd(tmp_path: Path, fields: dict[str, Any]) -> None:
    """A line-scan ISD projects and locates as the second evaluator within 1e-6 px and 1e-6 m.

    On the detector 1e-6 px are 0.6 micrometres.
    """
    own = dict(fields)
    isd = twin.simulated(0.2, backwards=own.pop("backwards", False)) | own
    sensor = fg.read_sensor(write(tmp_path, isd))
    assert sensor.body is not None and sensor.body.name == "Mars" and sensor.body.same(MARS)
    at = pixels(sensor)
    ground = np.array([twin.to_ground(isd, line + 0.5, sample + 0.5) for line, sample in at])
    assert np.abs(np.stack(sensor.project(ground), axis=1) - at).max() < 1e-6
    assert np.abs(sensor.locate(*at.T, height_m=0.0) - ground).max() < 1e-6
    heights = sensor.body.coordinates(sensor.locate(*at.T, height_m=2500.0))[:, 2]
    assert np.abs(heights - 2500.0).max() < 1e-5


@pytest.mark.truth
def test_the_rotation_of_the_body_moves_the_ground(tmp_path: Path) -> None:
    """The rotation of the body moves located points by omega R cos(latitude) t from the central line."""
    isd = twin.simulated()
    still = json.loads(json.dumps(isd))
    still["body_rotation"]["quaternions"] = [isd["body_rotation"]["quaternions"][1]] * 3
    one, two = (fg.read_sensor(write(tmp_path, own)) for own in (isd, still))
    line = np.array([0.0, 999.5, 1999.0])
    apart = one.locate(line, np.full(3, 400.0), height_m=0.0) - two.locate(line, np.full(3, 400.0), height_m=0.0)
    time_s = np.array([-999.5, 0.0, 1.1 * 999.5]) * 1.9e-3
    radius = np.linalg.norm(one.locate(line, np.full(3, 400.0), height_m=0.0)[:, :2], axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(apart, axis=1), abs(twin.RATE_RAD_S * time_s) * radius, rtol=2e-3, atol=0.02
    )


@pytest.mark.oracle
def test_a_line_scan_state_of_mars(tmp_path: Path) -> None:
    """A line-scan image of Mars written as a state projects as the original within 1e-3 px by evaluator and reader."""
    straight = {"optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}}}
    sensor = fg.read_sensor(write(tmp_path, twin.simulated(0.2) | straight))
    record = write_compared(tmp_path / "state.json", sensor)
    assert record["largest_px"] < 1e-3
    state = csm_line_scan.read_state(tmp_path / "state.json")
    again = fg.read_sensor(tmp_path / "state.json")
    assert again.body is not None and again.body.same(MARS)
    at = pixels(sensor, 3)
    ground = np.array([csm_line_scan.to_ground(state, line + 0.5, sample + 0.5, 0.0) for line, sample in at])
    assert np.abs(np.stack(again.project(ground), axis=1) - at).max() < 2e-6
    assert np.abs(np.stack(sensor.project(ground), axis=1) - at).max() < 1e-3


def block(folder: Path, rng: np.random.Generator) -> np.ndarray:
    """Write a stereo pair of Mars with an error of each orbit and 0.3 px of noise; return the true points.

    It has 12 control, 40 tie and 12 check points.
    """
    radius, pitch = twin.MARS_KM[0], 0.25
    apart = np.arcsin((radius + 300.0) / radius * np.sin(pitch)) - pitch
    images = {name: twin.simulated(sign * pitch, ahead_rad=-sign * apart) for name, sign in (("a", 1.0), ("b", -1.0))}
    true = {name: fg.read_sensor(write(folder, isd, f"{name}.json")) for name, isd in images.items()}
    line, sample = rng.uniform(450.0, 1550.0, 64), rng.uniform(60.0, 740.0, 64)
    ground = true["a"].locate(line, sample, height_m=rng.uniform(-500.0, 1500.0, 64))
    roles = ["control"] * 12 + ["tie"] * 40 + ["check"] * 12
    names = [f"{role}{k}" for k, role in enumerate(roles)]
    marks = ["image,id,line,sample,sigma_line_px,sigma_sample_px"]
    for name, sensor in true.items():
        where = np.stack(sensor.project(ground), axis=1)
        assert sensor.is_inside(*where.T).all()
        seen = where + rng.normal(scale=0.3, size=where.shape)
        marks += [f"{name},{p},{a!r},{b!r},0.3,0.3" for p, (a, b) in zip(names, seen.tolist(), strict=True)]
    (folder / "observations.csv").write_text("\n".join(marks) + "\n")
    rows = ["id,role,x_m,y_m,z_m,sigma_east_m,sigma_north_m,sigma_up_m"]
    for name, role, place in zip(
        names, roles, (ground + rng.normal(scale=0.5, size=ground.shape)).tolist(), strict=True
    ):
        cells = [""] * 6 if role == "tie" else [*map(repr, place), "0.5", "0.5", "0.5"]
        rows.append(",".join([name, role, *cells]))
    (folder / "points.csv").write_text("\n".join(rows) + "\n")
    for name, isd in images.items():
        own = isd["instrument_position"]
        own["positions"] = (np.array(own["positions"]) + rng.normal(scale=0.05, size=3)).tolist()
        write(folder, isd, f"{name}.json")
    (folder / "project.toml").write_text("""schema = 1
name = "mars"
body = "Mars"
[[images]]
id = "a"
metadata = "a.json"
[[images]]
id = "b"
metadata = "b.json"
[points]
file = "points.csv"
crs = "body-fixed"
[observations]
file = "observations.csv"
""")
    return ground


@pytest.mark.oracle
def test_a_block_of_mars(tmp_path: Path, rng: np.random.Generator) -> None:
    """The adjustment removes orbit errors of 50 m: tie points are right within 3 m and sigma0 is about 1.

    The image noise of 0.3 px is 2 m.
    """
    ground = block(tmp_path, rng)
    solution = fg.adjust(fg.read_project(tmp_path / "project.toml"))
    ties = [k for k, name in enumerate(solution.block.points.ids) if name.startswith("tie")]
    apart = solution.ground_m[ties] - ground[12:52]
    assert len(ties) == 40 and 0.75 < solution.sigma0 < 1.25
    assert np.sqrt(np.mean(apart**2)) < 3.0
    images = [image.sensor for image in solution.block.images]
    assert all(sensor.body is not None and sensor.body.same(MARS) for sensor in images)
    moved = np.stack(images[0].project(ground)) - images[0].project(ground, solution.correction("a"))
    assert np.abs(moved).max() > 2.0


# --- damaged files ----------------------------------------------------------------------------------


def _set(place: str, value: Any) -> Callable[[dict[str, Any]], Any]:
    *way, last = place.split(".")

    def change(values: dict[str, Any]) -> None:
        for key in way:
            values = values[key]
        values[last] = value

    return change


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no rates": (lambda v: v.pop("line_scan_rate"), "json.missing"),
    "rates": (_set("line_scan_rate", [[0.5, 1.0]]), "json.numbers"),
    "rate zero": (_set("line_scan_rate", [[0.5, -1.9, 0.0]]), "earth.period"),
    "rates in order": (_set("line_scan_rate", [[0.5, -1.9, 0.002], [0.5, 0.0, 0.002]]), "earth.order"),
    "late": (_set("line_scan_rate", [[0.5, 5.0, 0.002]]), "isd.body_span"),
    "short pointing": (_set("instrument_pointing.ephemeris_times", np.linspace(3.5e8, 3.5e8 + 0.5, 41).tolist()),
                       "earth.list_span"),
    "one state": (lambda v: v["instrument_position"].update(
        ephemeris_times=[3.5e8 + 0.25], positions=[[1.0, 2.0, 3.0]], velocities=[[1.0, 2.0, 3.0]]), "isd.states"),
    "no velocities": (lambda v: v["instrument_position"].pop("velocities"), "json.missing"),
    "velocity": (lambda v: v["instrument_position"]["velocities"][2].__setitem__(1, 1e308), "isd.size"),
    "position in m": (lambda v: v["instrument_position"]["positions"][2].__setitem__(1, 4e12), "isd.size"),
    "quaternion": (lambda v: v["instrument_pointing"]["quaternions"][3].__setitem__(0, 2.0), "earth.quaternion"),
    "times": (lambda v: v["instrument_pointing"]["ephemeris_times"].reverse(), "isd.times"),
    "centre": (_set("center_ephemeris_time", 1.0), "isd.times"),
    "short body": (_set("body_rotation.ephemeris_times", [3.5e8, 3.5e8 + 0.2, 3.5e8 + 0.3]), "isd.body_span"),
    "body": (lambda v: v.pop("body_rotation"), "json.missing"),
    "focal": (_set("focal_length_model.focal_length", 0.0), "isd.focal"),
    "centre of the detector": (_set("detector_center", {}), "json.missing"),
    "detector": (_set("focal2pixel_samples", [0.0, 0.0, 140.0]), "isd.detector"),
    "summing": (_set("detector_sample_summing", 0), "isd.detector"),
    "distortion": (_set("optical_distortion", {"lrolrocnac": {"coefficients": [1.0]}}), "isd.distortion"),
    "coefficients": (_set("optical_distortion", {"radtan": {"coefficients": [1.0]}}), "json.numbers"),
    "constant": (_set("instrument_pointing.constant_rotation", [1.0] * 9), "frame.camera"),
    "lines": (_set("image_lines", -3), "json.count"),
    "radii": (_set("radii", {"semimajor": 0.0, "semiminor": 1.0, "unit": "km"}), "body.radii"),
    "narrow": (_set("focal2pixel_samples", [0.0, 1e9, 0.0]), "sensor.no_field"),
}  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize("name", list(DAMAGES))
def test_damaged_isd_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    isd, (damage, code) = twin.simulated(), DAMAGES[name]
    damage(isd)
    path = write(tmp_path, isd)
    with pytest.raises((InputError, OutOfTimeRange)) as caught:
        fg.read_sensor(path)
    (problem,) = caught.value.problems
    assert problem.code == code and problem.file == str(path) and problem.place and problem.remedy
    assert "\n" not in problem.text()
