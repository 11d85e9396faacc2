"""The model of DigitalGlobe ISD files is compared with independent code, the vendor's RPC and another program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from factors.geometry.ellipsoid import geodetic_array
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.light_sizes import light_sizes
from fg_orient.sensors.metadata import SegmentTiming
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support import csm_line_scan as csm
from tests.support.command import in_process
from tests.support.isd_files import write_isd
from tests.support.isd_line_scan import IsdCamera

PAIR = ("1040010074793300", "1040010075633C00")


def grid(sensor: GeneralPushbroom, n: int = 9) -> tuple[np.ndarray, np.ndarray]:
    line, sample = np.meshgrid(
        np.linspace(0.0, sensor.n_lines - 1.0, n), np.linspace(0.0, sensor.n_samples - 1.0, n), indexing="ij"
    )
    return line.ravel(), sample.ravel()


def apart_px(sensor: GeneralPushbroom, ground: np.ndarray, line: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Return the lines and samples (n, 2) at which the sensor sees ground points, minus pixels."""
    return np.stack(sensor.project(ground), axis=1) - np.stack([line, sample], axis=1)


@pytest.mark.oracle
@pytest.mark.parametrize("aberration", [False, True])
def test_invented_satellite_equals_independent_code(tmp_path: Path, aberration: bool) -> None:
    """An invented ISD with two line rates is projected as by independent code within 1e-5 px, 3 um.

    The camera is rotated, shifted and has an inclined detector line. With aberration the limit is 2e-3 px, because the
    model is of first order in v/c.
    """
    path = write_isd(tmp_path)
    sensor, camera = read_sensor(path, light=("aberration",) if aberration else ("none",)), IsdCamera(path)
    assert isinstance(sensor.metadata.timing, SegmentTiming)
    line, sample = grid(sensor, 5)
    line = np.append(line, [7999.5, 8000.5])  # beside the change of the rate
    sample = np.append(sample, [10.0, 11_000.0])
    ground = camera.to_ground(line, sample, 250.0, aberration)
    # first order in v/c against the sum of velocities: (v/c)^2 = 6e-10 rad, 1.2e-3 px
    assert np.abs(apart_px(sensor, ground, line, sample)).max() < (2e-3 if aberration else 1e-5)


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", PAIR)
def test_rigorous_model_meets_the_vendors_rpc(real_data: Path, name: str) -> None:
    """The WorldView model without effects on light fits the vendor's RPC: mean <= 0.5 px, standard deviation <= 1 px.

    The attitudes of the file contain the effects. Measured: mean <= 0.1 px, sd 0.3 to 0.93 px.
    """
    path = real_data / "worldview-wv3" / f"{name}.xml"
    sensor, rpc = read_sensor(path), read_sensor(path, model="rpc")
    assert isinstance(sensor, GeneralPushbroom) and isinstance(rpc, RpcSensor)
    line, sample = grid(sensor)
    for height_m in (0.0, 400.0):
        ground = sensor.locate(line, sample, height_m=height_m)
        apart = np.stack(rpc.project(ground), axis=1) - np.stack([line, sample], axis=1)
        assert np.abs(apart.mean(axis=0)).max() <= 0.5 and apart.std(axis=0).max() <= 1.0
        assert np.abs(IsdCamera(path).rpc_pixels(ground) - np.stack(rpc.project(ground), axis=1)).max() < 1e-6


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", PAIR)
def test_effects_on_light_take_it_away_from_the_rpc(real_data: Path, name: str) -> None:
    """Each effect on light moves pixels by its stated size; the aberration moves them by 45 to 51 px."""
    path = real_data / "worldview-wv3" / f"{name}.xml"
    plain = read_sensor(path)
    line, sample = grid(plain, 3)
    ground, sizes = plain.locate(line, sample, height_m=0.0), {one["effect"]: one for one in light_sizes(plain)}
    for effect, low, high in (("aberration", 45.0, 51.0), ("light_time", 0.8, 1.1), ("refraction", 2.5, 4.0)):
        other = read_sensor(path, light=(effect,))
        shift = apart_px(other, ground, line, sample)
        assert low < np.linalg.norm(shift, axis=1).max() < high
        assert sizes[effect]["largest_px"] == pytest.approx(np.linalg.norm(shift, axis=1).max(), rel=0.01)
        stated = np.array([sizes[effect]["line_px"], sizes[effect]["sample_px"]])
        assert np.abs(shift.mean(axis=0) - stated).max() < 0.01 * high
        assert not sizes[effect]["applied"] and any(effect.replace("_", " ") in str(note) for note in plain.notes)


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", PAIR)
def test_model_equals_independent_code(real_data: Path, name: str) -> None:
    """The WorldView model agrees with independent code within 0.01 px, the noise of the attitudes.

    One interpolates by slerp and Hermite polynomials, the other by Lagrange polynomials.
    """
    path = real_data / "worldview-wv3" / f"{name}.xml"
    camera = IsdCamera(path)
    for aberration in (False, True):
        sensor = read_sensor(path, light=("aberration" if aberration else "none",))
        line, sample = grid(sensor)
        ground = camera.to_ground(line, sample, 100.0, aberration)
        assert np.abs(apart_px(sensor, ground, line, sample)).max() < 0.01


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", PAIR)
def test_state_of_another_program(real_data: Path, name: str) -> None:
    """ASP's state agrees with our model with all effects on light within 1 px, and 0.01 px with the file's attitudes.

    ASP rotates the attitudes by all three effects. One rotation applies to all samples of a line, while the effects
    change by 0.6 px along it.
    """
    folder = real_data / "worldview-wv3"
    state, sensor = csm.read_state(folder / f"{name}.json"), read_sensor(folder / f"{name}.xml")
    states = sensor.metadata.ephemeris
    assert np.array_equal(np.reshape(state["m_positions"], (-1, 3)), states.position_m)
    line, sample = grid(sensor, 3)
    ground = np.array([csm.to_ground(state, a + 0.5, b + 0.5, 0.0) for a, b in zip(line, sample, strict=True)])
    apart = apart_px(sensor, ground, line, sample)
    assert 45.0 < np.linalg.norm(apart, axis=1).mean() < 52.0
    every = read_sensor(folder / f"{name}.xml", light=("aberration", "light_time", "refraction"))
    assert np.abs(apart_px(every, ground, line, sample)).max() < 1.0
    q = sensor.metadata.attitude.quaternion[:, [1, 2, 3, 0]]
    half = np.sqrt(0.5)  # their camera: x along samples, y along lines; a quarter turn about z
    x, y, z, w = q.T
    turned = np.stack([half * (x - y), half * (x + y), half * (z - w), half * (w + z)], axis=1)
    state["m_quaternions"] = turned.ravel().tolist()
    ground = np.array([csm.to_ground(state, a + 0.5, b + 0.5, 0.0) for a, b in zip(line, sample, strict=True)])
    assert np.abs(apart_px(sensor, ground, line, sample)).max() < 0.01


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", PAIR)
def test_locate_frame_compares_with_the_rpc_of_the_file(real_data: Path, name: str) -> None:
    """``locate --frame`` fits the RPC of the file within 1 m, and with aberration it misfits by 15 to 20 m.

    Measured are 0.02 to 0.5 m; a pixel has 0.35 m.
    """
    path = real_data / "worldview-wv3" / f"{name}.xml"
    done = in_process("locate", path, "--frame", "--json")
    points = done.json["points"]
    assert len(points) == 9 and {one["height_from"] for one in points} == {"file"}
    assert max(one["misfit_m"] for one in points) < 1.0
    away = in_process(
        "locate", real_data / "worldview-wv3" / f"{name}.xml", "--frame", "--json", "--light", "aberration"
    )
    assert all(15.0 < one["misfit_m"] < 20.0 for one in away.json["points"])


