"""Each command that reads a result folder refuses a damaged one in one line with the reason."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.model.errors import InputError
from fg_orient.result.record import read_any_result
from tests.support.changed_text import change_file
from tests.support.results import of_version_0_1, sealed

pytestmark = pytest.mark.behaviour

MANIFEST, RECORD = "manifest.json", "result.json"


def _text(name: str, old: str, new: str) -> Callable[[Path, Path], object]:
    """Return a function that replaces a text in a file by one of the same length, so that its size is unchanged."""
    assert len(old) == len(new)

    def change(folder: Path, other: Path) -> None:
        change_file(folder / name, (old, new))

    return change


def _cut(name: str, part: float) -> Callable[[Path, Path], object]:
    def change(folder: Path, other: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(part * len(data))])

    return change


def _taken(*names: str) -> Callable[[Path, Path], object]:
    """Copy files of another run."""

    def change(folder: Path, other: Path) -> None:
        for name in names:
            shutil.copy(other / name, folder / name)

    return change


def _link(folder: Path, other: Path) -> None:
    """Put a link out of the folder in place of a table of the same content."""
    moved = folder.parent / "elsewhere.csv"
    (folder / "eop.csv").rename(moved)
    (folder / "eop.csv").symlink_to(moved)


def _half(folder: Path, other: Path) -> None:
    """Leave the files that a copy in alphabetical order has written when it ends after the manifest.

    The tables are missing.
    """
    names = sorted(path.name for path in folder.iterdir())
    for name in names[names.index(MANIFEST) + 1 :]:
        (folder / name).unlink()


def _digest(folder: Path, other: Path) -> None:
    content = json.loads((folder / MANIFEST).read_text("utf-8"))
    content["files"]["points.csv"]["sha256"] = "0" * 64
    (folder / MANIFEST).write_text(json.dumps(content), "utf-8")


def _later(folder: Path, other: Path) -> None:
    content = json.loads((folder / MANIFEST).read_text("utf-8"))
    (folder / MANIFEST).write_text(json.dumps(content | {"schema": 99}), "utf-8")


def _escape(folder: Path, other: Path) -> None:
    content = json.loads((folder / MANIFEST).read_text("utf-8"))
    content["files"]["../twin/points.csv"] = content["files"]["points.csv"]
    (folder / MANIFEST).write_text(json.dumps(content), "utf-8")


def _encoded(folder: Path, other: Path) -> None:
    text = (folder / RECORD).read_text("utf-8")
    (folder / RECORD).write_bytes(text.encode("utf-16"))


def _added(folder: Path, other: Path) -> None:
    shutil.copy(other / "eop.csv", folder / "outliers.csv")


#: Damage: what was done to the folder, and the code of the refusal.
DAMAGED: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "a file is missing": (lambda folder, _: (folder / "eop.csv").unlink(), "manifest.incomplete"),
    "a file is cut": (_cut("points.csv", 0.5), "manifest.incomplete"),
    "the record is missing": (lambda folder, _: (folder / RECORD).unlink(), "manifest.incomplete"),
    "the record is of another run": (_taken(RECORD), "manifest.other_run"),
    "the manifest is of another run": (_taken(MANIFEST), "manifest.other_run"),
    "a table is of another run": (_taken("eop.csv"), "manifest.changed"),
    "a table is edited": (_text("eop.csv", "posterior", "POSTERIOR"), "manifest.changed"),
    "the record is edited": (_text(RECORD, '"status": "converged"', '"status": "CONVERGED"'), "manifest.changed"),
    "the record has another encoding": (_encoded, "report.damaged"),
    "the manifest is missing": (lambda folder, _: (folder / MANIFEST).unlink(), "manifest.incomplete"),
    "the manifest is cut": (_cut(MANIFEST, 0.5), "manifest.damaged"),
    "a digest is wrong": (_digest, "manifest.changed"),
    "a table is a link out of the folder": (_link, "manifest.outside"),
    "the manifest names a file out of the folder": (_escape, "manifest.damaged"),
    "half of it is copied": (_half, "manifest.incomplete"),
    "it is of a later version": (_later, "manifest.later"),
    "a file is added": (_added, "manifest.added"),
}


@pytest.fixture(scope="module")
def other(twin_source: Path, tmp_path_factory: pytest.TempPathFactory, run: Any) -> Path:
    """Return the result of another run of the same project."""
    out = tmp_path_factory.mktemp("other") / "result"
    assert run("adjust", twin_source / "project.toml", "--out", out, "--eop-set", 10).code == 0
    return out


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the flat elevation model of the scene."""
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    place = rasterio.Affine(0.1, 0.0, 31.0, 0.0, -0.1, 42.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32", crs="EPSG:4979", transform=place
    ) as out:
        out.write(np.full((1, 20, 20), 300.0, "float32"))
    return path


