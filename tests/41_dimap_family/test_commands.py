"""The commands with a result, another model, extrapolated attitudes, DEM heights above a geoid; the project file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fg_orient.errors import InputError, OutOfTimeRange
from fg_orient.io.project import read_project
from fg_orient.io.sensor import read_sensor
from fg_orient.raster.adjusted import read_correction
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process as run

PHR = "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML"
HRS = "asp/spot5_hrs1_segment.xml"


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("twin") / "zonguldak"
    simulate_zonguldak(folder, ZonguldakOptions())
    return folder


@pytest.fixture(scope="module")
def result(twin: Path) -> Path:
    out = twin.parent / "result"
    assert run("adjust", twin / "project.toml", "--out", out, "--quiet").code == 0
    return out


def cut_attitudes(path: Path, keep: int) -> float:
    """Leave the first ``keep`` attitudes in the file; the time of the last one, s of the day."""
    text = path.read_text("utf-8")
    tag = "</Angles>"
    start, end = text.index("<Corrected_Attitude>"), text.index("</Corrected_Attitude>")
    parts = text[start:end].split(tag)
    kept = tag.join(parts[:keep]) + tag
    path.write_text(text[:start] + kept + text[end:], encoding="utf-8")
    return float(read_sensor(path).metadata.attitude.time_s[-1])  # type: ignore[union-attr]


@pytest.fixture
def short(twin: Path, tmp_path: Path) -> Path:
    """A copy of the twin whose left image ends 0.1 s or less after its attitudes."""
    import shutil

    shutil.copytree(twin, tmp_path / "short")
    left = tmp_path / "short" / "left.DIM"
    sensor = read_sensor(left)
    timing, listed = sensor.metadata.timing, sensor.metadata.attitude.time_s  # type: ignore[union-attr]
    end = timing.reference_time_s + timing.line_period_s * (sensor.n_lines - 1 - timing.reference_line)
    inside = int(np.searchsorted(listed, end)) if listed[-1] > end else len(listed)
    cut_attitudes(left, inside)
    return tmp_path / "short" / "project.toml"


def test_result_gives_adjusted_geometry(twin: Path, result: Path) -> None:
    image = twin / "left.DIM"
    pixel = ("--line", 6000, "--sample", 3000, "--height", 400, "--json")
    plain, adjusted = (run("locate", image, *pixel, *w).json["points"][0] for w in ((), ("--result", result)))
    sensor = read_sensor(image)
    expected = sensor.locate(6000.0, 3000.0, height_m=400.0, correction=read_correction(result, sensor))[0]  # type: ignore[call-arg]
    assert [adjusted[k] for k in ("x_m", "y_m", "z_m")] == expected.tolist()
    assert adjusted["x_m"] != plain["x_m"]
    place = ("--lon", adjusted["lon_deg"], "--lat", adjusted["lat_deg"], "--height", 400)
    (back,) = run("project", image, *place, "--result", result, "--json").json["points"]
    assert (back["line"], back["sample"]) == pytest.approx((6000.0, 3000.0), abs=1e-5)


def test_intersection_with_a_result_meets_better(twin: Path, result: Path) -> None:
    project = twin / "project.toml"
    before, after = (run("intersect", project, *w, "--json").json["points"] for w in ((), ("--result", result)))
    assert np.median([p["miss_m"] for p in after]) < 3.0 < np.median([p["miss_m"] for p in before])


def test_footprint_of_a_project_and_of_files(twin: Path, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "f.geojson"
    ended = run("footprint", twin / "project.toml", "--height", 300, "--result", result, "--out", out, "--json")
    assert ended.code == 0
    assert [r["image"] for r in ended.json["images"]] == ["left", "right"]
    (pair,) = ended.json["pairs"]
    assert pair["base_to_height"] == pytest.approx(0.79, abs=0.02)
    assert json.loads(out.read_text("utf-8"))["features"][1]["properties"] == ended.json["images"][1]
    again = run("footprint", twin / "left.DIM", "--height", 300, "--out", out, "--json")
    assert [e["code"] for e in again.json["errors"]] == ["output.exists"]
    shown = run("footprint", twin / "left.DIM", twin / "right.DIM", "--height", 300)
    assert shown.code == 0 and "1 - 2" in shown.stdout and "B/H" in shown.stdout
    for words, code in (((), "cli.no_height"), (("--height", 1, "--dem", "x.tif"), "cli.two_heights")):
        ended = run("footprint", twin / "left.DIM", *words, "--json")
        assert (ended.code, [e["code"] for e in ended.json["errors"]]) == (2, [code])


def test_rpc_of_an_adjusted_rigorous_model(twin: Path, result: Path, tmp_path: Path) -> None:
    """Its error at independent points stands in the record; the file is the adjusted model, not the metadata's."""
    out = tmp_path / "left_RPC.TXT"
    ended = run("rpc", "fit", twin / "left.DIM", "--heights", 0, 1500, "--grid", 8, 8, 5, "--result", result, "--out",
                out, "--json")  # fmt: skip
    assert ended.code == 0
    assert max(ended.json["check"][f"max_{axis}_px"] for axis in ("line", "sample")) < 1e-3
    rigorous = read_sensor(twin / "left.DIM")
    correction = read_correction(result, rigorous)
    line, sample, height = (
        np.array(a) for a in ([10.0, 6000.0, 11990.0], [9.0, 6000.0, 11990.0], [0.0, 700.0, 1500.0])
    )
    ground = rigorous.locate(line, sample, height_m=height, correction=correction)  # type: ignore[call-arg]
    there = np.array(read_sensor(out).project(ground))
    assert np.abs(there - [line, sample]).max() < 1e-3
    assert np.abs(np.array(rigorous.project(ground)) - [line, sample]).max() > 0.5
    ended = run("rpc", "fit", twin / "points.csv", "--result", result, "--json")
    assert ended.code == 2 and "--result" in ended.json["errors"][0]["place"]