@pytest.mark.behaviour
def test_unknowns_curves_and_kernels_are_those_of_every_pushbroom(tmp_path: Path) -> None:
    sensor = read_sensor(write_isd(tmp_path))
    model = sensor.image_model(fg.Options(eop_set=15, curve_intervals=4))
    assert {"roll_0", "x_0", "roll_c0"} <= set(model.parameters.names)
    facts = model.facts()
    assert [one["effect"] for one in facts["light"]] == ["light_time", "aberration", "refraction"]
    assert facts["mission"] == "WV09" and facts["format"] == "DigitalGlobe ISD"


@pytest.mark.behaviour
def test_choice_of_the_effects(tmp_path: Path) -> None:
    path = write_isd(tmp_path)
    assert not read_sensor(path).metadata.effects
    assert not read_sensor(path, light=("none",)).metadata.effects
    chosen = read_sensor(path, light=("refraction", "light_time")).metadata.effects
    assert chosen.refraction and chosen.light_time and not chosen.aberration
    for wrong in (("abberation",), ("none", "aberration")):
        with pytest.raises(InputError, match="effect on light"):
            read_sensor(path, light=wrong)


BAD = [
    (("<NUMROWS>20000", "<NUMROWS>1"), "out_of_range"),
    (("<SATID>WV09</SATID>", ""), "missing_element"),
    (("<TLCLIST>8000.0 0.4", "<TLCLIST>8000.0"), "wrong_count"),
    (("<TLCLIST>8000.0 0.4", "<TLCLIST>0.0 0.4"), "time_order"),
    (("<TLCLIST>8000.0 0.4", "<TLCLIST>8000.0 -0.4"), "out_of_range"),
    (("<TLCTIME>2022-04-17T22", "<TLCTIME>2022-04-17T29"), "not_a_time"),
    (("<TLCTIME>2022-04-17T22", "<TLCTIME>2022-04-17T21"), "list_span"),
    (("<NUMPOINTS>160", "<NUMPOINTS>161"), "count"),
    (("<EPHEMLIST>7 ", "<EPHEMLIST>8 "), "numbered"),
    (("<EPHEMLIST>7 -", "<EPHEMLIST>7 -9"), "radius"),
    (("<ATTLIST>7 ", "<ATTLIST>7 1"), "quaternion_norm"),
    (("<ATTLIST>7 ", "<ATTLIST>7 nan "), "wrong_count"),
    (("<TIMEINTERVAL>0.02", "<TIMEINTERVAL>0,02"), "decimal_comma"),
    (("<PD>16000", "<PD>16"), "out_of_range"),
    (("<POLYORDER>-1", "<POLYORDER>3"), "distortion"),
    (("</DETECTOR_ARRAY>", "</DETECTOR_ARRAY><DETECTOR_ARRAY/>"), "arrays"),
    (("<DETPITCH>0.008", "<DETPITCH>0"), "out_of_range"),
    (("<QCS1>", "<QCS1>1"), "quaternion_norm"),
    (("<BAND_P>", "<BAND_X/><BAND_P>"), ""),
]  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize(("change", "code"), BAD)
def test_damaged_files_are_one_clear_line(tmp_path: Path, change: tuple[str, str], code: str) -> None:
    path = write_isd(tmp_path, change)
    if not code:  # the named band is chosen among several
        assert read_sensor(path).metadata.instrument == "P"
        return
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    (problem,) = caught.value.problems
    assert problem.code.endswith(code) and problem.file == str(path) and "\n" not in str(problem)
    assert problem.place


