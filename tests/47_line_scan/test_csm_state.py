"""Line-scan states of CSM are read and written; a second evaluator follows the published definitions."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from factors.geometry import interpolation
from fg_orient.formats.metadata.csm_state import write_compared
from fg_orient.formats.rpc import write_rpc
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.line_detector import fit_detector
from fg_orient.sensors.pushbroom import PushbroomSensor
from tests.support import csm_line_scan as csm
from tests.support.command import in_process
from tests.support.isd_files import write_isd
from tests.support.rpc_model import synthetic_model

WV3 = "worldview-wv3/1040010074793300.json"


def pixels(sensor: PushbroomSensor, n: int = 5) -> tuple[np.ndarray, np.ndarray]:
    line, sample = np.meshgrid(
        np.linspace(sensor.first_line, sensor.last_line, n),
        np.linspace(sensor.first_sample, sensor.last_sample, n), indexing="ij",
    )  # fmt: skip
    return line.ravel(), sample.ravel()


def apart_px(path: Path, sensor: PushbroomSensor, correction: Correction | None = None) -> float:
    """Return the largest distance, px: pixels to the ground by the second evaluator, back by the sensor."""
    return largest_px(path, sensor, *pixels(sensor), correction)


def band_px(path: Path, sensor: PushbroomSensor, columns: list[int], n: int) -> float:
    """Return the largest difference in pixels at three lines and ``n`` samples of a state's band of columns."""
    line, sample = np.meshgrid(
        np.linspace(sensor.first_line, sensor.last_line, 3), np.linspace(columns[0], columns[1] - 1.0, n)
    )
    assert csm.read_state(path)["m_nSamples"] == columns[1] - columns[0]
    return largest_px(path, sensor, line.ravel(), sample.ravel(), None, columns[0])


def largest_px(
    path: Path, sensor: PushbroomSensor, line: np.ndarray, sample: np.ndarray, correction: Correction | None,
    first: int = 0,
) -> float:  # fmt: skip
    """Return the largest difference in pixels at pixels of the image.

    The image of the state begins with column ``first``.
    """
    state = csm.read_state(path)
    worst = 0.0
    for height_m in (0.0, 800.0):
        ground = np.array(
            [csm.to_ground(state, a + 0.5, b - first + 0.5, height_m) for a, b in zip(line, sample, strict=True)]
        )
        got = np.stack(sensor.project(ground, correction), axis=1) - np.stack([line, sample], axis=1)
        worst = max(worst, float(np.abs(got).max()))
    return worst


def corrected(rng: np.random.Generator, n_curves: int = 4) -> Correction:
    """Return the corrections of metres and some 1e-5 rad, with curves over some intervals."""
    size = np.array([3.0] * 3 + [1e-3] * 3 + [2e-5] * 3)
    curve = np.array([0.5] * 3 + [0.0] * 3 + [2e-6] * 3)[:, None] * rng.normal(size=(9, n_curves))
    return Correction(rng.normal(size=(9, 3)) * size[:, None] * [1.0, 0.3, 0.1], curve=curve)


# --- reading ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def invented(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the state of an invented satellite with two line rates."""
    folder = tmp_path_factory.mktemp("state")
    write_compared(folder / "state.json", read_sensor(write_isd(folder)))
    return (folder / "state.json").read_bytes()


@pytest.fixture
def state_file(tmp_path: Path, invented: bytes) -> Path:
    path = tmp_path / "state.json"
    path.write_bytes(invented)
    return path


def changed(path: Path, **fields: Any) -> Path:
    state = csm.read_state(path)
    text = json.dumps(state | {name: value for name, value in fields.items() if value is not None})
    path.write_text(f"{csm.MODEL}\n{text}\n", encoding="utf-8")
    return path


