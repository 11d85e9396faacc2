"""Multi-image tie points of MicMac: the published SPOT 7 pair, a round trip, and faults that name their line."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.tie_folders import MICMAC, read_image
from fg_orient.formats.exchange.ties import tie_survey
from fg_orient.formats.registry import Settings
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from tests.support.work import counted

TABLE = "Pt.x,Pt.y,Id\n32.036,1436.579,0\n61.123,1767.49,1\n1e1,.5,7\n"


@pytest.mark.behaviour
def test_columns_are_sample_line_id(tmp_path: Path) -> None:
    (tmp_path / "PMUL-a.tif.csv").write_text(TABLE, newline="\r\n")
    (tmp_path / "PMUL-b.csv.gz").write_bytes(gzip.compress(b"Pt.x,Pt.y,Id\n5,6,7\n8,9,0\n"))
    survey = MICMAC.read((tmp_path,), Settings())  # type: ignore[misc]
    assert (survey.images, survey.ids) == (("a.tif", "b"), ("0", "1", "7"))
    o = survey.observed
    rows = list(zip(o.image.tolist(), o.point.tolist(), o.line.tolist(), o.sample.tolist(), strict=True))
    assert rows == [
        (0, 0, 1436.579, 32.036), (0, 1, 1767.49, 61.123), (0, 2, 0.5, 10.0), (1, 2, 6.0, 5.0), (1, 0, 9.0, 8.0),
    ]  # fmt: skip


@pytest.mark.oracle
@pytest.mark.parametrize("ids", [("3", "0", "12"), ("a", "01", "3")])
def test_what_is_written_is_read_again(ids: tuple[str, ...], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    image, point = np.array([0, 0, 1, 1, 2]), np.array([0, 1, 1, 2, 0])
    line, sample = rng.uniform(-0.5, 30000, (2, 5))
    MICMAC.write(tie_survey(("a", "b", "c"), ids, image, point, line, sample), (tmp_path / "t",), Settings())  # type: ignore[misc]
    again = MICMAC.read((tmp_path / "t",), Settings())  # type: ignore[misc]
    expected = ids if ids[0] == "3" else ("0", "1", "2")
    named = [expected[p] for p in point]
    assert again.images == ("a", "b", "c")
    o = again.observed
    assert np.array_equal(o.image, image)
    assert [again.ids[p] for p in o.point] == named
    assert np.array_equal(o.line, line)
    assert np.array_equal(o.sample, sample)
    for k, name in enumerate(("a", "b", "c")):
        with (tmp_path / "t" / f"PMUL-{name}.csv").open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        found = sorted((float(row["Pt.y"]), float(row["Pt.x"]), row["Id"]) for row in rows)
        at = np.flatnonzero(image == k)
        assert found == sorted((line[i], sample[i], named[i]) for i in at)


FAULTS = [
    ("Pt.x,Pt.y,Id", "Pt.y,Pt.x,Id", "interchange.cells", "line 1"),
    ("61.123,", "61,123,", "interchange.cells", "line 3"),
    ("1767.49", "nan", "interchange.cells", "line 3"),
    ("1767.49", "1_767", "interchange.cells", "line 3"),
    (",7", ",7.5", "interchange.cells", "line 4"),
    (",7", ",1e300", "interchange.cells", "line 4"),
    (",7", ",1", "interchange.twice", "line 4"),
    ("\n1e1", "\n\n1e1", "interchange.cells", "line 4"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("old", "new", "code", "place"), FAULTS)
def test_faults_name_their_line(old: str, new: str, code: str, place: str, tmp_path: Path) -> None:
    (tmp_path / "PMUL-a.csv").write_text(TABLE.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "PMUL-a.csv")
    (found,) = error.value.problems
    assert (found.code, found.place) == (code, place)


@pytest.mark.behaviour
def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="PMUL-IMAGE"):
        MICMAC.read((tmp_path,), Settings())  # type: ignore[misc]
    for name, raw in (("PMUL-a.csv", TABLE.encode()), ("PMUL-a.csv.gz", gzip.compress(TABLE.encode()))):
        (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError) as error:
        MICMAC.read((tmp_path,), Settings())  # type: ignore[misc]
    assert error.value.problems[0].code == "micmac.name"
    (tmp_path / "PMUL-b.csv.gz").write_bytes(gzip.compress(TABLE.encode())[:-9])
    with pytest.raises(InputError) as error:
        read_image(tmp_path / "PMUL-b.csv.gz")
    assert error.value.problems[0].code == "ties.unreadable"


@pytest.mark.slow
@pytest.mark.truth
@pytest.mark.real_data
def test_the_published_pair_is_read_as_arrays_and_agrees_with_its_rpc(real_data: Path) -> None:
    folder = real_data / "micmac-spot7-rpc"
    with counted() as calls:
        survey = MICMAC.read((folder,), Settings())  # type: ignore[misc]
    assert calls.count < 5 * 115_109  # calls of functions: only those that split and store the lines
    assert survey.images == ("SPOT_1A", "SPOT_1B")
    o = survey.observed
    n = len(o) // 2
    assert (n, len(survey.ids)) == (115_109, 115_109)
    assert np.array_equal(o.point[:n], o.point[n:])
    left, right = (read_sensor(folder / f"RPC_{name}.xml") for name in ("1A", "1B"))
    some = np.arange(0, n, 500)
    low, high = (
        np.column_stack(right.project(left.locate(o.line[some], o.sample[some], height_m=np.full(len(some), h))))
        for h in (0.0, 1500.0)
    )
    along = (high - low) / np.linalg.norm(high - low, axis=1, keepdims=True)
    off = np.column_stack([o.line[n + some], o.sample[n + some]]) - low
    across = off[:, 0] * along[:, 1] - off[:, 1] * along[:, 0]
    # the ray of the left image passes the point of the right one within the error of uncorrected RPC
    assert np.abs(np.median(across)) < 5.0
    assert np.median(np.abs(across - np.median(across))) < 0.5
