"""Control features of a project file: the tests check table, GeoPackage, the record of the result, and faults."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.simulate import ZonguldakOptions, simulate_zonguldak
from tests.support.changed_text import change_file
from tests.support.command import in_process as run

from .conftest import Array, scene

PROJECT = """schema = 1
name = "lines"

[[images]]
id = "left"
metadata = "{left}"

[[images]]
id = "right"
metadata = "{right}"

[points]
file = "check.csv"
crs = "EPSG:4979"

[observations]
file = "measured.csv"

[lines]
file = "features.csv"
observations = "on_features.csv"
crs = "EPSG:4979"

[orientation]
eop_set = 1
"""


@pytest.fixture(scope="module")
def block() -> fg.Block:
    return scene(5, eop_set=1).block


@pytest.fixture
def folder(tmp_path: Path, written: Path) -> Path:
    """Return a copy of the project for each test."""
    return Path(shutil.copytree(written, tmp_path / "twin"))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, block: fg.Block) -> Path:
    """Return the scene as a project: ten lines, twenty check points."""
    out = tmp_path_factory.mktemp("lines") / "twin"
    simulate_zonguldak(out, ZonguldakOptions(seed=3))
    names = {image.id: Path(image.sensor.file).name for image in fg.read_project(out / "project.toml").images}
    paths = {name: next(out.rglob(file)).relative_to(out).as_posix() for name, file in names.items()}
    (out / "lines.toml").write_text(PROJECT.format(**paths), "utf-8")
    origin = fg.adjust(block).problem.origin_m
    features, segments = ["feature,lon_deg,lat_deg,height_m,sigma_across_m,sigma_up_m"], vertices(block, origin)
    features += [f"{name},{place},0.3,0.3" for name, ends in segments.items() for place in geographic(ends)]
    (out / "features.csv").write_text("\n".join(features) + "\n", "utf-8")
    check = block.withheld.open().ecef_m
    rows = [
        f"{name},check,{place},0.01,0.01,0.01"
        for name, place in zip(block.withheld.ids, geographic(check), strict=True)
    ]
    (out / "check.csv").write_text(
        "id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m\n" + "\n".join(rows) + "\n", "utf-8"
    )
    o, ids = block.observations, block.points.ids
    lines = [f"{block.images[i].id},{ids[j].partition('/')[0]},{line!r},{sample!r},0.5,0.5" for i, j, line, sample in
             zip(o.image, o.point, o.line.tolist(), o.sample.tolist(), strict=True)]  # fmt: skip
    head = "line,sample,sigma_line_px,sigma_sample_px\n"
    (out / "measured.csv").write_text(f"image,id,{head}" + "\n".join(lines[:40]) + "\n", "utf-8")
    (out / "on_features.csv").write_text(f"image,feature,{head}" + "\n".join(lines[40:]) + "\n", "utf-8")
    return out


def vertices(block: fg.Block, origin: Array) -> dict[str, Array]:
    """Return the ends (2, 3) of each line in ECEF."""
    found = {}
    for extra in block.extra:
        start, along = extra.setup[0, :3], extra.setup[0, 3:6]
        found[extra.unknowns[0].removeprefix("point:").partition("/")[0]] = origin + np.array([start, start + along])
    return found


def geographic(ecef: Array) -> list[str]:
    return [",".join(map(repr, row)) for row in np.column_stack(ecef_to_geodetic(ecef)).tolist()]


@pytest.mark.consistency
def test_a_project_equals_the_block_in_memory(folder: Path, block: fg.Block) -> None:
    read = fg.read_project(folder / "lines.toml")
    assert read.points.ids == block.points.ids and len(read.extra) == 60
    assert {Path(source.path).name for source in read.sources} >= {"features.csv", "on_features.csv"}
    assert np.nanmax(np.abs(fg.adjust(read).ground_m - fg.adjust(block).ground_m)) < 1e-5


@pytest.mark.behaviour
def test_result_of_the_command(folder: Path) -> None:
    done = run("adjust", folder / "lines.toml", "--out", folder / "result", "--json")
    assert done.code == 0, done.stderr
    features = json.loads((folder / "result" / "result.json").read_text("utf-8"))["features"]
    assert [one["feature"] for one in features] == [f"L{k}" for k in range(10)]
    assert all(one["n"] == 6 and 0.0 < one["rms_w"] <= one["largest_w"] for one in features)
    page = (folder / "result" / "report.html").read_text("utf-8")
    assert 'id="features"' in page and "Control features" in page and features[3]["point"] in page
    assert run("validate", folder / "lines.toml").code == 0


@pytest.mark.consistency
def test_a_geopackage_equals_the_table(folder: Path, block: fg.Block) -> None:
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    rows = (folder / "features.csv").read_text("utf-8").splitlines()[1:]
    names = [row.split(",")[0] for row in rows][::2]
    places = np.array([[float(value) for value in row.split(",")[1:4]] for row in rows]).reshape(-1, 2, 3)
    columns = [np.array(names, object), np.full(len(names), 0.3), np.full(len(names), 0.3)]
    pyogrio.raw.write(
        folder / "features.gpkg", shapely.to_wkb(shapely.linestrings(places)), columns,
        ["feature", "sigma_across_m", "sigma_up_m"], layer="control_features", driver="GPKG",
        geometry_type="LineString Z", crs="EPSG:4979",
    )  # fmt: skip
    text = (folder / "lines.toml").read_text("utf-8").replace('"features.csv', '"features.gpkg')
    (folder / "lines.toml").write_text(text, "utf-8")
    found = fg.read_project(folder / "lines.toml")
    assert np.nanmax(np.abs(fg.adjust(found).ground_m - fg.adjust(block).ground_m)) < 1e-5
    (folder / "lines.toml").write_text(
        text.replace('crs = "EPSG:4979"\n\n[orient', 'crs = "EPSG:32636"\n\n[orient'), "utf-8"
    )
    with pytest.raises(fg.InputError, match=r"features\.gpkg"):
        fg.read_project(folder / "lines.toml")


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("lines.toml", "features.csv", "none.csv", "none.csv"),
        ("lines.toml", 'crs = "EPSG:4979"\n\n[orientation]', 'crs = "EPSG:1"\n\n[orientation]', "lines.crs"),
        ("features.csv", "L3,", "L4,", "straight line has two vertices"),
        ("features.csv", ",0.3,0.3\nL1", ",0.3,0.4\nL1", "different kinds or standard deviations"),
        ("features.csv", ",0.3,0.3\nL1", ",0.3,-0.3\nL1", "above 0"),
        ("features.csv", ",0.3,0.3\nL1", ",x,0.3\nL1", "number"),
        ("on_features.csv", "left,L0", "left,Q0", "no such feature"),
        ("on_features.csv", "left,L0", "middle,L0", "no such image"),
    ],
)
def test_faults_name_file_and_remedy(folder: Path, file: str, old: str, new: str, message: str) -> None:
    change_file(folder / file, (old, new))
    done = run("validate", folder / "lines.toml")
    assert done.code == 2 and message in done.stderr + done.stdout and file in done.stderr + done.stdout