@pytest.mark.oracle
@pytest.mark.parametrize("fields", [
    {},
    {"m_distortionType": 0, "m_opticalDistCoeffs": [1e-3, 2e-10, -3e-18]},
    {"m_distortionType": 1, "m_opticalDistCoeffs": [3.0, 1.001, 2e-3, 1e-8, 0, 0, 2e-13, 0, 0, 0,
                                                    -2.0, 1e-3, 0.999, 3e-8, 0, 0, 1e-13, 0, 0, 0]},
    {"m_zDirection": -1.0},
    {"m_detectorSampleSumming": 2.0, "m_startingDetectorSample": 40.0, "m_iTransL": [3.0, 0.01, 1.0]},
    {"m_iTransS": [0.0, 0.02, 1.0], "m_iTransL": [0.0, 1.0, 0.02]},
])  # fmt: skip
def test_features_of_a_state(state_file: Path, fields: dict[str, Any]) -> None:
    """Each feature of a line-scan state is read as by the second evaluator within 2e-6 px, a micrometre on the ground.

    Features are distortion, direction of z, summing, first sample and a detector along y.
    """
    path = changed(state_file, **fields)
    assert apart_px(path, read_sensor(path)) < 2e-6


@pytest.mark.oracle
def test_fewer_samples_near_the_ends(rng: np.random.Generator) -> None:
    """Interpolation has the order 8 inside the list and 6, 4, 2 at its ends, as the second evaluator has."""
    times, values = 0.3 + 0.02 * np.arange(12), rng.normal(size=(12, 3))
    at = np.concatenate([np.linspace(0.295, 0.525, 50), times])
    expected = np.array([csm.interpolated(values, 0.3, 0.02, t) for t in at])
    assert np.abs(interpolation.centred(times, values, at) - expected).max() < 1e-12


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", [WV3, "worldview-wv3/1040010075633C00.adjusted_state.json"])
def test_states_of_another_program(real_data: Path, name: str) -> None:
    sensor = read_sensor(real_data / name)
    assert (sensor.n_samples, sensor.metadata.format) == (43_008, "CSM state")
    assert apart_px(real_data / name, sensor) < 2e-6


# --- writing ------------------------------------------------------------------------------------


@pytest.mark.consistency
@pytest.mark.real_data
@pytest.mark.parametrize(("n_curves", "most_px"), [(0, 1e-6), (4, 2e-5)])
def test_round_trip_of_a_state(
    real_data: Path, tmp_path: Path, rng: np.random.Generator, n_curves: int, most_px: float
) -> None:
    """A corrected state that is written and read twice keeps positions within 1e-9 m and rays; curves cost 2e-5 px.

    Curves have jumps of the third derivative at the ends of their intervals, which polynomials through samples of 20 ms
    smooth: 9e-6 px.
    """
    sensor, correction = read_sensor(real_data / WV3), corrected(rng, n_curves)
    record = write_compared(tmp_path / "a.json", sensor, correction)
    assert record["largest_px"] < most_px and apart_px(tmp_path / "a.json", sensor, correction) < 2.0 * most_px
    once = read_sensor(tmp_path / "a.json")
    line = np.linspace(0.0, sensor.n_lines - 1.0, 50)
    states = sensor.states(line)
    p, _ = sensor.oriented(states, states.mount, correction)
    assert np.abs(once.states(line).position_m - p).max() < (4e-9 if n_curves == 0 else 1e-6)  # ulp of 7e6 m: 9e-10
    write_compared(tmp_path / "b.json", once)
    twice = read_sensor(tmp_path / "b.json")
    assert np.abs(twice.metadata.ephemeris.position_m - once.metadata.ephemeris.position_m).max() <= 1e-9
    assert np.abs(twice.rays(line, line)[1] - once.rays(line, line)[1]).max() < 1e-15 * 10


@pytest.mark.oracle
@pytest.mark.real_data
@pytest.mark.parametrize(("name", "most_px"), [
    ("geocosicorr3d/SPOT2.DIM", 1e-3), ("geocosicorr3d/SPOT4.DIM", 1e-3), ("geocosicorr3d/SPOT6.XML", 1e-3),
    ("shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML", 1e-3), ("worldview-wv3/1040010074793300.xml", 1e-3),
])  # fmt: skip
def test_rigorous_models_as_states(
    real_data: Path, tmp_path: Path, name: str, most_px: float, rng: np.random.Generator
) -> None:
    """Each rigorous model written as a state projects by the second evaluator within 1e-3 px.

    Measured are 1e-6 px (SPOT 1 to 4, Pléiades) and 1.1e-4 px (SPOT 6).
    """
    sensor, path = read_sensor(real_data / name, extrapolate_attitude_s=0.2), tmp_path / "state.json"
    for correction in (None, corrected(rng)):
        record = write_compared(path, sensor, correction)
        assert apart_px(path, sensor, correction) < most_px
        assert record["largest_px"] < most_px


