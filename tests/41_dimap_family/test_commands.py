"""The commands are run with a result, another model, extrapolated attitudes, and DEM heights above a geoid."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

from fg_orient.formats.project import read_project
from fg_orient.formats.rpc import read_rpc
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.rectification.ortho_models import read_orientation
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process as run
from tests.support.published_rays import misses_m
from tests.support.rpc_model import reference_project

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


def cut_attitudes(path: Path, keep: int) -> None:
    """Leave the first ``keep`` attitudes in the file."""
    text = path.read_text("utf-8")
    tag = "</Angles>"
    start, end = text.index("<Corrected_Attitude>"), text.index("</Corrected_Attitude>")
    parts = text[start:end].split(tag)
    kept = tag.join(parts[:keep]) + tag
    path.write_text(text[:start] + kept + text[end:], encoding="utf-8")


@pytest.fixture
def short(twin: Path, tmp_path: Path) -> Path:
    """Return a copy of the twin whose left image ends 0.1 s or less after its attitudes."""
    import shutil

    shutil.copytree(twin, tmp_path / "short")
    left = tmp_path / "short" / "left.DIM"
    sensor = read_sensor(left)
    timing, listed = sensor.metadata.timing, sensor.metadata.attitude.time_s  # type: ignore[union-attr]
    end = timing.reference_time_s + timing.line_period_s * (sensor.n_lines - 1 - timing.reference_line)
    inside = int(np.searchsorted(listed, end)) if listed[-1] > end else len(listed)
    cut_attitudes(left, inside)
    return tmp_path / "short" / "project.toml"


@pytest.mark.oracle
def test_result_gives_adjusted_geometry(twin: Path, result: Path) -> None:
    image = twin / "left.DIM"
    pixel = ("--line", 6000, "--sample", 3000, "--height", 400, "--json")
    plain, adjusted = (run("locate", image, *pixel, *w).json["points"][0] for w in ((), ("--result", result)))
    sensor = read_sensor(image)
    expected = sensor.locate(6000.0, 3000.0, height_m=400.0, correction=read_orientation(result, sensor).correction)[0]  # type: ignore[call-arg]
    assert [adjusted[k] for k in ("x_m", "y_m", "z_m")] == expected.tolist()
    correction = read_orientation(result, sensor).correction
    pixel_of = np.array([6000.0]), np.array([3000.0])
    assert misses_m(sensor.metadata, *pixel_of, expected[None], correction)[0] < 1e-6
    assert adjusted["x_m"] != plain["x_m"]
    place = ("--lon", adjusted["lon_deg"], "--lat", adjusted["lat_deg"], "--height", 400)
    (back,) = run("project", image, *place, "--result", result, "--json").json["points"]
    assert (back["line"], back["sample"]) == pytest.approx((6000.0, 3000.0), abs=1e-5)


@pytest.mark.behaviour
def test_intersection_with_a_result(twin: Path, result: Path) -> None:
    """``intersect --result`` gives rays with a median miss below 3 m and height sigmas of 0.5 to 5 m."""
    project = twin / "project.toml"
    after = run("intersect", project, "--result", result, "--json").json
    assert np.median([p["miss_m"] for p in after["points"]]) < 3.0
    assert all(0.5 < p["sigma_up_m"] < 5.0 for p in after["points"])


@pytest.mark.behaviour
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


@pytest.mark.oracle
def test_rpc_of_an_adjusted_rigorous_model(twin: Path, result: Path, tmp_path: Path) -> None:
    """``rpc fit --result`` writes the RPC of the adjusted model and records its error at independent points.

    It differs from the model of the metadata by over 0.5 px.
    """
    out = tmp_path / "left_RPC.TXT"
    ended = run("rpc", "fit", twin / "left.DIM", "--heights", 0, 1500, "--grid", 8, 8, 5, "--result", result, "--out",
                out, "--json")  # fmt: skip
    assert ended.code == 0
    assert max(ended.json["check"][f"max_{axis}_px"] for axis in ("line", "sample")) < 1e-3
    rigorous = read_sensor(twin / "left.DIM")
    correction = read_orientation(result, rigorous).correction
    line, sample, height = (
        np.array(a) for a in ([10.0, 6000.0, 11990.0], [9.0, 6000.0, 11990.0], [0.0, 700.0, 1500.0])
    )
    ground = rigorous.locate(line, sample, height_m=height, correction=correction)  # type: ignore[call-arg]
    assert misses_m(rigorous.metadata, line, sample, ground, correction).max() < 1e-6
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ground.T)
    written = np.array(reference_project(read_rpc(out), *geodetic), float)
    assert np.abs(written - [line, sample]).max() < 1e-3
    there = np.array(read_sensor(out).project(ground))
    assert np.abs(there - written).max() < 1e-4
    assert np.abs(np.array(rigorous.project(ground)) - [line, sample]).max() > 0.5
    ended = run("rpc", "fit", twin / "points.csv", "--result", result, "--json")
    assert ended.code == 2 and "--result" in ended.json["errors"][0]["place"]


@pytest.mark.behaviour
def test_ortho_extrapolates_as_the_other_commands(short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``rectify ortho`` refuses missing attitudes; with the option it uses all lines and records this."""
    lines = []

    def rectified(image: Path, model: Any, *_: Any, **__: Any) -> dict[str, Any]:
        lines.append(model.sensor.last_line)
        return {}

    monkeypatch.setattr("fg_orient.rectification.ortho.orthorectify", rectified)
    words = ("rectify", "ortho", tmp_path / "image.tif", short.parent / "left.DIM", "--height", 0, "--crs",
             "EPSG:32636", "--out", tmp_path / "map.tif", "--json")  # fmt: skip
    refused = run(*words)
    assert (refused.code, refused.json["errors"][0]["code"]) == (2, "sensor.attitude_span")
    record = run(*words, "--extrapolate-attitude", 0.2).json
    assert any("are extrapolated by" in note for note in record["notes"])
    assert lines == [11999.0]


