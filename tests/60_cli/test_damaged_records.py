"""Commands refuse damaged result folders of ``closerange`` and ``rectify fit`` with the reason."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.page_files import map_points, photos_and_control

pytestmark = pytest.mark.behaviour

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Output:
    """Output of a command.

    Parameters
    ----------
    make : callable
        Writes the input into a folder.
    words : tuple of str
        Command without ``--out``; names with .CSV are files of the input.
    record, table : str
        File with the record, and one of the tables.
    readers : callable
        Gives the commands that read a result folder, with a folder for their output.
    damaged : str
        Code of a record that is not JSON.
    """

    make: Callable[[Path], object]
    words: tuple[str, ...]
    record: str
    table: str
    readers: Callable[[Path, Path], dict[str, tuple[object, ...]]]
    damaged: str

    def command(self, source: Path) -> list[object]:
        return [source / word.lower() if word.endswith(".CSV") else word for word in self.words]


def _of_photos(folder: Path, out: Path) -> dict[str, tuple[object, ...]]:
    theirs = out.parent / "theirs.csv"
    theirs.write_text("name,value\nphoto left redundancy,1\n", "utf-8")
    return {"report": ("report", folder), "compare": ("closerange", "compare-report", folder, theirs)}


def _of_maps(folder: Path, out: Path) -> dict[str, tuple[object, ...]]:
    return {
        "check": ("rectify", "check", folder, "--standard", "NSSDA"),
        "ortho": (
            "rectify",
            "ortho",
            out.parent / "source" / "IMAGE.tif",
            folder,
            "--resolution",
            100,
            "--out",
            out / "map.tif",
        ),
    }


OUTPUTS = {
    "closerange": Output(photos_and_control, ("closerange", "dlt", "CONTROL.CSV"), "closerange.json", "points.csv",
                         _of_photos, "report.damaged"),
    "rectify": Output(map_points, ("rectify", "fit", "POINTS.CSV", "--crs", "EPSG:32636"), "result.json",
                      "coefficients.csv", _of_maps, "rectify.result"),
}  # fmt: skip
Damage = Callable[[Path, Path, Output], object]


def _table(folder: Path, out: Output) -> Path:
    return folder / out.table


def _edit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    k = next(k for k in range(len(data) - 1, 0, -1) if chr(data[k]) in "12345678")
    data[k] += 1
    path.write_bytes(data)


def _change_manifest(change: Callable[[dict[str, Any], Output], object]) -> Damage:
    def damage(folder: Path, _: Path, out: Output) -> None:
        content = json.loads((folder / MANIFEST).read_text("utf-8"))
        change(content, out)
        (folder / MANIFEST).write_text(json.dumps(content), "utf-8")

    return damage


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _link(folder: Path, other: Path, out: Output) -> None:
    moved = folder.parent / "elsewhere.csv"
    _table(folder, out).rename(moved)
    _table(folder, out).symlink_to(moved)


def _half(folder: Path, other: Path, out: Output) -> None:
    names = sorted(path.name for path in folder.iterdir())
    for name in names[names.index(MANIFEST) + 1 :]:
        (folder / name).unlink()


def _encoded(folder: Path, other: Path, out: Output) -> None:
    path = folder / out.record
    path.write_bytes(path.read_text("utf-8").encode("utf-16"))


#: Damage, and the code of the refusal; "" is that of a record that is not JSON.
DAMAGED: dict[str, tuple[Damage, str]] = {
    "a file is missing": (lambda f, _, out: _table(f, out).unlink(), "manifest.incomplete"),
    "a file is cut": (lambda f, _, out: _cut(_table(f, out)), "manifest.incomplete"),
    "the record is missing": (lambda f, _, out: (f / out.record).unlink(), "manifest.incomplete"),
    "the record is of another run": (lambda f, o, out: shutil.copy(o / out.record, f), "manifest.other_run"),
    "a table is of another run": (lambda f, o, out: shutil.copy(o / out.table, f), "manifest.changed"),
    "a table is edited": (lambda f, _, out: _edit(_table(f, out)), "manifest.changed"),
    "the record has another encoding": (_encoded, ""),
    "the manifest is missing": (lambda f, *_: (f / MANIFEST).unlink(), "manifest.incomplete"),
    "a digest is wrong": (
        _change_manifest(lambda c, out: c["files"][out.table].update(sha256="0" * 64)), "manifest.changed"),
    "a table is a link out of the folder": (_link, "manifest.outside"),
    "half of it is copied": (_half, "manifest.incomplete"),
    "it is of a later version": (_change_manifest(lambda c, _: c.update(schema=99)), "manifest.later"),
    "the manifest names a file out of the folder": (
        _change_manifest(lambda c, out: c["files"].update({"../a": c["files"][out.table]})), "manifest.damaged"),
}  # fmt: skip


@pytest.fixture(scope="module", params=OUTPUTS)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, run: Any) -> tuple[Output, Path]:
    """Return an output, and a folder with its input ``source`` and the results ``result`` and ``other``."""
    out, folder = OUTPUTS[request.param], tmp_path_factory.mktemp(request.param)
    (folder / "source").mkdir()
    out.make(folder / "source")
    words = out.command(folder / "source")
    assert run(*words, "--out", folder / "result").code in (0, 4)
    table = Path(str(next(word for word in words if isinstance(word, Path))))
    kept = table.read_bytes()
    table.write_text(_shorter(table.read_text("utf-8")), "utf-8")
    assert run(*words, "--out", folder / "other").code in (0, 4)
    table.write_bytes(kept)
    return out, folder


def _shorter(text: str) -> str:
    """Return the text of a table without its first row."""
    head, _, *rows = text.splitlines()
    return "\n".join([head, *rows, ""])


def content(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def copied(made: tuple[Output, Path], tmp_path: Path) -> tuple[Output, Path]:
    """Return the output and a folder with copies that a test may change."""
    output, folder = made
    shutil.copytree(folder, tmp_path / "all")
    (tmp_path / "all" / "out").mkdir()
    return output, tmp_path / "all"


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_folder_is_refused(run: Any, copied: tuple[Output, Path], case: str) -> None:
    output, folder = copied
    damage, code = DAMAGED[case]
    result = folder / "result"
    damage(result, folder / "other", output)
    before = content(result)
    for name, words in output.readers(result, folder / "out").items():
        ended = run(*words, "--json")
        assert ended.code == 2, (name, ended.stdout, ended.stderr)
        (error,) = ended.json["errors"]
        assert error["code"] == (code or output.damaged), (name, error)
        assert error["remedy"] and str(result) in error["file"] and len(ended.stderr.splitlines()) == 1, (name, error)
    assert content(result) == before and not list((folder / "out").iterdir())


def test_whole_and_old_folders_are_read(run: Any, copied: tuple[Output, Path]) -> None:
    """Result folders that are renamed, have another page or no manifest are read by each command."""
    output, folder = copied
    result = (folder / "result").rename(folder / "renamed")
    (result / "report.html").write_text("edited", "utf-8")
    for _ in range(2):
        for name, words in output.readers(result, folder / "out").items():
            ended = run(*words, "--json")
            assert ended.code in (0, 4), (name, ended.stderr)
        (result / MANIFEST).unlink(missing_ok=True)
        record = json.loads((result / output.record).read_text("utf-8"))
        record.pop("manifest", None)
        (result / output.record).write_text(json.dumps(record), "utf-8")
        shutil.rmtree(folder / "out")
        (folder / "out").mkdir()
