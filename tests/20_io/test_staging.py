"""Hidden files of outputs are removed when their process has ended, and kept while it runs."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from fg_orient.formats import staging
from fg_orient.formats.atomic import (
    Contents,
    alone,
    made_folder,
    outputs,
    require_free,
    staged_file,
    staged_folder,
    together,
    write_text,
)  # fmt: skip
from fg_orient.formats.staging import held, publish, scratch_folder, sweep, synchronise
from fg_orient.model.errors import InputError

pytestmark = [
    pytest.mark.behaviour, pytest.mark.skipif(sys.platform == "win32", reason="locks are of POSIX systems"),
]  # fmt: skip

CONTENTS = Contents("mark", ("mark", "more"))
#: A process that fills an output and then waits.
WRITER = """
import sys, time
from fg_orient.formats.atomic import Contents, staged_file, staged_folder
kind, path = sys.argv[1:]
with (staged_file(path) if kind == "file" else staged_folder(path)) as hidden:
    (hidden if kind == "file" else hidden / "mark").write_text("half")
    print("ready", flush=True)
    time.sleep(600)
"""


def hidden(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


@contextlib.contextmanager
def writer(kind: str, path: Path) -> Iterator[subprocess.Popen[str]]:
    """Yield a process in the middle of writing an output."""
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, kind, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_a_killed_process_left_is_swept_and_that_of_a_living_one_is_not(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    with writer(kind, out) as process:
        left = hidden(tmp_path)
        assert [name.rsplit(".", 1)[1] for name in left] == ["lock", "tmp"]
        with staged_folder(tmp_path / "other"):
            pass
        assert hidden(tmp_path) == left, "its writer lives"
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert hidden(tmp_path) == left
    with staged_folder(tmp_path / "another"):
        pass
    assert hidden(tmp_path) == [] and not out.exists()


def test_a_file_sweeps_its_folder_too(tmp_path: Path) -> None:
    with writer("folder", tmp_path / "out") as process:
        process.kill()
    assert len(hidden(tmp_path)) == 2
    staging.sweep_once.cache_clear()
    write_text(tmp_path / "file", "text")
    assert hidden(tmp_path) == []


def test_a_lock_left_inside_an_output_does_not_protect_it(tmp_path: Path) -> None:
    """The removal of a lock inside the staging folder failed, so the output contains it; --overwrite sweeps it."""
    kind = Contents("mark", ("mark", "inner/mark"))
    (tmp_path / "out" / "inner").mkdir(parents=True)
    for name in ("mark", "inner/mark", "inner/.mark.0123456789ab.lock"):
        (tmp_path / "out" / name).write_text("", "utf-8")
    require_free(tmp_path / "out", overwrite=True, contents=kind)
    assert sorted(path.name for path in (tmp_path / "out").rglob("*")) == ["inner", "mark", "mark"]
    (tmp_path / "out" / "inner" / "own").touch()
    with pytest.raises(InputError, match="inner/own"):
        require_free(tmp_path / "out", overwrite=True, contents=kind)


@pytest.mark.parametrize(("there", "expected"), [(False, "old"), (True, "new")])
def test_an_output_that_was_being_replaced_is_put_back(tmp_path: Path, there: bool, expected: str) -> None:
    """After a kill between two renamings the sweep restores the old folder, unless the new one is in its place."""
    stem = ".out.0123456789ab"
    for name, text in ((f"{stem}.old", "old"), (f"{stem}.tmp", "half"), *([("out", "new")] if there else [])):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mark").write_text(text, "utf-8")
    (tmp_path / f"{stem}.lock").write_text("", "utf-8")
    sweep(tmp_path)
    assert hidden(tmp_path) == [] and (tmp_path / "out" / "mark").read_text("utf-8") == expected


def test_a_lock_of_another_machine_is_left_for_a_week(tmp_path: Path) -> None:
    lock = tmp_path / ".out.0123456789ab.lock"
    lock.write_text("elsewhere 17\n", "utf-8")
    (tmp_path / ".out.0123456789ab.tmp").mkdir()
    sweep(tmp_path)
    assert len(hidden(tmp_path)) == 2
    os.utime(lock, (1e9, 1e9))
    sweep(tmp_path)
    assert hidden(tmp_path) == []


def test_files_that_only_look_alike_stay(tmp_path: Path) -> None:
    names = [".out.lock", ".out.0123456789ab.tmp", ".out.0123456789ab.old", "out.0123456789ab.lock", ".a.XYZ.lock"]
    for name in names:
        (tmp_path / name).write_text("mine", "utf-8")
    link = tmp_path / ".out.ba9876543210.lock"
    link.symlink_to(tmp_path / names[0])
    sweep(tmp_path)
    assert sorted([*names, link.name]) == sorted(path.name for path in tmp_path.iterdir())


@pytest.mark.parametrize("exchange", [True, False])
def test_a_folder_is_replaced_or_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: bool) -> None:
    """``publish`` replaces a folder, or leaves it as before if replacing is not allowed or a renaming fails.

    This includes file systems that cannot exchange two folders.
    """
    if not exchange:
        monkeypatch.setattr(staging, "_renamed", lambda *_: False)
    for text in ("one", "two"):
        (tmp_path / text).mkdir()
        (tmp_path / text / "mark").write_text(text, "utf-8")
    publish(tmp_path / "two", tmp_path / "one", replace=True)
    assert (tmp_path / "one" / "mark").read_text("utf-8") == "two"
    (tmp_path / "three").mkdir()
    with pytest.raises(FileExistsError):
        publish(tmp_path / "three", tmp_path / "one", replace=False)
    if not exchange:
        rename, calls = Path.rename, list[Path]()

        def failing(source: Path, target: Path) -> Path:
            calls.append(source)
            if len(calls) == 2:
                raise OSError(5, "Input/output error")
            return rename(source, target)

        monkeypatch.setattr(Path, "rename", failing)
        with pytest.raises(OSError, match="Input/output"):
            publish(tmp_path / "three", tmp_path / "one", replace=True)
        assert (tmp_path / "one" / "mark").read_text("utf-8") == "two"


def test_writers_at_once_leave_one_whole_output(tmp_path: Path) -> None:
    """Four writers at once leave one whole folder: one succeeds without ``overwrite``, all four with it."""
    codes: list[str] = []

    def write(text: str, overwrite: bool, barrier: threading.Barrier) -> None:
        try:
            with staged_folder(tmp_path / "out", overwrite=overwrite, contents=CONTENTS) as folder:
                for name in CONTENTS.names:
                    (folder / name).write_text(text, "utf-8")
                barrier.wait()
            codes.append("")
        except InputError as error:
            codes.append(error.problems[0].code)

    for overwrite in (False, True, True, True):
        codes.clear()
        barrier = threading.Barrier(4)
        threads = [threading.Thread(target=write, args=(str(k), overwrite, barrier)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(codes) == (["", "", "", ""] if overwrite else ["", *["output.exists"] * 3])
        assert len({path.read_text("utf-8") for path in (tmp_path / "out").iterdir()}) == 1
        assert hidden(tmp_path) == []


def test_several_files_change_together_or_not_at_all(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("old", "utf-8")
    with pytest.raises(InputError), together(first, second):
        write_text(first, "new")
        write_text(second, "new")
        raise InputError.of("output.unwritable", file=second)
    assert first.read_text("utf-8") == "old" and sorted(p.name for p in tmp_path.iterdir()) == ["first"]
    with together(first, second):
        write_text(first, "new")
        write_text(second, "new")
    assert first.read_text("utf-8") == "new" and hidden(tmp_path) == []


def test_outputs_of_several_files_are_all_written_or_none(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text("before")
    with pytest.raises(RuntimeError), outputs(old, new, None, overwrite=True):
        write_text(old, "after")
        write_text(new, "after")
        raise RuntimeError
    assert old.read_text() == "before" and sorted(path.name for path in tmp_path.iterdir()) == ["old"]
    with outputs(old, new, overwrite=True):
        write_text(old, "after")
        write_text(new, "after")
    assert old.read_text() == new.read_text() == "after" and hidden(tmp_path) == []


def test_an_output_is_written_by_one_run_at_a_time(tmp_path: Path) -> None:
    """A second run is refused while the first one writes, and, without ``overwrite``, after it."""
    one, other = tmp_path / "one", tmp_path / "other"
    with outputs(one, other, overwrite=False):
        for overwrite in (False, True):
            with pytest.raises(InputError) as refused, outputs(other, overwrite=overwrite):
                pytest.fail("two runs write one file")
            assert refused.value.problems[0].code == "output.busy" and str(other) in str(refused.value)
        write_text(other, "text")
    with pytest.raises(InputError) as refused, outputs(other, overwrite=False):
        pytest.fail("the file exists")
    assert refused.value.problems[0].code == "output.exists" and other.read_text() == "text"
    assert hidden(tmp_path) == []


def test_the_lock_of_a_killed_run_excludes_nobody(tmp_path: Path) -> None:
    code = "import sys, time; from fg_orient.formats.atomic import alone; from pathlib import Path\n"
    code += "with alone(Path(sys.argv[1])):\n    print('ready', flush=True)\n    time.sleep(600)"
    words = [sys.executable, "-c", code, str(tmp_path / "file")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        with pytest.raises(InputError), alone(tmp_path / "file"):
            pytest.fail("the process is alive")
        process.kill()
    assert len(hidden(tmp_path)) == 1
    with outputs(tmp_path / "file", overwrite=False):
        write_text(tmp_path / "file", "text")
    assert hidden(tmp_path) == []


def test_a_hidden_file_that_cannot_be_removed_keeps_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hidden file that cannot be removed keeps its lock, and the next run removes both.

    Without the lock the next run could not recognise the file.
    """
    with monkeypatch.context() as patched, held(tmp_path / "out") as temporary:
        temporary.write_text("half")
        patched.setattr(Path, "unlink", lambda *_, **__: (_ for _ in ()).throw(OSError(5, "error")))
        patched.setattr(staging, "_release", lambda *_: pytest.fail("the lock is removed"))
    assert [name.rsplit(".", 1)[1] for name in hidden(tmp_path)] == ["lock", "tmp"]
    sweep(tmp_path)
    assert hidden(tmp_path) == []


def test_a_new_folder_is_removed_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), made_folder(tmp_path / "a" / "b"):
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a").mkdir()
    with pytest.raises(RuntimeError), made_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "kept").write_text("of another run")
        raise RuntimeError
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b", "kept"]


def test_a_work_folder_is_of_the_user_alone(tmp_path: Path) -> None:
    with scratch_folder(tmp_path) as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "deep").mkdir()
        (folder / "deep" / "file").write_text("text", "utf-8")
        synchronise(folder)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write_text(path, "old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        write_text(path, "new")
    with pytest.raises(InputError, match="No space left"), staged_folder(tmp_path / "out") as folder:
        (folder / "mark").write_text("new", "utf-8")
    assert path.read_text("utf-8") == "old" and [p.name for p in tmp_path.iterdir()] == ["file"]
    with staged_file(path) as hidden_file:
        hidden_file.write_text("without waiting", "utf-8")
    assert path.read_text("utf-8") == "without waiting"
