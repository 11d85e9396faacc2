"""Bundle problems of libmv: pixels by the formula of a camera, the published problem with scipy, damaged files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import coo_array
from scipy.spatial.transform import Rotation

import fg_orient as fg
from fg_orient.formats.exchange.libmv import read_libmv
from fg_orient.formats.frame_model import frame_block
from tests.support.command import in_process

Array = np.ndarray
#: Cost of the published problem after Ceres Solver 2.2 with the camera held (pycolmap 4.2, tolerances 1e-16).
CERES = 4607.591952585
FOCAL, PRINCIPAL = 800.0, (320.0, 240.0)


def problem() -> bytes:
    """Return two images (numbers 3 and 8) of three points (5, 6, 9), all points in both, without noise."""
    points = np.array([[0.1, -0.2, 4.0], [-0.5, 0.3, 5.0], [0.7, 0.6, 6.0]])
    poses = [
        (3, Rotation.identity(), np.zeros(3)),
        (8, Rotation.from_rotvec([0.02, -0.1, 0.05]), np.array([-1, 0, 0.2])),
    ]
    out = b"vP" + struct.pack("<8f", FOCAL, *PRINCIPAL, 0, 0, 0, 0, 0) + struct.pack("<i", len(poses))
    marks = []
    for number, rotation, t in poses:
        columns = rotation.as_matrix().T.ravel()  # one column after the other
        out += struct.pack("<i12f", number, *columns, *t)
        for point, ground in zip((5, 6, 9), points, strict=True):
            q = rotation.as_matrix() @ ground + t
            marks.append(struct.pack("<iiff", number, point, *(FOCAL * q[:2] / q[2] + PRINCIPAL)))
    out += struct.pack("<i", 3) + b"".join(struct.pack("<i3f", k, *p) for k, p in zip((5, 6, 9), points, strict=True))
    return out + struct.pack("<i", len(marks)) + b"".join(marks)


@pytest.mark.oracle
def test_pixels_are_those_of_the_formula(tmp_path: Path) -> None:
    (tmp_path / "problem.bin").write_bytes(problem())
    model = read_libmv(tmp_path / "problem.bin", {"3": (480, 640), "8": (480, 640)})
    assert [pose.name for pose in model.poses] == ["3", "8"] and model.point_ids == ("5", "6", "9")
    assert np.abs(model.residuals_px()).max() < 1e-3  # float32
    assert (model.cameras["1"].n_lines, model.cameras["1"].n_samples, model.notes) == (480, 640, ())
    (note,) = map(str, read_libmv(tmp_path / "problem.bin").notes)
    assert "no image sizes" in note and "for 3, 8" in note


def arrays(path: Path) -> tuple[Array, ...]:
    """Return the camera, rotations, translations, points, image and point of each mark, x y, by numpy alone."""
    raw = path.read_bytes()
    camera, n = np.frombuffer(raw, "<f4", 3, 2).astype(float), struct.unpack_from("<i", raw, 34)[0]
    images = np.frombuffer(raw, [("id", "<i4"), ("n", "<f4", 12)], n, 38)
    at = 38 + 52 * n
    m = struct.unpack_from("<i", raw, at)[0]
    points = np.frombuffer(raw, [("id", "<i4"), ("n", "<f4", 3)], m, at + 4)
    at += 4 + 16 * m
    k = struct.unpack_from("<i", raw, at)[0]
    marks = np.frombuffer(raw, [("i", "<i4"), ("p", "<i4"), ("xy", "<f4", 2)], k, at + 4)
    assert at + 4 + 16 * k == len(raw)
    numbers = images["n"].astype(float)
    image = np.searchsorted(images["id"], marks["i"])
    point = np.searchsorted(points["id"], marks["p"])
    rotations = Rotation.from_matrix(np.swapaxes(numbers[:, :9].reshape(-1, 3, 3), 1, 2))
    return camera, rotations, numbers[:, 9:], points["n"].astype(float), image, point, marks["xy"].astype(float)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.real_data
def test_the_published_problem_has_the_costs_that_scipy_finds(real_data: Path) -> None:
    """The published problem has the cost of scipy at the start and at the minimum over all poses and points.

    The cost is half the sum of squares.
    """
    path = real_data / "libmv-ba" / "problem_01.bin"
    (f, *principal), start, t, ground, image, point, xy = arrays(path)
    n, m, k = len(t), len(ground), len(xy)
    assert (n, m, k) == (333, 26, 5421)

    def camera_points(x: Array) -> Array:
        turned = Rotation.from_rotvec(x[: 3 * n].reshape(-1, 3)) * start
        return turned[image].apply(x[6 * n :].reshape(-1, 3)[point]) + x[3 * n : 6 * n].reshape(-1, 3)[image]

    def residuals(x: Array) -> Array:
        q = camera_points(x)
        return (f * q[:, :2] / q[:, 2:] + principal - xy).ravel()

    def jacobian(x: Array) -> coo_array:
        """Return the derivatives by the unknowns.

        q is linear in the translation; a turn of the camera moves q by w x (q - t).
        """
        q, w = camera_points(x), x[: 3 * n].reshape(-1, 3)
        by_q = np.zeros((k, 2, 3))
        by_q[:, 0, 0] = by_q[:, 1, 1] = f / q[:, 2]
        by_q[:, :, 2] = -f * q[:, :2] / q[:, 2:] ** 2
        step, turns = 1e-6, []
        arm = start[image].apply(x[6 * n :].reshape(-1, 3)[point])
        for axis in np.eye(3):
            plus, minus = (Rotation.from_rotvec(w + s * step * axis)[image].apply(arm) for s in (1.0, -1.0))
            turns.append((plus - minus) / (2.0 * step))
        by_w = by_q @ np.stack(turns, axis=2)
        by_g = by_q @ (Rotation.from_rotvec(w) * start)[image].as_matrix()
        rows = np.arange(2 * k).reshape(k, 2, 1)
        columns = [3 * image, 3 * (n + image), 6 * n + 3 * point]
        at = [np.broadcast_to(c[:, None, None] + np.arange(3), (k, 2, 3)).ravel() for c in columns]
        values = np.concatenate([d.ravel() for d in (by_w, by_q, by_g)])
        rows = np.tile(np.broadcast_to(rows, (k, 2, 3)).ravel(), 3)
        return coo_array((values, (rows, np.concatenate(at))), shape=(2 * k, 6 * n + 3 * m)).tocsr()

    x0 = np.concatenate([np.zeros(3 * n), t.ravel(), ground.ravel()])
    model = read_libmv(path)
    ours = 0.5 * float(np.sum(model.residuals_px() ** 2))
    assert ours == pytest.approx(0.5 * float(np.sum(residuals(x0) ** 2)), rel=1e-9)
    found = least_squares(residuals, x0, jacobian, x_scale="jac", ftol=1e-15, xtol=1e-15, gtol=1e-15,
                          max_nfev=10, tr_options={"atol": 1e-15, "btol": 1e-15, "maxiter": 20000})  # fmt: skip
    solution = fg.adjust(frame_block(model, "libmv"), statistics="basic")
    assert solution.chi2 / 2.0 == pytest.approx(found.cost, rel=1e-9)
    assert solution.chi2 / 2.0 == pytest.approx(CERES, rel=1e-12)


def spoilt(at: int, new: bytes, *, length: int | None = None) -> bytes:
    """Return the file with other bytes at a position; ``length`` truncates it."""
    raw = problem()
    return (raw[:at] + new + raw[at + len(new) :])[:length]


NAN, FAR, NO = struct.pack("<f", np.nan), struct.pack("<i", 77), struct.pack("<i", -1)
#: Of :func:`problem`: images from byte 38, points from 146, image points from 198; 294 bytes.
DAMAGED = {
    "empty": (b"", "does not begin with the letters vP"),
    "text": (b"49 7776 31843\n" * 9, "does not begin with the letters vP"),
    "big-endian": (spoilt(0, b"V"), "does not begin with the letters vP"),
    "normalised": (spoilt(1, b"N"), "does not begin with the letters vP"),
    "head alone": (spoilt(0, b"", length=38), "the counts in the file do not agree with the length"),
    "no images": (spoilt(34, bytes(4)), "(found 0 images)"),
    "minus one image": (spoilt(34, NO), "(found -1 images)"),
    "too many images": (spoilt(34, FAR), "(found 77 images)"),
    "too many points": (
        spoilt(142, FAR),
        "byte 142: the counts in the file do not agree with the length of the file (found 77 points)",
    ),
    "one image point less": (spoilt(194, struct.pack("<i", 5)), "(found 16 bytes more)"),
    "truncated": (spoilt(0, b"", length=-1), "(found 6 image points)"),
    "ends in the points": (spoilt(0, b"", length=170), "(found 3 points)"),
    "one byte more": (problem() + b"0", "(found 1 bytes more)"),
    "no focal length": (spoilt(2, bytes(4)), "the focal length is not above 0"),
    "nan in the camera": (spoilt(6, NAN), "byte 2"),
    "distortion": (spoilt(14, struct.pack("<f", 0.1)), "the order and direction of its coefficients are not known"),
    "image twice": (spoilt(38, struct.pack("<i", 8)), "twice"),
    "a matrix": (spoilt(42, struct.pack("<f", 1.1)), "image 3: the matrix is not a rotation"),
    "a mirror image": (spoilt(42, struct.pack("<f", -1.0)), "a mirror image"),
    "nan in a translation": (spoilt(78, NAN), "image 0: a number is not finite"),
    "nan in a point": (spoilt(150, NAN), "point 0: a number is not finite"),
    "inf in an image point": (spoilt(206, struct.pack("<f", np.inf)), "image point 0: a number is not finite"),
    "no such image": (
        spoilt(198, FAR),
        "image point 0: the file has no image or point of this number (found image 77, point 5)",
    ),
    "no such point": (spoilt(202, FAR), "(found image 3, point 77)"),
    "image point twice": (spoilt(202, struct.pack("<i", 6)), "image point 1"),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_ends_with_2_and_one_line(name: str, tmp_path: Path) -> None:
    raw, text = DAMAGED[name]
    (tmp_path / "problem.bin").write_bytes(raw)
    done = in_process("validate", "--format", "libmv", tmp_path / "problem.bin")
    assert done.code == 2 and done.stderr.count("\n") == 1, done
    assert done.stderr.startswith("error: problem.bin") and text in done.stderr, done.stderr
