"""Pixels in the report: pictures under the vectors, chips of the largest residuals, unusable rasters."""

from __future__ import annotations

import base64
import json
import re
import shutil
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from fg_orient.report import payload, pictures
from fg_orient.report.pictures import pictures_of
from fg_orient.result.record import read_result
from tests.support.command import in_process
from tests.support.json_schemas import SCHEMAS, faults
from tests.support.page import structure
from tests.support.rendered_pair import LAT, LON, PER_LAT, PER_LON, Scene, View, read_raster, write_pair, write_raster

#: Models without error; point 7 is measured wrong in b.
SIDE = 96
VIEWS = (View("a", (0.25, -0.05), SIDE), View("b", (-0.25, 0.1), SIDE, 4.0), View("c", (0.05, 0.3), SIDE))
WRONG, ERROR_PX = "7", np.array([9.0, -6.0])


def adjusted(project: Path) -> Path:
    """Adjust a project; return its result folder."""
    out = project.parent / "result"
    assert (
        in_process("adjust", project, "--out", out, "--json", "--overwrite").code == 4
    )  # the wrong measurement is found
    return out


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a project of three rendered images, one wrong measurement, and its result."""
    folder, rng = tmp_path_factory.mktemp("pixels"), np.random.default_rng(5)
    scene = Scene(45.0, 3, relief_m=5.0, walls=0)
    project = write_pair(folder, scene, VIEWS, 50.0)
    xy = rng.uniform(-16.0, 16.0, (2, 30))
    h = scene.height(xy)
    lines = ["id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m"]
    for k, (x, y, z) in enumerate(zip(*xy, h, strict=True)):
        known = f"control,{LON + x / PER_LON:.10f},{LAT + y / PER_LAT:.10f},{z:.4f},0.1,0.1,0.1"
        lines.append(f"{k},{known if k >= 20 else 'tie,,,,,,'}")
    (folder / "points.csv").write_text("\n".join(lines) + "\n", "utf-8")
    lines = ["image,id,line,sample,sigma_line_px,sigma_sample_px"]
    for view in VIEWS:
        at = view.project(*xy, h) + rng.normal(0.0, 0.2, (30, 2))
        at[int(WRONG)] += ERROR_PX * (view.name == "b")
        lines += [f"{view.name},{k},{line:.4f},{sample:.4f},0.2,0.2" for k, (line, sample) in enumerate(at)]
    (folder / "observations.csv").write_text("\n".join(lines) + "\n", "utf-8")
    with project.open("a", encoding="utf-8") as file:
        file.write('\n[points]\nfile = "points.csv"\ncrs = "EPSG:4979"\n\n[observations]\nfile = "observations.csv"\n')
    adjusted(project)
    return folder


@pytest.fixture
def copy(rendered: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder, to be changed."""
    return Path(shutil.copytree(rendered, tmp_path / "copy"))


def decoded(href: str) -> np.ndarray:
    """Return the grey values of an address."""
    with warnings.catch_warnings(), MemoryFile(base64.b64decode(href.partition("base64,")[2])) as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open() as source:
            return np.asarray(source.read(1))


def page(folder: Path) -> str:
    """Return the text of the page that ``report`` writes."""
    assert in_process("report", folder, "--quiet").code == 0
    return (folder / "report.html").read_text("utf-8")


