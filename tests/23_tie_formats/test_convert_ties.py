"""``convert`` on tie points and models of other programs names losses and asks for unverified formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.bal import assumed_side, frame_model_of, read_bal_data
from fg_orient.formats.exchange.bundler import read_bundler
from fg_orient.formats.exchange.colmap_database import read_colmap_database
from fg_orient.formats.exchange.colmap_text import read_colmap_text, write_colmap_text
from fg_orient.formats.exchange.tie_folders import read_image, write_match
from fg_orient.formats.registry import formats
from tests.support.command import in_process
from tests.support.frame_models import frame_model


def matches(folder: Path) -> Path:
    left, right = np.array([[10.25, 20.5], [30.0, 40.0]]), np.array([[11.25, 21.5], [31.0, 41.0]])
    write_match(folder / "run-a__b.match", left, right)
    return folder / "run-a__b.match"


@pytest.mark.behaviour
def test_an_unverified_format_is_asked_for_once_with_a_sentence(tmp_path: Path) -> None:
    ended = in_process("convert", matches(tmp_path), "--to", "micmac-ties", "--out", tmp_path / "out")
    assert ended.code == 2
    assert "--accept-unverified" in ended.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.behaviour
def test_matches_become_tables_and_a_database(tmp_path: Path) -> None:
    path = matches(tmp_path)
    ended = in_process("convert", path, "--accept-unverified", "--to", "micmac-ties", "--out", tmp_path / "out")
    assert ended.code == 0, ended.stderr
    assert read_image(tmp_path / "out" / "PMUL-a.csv")[0].tolist() == [[10.25, 20.5], [30.0, 40.0]]
    words = ["convert", tmp_path / "out", "--from", "micmac-ties", "--out", tmp_path / "ties.db"]
    refused = in_process(*words)
    assert refused.code == 2
    assert "--image-size a=LINES,SAMPLES" in refused.stderr
    ended = in_process(*words, "--image-size", "a=100,200", "--image-size", "b=100,200", "--json")
    assert (ended.code, ended.json["image_points"], ended.json["tie"]) == (0, 4, 2)
    survey = read_colmap_database(tmp_path / "ties.db")
    assert sorted(survey.observed.line.tolist()) == [10.25, 11.25, 30.0, 31.0]


@pytest.mark.behaviour
@pytest.mark.parametrize("wanted", ["bundler", "bal", "colmap-text"])
def test_points_are_no_model(wanted: str, tmp_path: Path) -> None:
    """Converting matches to a format of models is refused and names the formats that contain a model."""
    words = ["convert", matches(tmp_path), "--accept-unverified", "--to", wanted, "--out", tmp_path / "out"]
    ended = in_process(*words)
    assert ended.code == 2 and "needs cameras and poses, which asp-match does not" in ended.stderr
    assert "only be read" not in ended.stderr and "bal, bundler" in ended.stderr and "colmap-text" in ended.stderr


@pytest.mark.behaviour
def test_rounding_to_single_precision_is_told(tmp_path: Path) -> None:
    (tmp_path / "t").mkdir()
    for name in ("a", "b"):
        (tmp_path / "t" / f"PMUL-{name}.csv").write_text("Pt.x,Pt.y,Id\n1000.1,2000.3,0\n")
    sizes = ["--image-size", "a=9000,9000", "--image-size", "b=9000,9000"]
    ended = in_process("convert", tmp_path / "t", "--from", "micmac-ties", "--out", tmp_path / "t.db", *sizes, "--json")
    (lost,) = (p for p in ended.json["lost"] if p["code"] == "lost.single")
    error = max(abs(float(np.float32(value)) - value) for value in (1000.6, 2000.8))  # COLMAP adds half a pixel
    assert lost["value"] == f"up to {error:.1g} px"


@pytest.mark.consistency
def test_a_model_goes_from_colmap_to_bundler_and_back_with_its_residuals(tmp_path: Path) -> None:
    model = frame_model(("none", "radial"))
    write_colmap_text(tmp_path / "sparse", model)
    words = ["convert", tmp_path / "sparse", "--from", "colmap-text", "--out", tmp_path / "bundle.out"]
    ended = in_process(*words)
    assert ended.code == 0, ended.stderr
    assert "names of images" in ended.stderr
    data, _, _ = read_bundler(tmp_path / "bundle.out")
    assert np.sum(frame_model_of(data).residuals_px() ** 2) == pytest.approx(
        np.sum(model.residuals_px() ** 2), rel=1e-9
    )
    assert in_process(*words).code == 2  # nothing is overwritten
    back = ["convert", tmp_path / "bundle.out", "--to", "colmap-text", "--out", tmp_path / "back"]
    assert in_process(*back).code == 2  # unverified
    ended = in_process(*back, "--accept-unverified", "--json")
    assert ended.code == 0
    (note,) = (text for text in ended.json["notes"] if "the file contains no image sizes" in text)
    assert "are assumed for 0, 1, 2; give the true sizes" in note
    again = read_colmap_text(tmp_path / "back")
    assert np.sum(again.residuals_px() ** 2) == pytest.approx(np.sum(model.residuals_px() ** 2), rel=1e-9)


@pytest.mark.behaviour
def test_sizes_of_images_are_given_or_said_to_be_assumed(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "sparse", frame_model(("none", "k1")))
    bal = tmp_path / "problem.txt"
    assert in_process("convert", tmp_path / "sparse", "--from", "colmap-text", "--to", "bal", "--out", bal).code == 0
    words = ["convert", bal, "--from", "bal", "--to", "colmap-text", "--out"]
    one = in_process(*words, tmp_path / "one", "--image-size", "1=701,801")
    side = assumed_side(read_bal_data(bal))
    assert one.code == 0 and f"{side} x {side} pixels" in one.stderr and "are assumed for 0, 2; give" in one.stderr
    sizes = [(c.n_lines, c.n_samples) for c in read_colmap_text(tmp_path / "one").cameras.values()]
    assert sizes == [(side, side), (701, 801), (side, side)]
    both = in_process(*words, tmp_path / "both", *(f"--image-size={k}=60{k},90{k}" for k in range(3)))
    assert both.code == 0 and "assumed" not in both.stderr
    sizes = [(c.n_lines, c.n_samples) for c in read_colmap_text(tmp_path / "both").cameras.values()]
    assert sizes == [(600, 900), (601, 901), (602, 902)]


@pytest.mark.behaviour
@pytest.mark.parametrize("target", ["colmap-text", "colmap-database"])
def test_a_size_of_an_image_that_is_not_there_is_refused(tmp_path: Path, target: str) -> None:
    write_colmap_text(tmp_path / "sparse", frame_model(("none", "k1")))
    bal, out = tmp_path / "problem.txt", tmp_path / "out"
    assert in_process("convert", tmp_path / "sparse", "--from", "colmap-text", "--to", "bal", "--out", bal).code == 0
    ended = in_process("convert", bal, "--from", "bal", "--to", target, "--out", out, "--image-size", "left=9,9")
    assert ended.code == 2
    assert "--image-size: the file has no image of this name (found left); choose one of 0, 1, 2" in ended.stderr
    assert not out.exists()


@pytest.mark.behaviour
def test_sizes_beside_a_format_that_has_none_are_refused_too(tmp_path: Path) -> None:
    ended = in_process("convert", matches(tmp_path), "--accept-unverified", "--to", "micmac-ties", "--out",
                       tmp_path / "out", "--image-size", "c=9,9")  # fmt: skip
    assert ended.code == 2
    assert "the file has no image of this name (found c); choose one of a, b" in ended.stderr


@pytest.mark.behaviour
def test_cameras_that_bundler_cannot_hold_are_refused_by_name(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "sparse", frame_model(("brown",)))
    ended = in_process("convert", tmp_path / "sparse", "--from", "colmap-text", "--out", tmp_path / "bundle.out")
    assert ended.code == 2
    assert "camera 1" in ended.stderr
    assert not (tmp_path / "bundle.out").exists()


@pytest.mark.behaviour
def test_formats_with_a_model_say_which_was_tried() -> None:
    found = formats()
    written = {"colmap-text", "bundler", "bal"}
    assert {name for name, f in found.items() if f.read_model} == written | {"photomodeler", "sba", "libmv"}
    assert {name for name, f in found.items() if f.write_model} == written
    tie_formats = (
        "asp-match",
        "colmap-database",
        "colmap-text",
        "bundler",
        "bal",
        "micmac-ties",
        "photomodeler",
        "dbat",
    )
    assert [name for name in tie_formats if not found[name].verified] == ["asp-match", "bundler"]