def test_extrapolation_of_a_project_is_in_its_result(short: Path, tmp_path: Path) -> None:
    """Refused with the line and the remedy; with the option the notes of the result say what was done."""
    ended = run("locate", short.parent / "left.DIM", "--line", 11999, "--sample", 5, "--height", 0, "--json")
    (error,) = ended.json["errors"]
    assert (ended.code, error["code"]) == (2, "sensor.attitude_span")
    assert "--extrapolate-attitude" in error["remedy"] and error["place"].startswith("line 11999")
    for words in (("--extrapolate-attitude", 0.2), ()):
        if not words:
            text = short.read_text("utf-8").replace("[orientation]", "[orientation]\nextrapolate_attitude_s = 0.2")
            assert "extrapolate" in text
            short.write_text(text, encoding="utf-8")
        out = tmp_path / f"result{len(words)}"
        assert run("adjust", short, *words, "--out", out, "--quiet").code == 0
        notes = json.loads((out / "result.json").read_text("utf-8"))["images"][0]["notes"]
        assert any("extrapolated with the last rate by 0." in note for note in notes)
    assert run("adjust", short, "--extrapolate-attitude", 9, "--out", tmp_path / "x", "--json").code == 2


def test_observations_on_lines_without_attitude(short: Path) -> None:
    """Points measured there are refused by the line when the block is adjusted."""
    block = read_project(short)
    sensor = block.images[0].sensor
    with pytest.raises(OutOfTimeRange):
        sensor.rays(11999.0, 5.0)
    with pytest.raises(InputError):
        read_project(short, extrapolate_attitude_s=-1.0)


@pytest.mark.real_data
def test_models_of_one_file(real_data: Path) -> None:
    """PHR_DIMAP holds both: the rigorous one is used, --model rpc takes the other."""
    pixel = ("--line", 100, "--sample", 200, "--height", 500, "--json")
    ways = ((), ("--model", "rigorous"), ("--model", "rpc"))
    auto, rigorous, rpc = (run("locate", real_data / PHR, *pixel, *w).json["points"][0] for w in ways)
    assert auto == rigorous
    apart = np.linalg.norm([auto[k] - rpc[k] for k in ("x_m", "y_m", "z_m")])
    assert 0.0 < apart < 0.01
    ended = run("locate", real_data / "micmac-spot7-rpc/RPC_1A.xml", *pixel, "--model", "rigorous")
    assert [e["code"] for e in ended.json["errors"]] == ["sensor.only_rpc"]


@pytest.mark.real_data
def test_frame_of_spot6_is_printed_with_its_heights(real_data: Path) -> None:
    ended = run("locate", real_data / "geocosicorr3d/SPOT6.XML", "--frame")
    assert ended.code == 0
    assert ended.stdout.count("836.4") == 5 and "misfit_m" in ended.stdout
    assert "height of each is solved" in ended.stderr