@pytest.mark.behaviour
def test_extrapolation_of_a_project_is_in_its_result(short: Path, tmp_path: Path) -> None:
    """``locate`` refuses a line without attitude with the remedy; ``adjust`` with the option notes what it did."""
    ended = run("locate", short.parent / "left.DIM", "--line", 11999, "--sample", 5, "--height", 0, "--json")
    (error,) = ended.json["errors"]
    assert (ended.code, error["code"]) == (2, "sensor.attitude_span")
    assert "--extrapolate-attitude" in error["remedy"] and error["place"].startswith("line 11999")
    out = tmp_path / "result"
    assert run("adjust", short, "--extrapolate-attitude", 0.2, "--out", out, "--quiet").code == 0
    notes = json.loads((out / "result.json").read_text("utf-8"))["images"][0]["notes"]
    assert any("are extrapolated by 0." in note for note in notes)
    assert run("adjust", short, "--extrapolate-attitude", 9, "--out", tmp_path / "x", "--json").code == 2
    text = short.read_text("utf-8").replace("[orientation]", "[orientation]\nextrapolate_attitude_s = 0.2")
    short.write_text(text, encoding="utf-8")
    assert any("extrapolated" in str(note) for note in read_project(short).images[0].sensor.notes)
    with pytest.raises(InputError, match="a number from 0 to 5 in s"):
        read_project(short, extrapolate_attitude_s=-1.0)


@pytest.mark.behaviour
@pytest.mark.real_data
def test_models_of_one_file(real_data: Path) -> None:
    """For a file with both models the commands use the rigorous one, and --model rpc selects the RPC."""
    pixel = ("--line", 100, "--sample", 200, "--height", 500, "--json")
    ways = ((), ("--model", "rigorous"), ("--model", "rpc"))
    auto, rigorous, rpc = (run("locate", real_data / PHR, *pixel, *w).json["points"][0] for w in ways)
    assert auto == rigorous
    apart = np.linalg.norm([auto[k] - rpc[k] for k in ("x_m", "y_m", "z_m")])
    assert 0.0 < apart < 0.01
    ended = run("locate", real_data / "micmac-spot7-rpc/RPC_1A.xml", *pixel, "--model", "rigorous")
    assert [e["code"] for e in ended.json["errors"]] == ["sensor.only_rpc"]


