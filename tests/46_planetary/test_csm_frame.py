"""Frame states of CSM and ISD are written and read; an independent evaluator checks them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.metadata.csm_frame import read_state, write_state
from fg_orient.formats.metadata.isd import read_isd, write_isd
from fg_orient.model.errors import InputError
from fg_orient.sensors.focal_plane import Distortion
from fg_orient.sensors.framing import FramingSensor
from tests.support.changed_text import change_file
from tests.support.csm_frame_twin import State
from tests.support.planetary_files import project, write_block

#: Distortions that a state holds exactly: about 20 pixels in the corners.
RADIAL = Distortion("radial", (1e-4, -2e-6, 3e-10))
TRANSVERSE = Distortion("transverse", (0.001, 1.0001, 2e-5, 1e-6, -2e-6, 3e-6, 1e-8, 0.0, 2e-8, 0.0,
                                       -0.002, 1e-5, 0.9999, 2e-6, 1e-6, 0.0, 0.0, 3e-8, 0.0, -1e-8))  # fmt: skip
RADTAN = Distortion("radtan", (-2e-3, 4e-3, 3e-4, -5e-4, 1e-3, 76.054))
MODELS = {"none": Distortion(), "radial": RADIAL, "transverse": TRANSVERSE, "radtan": RADTAN}


def with_distortion(sensor: FramingSensor, distortion: Distortion) -> FramingSensor:
    """Return the sensor with another distortion."""
    camera = replace(sensor.camera, distortion=distortion)
    return FramingSensor(camera, sensor.n_lines, sensor.n_samples, sensor.body, taken=sensor.taken, file=sensor.file)


def grid(sensor: FramingSensor) -> tuple[Any, Any]:
    """Return the pixels over the image."""
    line, sample = np.meshgrid(np.linspace(0, sensor.last_line, 9), np.linspace(0, sensor.last_sample, 9))
    return line.ravel(), sample.ravel()


@pytest.mark.oracle
@pytest.mark.parametrize("model", list(MODELS))
def test_written_state_by_an_independent_evaluator(tmp_path: Path, model: str) -> None:
    """An independent evaluator of a written frame state projects as the sensor within 1e-6 px.

    The camera looks backwards along its third axis; the state has other axes and a mirrored distortion.
    """
    name = write_block(tmp_path, n_points=5)[0]
    sensor = with_distortion(read_isd(tmp_path / f"{name}.isd"), MODELS[model])
    assert sensor.camera.focal_mm < 0.0
    correction = np.array([30.0, -20.0, 10.0, 1e-3, -2e-3, 3e-3])
    record = write_state(tmp_path / "state.json", sensor, correction)
    assert record["largest_px"] < 1e-9
    line, sample = grid(sensor)
    ground = sensor.locate(line, sample, height_m=200.0, correction=correction)
    state = State(tmp_path / "state.json")
    theirs = np.array([state.pixel(point) for point in ground]) - 0.5
    assert np.abs(theirs - np.column_stack([line, sample])).max() < 1e-6


@pytest.mark.oracle
@pytest.mark.real_data
def test_metric_camera_as_a_state(real_data: Path, tmp_path: Path) -> None:
    """A state of the Apollo camera has radial and tangential distortion and is exact to 0.06 px of the image.

    0.057 px are 1.1 um on the film. The nearest transverse distortion leaves 3.2 px, the nearest radial one 3.7 px.
    """
    sensor, path = read_isd(real_data / "isis-apollo/Sub4-AS15-M-0583_msk.isd"), tmp_path / "state.json"
    record = write_state(path, sensor)
    assert record["distortion"] == "radtan" and record["largest_px"] < 0.06 and record["mean_px"] < 0.006
    line, sample = grid(sensor)
    ground = sensor.locate(line, sample, height_m=200.0)
    theirs = np.array([State(path).pixel(point) for point in ground]) - 0.5
    assert np.hypot(*(theirs - np.column_stack([line, sample])).T).max() < 0.06


@pytest.mark.consistency
@pytest.mark.parametrize("model", list(MODELS))
def test_state_round_trip(tmp_path: Path, model: str) -> None:
    """A frame state that is read, written and read keeps its centre within 1e-9 m and pixels within 1e-6 px."""
    name = write_block(tmp_path, n_points=5)[0]
    write_state(tmp_path / "one.json", with_distortion(read_isd(tmp_path / f"{name}.isd"), MODELS[model]))
    one = fg.read_sensor(tmp_path / "one.json")
    write_state(tmp_path / "two.json", one)
    two = fg.read_sensor(tmp_path / "two.json")
    assert np.abs(two.camera.centre_m - one.camera.centre_m).max() < 1e-9
    line, sample = grid(one)
    ground = one.locate(line, sample, height_m=0.0)
    assert np.abs(np.stack(two.project(ground)) - [line, sample]).max() < 1e-6


@pytest.mark.consistency
@pytest.mark.parametrize("form", ["isd", "state"])
def test_adjusted_images_written_and_read(tmp_path: Path, form: str) -> None:
    """Adjusted images written as ISD or state project the ground points as the adjustment within the stated error."""
    names = write_block(tmp_path, n_points=20)
    solution, out = fg.adjust(fg.read_project(tmp_path / "project.toml")), tmp_path / "out"
    out.mkdir()
    for image in solution.block.images:
        sensor, correction = image.sensor, solution.correction(image.id)
        ground = solution.ground_m
        expected = sensor.project(ground, correction)
        if form == "isd":
            write_isd(out / f"{image.id}.isd", sensor, correction)
            again, limit = fg.read_sensor(out / f"{image.id}.isd"), 1e-6
            assert again.serial == sensor.serial
        else:
            record = write_state(out / f"{image.id}.json", sensor, correction)
            again, limit = fg.read_sensor(out / f"{image.id}.json"), 1.01 * record["largest_px"]
            assert 1e-5 < record["largest_px"] < 1e-3  # radial and tangential: 0.057 px over the whole frame
        assert np.abs(again.camera.centre_m - sensor.camera.corrected(correction).centre_m).max() < 1e-9
        seen = np.isfinite(expected[0]) & sensor.is_inside(*expected)
        assert np.hypot(*(np.stack(again.project(ground)) - expected))[seen].max() <= limit
    assert names


@pytest.mark.consistency
def test_block_of_states(tmp_path: Path) -> None:
    """A block of states has the sigma0 and ground points of the block of ISD if priors are wide.

    Its priors are along other axes.
    """
    names = write_block(tmp_path)
    for name in names:
        path = tmp_path / f"{name}.isd"
        values = json.loads(path.read_text())
        values["optical_distortion"] = {"radial": {"coefficients": list(RADIAL.coefficients)}}
        path.write_text(json.dumps(values))
    same = fg.read_project(tmp_path / "project.toml")
    for image in same.images:
        write_state(tmp_path / f"{image.id}.json", image.sensor)
    text = project(names).replace(".isd", ".json") + "[observations.images]\n"
    text += "".join(f'"{image.sensor.serial}" = "{image.id}"\n' for image in same.images)
    (tmp_path / "states.toml").write_text(text)
    block = fg.read_project(tmp_path / "states.toml")
    wide = {"position_sigma_m": (1e6, 1.0, 1.0), "attitude_sigma_rad": (10.0, 1.0, 1.0)}
    one, two = fg.adjust(block, **wide), fg.adjust(same, **wide)
    assert one.redundancy == two.redundancy
    assert one.sigma0 == pytest.approx(two.sigma0, rel=1e-6)
    assert np.abs(one.ground_m - two.ground_m).max() < 0.1  # of 100 m


# --- damaged files ----------------------------------------------------------------------------------


def _isd(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "M-0001.isd"
        values = json.loads(path.read_text())
        change(values)
        path.write_text(json.dumps(values))

    return damage


def _text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        change_file(folder / name, (old, new))

    return damage


def _set(place: str, value: Any) -> Callable[[Path], None]:
    *way, last = place.split(".")

    def change(values: dict[str, Any]) -> None:
        for key in way:
            values = values[key]
        values[last] = value

    return _isd(change)


DAMAGES: dict[str, tuple[Callable[[Path], None], str]] = {
    "not JSON": (_text("M-0001.isd", "{", ""), ""),
    "cut": (lambda f: (f / "M-0001.isd").write_text((f / "M-0001.isd").read_text()[:900]), "json.syntax"),
    "empty ISD": (lambda f: (f / "M-0001.isd").write_text(""), ""),
    "model": (_set("name_model", ["USGS_ASTRO_FRAME_SENSOR_MODEL"]), "json.text"),
    "lines": (_set("image_lines", 0), "json.count"),
    "samples": (_set("image_samples", "many"), "json.numbers"),
    "no radii": (_isd(lambda v: v.pop("radii")), "json.missing"),
    "radii": (_set("radii.semimajor", -1.0), "body.radii"),
    "unit": (_set("radii.unit", "miles"), "isd.unit"),
    "other body": (_set("radii.semimajor", 3396.19), "body.differs"),
    "no position": (_isd(lambda v: v.pop("instrument_position")), "json.missing"),
    "position": (_set("instrument_position.positions", [[1.0, 2.0]]), "json.numbers"),
    "nan": (_set("instrument_position.positions", [[1.0, 2.0, float("nan")]]), "json.syntax"),
    "quaternion": (_set("instrument_pointing.quaternions", [[1.0, 1.0, 0.0, 0.0]]), "earth.quaternion"),
    "time": (_set("center_ephemeris_time", 5e8), "isd.times"),
    "times": (_set("instrument_pointing.ephemeris_times", [0.0, 1.0]), "json.numbers"),
    "matrix": (_set("body_rotation.constant_rotation", [1.0] * 9), "frame.camera"),
    "focal": (_set("focal_length_model.focal_length", 0.0), "frame.camera"),
    "no focal": (_set("focal_length_model", {}), "json.missing"),
    "detector": (_set("focal2pixel_lines", [0.0, 0.0, 0.0]), "isd.detector"),
    "summing": (_set("detector_line_summing", -1.0), "isd.detector"),
    "distortion": (_set("optical_distortion", {"cahvor": {}}), "isd.distortion"),
    "coefficients": (_set("optical_distortion", {"radial": {"coefficients": [1.0]}}), "json.numbers"),
    "label": (_text("M-0001.pvl", "End_Group", ""), "pvl.end"),
    "open label": (_text("M-0001.pvl", "End_Object\nEnd", ""), "pvl.open"),
    "alpha cube": (_text("M-0001.pvl", "AlphaLines          = 8000", "AlphaLines          = many"), "pvl.numbers"),
    "type": (_text("net.pvl", "PointType = Free", "PointType = Loose"), "isis.type"),
    "no id": (_text("net.pvl", "PointId = P1", "PointIt = P1"), "pvl.missing"),
    "coordinate": (_text("net.pvl", "    AprioriX =", "    AprioriX = x"), "pvl.statement"),
    "covariance": (_text("net.pvl", "AprioriCovarianceMatrix = (", "AprioriCovarianceMatrix = (-"), "isis.covariance"),
    "twice": (_text("net.pvl", "PointId = P1\n", "PointId = P2\n"), "points.id_twice"),
    "sample": (_text("net.pvl", "Sample = ", "Sample = -"), "observations.outside"),
    "serial": (_text("net.pvl", "SerialNumber = APOLLO15", "SerialNumber = APOLLO16"), "observations.image_unknown"),
    "statement": (_text("net.pvl", "      Line = ", "      Line "), "pvl.statement"),
    "no network": (lambda f: (f / "net.pvl").write_text("Object = Other\nEnd_Object\nEnd\n"), "isis.no_network"),
    "empty network": (lambda f: (f / "net.pvl").write_text(""), "pvl.empty"),
    "body": (_text("project.toml", 'body = "Moon"', 'body = "Moonlet"'), "body.unknown"),
    "crs": (_text("project.toml", '[points]\n', '[points]\ncrs = "EPSG:4979"\n'), "isis.crs"),
}  # fmt: skip


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a sound block."""
    folder = tmp_path_factory.mktemp("sound")
    write_block(folder, n_points=12)
    fg.read_project(folder / "project.toml")
    return folder


