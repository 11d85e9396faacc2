"""Files of sba: pixels follow its description, its examples have the printed errors, damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.exchange.sba import read_sba
from fg_orient.formats.frame_model import EXTERIOR, FrameModel, frame_block
from fg_orient.model.errors import InputError
from tests.support.command import in_process

K = np.array([[851.5, 0.0, 330.0], [0.0, 853.0, 262.0], [0.0, 0.0, 1.0]])
CALIB = "851.5 0 330\n0 853.0 262\n\n0 0 1\n"
QUATERNIONS = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.36, -0.48, 0.0]])
TRANSLATIONS = np.array([[0.1, -0.2, 5.0], [0.3, 0.1, 6.0]])
POINTS = np.array([[0.1, 0.2, 0.3], [-0.4, 0.5, 0.1], [0.6, -0.3, -0.2]])
NONE, KC = np.zeros(5), np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01])


def turned(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the rotation of points by a unit quaternion w, v: x + 2 v x (v x x + w x)."""
    return x + 2.0 * np.cross(q[1:], np.cross(q[1:], x) + q[0] * x)


def pixels(k: np.ndarray, kc: np.ndarray) -> list[list[list[float]]]:
    """Compute the formula of sba for each camera: x_d = (1 + kc0 r2 + kc1 r4 + kc4 r6) x_n + dx, then K x_d."""
    out = []
    for q, t in zip(QUATERNIONS, TRANSLATIONS, strict=True):
        p = turned(q, POINTS) + t
        x, y = (p[:, :2] / p[:, 2:]).T
        r2 = x * x + y * y
        radial = 1.0 + kc[0] * r2 + kc[1] * r2**2 + kc[4] * r2**3
        xd = radial * x + 2.0 * kc[2] * x * y + kc[3] * (r2 + 2.0 * x * x)
        yd = radial * y + kc[2] * (r2 + 2.0 * y * y) + 2.0 * kc[3] * x * y
        out.append((k @ np.stack([xd, yd, np.ones(len(x))])).T[:, :2].tolist())
    return out


def written(folder: Path, before: str = "", k: np.ndarray = K, kc: np.ndarray = NONE, each: str = "") -> Path:
    """Write the files of three cameras and some points; return their folder.

    ``before`` are further numbers in front of each camera, ``each`` further cells after each image point.
    """
    seen = pixels(k, kc)
    rows = zip(QUATERNIONS.tolist(), TRANSLATIONS.tolist(), strict=True)
    lines = [f"{before} {' '.join(map(repr, q + t))}" for q, t in rows]
    (folder / "cams.txt").write_text("# quaternion translation\n" + "\n".join(lines) + "\n")
    views = [
        f"{' '.join(map(repr, at))} 2 " + " ".join(f"{i} {seen[i][j][0]!r} {seen[i][j][1]!r}{each}" for i in (1, 0))
        for j, at in enumerate(POINTS.tolist())
    ]
    (folder / "pts.txt").write_text("# X Y Z  nframes  frame0 x0 y0\n" + "\n".join(views) + "\n")
    (folder / "calib.txt").write_text(CALIB)
    return folder


def read(folder: Path, *, calib: bool = True) -> FrameModel:
    return read_sba(folder / "cams.txt", folder / "pts.txt", folder / "calib.txt" if calib else None)


@pytest.mark.oracle
def test_pixels_are_those_of_the_formula(tmp_path: Path) -> None:
    """Each kind of sba camera has the pixels of the formula within 1e-9 px.

    The kinds are a common matrix with an aspect, own numbers, and own numbers with distortion.
    """
    plain = read(written(tmp_path))
    assert np.abs(plain.residuals_px()).max() < 1e-9 and len(plain.cameras) == 1
    assert np.array_equal(plain.points_m, POINTS) and plain.image.tolist() == [1, 0] * 3
    own = read(written(tmp_path, f"851.5 330 262 {853.0 / 851.5!r} 0"), calib=False)
    assert np.abs(own.residuals_px()).max() < 1e-9 and len(own.cameras) == 2
    square = np.array([[800.0, 0.0, 330.0], [0.0, 800.0, 262.0], [0.0, 0.0, 1.0]])
    before = f"800 330 262 1 0 {' '.join(map(repr, KC.tolist()))}"
    bent = read(written(tmp_path, before, square, KC), calib=False)
    assert np.abs(bent.residuals_px()).max() < 1e-9


