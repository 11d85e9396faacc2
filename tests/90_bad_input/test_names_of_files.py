"""Paths that no file can have, or that no record can contain, are refused in one line before the computation."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fg_orient.formats.atomic import write_text, writing
from fg_orient.formats.project import require_files
from fg_orient.formats.sensor import read_sensor
from fg_orient.formats.staging import claimed
from fg_orient.model.errors import InputError
from fg_orient.model.plugins import load_plugin
from fg_orient.result.summary import file_stems
from tests.support.command import in_process

pytestmark = pytest.mark.behaviour

LONG, NOT_UTF8 = 300 * "x", os.fsdecode(b"bad\xff")
PROJECT = """schema = 1
name = "names"
[[images]]
id = "left"
metadata = "METADATA"
[points]
file = "POINTS"
crs = "EPSG:4979"
[observations]
file = "observations.csv"
"""


@pytest.mark.parametrize(("name", "reason"), [(LONG, "too long"), (NOT_UTF8, "not UTF-8")])
@pytest.mark.parametrize(
    "words",
    [
        ("adjust", "NAME/project.toml"), ("adjust", "project.toml", "--out", "NAME"), ("validate", "NAME"),
        ("locate", "NAME"), ("footprint", "a.DIM", "--height", 0, "--out", "NAME.geojson"), ("footprint", "NAME"),
        ("--plugin", "NAME.py", "doctor"),
    ],
)  # fmt: skip
def test_a_command_refuses_a_path_that_it_cannot_use_or_record(
    words: tuple[object, ...], name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = in_process(*(str(word).replace("NAME", name) for word in words))
    lines = ended.stderr.splitlines()
    assert ended.code == 2 and len(lines) == 1 and reason in lines[0], ended
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "code"), [("a\\u0000b", "path.nul"), (LONG, "path.long_name")])
@pytest.mark.parametrize(("entry", "place"), [("METADATA", "images[1].metadata"), ("POINTS", "points.file")])
def test_a_project_file_that_names_an_impossible_file(
    entry: str, place: str, name: str, code: str, tmp_path: Path
) -> None:
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.replace(entry, name), "utf-8")
    with pytest.raises(InputError) as caught:
        require_files(path)
    assert [(p.code, p.place) for p in caught.value.problems if p.place] == [(code, place)]
    assert all(len(p.text()) < 400 for p in caught.value.problems)


@pytest.mark.parametrize(
    ("name", "code"),
    [("a\0b", "path.nul"), (LONG, "path.long_name"), (1000 * "abcd/", "path.long"), (NOT_UTF8, "path.encoding")],
)
@pytest.mark.parametrize("read", [require_files, read_sensor, load_plugin])
def test_functions_of_the_library_refuse_them_too(read: object, name: str, code: str) -> None:
    assert callable(read)
    with pytest.raises(InputError) as caught:
        read(name)
    assert [p.code for p in caught.value.problems] == [code]


@pytest.mark.parametrize("name", [".", "/"])
def test_a_folder_without_a_name_is_no_output_file(name: str) -> None:
    for write in (lambda: write_text(name, ""), lambda: claimed(Path(name)).__enter__()):
        with pytest.raises(InputError, match="Is a directory"), writing(name):
            write()


def test_a_long_image_id_gives_a_file_name_that_can_be_written(tmp_path: Path) -> None:
    names = [LONG + "1", LONG + "2", 300 * "\N{CJK UNIFIED IDEOGRAPH-56FE}"]
    stems = file_stems(names)
    assert len(set(stems.values())) == len(names)
    for stem in stems.values():
        write_text(tmp_path / f"{stem}_RPC.TXT", "")