@pytest.mark.behaviour
@pytest.mark.parametrize("name", list(DAMAGES))
def test_damaged_files_are_refused_in_one_line(sound: Path, tmp_path: Path, name: str) -> None:
    for path in sound.iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    damage, code = DAMAGES[name]
    damage(tmp_path)
    with pytest.raises(InputError) as caught:
        fg.read_project(tmp_path / "project.toml")
    problems = caught.value.problems
    assert not code or code in {p.code for p in problems}
    assert all("\n" not in p.text() and p.remedy for p in problems)
    assert all(p.file.startswith(str(tmp_path)) for p in problems)


STATES: dict[str, tuple[str, Any, str]] = {
    "model": ("m_modelName", "OTHER", "isd.model"),
    "parameters": ("m_currentParameterValue", [0.0] * 6, "json.numbers"),
    "quaternion": ("m_currentParameterValue", [0.0] * 7, "earth.quaternion"),
    "focal": ("m_focalLength", -1.0, "csm.focal"),
    "distortion": ("m_distortionType", 5, "isd.distortion"),
    "coefficients": ("m_opticalDistCoeffs", [1.0], "isd.coefficients"),
    "principal": ("m_linePp", 1.0, "csm.principal"),
    "detector": ("m_iTransS", [0.0, 0.0, 0.0], "isd.detector"),
    "axis": ("m_minorAxis", 0.0, "body.radii"),
    "size": ("m_nLines", 1.5, "json.count"),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("name", list(STATES))
def test_damaged_states_are_refused(sound: Path, tmp_path: Path, name: str) -> None:
    path, (key, value, code) = tmp_path / "state.json", STATES[name]
    write_state(path, with_distortion(read_isd(sound / "M-0000.isd"), RADIAL))
    model, _, body = path.read_text().partition("\n")
    path.write_text(f"{model}\n{json.dumps(json.loads(body) | {key: value})}\n")
    with pytest.raises(InputError) as caught:
        read_state(path)
    (problem,) = caught.value.problems
    assert problem.code == code
    assert problem.file == str(path)