def commands(folder: Path, twin: Path, dem: Path, out: Path) -> dict[str, tuple[object, ...]]:
    """Return each command that reads a result folder."""
    image = twin / "left.DIM"
    return {
        "report": ("report", folder),
        "report --export": ("report", folder, "--export", out / "layers.geojson"),
        "replay": ("replay", folder, "--project", twin / "project.toml", "--out", out / "again"),
        "accuracy": ("accuracy", folder, "--dem", dem),
        "dsm-points": ("dsm-points", folder, "--out", out / "points.csv"),
        "locate": ("locate", image, "--line", 100, "--sample", 200, "--height", 300, "--result", folder),
        "rpc convert": ("rpc", "convert", folder, "--for", "gdal", "--out", out / "rpc"),
        "adjust": ("adjust", twin / "project.toml", "--from", folder, "--out", out / "next"),
    }  # fmt: skip


def content(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder and below."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


#: Cases that the fast tests give to each command; other cases go to one command.
FAST = ("a file is missing", "a table is edited", "the record is of another run")


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_folder_is_refused(
    run: Any, result: Path, other: Path, twin_source: Path, dem: Path, tmp_path: Path, case: str
) -> None:
    refused_by(run, result, other, twin_source, dem, tmp_path, case, each=case in FAST)


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for case in DAMAGED if case not in FAST])
def test_damaged_folder_is_refused_by_each_command(
    run: Any, result: Path, other: Path, twin_source: Path, dem: Path, tmp_path: Path, case: str
) -> None:
    refused_by(run, result, other, twin_source, dem, tmp_path, case, each=True)


def refused_by(
    run: Any, result: Path, other: Path, twin: Path, dem: Path, tmp_path: Path, case: str, *, each: bool
) -> None:
    """Damage a result, and assert that the command ``report`` or each command refuses it and writes nothing."""
    damage, code = DAMAGED[case]
    damage(result, other)
    before, out = content(result), tmp_path / "out"
    out.mkdir()
    for name, words in commands(result, twin, dem, out).items():
        if not each and name != "report":
            continue
        ended = run(*words, "--json")
        assert ended.code == 2, (name, ended.stdout, ended.stderr)
        (error,) = ended.json["errors"]
        assert error["code"] == code, (name, error)
        assert error["remedy"] and str(result) in error["file"], (name, error)
        assert len(ended.stderr.splitlines()) == 1, (name, ended.stderr)
    assert content(result) == before
    assert list(out.iterdir()) == []


def test_folder_of_version_0_1_is_read(run: Any, result: Path, twin_source: Path, dem: Path, tmp_path: Path) -> None:
    of_version_0_1(result)
    for name, words in commands(result, twin_source, dem, tmp_path).items():
        ended = run(*words)
        expected = 2 if name == "rpc convert" else 0  # the twin has no RPC
        assert ended.code in (expected, 4), (name, ended.stderr)


def test_residuals_of_an_unknown_image_are_refused(result: Path) -> None:
    """Residuals of an unknown image in a folder without manifest are refused. Fuzzing found this case."""
    of_version_0_1(result)
    path = result / "residuals.csv"
    path.write_text(path.read_text("utf-8").replace("left,", "other,", 1), "utf-8")
    with pytest.raises(InputError, match="other") as caught:
        read_any_result(result).residual_summary()
    assert caught.value.problems[0].code == "report.damaged"


def test_whole_folder_is_read(run: Any, result: Path, twin_source: Path, dem: Path, tmp_path: Path) -> None:
    """A result folder is read after it is copied, renamed and given another page, and its manifest lists all files."""
    copy = shutil.copytree(result, tmp_path / "another name")
    (copy / "report.html").write_text("edited", "utf-8")
    for name in ("report", "locate"):
        assert run(*commands(copy, twin_source, dem, tmp_path)[name]).code == 0
    stated = json.loads((copy / MANIFEST).read_text("utf-8"))
    assert sorted(stated["files"]) == sorted(p.name for p in copy.iterdir() if p.name not in (MANIFEST, "report.html"))
    assert sealed(copy) == copy


def test_manifest_has_the_digests_of_the_files(result: Path) -> None:
    import hashlib

    stated = json.loads((result / MANIFEST).read_text("utf-8"))["files"]
    for name, one in stated.items():
        data = (result / name).read_bytes()
        assert one == {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