@pytest.mark.behaviour
def test_resampled_levels_are_not_a_line_scan(tmp_path: Path) -> None:
    path = write_isd(tmp_path, ("Stereo 1B", "Stereo OR2A"))
    with pytest.raises(InputError, match="element RPB"):
        read_sensor(path)


@pytest.mark.behaviour
def test_the_report_states_the_size_of_each_effect(tmp_path: Path) -> None:
    """Record and report state size and use of each effect on light for each image."""
    source = write_isd(tmp_path)
    sensor = read_sensor(source)
    line, sample = grid(sensor, 4)
    ground = sensor.locate(line, sample, height_m=30.0)
    pixels = np.stack(sensor.project(ground), axis=1)
    rows = [f"{image},{k},{a:.4f},{b:.4f},0.3,0.3" for image in ("a", "b") for k, (a, b) in enumerate(pixels)]
    (tmp_path / "points.csv").write_text(
        "id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m\n"
        + "\n".join(
            f"{k},control,{np.degrees(lon):.9f},{np.degrees(lat):.9f},{h:.4f},0.1,0.1,0.1"
            for k, (lon, lat, h) in enumerate(geodetic_array(ground))
        )
        + "\n", encoding="utf-8",
    )  # fmt: skip
    (tmp_path / "observations.csv").write_text(
        "\n".join(["image,id,line,sample,sigma_line_px,sigma_sample_px", *rows]) + "\n", encoding="utf-8"
    )
    (tmp_path / "b").mkdir()
    write_isd(tmp_path / "b", ("<SATID>WV09", "<SATID>WV08"))
    images = "".join(f'[[images]]\nid = "{name}"\nmetadata = "{file}"\n' for name, file in (
        ("a", "scene.XML"), ("b", "b/scene.XML")))  # fmt: skip
    (tmp_path / "project.toml").write_text(
        f'schema = 1\nname = "wv"\n{images}[points]\nfile = "points.csv"\ncrs = "EPSG:4979"\n'
        '[observations]\nfile = "observations.csv"\n[orientation]\nlight = ["refraction"]\n', encoding="utf-8",
    )  # fmt: skip
    done = in_process("adjust", tmp_path / "project.toml", "--out", tmp_path / "result", "--json")
    assert done.code in (0, 4), done.stderr
    record = json.loads((tmp_path / "result" / "result.json").read_text("utf-8"))
    assert [(one["effect"], one["applied"]) for one in record["images"][0]["light"]] == [
        ("light_time", False), ("aberration", False), ("refraction", True)
    ]  # fmt: skip
    page = (tmp_path / "result" / "report.html").read_text("utf-8")
    assert "Effects on light" in page and page.count("<td>light time</td>") == 2
    pixel = ("--line", 100, "--sample", 200, "--height", 0, "--result", tmp_path / "result", "--json")
    other = in_process("locate", source, *pixel)
    assert other.code == 2 and "--light refraction" in other.stderr
    assert in_process("locate", source, *pixel, "--light", "refraction").code == 0