@pytest.mark.oracle
@pytest.mark.real_data
@pytest.mark.slow
def test_spot_5_as_state(real_data: Path, tmp_path: Path) -> None:
    """SPOT 5 as one state is exact to 0.03 px, and as six bands of columns to 1e-3 px.

    Its look angles are polynomials of degree 5 in both directions, which no distortion of CSM contains. A polynomial of
    degree 4 leaves 0.13 px, of degree 5 1e-4 px; a radial distortion has the terms of degree 5, but the same ones for
    both directions.
    """
    source = real_data / "geocosicorr3d/SPOT5.DIM"
    sensor, path = read_sensor(source), tmp_path / "state.json"
    record = write_compared(path, sensor)
    assert apart_px(path, sensor) < 0.03 and record["largest_px"] < 0.03
    done = in_process("convert", source, "--to", "csm-state", "--bands", "6", "--out", path, "--json")
    assert done.code == 0 and done.json["largest_px"] < 1e-3, done.stderr
    bands = [band["columns"] for band in done.json["bands"]]
    assert [bands[0][0], *(end for _, end in bands)] == list(range(0, 12_001, 2_000))
    for out, columns in zip(done.json["out"], bands, strict=True):
        assert band_px(Path(out), sensor, columns, 41) < 1e-3
    psi_x, psi_y = sensor.look_angles(np.arange(12_000.0))
    for degree, low, high in ((4, 0.02, 0.2), (5, 0.0, 2e-4)):
        for tangent in (np.tan(psi_x), np.tan(psi_y)):
            fit = np.polynomial.Polynomial.fit(np.arange(12_000.0), tangent, degree)
            worst = np.abs(fit(np.arange(12_000.0)) - tangent).max() / 6.011e-6
            assert low <= worst < high


@pytest.mark.behaviour
def test_convert_writes_a_state(tmp_path: Path) -> None:
    source, out = write_isd(tmp_path), tmp_path / "state.json"
    done = in_process("convert", source, "--to", "csm-state", "--out", out, "--json")
    assert done.code == 0, done.stderr
    assert done.json["to"] == "csm-state" and done.json["largest_px"] < 1e-5
    assert apart_px(out, read_sensor(source)) < 1e-5
    again = in_process("convert", source, "--to", "csm-state", "--out", out)
    assert again.code == 2 and "--overwrite" in again.stderr
    done = in_process("convert", source, "--to", "csm-state", "--out", out, "--overwrite")
    assert done.code == 0 and "largest 0.0000" in done.stdout


@pytest.mark.oracle
def test_look_angles_of_degree_5_in_bands(tmp_path: Path) -> None:
    """The error of bands of columns falls with the fourth power of their width, within a factor of 2.

    The bands have cubic polynomials in both directions.
    """
    n = 8_000
    u = np.linspace(-1.0, 1.0, n)
    curved = np.stack([0.3 * u**3 + 0.2 * u**4 + u**5, 0.2 * u**2 - 0.1 * u**4 + 0.15 * u**5], axis=1)
    tangents = 5e-6 * (np.stack([-4_000.0 * u, 30.0 + u], axis=1) + curved)

    def largest(bands: int) -> float:
        worst = 0.0
        for part in np.split(np.arange(n), bands):
            camera = fit_detector(part.astype(float), tangents[part], band=True)
            apart = np.abs(camera.directions(part.astype(float))[:, :2] - tangents[part]).max() / 5e-6
            assert apart == pytest.approx(max(camera.largest_px), rel=0.02)
            worst = max(worst, float(apart))
        return worst

    wide, narrow = largest(8), largest(16)
    assert 8.0 < wide / narrow < 32.0 and narrow < 1e-3


