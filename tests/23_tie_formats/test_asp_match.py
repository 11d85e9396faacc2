"""Match files of ASP are written byte by byte from the published layout and read; damage is named."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.tie_folders import FORMAT, images_of, read_match, write_match
from fg_orient.formats.exchange.ties import tie_survey
from fg_orient.formats.registry import Settings
from fg_orient.model.errors import InputError


def record(x: float, y: float, descriptor: tuple[float, ...] = (), polarity: int = 1) -> bytes:
    """Return an interest point, field by field."""
    head = struct.pack("<ffiifff", x, y, int(x), int(y), 0.25, 2.0, 0.5)
    tail = struct.pack("<BIIQ", polarity, 3, 4, len(descriptor))
    return head + tail + struct.pack(f"<{len(descriptor)}f", *descriptor)


def file_of(left: list[bytes], right: list[bytes]) -> bytes:
    return struct.pack("<QQ", len(left), len(right)) + b"".join(left) + b"".join(right)


LEFT, RIGHT = [(10.5, 20.25), (30.75, 40.0)], [(11.5, 21.25), (31.75, 41.0)]


@pytest.mark.behaviour
@pytest.mark.parametrize("lengths", [(0, 0, 0, 0), (128, 128, 128, 128), (2, 0, 3, 2), (2, 2, 2, 0)])
def test_pixels_are_read_past_descriptors_of_any_length(lengths: tuple[int, ...], tmp_path: Path) -> None:
    path = tmp_path / "run-a__b.match"
    parts = [record(*p, (0.5,) * n) for p, n in zip(LEFT + RIGHT, lengths, strict=True)]
    path.write_bytes(file_of(parts[:2], parts[2:]))
    left, right = read_match(path)
    assert left.tolist() == [[y, x] for x, y in LEFT]
    assert right.tolist() == [[y, x] for x, y in RIGHT]


@pytest.mark.oracle
def test_what_is_written_is_read_again_and_has_the_bytes_of_the_layout(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    left, right = rng.uniform(-0.5, 12000, (2, 50, 2)).astype(np.float32).astype(float)
    write_match(tmp_path / "x-a__b.match", left, right)
    again = read_match(tmp_path / "x-a__b.match")
    assert np.array_equal(again[0], left)
    assert np.array_equal(again[1], right)
    content = (tmp_path / "x-a__b.match").read_bytes()
    size = len(record(0.0, 0.0))
    assert struct.unpack_from("<QQ", content) == (50, 50)
    assert len(content) == 16 + 100 * size
    for k, (line, sample) in enumerate(np.vstack([left, right]).tolist()):
        assert struct.unpack_from("<ffii", content, 16 + k * size) == (sample, line, round(sample), round(line))
        assert struct.unpack_from("<Q", content, 16 + (k + 1) * size - 8) == (0,)  # no descriptor


@pytest.mark.behaviour
def test_a_folder_is_joined_to_points_of_three_images_and_written_as_pairs(tmp_path: Path) -> None:
    point, image = np.nonzero(np.array([[1, 1, 1], [1, 1, 0], [0, 1, 1]]))
    line, sample = np.arange(7) * 1.5, 100 + np.arange(7) * 0.25
    survey = tie_survey(("a", "b", "c"), ("1", "2", "3"), image, point, line, sample)
    FORMAT.write(survey, (tmp_path / "ties",), Settings())  # type: ignore[misc]
    names = sorted(file.name for file in (tmp_path / "ties").iterdir())
    assert names == ["run-a__b.match", "run-a__c.match", "run-b__c.match"]
    again = FORMAT.read((tmp_path / "ties",), Settings())  # type: ignore[misc]
    assert again.images == ("a", "b", "c")
    o = again.observed

    def sets(p: np.ndarray, i: np.ndarray, y: np.ndarray, x: np.ndarray) -> set[frozenset[tuple[float, ...]]]:
        rows = list(zip(p.tolist(), i.tolist(), y.tolist(), x.tolist(), strict=True))
        return {frozenset(row[1:] for row in rows if row[0] == k) for k in set(p.tolist())}

    assert sets(o.point, o.image, o.line, o.sample) == sets(point, image, line, sample)


@pytest.mark.behaviour
def test_a_conflict_is_dropped_and_told(tmp_path: Path) -> None:
    write_match(tmp_path / "run-a__b.match", np.array([[1.0, 2.0], [9.0, 9.0]]), np.array([[3.0, 4.0], [8.0, 8.0]]))
    write_match(tmp_path / "run-b__c.match", np.array([[3.0, 4.0]]), np.array([[5.0, 6.0]]))
    write_match(tmp_path / "run-a__c.match", np.array([[1.0, 7.0]]), np.array([[5.0, 6.0]]))
    survey = FORMAT.read((tmp_path,), Settings())  # type: ignore[misc]
    assert survey.observed.line.tolist() == [9.0, 8.0]
    (told,) = survey.notes
    assert str(told) == (
        "1 of 2 tie points left out (4 image points): their matches connect two different pixels of one image, the"
        " first (1, 2) and (1, 7) of a"
    )


@pytest.mark.behaviour
def test_names_tell_the_images() -> None:
    assert images_of(Path("run-left__right.match")) == ("left", "right")
    assert images_of(Path("out-a_b-1__c-2.tif.match")) == ("a_b-1", "c-2.tif")
    for name in ("left__right.match", "run-left.match", "run-a__a.match", "run-a__b.txt"):
        with pytest.raises(InputError, match="name"):
            images_of(Path(name))


FAULTS = [
    (b"", "counts"),
    (struct.pack("<QQ", 1, 2) + record(1, 2) * 3, "counts"),
    (struct.pack("<QQ", 2**62, 2**62) + record(1, 2) * 2, "counts"),
    (file_of([record(1, 2)], [record(1, 2)])[:-1], "counts"),
    (file_of([record(1, 2, (1.0,))], [record(1, 2, (1.0, 2.0))])[:-1], "interest point 3"),
    (file_of([record(1, 2)], [record(1, 2)]) + b"\0", "interest point 3"),
    (file_of([record(1, 2)], [record(1, 2, polarity=7)]), "interest point 2"),
    (file_of([record(1, 2)], [struct.pack("<f", np.nan) + record(1, 2)[4:]]), "interest point 2"),
    (file_of([record(1, 2)], [struct.pack("<f", 5.0) + record(1, 2)[4:]]), "interest point 2"),
    (file_of([record(1, 2)[:-8] + b"\xff" * 8], [record(1, 2)]), "interest point"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("raw", "place"), FAULTS)
def test_what_no_match_file_holds_is_refused(raw: bytes, place: str, tmp_path: Path) -> None:
    (tmp_path / "run-a__b.match").write_bytes(raw)
    with pytest.raises(InputError) as error:
        read_match(tmp_path / "run-a__b.match")
    (found,) = error.value.problems
    assert found.code == "match.layout"
    assert found.place.startswith(place)


@pytest.mark.behaviour
def test_three_images_need_a_folder_and_names_must_fit_one(tmp_path: Path) -> None:
    one = np.zeros(1, int)
    survey = tie_survey(("a", "b", "c"), ("1",), one, one, np.zeros(1), np.zeros(1))
    with pytest.raises(InputError, match="3 images"):
        FORMAT.write(survey, (tmp_path / "run-a__b.match",), Settings())  # type: ignore[misc]
    two = tie_survey(("a", "b"), ("1",), np.arange(2), np.zeros(2, int), np.zeros(2), np.zeros(2))
    with pytest.raises(InputError, match=r"name the file PREFIX-LEFT__RIGHT\.match"):
        FORMAT.write(two, (tmp_path / "p.match",), Settings())  # type: ignore[misc]
    assert not (tmp_path / "p.match").exists()
    odd = tie_survey(("a__b", "c"), ("1",), np.arange(2), np.zeros(2, int), np.zeros(2), np.zeros(2))
    with pytest.raises(InputError, match="a__b"):
        FORMAT.write(odd, (tmp_path / "ties",), Settings())  # type: ignore[misc]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"\*\.match"):
        FORMAT.read((tmp_path / "empty",), Settings())  # type: ignore[misc]


@pytest.mark.behaviour
def test_empty_files_hold_no_match(tmp_path: Path) -> None:
    write_match(tmp_path / "run-a__b.match", np.empty((0, 2)), np.empty((0, 2)))
    assert len(FORMAT.read((tmp_path,), Settings()).ids) == 0  # type: ignore[misc]
    assert FORMAT.verified is False