@pytest.mark.oracle
def test_the_first_chip_shows_the_wrong_measurement(rendered: Path) -> None:
    result = read_result(rendered / "result")
    chip = pictures_of(result, rendered / "result").chips[0]
    assert (chip.point.image, chip.point.id, chip.point.removed) == ("b", WRONG, 0)
    # the residual leads back to the true place; the other rays take a part of the error
    v = np.array([chip.point.v_line_px, chip.point.v_sample_px])
    assert v @ ERROR_PX < 0.0 and np.linalg.norm(v + ERROR_PX) < 0.7 * np.linalg.norm(ERROR_PX)
    row = next(k for k in result.rows["b"].tolist() if result.residuals.words["id"][k] == WRONG)
    line, sample = (result.residuals.figures[name][row] for name in ("line", "sample"))
    # the cross lies where the table says, the centre of a pixel being at one half: the chip is that part of the raster
    top, left = round(line - chip.y + 0.5), round(sample - chip.x + 0.5)
    part = np.full((64, 64), np.nan)
    pixels = read_raster(rendered / "b.tif")
    rows, columns = (np.arange(first, first + 64) for first in (top, left))
    inside = np.ix_((rows >= 0) & (rows < SIDE), (columns >= 0) & (columns < SIDE))
    part[inside] = pixels[np.clip(rows, 0, SIDE - 1)][:, np.clip(columns, 0, SIDE - 1)][inside]
    low, high = np.nanpercentile(part, (2.0, 98.0))
    expected = np.clip((part - low) / (high - low) * 255.0, 0.0, 255.0)
    shown = decoded(chip.href).astype(float)
    assert shown.shape == (64, 64)
    assert np.nanmax(np.abs(shown - expected)) <= 0.51
    assert (shown[np.isnan(part)] == 128.0).all()
    numbers = [float(word) for word in re.findall(r"-?[\d.]+", chip.arrow)]
    np.testing.assert_allclose(numbers[:2], [chip.x, chip.y], atol=0.006)
    np.testing.assert_allclose(
        numbers[2:4], [chip.x + chip.point.v_sample_px, chip.y + chip.point.v_line_px], atol=0.006
    )


@pytest.mark.oracle
def test_a_removed_measurement_is_the_first_chip(copy: Path) -> None:
    """A removed image point is the first chip, at its measured place with an arrow to the true one, and labelled."""
    out = copy / "searched"
    assert in_process("adjust", copy / "project.toml", "--snoop", "--out", out).code == 0
    result = read_result(out)
    assert (WRONG, "b") not in set(zip(result.residuals.words["id"], result.residuals.words["image"], strict=True))
    chips = pictures_of(result, out).chips
    first = chips[0].point
    assert (first.image, first.id, first.removed) == ("b", WRONG, 1) and len(chips) == 10
    row = next(line for line in (copy / "observations.csv").read_text("utf-8").splitlines() if line.startswith("b,7,"))
    assert [first.line, first.sample] == [float(cell) for cell in row.split(",")[2:4]]
    # noise of 0.2 px in each of three rays, and that of the other two in the true place
    assert np.abs(np.array([first.v_line_px, first.v_sample_px]) + ERROR_PX).max() < 1.5
    # the cross lies on the same grey values as in the chip of the raster itself
    top, left = round(first.line - chips[0].y + 0.5), round(first.sample - chips[0].x + 0.5)
    assert (top, left) == (round(first.line) - 32, round(first.sample) - 32)
    assert [chip.point.removed for chip in chips[1:]] == [0] * 9
    text = (out / "report.html").read_text("utf-8")
    assert text.count("<strong>removed</strong> in round 1") == 1 and "Image points that the search" in text
    assert "<strong>removed</strong>" not in (copy / "result" / "report.html").read_text("utf-8")
    (copy / "b.tif").unlink()
    assert [chip.point.image for chip in pictures_of(result, out).chips].count("b") == 0


@pytest.mark.behaviour
def test_the_page_has_pictures_inside_itself(rendered: Path) -> None:
    text = (rendered / "result" / "report.html").read_text("utf-8")
    found = structure(rendered / "result" / "report.html")
    assert found.tags.count("image") == 10 + len(VIEWS)
    links = [value for name, value in found.attributes if name == "href" and not value.startswith("#")]
    assert links and all(link.startswith("data:image/") for link in links)
    assert "Largest residuals in the pixels" in text and str(rendered) not in text
    images = re.findall("<image[^>]*>", text)
    assert re.findall("<image[^>]*>", page(rendered / "result")) == images
    record = json.loads((rendered / "result" / "result.json").read_text("utf-8"))
    assert record["pixels"] == {name: {"file": f"../{name}.tif", "origin": None} for name in "abc"}
    assert list(faults(record, json.loads((SCHEMAS / "adjust.json").read_text("utf-8")))) == []
    # the picture of an image fills the frame of its vectors
    drawing = next(re.finditer(r"<svg class=\"panel\"(?:(?!<svg class).)*</svg>", text, re.DOTALL)).group()
    boxes = [*ET.fromstring(drawing).iter()]
    frame, inside = (next(box for box in boxes if box.get("class") == name) for name in ("frame", "pixels"))
    outer = next(box for box in boxes if inside in list(box))
    for name, begin in (("x", 1.0), ("y", 1.0), ("width", 0.0), ("height", 0.0)):
        image = float(inside.attrib[name]) + begin * float(outer.attrib[name])
        assert abs(image - float(frame.attrib[name])) < 2.5


