"""Matching of rendered images is tested: accuracy, calibrated sigmas, wrong matches, tracks, interruption."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import fg_orient as fg
from fg_orient.model.errors import InputError
from fg_orient.orientation.match import kept
from fg_orient.orientation.match.job import match_project
from fg_orient.orientation.match.options import MatchOptions
from tests.support.command import in_process
from tests.support.matched_points import errors, rays, table
from tests.support.page import structure
from tests.support.rendered_pair import Scene, View, read_raster, write_pair, write_raster

from .conftest import VIEWS

Matched = tuple[Path, dict[str, Any]]


@pytest.mark.oracle
def test_errors_are_small_and_as_large_as_stated(matched: Matched, scene: Scene) -> None:
    found = errors(matched[0], scene, VIEWS)
    assert len(found.error_px) > 400
    assert found.rms_px() <= 0.12
    assert 0.8 <= found.nees() <= 1.25
    assert found.is_wrong().mean() <= 0.002
    assert np.abs(found.error_px[~found.is_wrong()].mean(axis=0)).max() < 0.02


@pytest.mark.oracle
def test_points_have_all_their_rays(matched: Matched) -> None:
    folder, record = matched
    by_point = rays(folder)
    counts = Counter(len(r) for r in by_point.values())
    assert counts[3] > 100
    assert {str(k): n for k, n in counts.items()} == record["rays"]
    assert len(by_point) == record["n_points"]
    assert record["pairs_without_matches"] == []
    assert {(p["a"], p["b"]) for p in record["pairs"]} == {("a", "b"), ("a", "c"), ("b", "c")}


@pytest.mark.oracle
def test_orientation_errors_are_found_as_y_parallax(matched: Matched) -> None:
    """The mean y-parallax before the trend is the part of the models' shifts across the epipolar lines.

    The test computes this part from the leans.
    """
    by_name = {v.name: v for v in VIEWS}
    for pair in matched[1]["pairs"]:
        a, b = by_name[pair["a"]], by_name[pair["b"]]
        along = b.matrix @ (np.array(a.lean) - np.array(b.lean))
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        wrong = b.matrix @ a.matrix.T @ np.array(a.shift_px) - np.array(b.shift_px)
        assert abs(pair["y_parallax_before_mean_px"]) == pytest.approx(abs(across @ wrong), abs=0.05)


@pytest.mark.behaviour
def test_tables_of_the_project_can_be_adjusted(matched: Matched) -> None:
    """``adjust`` of a matched project has sigma0 1 within 0.2, and the project file keeps its lines."""
    folder, record = matched
    text = (folder / "project.toml").read_text("utf-8")
    assert text.startswith("# rendered\nschema = 1\n")
    assert text.endswith('\n\n[observations]\nfile = "observations.csv"\n') and "[points]" not in text
    solution = fg.adjust(fg.read_project(folder / "project.toml"))
    assert solution.sigma0 == pytest.approx(1.0, abs=0.2)
    assert not (folder / "points.csv").exists()  # all are tie points
    assert json.loads((folder / "match" / "match.json").read_text())["n_points"] == record["n_points"]
    page = structure(folder / "match" / "report.html")
    assert page.tags.count("img") == 3 and "svg" in page.tags
    assert any("Tie points measured" in text for text in page.text)
    assert len(set(page.ids)) == len(page.ids)
    assert not list(folder.glob(".project.match"))


@pytest.mark.behaviour
def test_points_of_a_table_stay(project: Path) -> None:
    """``match`` adds tie points below the records of a user, and a second run replaces its own points only."""
    points = "# surveyed\nrole,id,x_m,y_m,z_m,sigma_east_m,sigma_north_m,sigma_up_m\ncontrol,7,1,2,3,1,1,1\n"
    image = "id,image,sample,line,sigma_sample_px,sigma_line_px\n7,a,10,20,0.5,0.5\n7,b,11,21,0.5,0.5\n"
    (project.parent / "gcp.csv").write_text(points, "utf-8")
    (project.parent / "marks.csv").write_text(image, "utf-8")
    entries = '\n[points]\nfile = "gcp.csv" # mine\ncrs = "EPSG:4978"\n[observations]\nfile = "marks.csv"\n'
    project.write_text(project.read_text("utf-8") + entries, "utf-8")
    before = project.read_bytes()
    options = ("--per-cell", "2", "--cells", "4")
    ended = in_process("match", project, *options)
    assert ended.code == 0, ended.stderr
    assert project.read_bytes() == before
    assert (project.parent / "gcp.csv").read_text("utf-8").startswith(points)
    assert (project.parent / "marks.csv").read_text("utf-8").startswith(image)
    first = [(project.parent / name).read_bytes() for name in ("gcp.csv", "marks.csv")]
    new = table(project.parent / "marks.csv")[2:]
    assert len(new) > 20 and all(row["id"].startswith("match-") for row in new)
    again = in_process("match", project, *options, "--out", project.parent / "other")
    assert again.code == 2 and "--overwrite" in again.stderr
    assert in_process("match", project, *options, "--overwrite").code == 0
    assert [(project.parent / name).read_bytes() for name in ("gcp.csv", "marks.csv")] == first


@pytest.mark.consistency
def test_an_interrupted_run_goes_on(
    project: Path, matched: Matched, monkeypatch: pytest.MonkeyPatch,
    interrupted: Callable[[int], Callable[[int, int, str], None]],
) -> None:  # fmt: skip
    with pytest.raises(KeyboardInterrupt) as caught:
        match_project(project, progress=interrupted(1))
    assert caught.value.args[0].code == "match.interrupted"
    assert not (project.parent / "observations.csv").exists()
    asked: list[int] = []
    monkeypatch.setattr(kept, "_read", lambda file, read=kept._read: asked.append(1) or read(file))
    match_project(project, resume=True)
    assert asked
    assert (project.parent / "observations.csv").read_bytes() == (matched[0] / "observations.csv").read_bytes()


@pytest.mark.behaviour
def test_nodata_and_offsets(rendered: Path, tmp_path: Path) -> None:
    """A part of an image is matched at its place in the scene, without points at empty pixels."""
    shutil.copytree(rendered, tmp_path, dirs_exist_ok=True)
    pixels = read_raster(tmp_path / "a.tif")
    pixels[:, 120:] = 0
    write_raster(tmp_path / "part.tif", pixels[40:, 10:])
    project = tmp_path / "project.toml"
    text = project.read_text("utf-8")
    line = 'metadata = "a_RPC.TXT"'
    text = text.replace(line, f'{line}\npixels = "part.tif"\npixels_origin = [40, 10]')
    project.write_text(text, "utf-8")
    record = match_project(project)
    at = np.array([r["a"][0] for r in rays(tmp_path).values() if "a" in r])
    assert at[:, 0].min() > 40 and at[:, 1].min() > 10 and at[:, 1].max() < 120
    assert next(p for p in record["pairs"] if p["b"] == "b")["y_parallax_after_rms_px"] < 0.1


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda p: (p.parent / "b.tif").unlink(), "match.no_pixels", "pixels ="),
        (lambda p: (p.parent / "b.tif").write_text("no raster"), "match.pixels", "GDAL"),
        (lambda p: p.write_text(p.read_text().partition('\n[[images]]\nid = "b"')[0]), "match.one_image",
         "two images"),
        (lambda p: p.write_text(p.read_text() + '\n[points]\nfile = "p.parquet"\ncrs = "EPSG:4979"\n'),
         "match.table_form", "convert"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused(project: Path, change: Callable[[Path], Any], code: str, words: str) -> None:
    change(project)
    with pytest.raises(InputError) as caught:
        match_project(project)
    assert [p.code for p in caught.value.problems] == [code]
    assert words in str(caught.value)


@pytest.mark.behaviour
def test_a_dem_restricts_the_search(project: Path, matched: Matched, scene: Scene) -> None:
    """With a DEM ``match`` finds nearly the same points; with heights 500 m too high it finds none."""
    scene.write_dem(project.parent / "dem.tif", 5.0)
    ended = in_process("match", project, "--dem", project.parent / "dem.tif", "--dem-sigma", 5, "--json")
    assert ended.code == 0, ended.stderr
    record = ended.json
    assert record["heights_m"][1] - record["heights_m"][0] < 100.0 < np.ptp(matched[1]["heights_m"])
    assert record["n_points"] == pytest.approx(matched[1]["n_points"], rel=0.1)
    assert errors(project.parent, scene, VIEWS).is_wrong().mean() <= 0.002
    scene.write_dem(project.parent / "dem.tif", 5.0, 500.0)
    ended = in_process("match", project, "--dem", project.parent / "dem.tif", "--dem-sigma", 5, "--overwrite")
    assert ended.code == 2
    assert "no two images overlap" in ended.stderr or "no pair of images matches" in ended.stderr


@pytest.mark.oracle
def test_control_points_by_chips(project: Path, scene: Scene) -> None:
    """Chips are found at their true pixels within 0.2 px, and a chip of other ground is excluded with a warning.

    The models are wrong.
    """
    rng, package = np.random.default_rng(8), project.parent / "chips.gpkg"
    xy = rng.uniform(-22.0, 22.0, (2, 14))
    heights = scene.write_chips(package, xy, 20, rng)
    project.write_text(project.read_text("utf-8") + "\n[orientation]\nrpc_shift_sigma_px = 3.0\n", "utf-8")
    with rasterio.open(project.parent / "chips" / "g0.tif", "r+") as target:
        target.write(target.read(1)[::-1], 1)
    ended = in_process("match", project, "--control", package, "--per-cell", 2, "--json")
    assert ended.code == 0, ended.stderr
    found = rays(project.parent)
    error, sigma = [], []
    for k in range(1, 14):
        for view in VIEWS:
            if view.name in (marks := found.get(f"match-chip-g{k}", {})):
                true = view.project(xy[:1, k], xy[1:, k], heights[k : k + 1])[0]
                error.append(marks[view.name][0] - true)
                sigma.append(marks[view.name][1])
    print(
        len(error),
        np.sqrt(np.mean(np.square(error), axis=0)),
        np.mean((np.array(error) / np.array(sigma)) ** 2),
        np.median(sigma),
    )
    assert len(error) >= 25 and "match-chip-g0" not in found
    assert float(np.sqrt(np.mean(np.square(error)))) < 0.2
    assert 0.5 < np.mean((np.array(error) / np.array(sigma)) ** 2) < 1.5
    assert ended.json["control"]["measured"] == len({name for name in found if "chip" in name})
    assert any(f["code"] == "match.chip_lost" and "g0" in f["place"] for f in ended.json["findings"])
    control = [row for row in table(project.parent / "points.csv") if row["role"] == "control"]
    assert {row["id"] for row in control} == {name for name in found if "chip" in name}
    block = fg.read_project(project)
    solution = fg.adjust(block)
    assert solution.sigma0 < 2.0
    assert abs(solution.correction("b")[:2] + np.array(VIEWS[1].shift_px)).max() < 0.3


@pytest.mark.behaviour
def test_images_that_show_different_ground_do_not_match(project: Path) -> None:
    """Images of different ground are refused with the reason. By chance alone no trend is found."""
    write_raster(project.parent / "b.tif", read_raster(project.parent / "b.tif")[::-1, ::-1])
    VIEWS[1].write_rpc(project.parent)  # GDAL has removed it together with the old image
    text = project.read_text("utf-8").partition('\n[[images]]\nid = "c"')[0]
    project.write_text(text, "utf-8")
    with pytest.raises(InputError, match="no pair of images matches"):
        match_project(project)


@pytest.mark.slow
@pytest.mark.consistency
def test_processes_give_the_same(project: Path, matched: Matched) -> None:
    match_project(project, workers=2)
    assert (project.parent / "observations.csv").read_bytes() == (matched[0] / "observations.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("snr", [20.0, 50.0, 100.0])
def test_bars_by_signal_to_noise(tmp_path: Path, snr: float) -> None:
    """Matches of rendered images have RMS, NEES and share of errors within their limits at each signal-to-noise ratio.

    The scene has hills of 8 m and walls, and an MTF of 0.15 at the Nyquist frequency. The RMS is at most 0.15 px for
    SNR 20, else 0.12 px.
    """
    views = (View("a", (0.25, -0.05), 400), View("b", (-0.25, 0.1), 400, 4.0, (2.5, -1.5), 1.3, 40.0))
    scene = Scene(155.0, 3)
    record = match_project(write_pair(tmp_path, scene, views, snr))
    found = errors(tmp_path, scene, views)
    print(f"\nwrong: {record['predicted_wrong_share'] * 100:.3f} % predicted")
    print(f"\nsignal to noise {snr:g}: {len(found.error_px)} points, RMS {found.rms_px():.3f} px, "
          f"NEES {found.nees():.2f}, "
          f"wrong {100 * found.is_wrong().mean():.2f} %, hidden {100 * (~found.visible).mean():.2f} %")  # fmt: skip
    assert len(found.error_px) > 800
    assert found.rms_px() <= (0.15 if snr == 20.0 else 0.12)
    assert 0.8 <= found.nees() <= 1.25
    assert found.is_wrong().mean() <= 0.002


@pytest.mark.behaviour
def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="ratio"):
        MatchOptions(ratio=1.5)
