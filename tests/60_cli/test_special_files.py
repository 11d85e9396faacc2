"""Pipes, devices, links and full disks end in one line; they neither stop the program nor harm other files."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fg_orient.cli import main
from fg_orient.formats.atomic import require_free_files, staged_file, write_text
from fg_orient.formats.faults import Faults
from fg_orient.formats.load import load_json, load_npz
from fg_orient.formats.staging import claimed, sweep
from fg_orient.formats.text_files import read_data, sha256_of
from fg_orient.model.errors import InputError
from tests.fuzz.harness import Broken, outcome
from tests.support.command import Run

pytestmark = [
    pytest.mark.behaviour, pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes are of POSIX systems"),
]  # fmt: skip

CLAIM = ".out.000000000000.lock"
PIXEL = ("--line", 5, "--sample", 5, "--height", 10)


def _data(path: Path) -> None:
    faults = Faults(str(path))
    read_data(path, faults)
    faults.raise_if_any()


@pytest.fixture(params=["pipe", "device"])
def special(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a pipe without a writer, or a link to a device that gives zeros without end."""
    path = tmp_path / "special.csv"
    if request.param == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.mark.parametrize("read", [
    _data, lambda path: load_npz(path, "checkpoint.unreadable"), lambda path: load_json(path, "interchange.json"),
])  # fmt: skip
def test_special_files_are_refused(special: Path, read: Callable[[Path], object]) -> None:
    """A table, an archive or a record that is a pipe or a device is refused at once."""
    found = outcome(lambda: read(special), 0)
    assert isinstance(found, str) and found


@pytest.mark.parametrize("words", [
    ("locate", "left.DIM", "--points"), ("convert", "--from", "csv", "--to", "csv", "--out", "other.csv"),
    ("rectify", "fit"), ("validate",), ("closerange", "intersect", "special.csv"),
])  # fmt: skip
def test_commands_refuse_special_files(special: Path, twin_source: Path, run: Run, words: tuple[str, ...]) -> None:
    """Commands end with exit code 2 and one line that names the pipe or device."""
    words = tuple(str(twin_source / word) if word == "left.DIM" else word for word in words)
    words = tuple(str(special) if word == "special.csv" else word for word in words)
    ended: list[Any] = []
    found = outcome(lambda: ended.append(run(*words, special)), 0)
    assert not isinstance(found, Broken), found.text
    assert ended[0].code == 2 and str(special) in ended[0].stderr and ended[0].stderr.count("\n") == 1


def test_hash_of_a_pipe_is_an_error(tmp_path: Path) -> None:
    """The hash of a pipe is an error, because its bytes would be lost or never come."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="pipe"):
        sha256_of(tmp_path / "pipe")


def test_a_lock_that_is_another_file_is_not_used(tmp_path: Path) -> None:
    """A pipe and a second name of another file are not locks: they are not waited for, changed or removed."""
    (tmp_path / "precious").write_text("precious", "utf-8")
    for make in (lambda path: os.link(tmp_path / "precious", path), os.mkfifo):
        make(tmp_path / CLAIM)
        make(tmp_path / ".a.aaaaaaaaaaaa.lock")
        with pytest.raises(OSError, match="lock"), claimed(tmp_path / "out"):
            pass
        sweep(tmp_path)
        assert (tmp_path / ".a.aaaaaaaaaaaa.lock").exists()
        for name in (CLAIM, ".a.aaaaaaaaaaaa.lock"):
            (tmp_path / name).unlink()
    assert (tmp_path / "precious").read_text("utf-8") == "precious"


def test_sweep_keeps_files_that_only_begin_alike(tmp_path: Path) -> None:
    """A sweep removes the hidden file and files with a further suffix, but no file whose name only begins alike."""
    stem = ".points.csv.aaaaaaaaaaaa"
    for name in (f"{stem}.lock", f"{stem}.tmp", f"{stem}.tmp.gpkg-journal", f"{stem}.tmp-wal", f"{stem}.tmp_mine"):
        (tmp_path / name).write_text("", "utf-8")
    sweep(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"{stem}.tmp_mine"]


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("nowhere")])
@pytest.mark.parametrize("overwrite", [False, True])
def test_pipes_and_open_links_are_not_replaced(
    tmp_path: Path, make: Callable[[Path], None], *, overwrite: bool
) -> None:
    """An output that is a pipe or a link without target is refused, also with --overwrite."""
    make(tmp_path / "out")
    with pytest.raises(InputError, match="pipe, a device or a link"):
        require_free_files(tmp_path / "out", overwrite=overwrite)


def test_outputs_do_not_replace_inputs(twin_source: Path, tmp_path: Path, run: Run) -> None:
    """An output that is an input, or a file of an input result, is refused with --overwrite, too."""
    image, project = tmp_path / "left.DIM", twin_source / "project.toml"
    image.write_bytes((twin_source / "left.DIM").read_bytes())
    before = image.read_bytes()
    assert run("adjust", project, "--out", tmp_path / "r", "--quiet").code == 0
    for words in (
        ("locate", image, *PIXEL, "--out", image), ("dsm-points", tmp_path / "r", "--out", tmp_path / "r/points.csv"),
    ):  # fmt: skip
        ended = run(*words, "--overwrite")
        assert ended.code == 2 and "would replace an input" in ended.stderr
    assert image.read_bytes() == before and run("report", tmp_path / "r", "--quiet").code == 0
    assert run("dsm-points", tmp_path / "r", "--out", tmp_path / "r/further.csv").code == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a device that is always full")
@pytest.mark.parametrize("words", [("--json",), (), ("--help",)])
def test_full_output_is_one_line(
    twin_source: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """If standard output cannot be written, one line says so, and the exit code is 2."""
    monkeypatch.setattr(sys, "argv", ["fg-orient", "locate", str(twin_source / "left.DIM"), *map(str, PIXEL), *words])
    monkeypatch.setattr("gc.freeze", lambda: None)
    with Path("/dev/full").open("w", encoding="utf-8") as full, contextlib.redirect_stdout(full):
        with pytest.raises(SystemExit) as end:
            main()
        error = capsys.readouterr().err
    assert end.value.code == 2 and error.count("error: standard output") == 1 and "Traceback" not in error


def test_closed_streams_do_not_end_the_run(
    twin_source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command without standard error and input writes its result."""
    out = tmp_path / "out.csv"
    monkeypatch.setattr(sys, "argv", ["fg-orient", "locate", str(twin_source / "left.DIM"), *map(str, PIXEL),
                                      "--out", str(out)])  # fmt: skip
    monkeypatch.setattr("gc.freeze", lambda: None)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", None)
        patch.setattr(sys, "stdin", None)
        with pytest.raises(SystemExit) as end:
            main()
        sys.stderr.close()
        sys.stdin.close()
    assert end.value.code == 0 and out.exists() and "written" in capsys.readouterr().out


def test_a_file_beside_a_pipe_is_written(tmp_path: Path) -> None:
    """A pipe with the name of a lock in the folder of an output does not stop the writer."""
    os.mkfifo(tmp_path / ".a.aaaaaaaaaaaa.lock")
    with staged_file(tmp_path / "file") as hidden:
        hidden.write_text("text", "utf-8")
    write_text(tmp_path / "other", "text")
    assert [(tmp_path / name).read_text("utf-8") for name in ("file", "other")] == ["text"] * 2
