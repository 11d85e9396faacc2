"""Files of other programs in a project give the same block as tables of fg_orient, with the same checks."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.exchange.convert import read_survey, write_survey
from fg_orient.formats.registry import Settings, format_named
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process

OWN = '[points]\nfile = "points.csv"\ncrs = "EPSG:4979"\n\n[observations]\nfile = "observations.csv"\n'
FILES = {"metashape-xml": "m.xml", "asp-gcp": "m.gcp", "odm": "gcp_list.txt", "micmac": "m.txt", "geojson": "m.geojson"}
#: These formats do not state the following.
LACKS = {
    "metashape-xml": ('crs = "EPSG:4979"\naccept_unverified = true\n', "sigma_px = [0.3, 0.3]\n"),
    "asp-gcp": ('sigma_axes = "enu"\naccept_unverified = true\n', 'sigma_axes = "enu"\n'),
    "odm": ("sigma_m = [0.06, 0.06, 1.0]\naccept_unverified = true\n", "sigma_px = [0.3, 0.3]\n"),
    "micmac": ('crs = "EPSG:4979"\naccept_unverified = true\n', "sigma_px = [0.3, 0.3]\n"),
}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_zonguldak(tmp_path_factory.mktemp("own") / "twin", ZonguldakOptions()).parent


@pytest.fixture(scope="module")
def own(source: Path) -> Block:
    """Return the block of our own tables."""
    return fg.read_project(source / "project.toml")


@pytest.fixture
def folder(source: Path, tmp_path: Path) -> Path:
    shutil.copytree(source, tmp_path / "twin")
    return tmp_path / "twin"


def exported(folder: Path, name: str) -> list[Path]:
    """Write the tables of a folder in another format into it; return the new files."""
    own = format_named("csv")
    survey, _ = read_survey([folder / "points.csv", folder / "observations.csv"], own, Settings(crs="EPSG:4979"))
    crs = "EPSG:32636" if name == "odm" else ""
    written, _ = write_survey(survey, [folder / FILES[name]], format_named(name), Settings(crs=crs, sigma_axes="enu"))
    return list(written)


def told(folder: Path, points: str, observations: str) -> Path:
    """Replace the tables in the project file of a folder; return the file."""
    path = folder / "project.toml"
    text = path.read_text("utf-8")
    begin, end = text.index("[points]"), text.index("[orientation]")
    path.write_text(f"{text[:begin]}[points]\n{points}\n[observations]\n{observations}\n{text[end:]}", "utf-8")
    return path


def from_format(folder: Path, name: str) -> Path:
    files = exported(folder, name)
    head = [f'file = "{file.name}"\nformat = "{name}"\n' for file in (files[0], files[-1])]
    rows = [line.split(",") for line in (folder / "points.csv").read_text("utf-8").splitlines()]
    checks = [row[0] for row in rows if row[1:2] == ["check"]]
    more = LACKS[name][0] + ("" if name == "metashape-xml" else f"check = {checks!r}\n".replace("'", '"'))
    return told(folder, head[0] + more, head[1] + LACKS[name][1])


def in_order(block: Block) -> tuple[np.ndarray, ...]:
    """Return the coordinates and image points sorted by id, image."""
    rank = np.argsort(np.argsort(block.points.ids))
    rows = np.lexsort((rank[block.observations.point], block.observations.image))
    o = block.observations
    order = np.argsort(block.points.ids)
    return (block.points.known.ecef_m[order], block.points.known.sigma_enu_m[order], o.line[rows], o.sample[rows],
            o.sigma_line_px[rows], o.sigma_sample_px[rows])  # fmt: skip


@pytest.mark.consistency
@pytest.mark.parametrize("name", sorted(LACKS))
def test_a_project_of_another_program_is_the_same_block(name: str, folder: Path, own: Block) -> None:
    block = fg.read_project(from_format(folder, name))
    assert sorted(block.points.ids) == sorted(own.points.ids)
    for value, expected in zip(in_order(block), in_order(own), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-6)  # through UTM and back: 1e-9 of 6e6 m
    sealed = dict(zip(block.withheld.ids, block.withheld.open().ecef_m, strict=True))
    expected = dict(zip(own.withheld.ids, own.withheld.open().ecef_m, strict=True))
    assert sealed.keys() == expected.keys() and len(sealed) == 10
    assert max(np.linalg.norm(sealed[k] - expected[k]) for k in sealed) < 1e-6
    files = {Path(s.path).name for s in block.sources}
    assert FILES[name] in files and "points.csv" not in files


@pytest.mark.behaviour
def test_a_format_that_was_never_tried_asks_here_too(folder: Path) -> None:
    path = from_format(folder, "asp-gcp")
    path.write_text(path.read_text("utf-8").replace("accept_unverified = true\n", ""), "utf-8")
    ended = in_process("validate", path)
    assert ended.code == 2 and "points.format" in ended.stderr and "add accept_unverified = true" in ended.stderr
    assert "--" not in ended.stderr.replace(str(folder), "")


@pytest.mark.behaviour
def test_faults_name_file_line_and_entry(folder: Path) -> None:
    path = from_format(folder, "odm")
    text, file = path.read_text("utf-8"), folder / FILES["odm"]
    for gone, said in (
        (
            "sigma_m = [0.06, 0.06, 1.0]\n",
            r"list.txt, line \d+, point \d+: the entry has no standard deviation; add sigma_m",
        ),
        ("sigma_px = [0.3, 0.3]\n", "the entry has no standard deviation .* add sigma_px = "),
    ):
        path.write_text(text.replace(gone, ""), "utf-8")
        with pytest.raises(InputError, match=said):
            fg.read_project(path)
    path.write_text(text, "utf-8")
    lines = file.read_text("utf-8").splitlines()
    file.write_text("\n".join([*lines[:4], lines[4].replace(lines[4].split()[1], "north"), *lines[5:]]), "utf-8")
    with pytest.raises(InputError, match=r"gcp_list.txt, line 5"):
        fg.read_project(path)
    file.write_text("\n".join(lines).replace("left", "middle"), "utf-8")
    with pytest.raises(InputError, match="image middle: the project has no image with this id"):
        fg.read_project(path)
    path.write_text(text.replace("sigma_px = [", 'images = { "middle" = "left" }\nsigma_px = ['), "utf-8")
    assert len(fg.read_project(path).observations) == 94


@pytest.mark.behaviour
def test_convert_reads_the_crs_of_a_simulation(source: Path, tmp_path: Path) -> None:
    words = ["convert", source / "points.csv", "--from", "csv", "--out", tmp_path / "points.geojson"]
    ended = in_process(*words, "--json")
    assert ended.code == 0 and ended.json["points"] > 30, ended.stderr


@pytest.mark.behaviour
def test_another_crs_than_the_file_says_is_one_fault_with_a_remedy_of_projects(folder: Path) -> None:
    path = from_format(folder, "odm")
    path.write_text(path.read_text("utf-8").replace('format = "odm"', 'format = "odm"\ncrs = "EPSG:32633"', 1), "utf-8")
    ended = in_process("validate", path, "--json")
    (found,) = ended.json["errors"]
    assert (ended.code, found["code"]) == (2, "interchange.crs_differs")
    assert (
        found["remedy"]
        == "leave crs out, or give the CRS of the file with a vertical CRS; the command convert transforms"
    )


@pytest.mark.behaviour
def test_our_points_with_tie_points_of_another_program(folder: Path, own: Block) -> None:
    """Image points of another program without a point in our table become tie points.

    Entries for foreign files are refused for our own tables.
    """
    (gcp,) = exported(folder, "metashape-xml")
    points = folder / "points.csv"
    first = next(line for line in points.read_text("utf-8").splitlines() if ",control," in line)
    points.write_text(points.read_text("utf-8").replace(first + "\n", ""), "utf-8")
    foreign = f'file = "{gcp.name}"\nformat = "metashape-xml"\n' + "".join(reversed(LACKS["metashape-xml"]))
    block = fg.read_project(told(folder, 'file = "points.csv"\ncrs = "EPSG:4979"\n', foreign))
    name = first.split(",")[0]
    assert block.points.roles[block.points.ids.index(name)] is Role.TIE
    assert len(block.observations) == len(own.observations) and len(block.points.ids) == len(own.points.ids)
    own_with = told(folder, 'file = "points.csv"\ncrs = "EPSG:4979"\nheight_m = 1.0\n', foreign)
    with pytest.raises(InputError, match=r"points.height_m: this entry is only for files of other programs"):
        fg.read_project(own_with)
    with pytest.raises(InputError, match=r"points.format.*did you mean"):
        fg.read_project(told(folder, 'file = "m.xml"\nformat = "metashap-xml"\n', foreign))


@pytest.mark.behaviour
def test_check_points_are_read_again_from_anywhere_and_not_if_the_file_changed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = from_format(folder, "micmac")
    monkeypatch.chdir(folder)
    block = fg.read_project(path.name)
    os.chdir(tmp_path)
    assert len(block.withheld.open().ecef_m) == 10
    file = folder / FILES["micmac"]
    file.write_text(file.read_text("utf-8").replace("0.", "1.", 1), "utf-8")
    with pytest.raises(InputError, match="changed"):
        block.withheld.open()