@pytest.mark.behaviour
def test_convert_writes_bands(tmp_path: Path) -> None:
    """``convert --bands`` writes a state per band of columns, exact to 1e-5 px, and refuses wrong numbers of bands."""
    source, out = write_isd(tmp_path), tmp_path / "state.json"
    sensor = read_sensor(source)
    done = in_process("convert", source, "--to", "csm-state", "--bands", "3", "--out", out, "--json")
    assert done.code == 0, done.stderr
    assert [band["columns"][1] for band in done.json["bands"]][-1] == sensor.n_samples
    assert max(band["largest_px"] for band in done.json["bands"]) == done.json["largest_px"]
    done = in_process("convert", source, "--to", "csm-state", "--bands", "3", "--out", out, "--overwrite")
    ends = [round(k * sensor.n_samples / 3) for k in range(4)]
    for k, columns in enumerate(itertools.pairwise(ends)):
        path = tmp_path / f"state_{k + 1}.json"
        assert f"{path}, columns {columns[0]} .. {columns[1] - 1}" in done.stdout
        assert band_px(path, sensor, list(columns), 5) < 1e-5
    again = in_process("convert", source, "--to", "csm-state", "--bands", "3", "--out", out)
    assert again.code == 2 and "state_1.json" in again.stderr
    for bands, target, code in (("0", "csm-state", "1 or more"), ("100000", "csm-state", "1 .. "),
                                ("2", "isd", "divided into bands")):  # fmt: skip
        done = in_process("convert", source, "--to", target, "--bands", bands, "--out", tmp_path / "a.json")
        assert done.code == 2 and code in done.stderr


@pytest.mark.behaviour
def test_an_rpc_does_not_become_a_state(tmp_path: Path) -> None:
    write_rpc(tmp_path / "image_RPC.TXT", synthetic_model())
    done = in_process("convert", tmp_path / "image_RPC.TXT", "--to", "csm-state", "--out", tmp_path / "state.json")
    assert done.code == 2 and "rigorous model of a pushbroom" in done.stderr


# --- damaged states -----------------------------------------------------------------------------

BAD: list[tuple[dict[str, Any], str]] = [
    ({"m_nLines": 0}, "json.count"),
    ({"m_positions": [1.0, 2.0, 3.0, 4.0]}, "csm.list"),
    ({"m_dtQuat": 0.0}, "csm.list"),
    ({"m_velocities": [1.0]}, "json.numbers"),
    ({"m_quaternions": [1.0] * 640}, "earth.quaternion"),
    ({"m_focalLength": -1.0}, "csm.camera"),
    ({"m_iTransS": [0.0, 0.0, 0.0]}, "csm.camera"),
    ({"m_iTransL": [0.0, 0.0]}, "json.numbers"),
    ({"m_zDirection": 0.5}, "csm.camera"),
    ({"m_distortionType": 4}, "isd.distortion"),
    ({"m_opticalDistCoeffs": [0.0]}, "isd.coefficients"),
    ({"m_currentParameterValue": [0.0, 1.0]}, "csm.parameters"),
    ({"m_platformFlag": 0}, "csm.aircraft"),
    ({"m_majorAxis": -1_737_400.0}, "body.radii"),
    ({"m_intTimes": [0.0] * 3}, "earth.period"),
    ({"m_intTimeLines": [5.0, 1.0, 9.0]}, "earth.order"),
    ({"m_intTimeStartTimes": [900.0, 901.0, 902.0]}, "earth.list_span"),
    ({"m_modelName": "USGS_ASTRO_SAR_SENSOR_MODEL"}, "isd.model"),
    ({"m_focalLength": "x"}, "json.numbers"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("fields", "code"), BAD)
def test_damaged_states_are_one_clear_line(state_file: Path, fields: dict[str, Any], code: str) -> None:
    text = json.dumps(csm.read_state(state_file) | fields)
    state_file.write_text(f"{csm.MODEL}\n{text}\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_sensor(state_file)
    (problem,) = caught.value.problems
    assert problem.code == code and problem.file == str(state_file) and problem.place and "\n" not in str(problem)


@pytest.mark.behaviour
def test_a_state_that_is_cut(state_file: Path) -> None:
    text = state_file.read_text(encoding="utf-8")
    state_file.write_text(text[: len(text) // 2], encoding="utf-8")
    with pytest.raises(InputError, match="not JSON"):
        read_sensor(state_file)