@pytest.mark.behaviour
@pytest.mark.parametrize("without", ["pixels", "rasterio"])
def test_without_pixels_the_page_is_as_ever(copy: Path, without: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if without == "pixels":
        for name in "abc":
            (copy / f"{name}.tif").unlink()
        text = (adjusted(copy / "project.toml") / "report.html").read_text("utf-8")
        assert "pixels" not in json.loads((copy / "result" / "result.json").read_text("utf-8"))
    else:
        monkeypatch.setitem(sys.modules, "rasterio", None)
        text = page(copy / "result")
    assert "<image" not in text and "Largest residuals in the pixels" not in text and "No picture" not in text


def _remove(path: Path) -> None:
    path.unlink()


def _damage(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:20])


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-12_000])  # the pixels end early, the head is sound


def _other(path: Path) -> None:
    write_raster(path, np.ones((30, 30), np.uint16))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "spoil, words",
    [(_remove, pictures.ABSENT), (_damage, pictures.UNREADABLE), (_cut, pictures.UNREADABLE), (_other, pictures.OTHER)],
)
def test_a_raster_that_is_not_usable_is_a_note(copy: Path, spoil: Callable[[Path], None], words: str) -> None:
    spoil(copy / "b.tif")
    text = page(copy / "result")
    assert text.count("No picture of") == 1 and f"No picture of image b: {words}." in text
    assert text.count('class="pixels"') == 2


@pytest.mark.behaviour
def test_a_part_of_the_scene_has_its_place(copy: Path) -> None:
    pixels = read_raster(copy / "b.tif")
    (copy / "b.tif").unlink()
    write_raster(copy / "part.tif", pixels[3:, 2:])
    project = copy / "project.toml"
    entry = 'metadata = "b_RPC.TXT"'
    text = project.read_text("utf-8").replace(entry, f'{entry}\npixels = "part.tif"\npixels_origin = [3, 2]')
    project.write_text(text, "utf-8")
    out = adjusted(project)
    part = pictures_of(read_result(out), out)
    assert part.images["b"].x == (1.5, SIDE - 0.5) and part.images["b"].y == (2.5, SIDE - 0.5)
    assert len(part.images) == 3 and part.chips[0].point[:2] == ("b", WRONG)


@pytest.mark.behaviour
def test_pictures_have_a_budget_of_bytes_and_of_pixels(rendered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = rendered / "result"
    result = read_result(folder)
    everything = pictures_of(result, folder)
    hrefs = [chip.href for chip in everything.chips] + [picture.href for picture in everything.images.values()]
    assert sum(map(len, hrefs)) == everything.used <= pictures.BUDGET == 600_000
    monkeypatch.setattr(pictures, "BUDGET", everything.used - 1)
    fewer = pictures_of(result, folder)
    assert fewer.used < everything.used and len(fewer.chips) == 10 and len(fewer.images) == 2
    assert fewer.notes == [f"No picture of image c: {pictures.FULL}"]
    monkeypatch.setattr(pictures, "DECODED", SIDE * SIDE + 1)
    assert len(pictures_of(result, folder).images) == 1
    assert pictures_of(result, folder).missing == {pictures.LARGE: ["a", "c"]}


@pytest.mark.behaviour
def test_drawings_and_pictures_share_the_bytes_of_the_page(rendered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = read_result(rendered / "result")
    everything = payload.payload(result)
    assert everything is not None and everything.words == ""
    monkeypatch.setattr(payload, "BUDGET", 63_000)
    alone, beside = (
        payload.payload(result),
        payload.payload(result, pictures_of(result, rendered / "result").used + 7000),
    )
    assert alone is not None and alone.words == ""
    assert beside is not None and "of 90 image points" in beside.words
    assert len(beside.json()) < len(alone.json())