@pytest.mark.oracle
def test_residuals_of_the_block_are_pixels_of_the_image(tmp_path: Path) -> None:
    """The residuals of an sba model are pixels of the image, and the block's sigma of samples contains the aspect.

    The equation uses stretched samples.
    """
    folder = written(tmp_path)
    lines = (folder / "pts.txt").read_text().splitlines()
    moved = np.array([[0.5, -0.25], [0.3, 0.2], [-0.4, 0.1]])
    for j, (dx, dy) in enumerate(moved.tolist()):
        cells = lines[1 + j].split()
        cells[5], cells[6] = repr(float(cells[5]) + dx), repr(float(cells[6]) + dy)
        lines[1 + j] = " ".join(cells)
    (folder / "pts.txt").write_text("\n".join(lines) + "\n")
    model = read(folder)
    assert float(np.sum(model.residuals_px() ** 2)) == pytest.approx(float(np.sum(moved**2)), rel=1e-9)
    seen = frame_block(model, "sba").observations
    aspect = model.cameras["1"].aspect
    assert aspect == pytest.approx(853.0 / 851.5 - 1.0) and np.all(seen.sigma_sample_px == 1.0 + aspect)


@pytest.mark.behaviour
@pytest.mark.parametrize("each", [" 0.1 0.0 0.2", " 0.1 0.0 0.0 0.2"])
def test_covariances_are_left_out_and_counted(each: str, tmp_path: Path) -> None:
    model = read(written(tmp_path, each=each))
    assert np.abs(model.residuals_px()).max() < 1e-9
    assert "the covariance matrices of 6 image points are left out" in str(model.notes[-1])


#: Number of cameras: projections, printed initial error, and errors after the adjustment without and with focal
#: length and principal point of each camera (README of sba); the latter stopped after 150 iterations.
PRINTED = {
    7: (1916, "19.0947", "0.675396", "0.659201"),
    9: (2422, "8.17604", "0.619559", "0.600039"),
}


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("n", PRINTED)
def test_the_published_examples_have_the_printed_errors(n: int, real_data: Path) -> None:
    """The published examples of sba have the printed errors at the start and after the adjustment.

    The error is the sum of squares over the number of image points; with free cameras it is at most the printed value.
    """
    count, initial, fixed, varied = PRINTED[n]
    files = [real_data / "sba" / name for name in (f"{n}cams.txt", f"{n}pts.txt", "calib.txt")]
    model = read_sba(*files)
    start = np.sum(model.residuals_px() ** 2) / count
    assert len(model.image) == count and f"{start:.6g}" == initial
    solution = fg.adjust(frame_block(model, "sba"), statistics="basic")
    assert f"{solution.chi2 / count:.6g}" == fixed
    own = read_sba(real_data / "sba" / f"{n}camsvarK.txt", files[1])
    interior = ("focal", "principal_sample", "principal_line")
    solution = fg.adjust(frame_block(own, "sba", unknowns=(*EXTERIOR, *interior)), statistics="basic")
    assert 0.999 * float(varied) < solution.chi2 / count < float(varied)


