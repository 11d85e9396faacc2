"""COLMAP databases written here by the published layout are read, written and read again; damage is named."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.colmap_database import read_colmap_database, write_colmap_database
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.ties import pairs_of, tie_survey
from fg_orient.model.errors import InputError

SIZES = {"left.tif": (1000, 1500), "middle.tif": (1000, 1500), "right.tif": (900, 1400)}


def pair_id(a: int, b: int) -> int:
    """Return the number of a pair of images as COLMAP documents it."""
    return min(a, b) * 2147483647 + max(a, b)


TABLES = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER, height INTEGER, params BLOB,
    prior_focal_length INTEGER);
CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER, prior_qw REAL);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
"""
GEOMETRIES = """
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB, config INTEGER);
"""


def published(path: Path, *, geometry: bool = True) -> None:
    """Write a database with the tables that COLMAP documents.

    Two of its images have affine keypoints, a third has plain ones.
    """
    with closing(sqlite3.connect(path)) as db:
        db.executescript(TABLES)
        if geometry:
            db.executescript(GEOMETRIES)
            good = np.array([[0, 1]], "<u4").tobytes()
            db.execute("INSERT INTO two_view_geometries VALUES (?, 1, 2, ?, 2)", (pair_id(3, 7), good))
            db.execute("INSERT INTO two_view_geometries VALUES (?, 0, 2, NULL, 1)", (pair_id(3, 9),))
        radial = np.array([1200.0, 750.0, 500.0, -0.1]).tobytes()
        db.execute("INSERT INTO cameras VALUES (5, 2, 1500, 1000, ?, 1)", (radial,))
        db.execute("INSERT INTO cameras VALUES (6, 5, 1500, 1000, ?, 1)", (np.ones(8).tobytes(),))
        for k, name, camera in ((7, "b.jpg", 5), (3, "a.jpg", 5), (9, "c.jpg", 6)):
            db.execute("INSERT INTO images VALUES (?, ?, ?, 1.0)", (k, name, camera))
        for k, columns in ((3, 6), (7, 4), (9, 2)):
            points = np.zeros((3, columns), "<f4")
            points[:, 0], points[:, 1] = [10.5, 20.5, 30.75], k
            db.execute("INSERT INTO keypoints VALUES (?, 3, ?, ?)", (k, columns, points.tobytes()))
        db.execute(
            "INSERT INTO matches VALUES (?, 2, 2, ?)", (pair_id(3, 7), np.array([[0, 1], [1, 2]], "<u4").tobytes())
        )
        db.execute("INSERT INTO matches VALUES (?, 1, 2, ?)", (pair_id(7, 9), np.array([[1, 2]], "<u4").tobytes()))
        db.commit()


@pytest.mark.behaviour
def test_a_database_as_published_is_read(tmp_path: Path) -> None:
    published(tmp_path / "database.db", geometry=False)
    survey = read_colmap_database(tmp_path / "database.db")
    assert survey.images == ("a.jpg", "b.jpg", "c.jpg")
    rows = sorted(
        zip(
            survey.observed.point.tolist(),
            survey.observed.image.tolist(),
            survey.observed.line.tolist(),
            survey.observed.sample.tolist(),
            strict=True,
        )
    )
    # keypoint 0 of a with 1 of b, that with 2 of c; keypoint 1 of a with 2 of b; half a pixel less
    assert rows == [(0, 0, 2.5, 10.0), (0, 1, 6.5, 20.0), (0, 2, 8.5, 30.25), (1, 0, 2.5, 20.0), (1, 1, 6.5, 30.25)]
    assert tuple(map(str, survey.notes)) == ("3 unverified matches",)


@pytest.mark.behaviour
def test_verified_matches_come_first(tmp_path: Path) -> None:
    published(tmp_path / "database.db")
    survey = read_colmap_database(tmp_path / "database.db")
    assert survey.observed.sample.tolist() == [10.0, 20.0]
    assert tuple(map(str, survey.notes)) == ("1 geometrically verified matches",)


def survey_of(n: int, seed: int = 2) -> Survey:
    """Return a survey of ``n`` points in two or three images each, with the rows in random order."""
    rng = np.random.default_rng(seed)
    sees = rng.random((n, 3)) < 0.7
    sees[:, 1] |= sees.sum(axis=1) < 2
    sees[:, 0] |= sees.sum(axis=1) < 2
    point, image = np.nonzero(sees)
    order = rng.permutation(len(point))
    line, sample = rng.uniform(0, 900, len(point)), rng.uniform(0, 1400, len(point))
    return tie_survey(tuple(SIZES), tuple(map(str, range(n))), image[order], point[order], line, sample)