@pytest.mark.behaviour
@pytest.mark.real_data
def test_frame_of_spot6_is_printed_with_its_heights(real_data: Path) -> None:
    ended = run("locate", real_data / "geocosicorr3d/SPOT6.XML", "--frame")
    assert ended.code == 0
    assert ended.stdout.count("836.4") == 5 and "misfit_m" in ended.stdout
    assert "height of each frame point is estimated" in ended.stderr


@pytest.mark.behaviour
def test_adjust_with_a_dem_as_control(twin: Path, tmp_path: Path) -> None:
    """``adjust --dem-control`` records the observed heights of tie points and counts them in the redundancy."""
    rasterio = pytest.importorskip("rasterio")
    folder = tmp_path / "ties"
    folder.mkdir()
    for name in ("left.DIM", "right.DIM", "observations.csv", "project.toml"):
        (folder / name).write_bytes((twin / name).read_bytes())
    rows = list(csv.reader((twin / "points.csv").read_text("utf-8").splitlines()))
    role = next(row.index("role") for row in rows if "role" in row)
    ties = [row[0] for row in rows if row[role : role + 1] == ["check"]]
    rows = [
        [row[0], *("tie" if k == role else "" for k in range(1, len(row)))] if row[0] in ties else row for row in rows
    ]
    (folder / "points.csv").write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    dem = tmp_path / "dem.tif"
    with rasterio.open(
        dem, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(0.05, 0.0, 30.3, 0.0, -0.05, 42.8),
    ) as raster:  # fmt: skip
        raster.write(np.full((1, 60, 60), 500.0, np.float32))
    ended = run("adjust", folder / "project.toml", "--dem-control", dem, "--dem-sigma", 300, "--out",
                tmp_path / "result", "--json")  # fmt: skip
    assert ended.code == 0
    found = ended.json["dem_control"]
    assert found["n"] == len(ties) > 5
    assert (found["outside"], found["at_rest"], found["sigma_m"]) == ([], True, 300.0)
    assert 2 <= found["rounds"] <= 4 and 10.0 < found["rms_m"] < 1500.0
    plain = run("adjust", folder / "project.toml", "--out", tmp_path / "plain", "--json").json
    assert ended.json["redundancy"] == plain["redundancy"] + found["n"]
    for words in (("--dem-sigma", 3), ("--dem-control", dem)):
        ended = run("adjust", folder / "project.toml", *words, "--out", tmp_path / "none", "--json")
        assert [e["code"] for e in ended.json["errors"]] == ["dem_control.both"]


@pytest.mark.behaviour
@pytest.mark.parametrize(("words", "limit_gb"), [((), 2.5), (("--memory-limit-gb", "3.5"), 3.5)])
def test_the_caches_of_the_dem_follow_the_memory_limit_of_the_project_file(
    twin: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], limit_gb: float
) -> None:
    given = list[float | None]()

    def read_dem(path: Path, vertical_crs: str, memory_limit_gb: float | None = None) -> None:
        given.append(memory_limit_gb)
        raise InputError.of("dem.missing", file=path)

    monkeypatch.setattr("fg_orient.cli.adjust.read_dem", read_dem)
    folder = shutil.copytree(twin, tmp_path / "twin")
    text = (folder / "project.toml").read_text("utf-8")
    with_limit = text.replace("[adjustment]", "[adjustment]\nmemory_limit_gb = 2.5", 1)
    assert with_limit != text
    (folder / "project.toml").write_text(with_limit, "utf-8")
    ended = run("adjust", folder / "project.toml", "--dem-control", "dem.tif", "--dem-sigma", "3", *words)
    assert ended.code == 2 and given == [limit_gb]