C, P, B = "cams.txt", "pts.txt", "calib.txt"
#: File, old and new text, part of the message.
DAMAGED = {
    "no cameras": (C, None, "", "the end of the file"),
    "six numbers": (C, "1.0 0.0 0.0 0.0", "1.0 0.0 0.0", "line 2"),
    "a number more in a line": (C, "0.36 -0.48", "0.36 -0.48 0.0", "line 3"),
    "a word": (C, "0.1 -0.2 5.0", "0.1 x 5.0", "line 2"),
    "nan": (C, "0.1 -0.2 5.0", "0.1 nan 5.0", "line 2"),
    "no unit quaternion": (C, "0.8 0.36", "0.9 0.36", "a quaternion of length 1"),
    "zero quaternion": (C, "1.0 0.0 0.0 0.0", "0.0 0.0 0.0 0.0", "line 2"),
    "utf-16": (C, None, "\ufeff1 0".encode("utf-16"), "UTF-16"),
    "nul": (P, None, b"1 2 3\0", "NUL"),
    "no points": (P, None, "# nothing\n", "the end of the file"),
    "no image points": (P, None, "1 2 3 0\n", "line 1"),
    "coordinates alone": (P, None, "1 2 3\n", "line 1"),
    "half an image": (P, None, "1 2 3 1.5 0 1 2\n", "line 1"),
    "minus one image": (P, None, "1 2 3 -1 0 1 2\n", "line 1"),
    "more images than cells": (P, None, "1 2 3 2 0 1 2\n", "line 1"),
    "five numbers each": (P, None, "1 2 3 1 0 1 2 3 4\n", "line 1"),
    "an image that is not there": (P, None, "1 2 3 1 2 1 2\n", "different images 0 to 1"),
    "half an image number": (P, None, "1 2 3 1 0.5 1 2\n", "line 1"),
    "an image twice": (P, None, "1 2 3 2 0 1 2 0 1 2\n", "different images"),
    "infinite pixel": (P, None, "1 2 3 1 0 1e400 2\n", "line 1"),
    "decimal comma": (P, None, "1,5 2 3 1 0 1 2\n", "line 1"),
    "two rows": (B, "0 0 1\n", "", "(found 2 lines)"),
    "four numbers": (B, "851.5 0 330", "851.5 0 330 0", "line 1"),
    "no focal length": (B, "851.5", "0", "the camera matrix"),
    "no last row": (B, "0 0 1", "0 0 2", "the camera matrix"),
    "skew": (B, "851.5 0", "851.5 1", "skew 1"),
    "negative aspect": (B, "853.0", "-853.0", "aspect -1.0"),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_ends_with_2_and_one_line(name: str, tmp_path: Path) -> None:
    file, old, new, text = DAMAGED[name]
    folder = written(tmp_path)
    if isinstance(new, bytes):
        (folder / file).write_bytes(new)
    else:
        whole = (folder / file).read_text()
        assert old is None or old in whole
        (folder / file).write_text(new if old is None else whole.replace(old, new, 1))
    done = in_process("validate", "--format", "sba", folder / C, folder / P, folder / B)
    assert done.code == 2 and done.stderr.count("\n") == 1, done
    assert done.stderr.startswith(f"error: {file}") and text in done.stderr, done.stderr


@pytest.mark.behaviour
def test_all_faulty_lines_and_missing_files_are_named(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (folder / P).write_text("1 2 3 1 0 1 2\n1 2\n1 2 3 1 9 1 2\n")
    done = in_process("validate", "--format", "sba", folder / C, folder / P, folder / B)
    places = [line.split(":")[1].split(", ")[1] for line in done.stderr.splitlines()]
    assert (done.code, places) == (2, ["line 2", "line 3"])
    for files in ((C, P), (C,), (C, P, B, B)):
        done = in_process("validate", "--format", "sba", *(folder / file for file in files))
        assert done.code == 2 and done.stderr.count("\n") == 1, done
    before = f"851.5 330 262 {853.0 / 851.5!r} 0"
    with pytest.raises(InputError, match="contain the camera matrix"):
        read(written(tmp_path, before))
    with pytest.raises(InputError, match="aspect 1 if the camera has distortion"):
        read(written(tmp_path, before + " 0.1 0 0 0 0"), calib=False)