@pytest.mark.consistency
def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    survey, path = survey_of(200), tmp_path / "a b" / "database.db"
    path.parent.mkdir()
    rounding = write_colmap_database(path, survey, SIZES)
    assert 0.0 < rounding < 1401 * 2.0**-24
    again = read_colmap_database(path)
    assert again.images == survey.images
    assert len(again.ids) == len(survey.ids)

    def sets(s: Survey) -> set[frozenset[tuple[int, float, float]]]:
        o = s.observed
        tracks: dict[int, list[tuple[int, float, float]]] = {}
        single = (np.float32(v + 0.5).tolist() for v in (o.line, o.sample))
        for p, i, y, x in zip(o.point.tolist(), o.image.tolist(), *single, strict=True):
            tracks.setdefault(p, []).append((i, y, x))
        return {frozenset(track) for track in tracks.values()}

    assert sets(again) == sets(survey)
    rows = "SELECT model, width, height, params, prior_focal_length FROM cameras ORDER BY camera_id"
    with closing(sqlite3.connect(path)) as db:
        cameras = [(*row[:3], *np.frombuffer(row[3]), row[4]) for row in db.execute(rows)]
    # COLMAP's number 0 is SIMPLE_PINHOLE (f, cx, cy)
    assert cameras == [
        (0, width, height, 1.2 * width, width / 2, height / 2, 0) for height, width in (SIZES[n] for n in survey.images)
    ]


@pytest.mark.oracle
def test_pairs_are_those_of_a_double_loop() -> None:
    o = survey_of(40).observed
    found = pairs_of(o.image, o.point)
    expected: dict[tuple[int, int], set[tuple[int, int]]] = {}
    for a in range(len(o)):
        for b in range(len(o)):
            if o.point[a] == o.point[b] and o.image[a] < o.image[b]:
                expected.setdefault((int(o.image[a]), int(o.image[b])), set()).add((a, b))
    assert {key: set(map(tuple, rows.tolist())) for key, rows in found.items()} == expected
    assert pairs_of(np.empty(0, int), np.empty(0, int)) == {}
    assert pairs_of(np.array([0, 1]), np.array([0, 1])) == {}


@pytest.mark.behaviour
def test_sizes_are_required(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"middle\.tif.*option image_size"):
        write_colmap_database(tmp_path / "new.db", survey_of(5), {"left.tif": (1, 1)})
    assert not (tmp_path / "new.db").exists()


FAULTS = [
    ("UPDATE keypoints SET rows = 4 WHERE image_id = 7", "colmap.blob"),
    ("UPDATE keypoints SET data = NULL WHERE image_id = 7", "colmap.blob"),
    ("UPDATE keypoints SET rows = -1 WHERE image_id = 7", "colmap.blob"),
    ("UPDATE keypoints SET image_id = 8 WHERE image_id = 7", "colmap.reference"),
    ("UPDATE matches SET pair_id = 3 * 2147483647 + 3 WHERE rows = 2", "colmap.reference"),
    ("UPDATE matches SET data = x'0000000009000000' WHERE rows = 1", "colmap.blob"),
    ("UPDATE keypoints SET rows = 'many' WHERE image_id = 7", "colmap.database"),
    ("DROP TABLE images", "colmap.database"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("damage", "code"), FAULTS)
def test_damage_is_named(damage: str, code: str, tmp_path: Path) -> None:
    published(tmp_path / "database.db", geometry=False)
    with closing(sqlite3.connect(tmp_path / "database.db")) as db:
        db.execute(damage)
        db.commit()
    with pytest.raises(InputError) as error:
        read_colmap_database(tmp_path / "database.db")
    assert error.value.problems[0].code == code
    assert error.value.problems[0].file == "database.db"


@pytest.mark.behaviour
def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("no database at all, but long enough to be read")
    for name, code in (("text.db", "colmap.database"), ("none.db", "ties.missing")):
        with pytest.raises(InputError) as error:
            read_colmap_database(tmp_path / name)
        assert error.value.problems[0].code == code
    assert not (tmp_path / "none.db").exists()
