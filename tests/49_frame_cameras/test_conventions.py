"""Conventions of other programs are compared with their formulas, pycolmap, DBAT's numbers and simulation."""

from __future__ import annotations

import re
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from factors.cameras import frame_corrections
from fg_orient.formats.metadata.frame import read_camera, read_convention, write_convention
from fg_orient.sensors.camera_conversion import ConvertedCamera
from fg_orient.sensors.conventions import CONVENTIONS, REFUSED, Image
from tests.support import dbat
from tests.support.changed_text import change_file
from tests.support.command import in_process

LINES, SAMPLES, PIXEL_MM, R0_MM = 1000, 1400, 0.005, 2.4
IMAGE = Image(LINES, SAMPLES, 1.0 / PIXEL_MM, R0_MM)
BROWN = {"k1": -0.1, "k2": 0.02, "p1": 1e-3, "p2": -5e-4}
TWO = {"fx": 900.0, "fy": 910.0, "cx": 703.0, "cy": 496.0}
ONE = {"f": 900.0, "cx": 703.0, "cy": 496.0}
LENS = {"k1": 0.05, "k2": -0.01, "k3": 3e-3, "k4": -4e-4}
#: mm, y up: a lens with barrel distortion.
MM = {"k1": 4.6e-3, "k2": -4.5e-5, "k3": -2.1e-6, "p1": -6.1e-5, "p2": -4.4e-5}
VALUES: dict[str, dict[str, float]] = {
    "opencv": TWO | BROWN | {"k3": 1e-3},
    "opencv-fisheye": TWO | LENS,
    "colmap-simple-pinhole": ONE,
    "colmap-pinhole": TWO,
    "colmap-simple-radial": ONE | {"k1": -0.1},
    "colmap-radial": ONE | {"k1": -0.1, "k2": 0.02},
    "colmap-opencv": TWO | BROWN,
    "colmap-opencv-fisheye": TWO | LENS,
    "colmap-full-opencv": TWO | BROWN | {"k3": 1e-3},
    "photomodeler": {"f": 4.56, "xp": 3.52, "yp": 2.47, **MM},
    "dbat": {"cc": 4.56, "px": 3.52, "py": 2.47, "aspect": 0.9996, **MM},
    "metashape": {"f": 900.0, "cx": 3.5, "cy": -4.5, "b1": 2.0, "b2": -0.7, "k1": -0.1, "k2": 0.02, "k3": 1e-3,
                  "k4": -2e-4, "p1": -5e-4, "p2": 1e-3},
    "pix4d": ONE | {"r1": -0.1, "r2": 0.02, "r3": 1e-3},
    "australis": {"c": 4.56, "xp": 0.02, "yp": 0.03, **MM, "b1": 4e-4, "b2": -3e-4},
    "balanced": {"c": 4.56, "x0": 0.02, "y0": 0.03, "a1": -4.6e-3, "a2": 4.5e-5, "a3": 2.1e-6, "b1": 6.1e-5,
                 "b2": 4.4e-5, "c1": -4e-4, "c2": 3e-4},
}  # fmt: skip


def convert(name: str, target: str, covariance: np.ndarray | None = None, **changes: float) -> ConvertedCamera:
    return fg.convert_camera(VALUES[name] | changes, name, target, covariance=covariance, image_size=(LINES, SAMPLES),
                             pixel_mm=PIXEL_MM, r0_mm=R0_MM)  # fmt: skip


def directions(n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(3).uniform(-0.5, 0.5, (2, n)))


# --- the formulas of the programs: x, y are X/Z right and Y/Z down; pixels from the centre of the first one -------


def radial_tangential(
    x: np.ndarray, y: np.ndarray, radial: list[float], p1: float, p2: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return OpenCV's distorted coordinates: x (1 + k1 r^2 + ...) + 2 p1 x y + p2 (r^2 + 2 x^2), likewise y."""
    r = x * x + y * y
    scale = 1.0 + sum(k * r ** (i + 1) for i, k in enumerate(radial))
    return scale * x + 2 * p1 * x * y + p2 * (r + 2 * x * x), scale * y + p1 * (r + 2 * y * y) + 2 * p2 * x * y


def forward(name: str, v: dict[str, float], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sample and line of directions."""

    def get(*names: str) -> list[float]:
        return [v.get(n, 0.0) for n in names]

    if name == "metashape":  # x' = x (1 + K1 r^2 + ...) + P1 (r^2 + 2 x^2) + 2 P2 x y; then w/2 + cx + f x'
        # + B1 x' + B2 y' and h/2 + cy + f y' from the corner
        x, y = radial_tangential(x, y, get("k1", "k2", "k3", "k4"), v["p2"], v["p1"])
        return 0.5 * SAMPLES + v["cx"] + (v["f"] + v["b1"]) * x + v["b2"] * y - 0.5, (
            0.5 * LINES + v["cy"] + v["f"] * y - 0.5
        )
    if name == "pix4d":
        x, y = radial_tangential(x, y, get("r1", "r2", "r3"), 0.0, 0.0)
        return v["f"] * x + v["cx"] - 0.5, v["f"] * y + v["cy"] - 0.5
    if "fisheye" in name:
        r = np.hypot(x, y)
        t = np.arctan(r)
        bent = t * (1 + v["k1"] * t**2 + v["k2"] * t**4 + v["k3"] * t**6 + v["k4"] * t**8) / r
        x, y = bent * x, bent * y
    else:
        x, y = radial_tangential(x, y, get("k1", "k2", "k3"), *get("p1", "p2"))
    corner = 0.5 if name.startswith("colmap") else 0.0
    fx, fy = (v["f"], v["f"]) if "f" in v else (v["fx"], v["fy"])
    return fx * x + v["cx"] - corner, fy * y + v["cy"] - corner


def backward(name: str, v: dict[str, float], sample: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of pixels; x, y are mm right and up from the principal point."""
    if name in ("photomodeler", "dbat"):
        x0, y0 = (v["xp"], v["yp"]) if name == "photomodeler" else (v["px"], v["py"])
        x, y = PIXEL_MM * sample - x0, -(PIXEL_MM * line - y0)
        x = x * (1 + (1 - v.get("aspect", 1.0)))  # DBAT's off-unit aspect parameter
    else:
        x0, y0 = (v["xp"], v["yp"]) if name == "australis" else (v["x0"], v["y0"])
        x = PIXEL_MM * (sample - 0.5 * (SAMPLES - 1)) - x0
        y = -PIXEL_MM * (line - 0.5 * (LINES - 1)) - y0
    r2 = x * x + y * y
    if name == "balanced":  # corrected = measured - dx
        a = [v[n] for n in ("a1", "a2", "a3")]
        along = sum(k * (r2 ** (i + 1) - R0_MM ** (2 * i + 2)) for i, k in enumerate(a))
        dx = along * x + v["b1"] * (r2 + 2 * x * x) + 2 * v["b2"] * x * y + v["c1"] * x + v["c2"] * y
        dy = along * y + 2 * v["b1"] * x * y + v["b2"] * (r2 + 2 * y * y)
        x, y, c = x - dx, y - dy, v["c"]
    else:  # corrected = measured + dx
        along = v["k1"] * r2 + v["k2"] * r2**2 + v["k3"] * r2**3
        dx = along * x + v["p1"] * (r2 + 2 * x * x) + 2 * v["p2"] * x * y
        dy = along * y + 2 * v["p1"] * x * y + v["p2"] * (r2 + 2 * y * y)
        if name == "australis":
            dx = dx + v["b1"] * x + v["b2"] * y
        x, y, c = x + dx, y + dy, next(v[n] for n in ("f", "cc", "c") if n in v)
    return x / c, -y / c


def corrects(name: str) -> bool:
    return CONVENTIONS[name].direction == "brown_measured_to_ideal"


def project(camera: ConvertedCamera, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    own = camera.interior.camera(np.eye(3), np.zeros(3))
    return frame_corrections.pixels(own.corrected(), np.column_stack([x, y, np.ones(len(x))]))[:, :2]


@pytest.mark.oracle
@pytest.mark.parametrize("name", CONVENTIONS)
def test_image_points_are_those_of_the_formula(name: str) -> None:
    camera = convert(name, name)
    if corrects(name):
        rng = np.random.default_rng(5)
        line, sample = rng.uniform(0, LINES, 300), rng.uniform(0, SAMPLES, 300)
        x, y = backward(name, VALUES[name], sample, line)
    else:
        x, y = directions()
        sample, line = forward(name, VALUES[name], x, y)
    assert np.abs(project(camera, x, y) - np.column_stack([line, sample])).max() < 1e-6
    again = camera.interior.ideal(line, sample)
    assert np.abs(again - np.column_stack([x, y])).max() < 1e-9


@pytest.mark.oracle
@pytest.mark.parametrize("name", [name for name in CONVENTIONS if name.startswith("colmap")])
def test_image_points_are_those_of_pycolmap(name: str) -> None:
    """A camera converted to a COLMAP model has the image points of pycolmap within 1e-6 px.

    OpenCV's first pixel is at (0, 0), COLMAP's at (0.5, 0.5).
    """
    pycolmap = pytest.importorskip("pycolmap")
    source = "opencv-fisheye" if "fisheye" in name else "opencv"
    kept = {n: VALUES[source][n] for n in VALUES[name] if n in VALUES[source]}
    given = kept if "fx" in kept else kept | {"fx": 900.0, "fy": 900.0}
    out = fg.convert_camera(given, source, name)
    model = name.removeprefix("colmap-").replace("-", "_").upper()
    camera = pycolmap.Camera(model=model, width=SAMPLES, height=LINES, params=list(out.values.values()))
    x, y = directions()
    expected = camera.img_from_cam(np.column_stack([x, y, np.ones(len(x))]))[:, ::-1] - 0.5
    assert out.is_exact
    assert np.column_stack(forward(source, given, x, y))[:, ::-1] == pytest.approx(expected, abs=1e-6)
    assert project(out, x, y) == pytest.approx(expected, abs=1e-6)


@pytest.mark.truth
@pytest.mark.real_data
def test_camera_of_dbat_is_that_of_its_report(real_data: Path) -> None:
    """DBAT's camera file is read with the values that its report prints for the same camera."""
    folder = real_data / "dbat" / "script" / "camcaldemo" / "result"
    text = (folder / "c4040z.xml").read_text()
    at = {name: [float(v) for v in re.findall(rf"<{name}>(.*?)</", text)[0].split(",")] for name in
          ("cc", "pp", "aspect", "skew", "K", "P")}  # fmt: skip
    names = ("cc", "px", "py", "aspect", "skew", "k1", "k2", "k3", "p1", "p2")
    values = dict(zip(names, (v for part in at.values() for v in part), strict=True))
    pixel_mm = 5.43764 / 1704
    camera = fg.convert_camera(values, "dbat", "photomodeler", pixel_mm=pixel_mm, image_size=(1704, 2272))
    exact = fg.convert_camera(values, "dbat", "dbat", pixel_mm=pixel_mm)
    printed = dbat.report(folder / "report.txt")[1]["camera"]
    theirs = {"Camera Constant": "cc", "px": "px", "py": "py", "K1": "k1", "K2": "k2", "K3": "k3", "P1": "p1",
              "P2": "p2"}  # fmt: skip
    for long, short in theirs.items():
        assert exact.values[short] == pytest.approx(float(printed[long][0]), rel=1e-5)
    assert exact.interior.aspect == pytest.approx(float(printed["as"][0]), rel=1e-5)
    assert not camera.is_exact and camera.values["k1"] == pytest.approx(values["k1"], rel=0.01)


# --- conversion -----------------------------------------------------------------------------------------------------

#: Fits: the other direction, the other projection, terms that the target does not have.
FITTED = [
    ("opencv", "dbat"), ("dbat", "opencv"), ("opencv-fisheye", "opencv"), ("opencv", "opencv-fisheye"),
    ("balanced", "metashape"), ("metashape", "balanced"), ("opencv", "colmap-simple-radial"), ("australis", "dbat"),
]  # fmt: skip
EXACT = [
    *permutations(("opencv", "colmap-full-opencv"), 2), *permutations(("opencv-fisheye", "colmap-opencv-fisheye"), 2),
    *permutations(("australis", "balanced"), 2), ("photomodeler", "dbat"), ("photomodeler", "australis"),
    ("photomodeler", "balanced"), ("pix4d", "opencv"), ("pix4d", "metashape"), ("opencv", "metashape"),
    ("colmap-opencv", "opencv"), ("colmap-opencv", "metashape"), ("colmap-pinhole", "opencv"),
    ("colmap-radial", "pix4d"),
    ("colmap-radial", "colmap-opencv"), ("colmap-simple-radial", "colmap-radial"),
    ("colmap-simple-pinhole", "colmap-pinhole"),
]  # fmt: skip


@pytest.mark.consistency
def test_there_and_back_is_exact_or_states_its_residual() -> None:
    """An exact conversion returns the values within 1e-9; a fitted one states largest, RMS and place of its error."""
    line, sample = (g.ravel() for g in np.meshgrid(np.linspace(0, LINES - 1, 41), np.linspace(0, SAMPLES - 1, 41)))
    for a, b in EXACT + FITTED:
        out, before = convert(a, b), convert(a, a)
        ideal = before.interior.ideal(line, sample)
        apart = np.hypot(*(project(out, *ideal.T) - np.column_stack([line, sample])).T)
        assert out.is_exact == ((a, b) not in FITTED), (a, b)
        if out.is_exact:
            back = fg.convert_camera(out.values, b, a, image_size=(LINES, SAMPLES), pixel_mm=PIXEL_MM, r0_mm=R0_MM)
            again = np.hypot(*(project(back, *ideal.T) - np.column_stack([line, sample])).T)
            assert back.is_exact and apart.max() < 1e-9 and again.max() < 1e-9, (a, b)
            for name, value in VALUES[a].items():
                assert back.values[name] == pytest.approx(value, rel=1e-9, abs=1e-15), (a, b, name)
        else:
            assert out.max_px == pytest.approx(apart.max(), rel=1e-6), (a, b)
            assert out.rms_px == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-6), (a, b)
            worst = np.argmin(np.hypot(line - out.at_px[0], sample - out.at_px[1]))
            assert apart[worst] == pytest.approx(apart.max(), rel=1e-6), (a, b)


@pytest.mark.oracle
def test_fit_is_the_least_squares_solution() -> None:
    """A fitted conversion is scipy's least-squares solution for pixels of OpenCV's formula on the grid.

    scipy begins elsewhere and has no derivatives of ours.
    """
    out = convert("photomodeler", "opencv")
    line, sample = (g.ravel() for g in np.meshgrid(np.linspace(0, LINES - 1, 41), np.linspace(0, SAMPLES - 1, 41)))
    x, y = backward("photomodeler", VALUES["photomodeler"], sample, line)
    names = list(out.values)

    def misfit(scaled: np.ndarray) -> np.ndarray:
        v = dict(zip(names, scaled * scale, strict=True))
        s, n = forward("opencv", v, x, y)
        return np.concatenate([s - sample, n - line])

    scale = np.array([900.0, 900.0, 700.0, 500.0, 0.1, 0.1, 1e-3, 1e-3, 0.1])
    start = np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = least_squares(misfit, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    mine = np.array(list(out.values.values())) / scale
    assert mine == pytest.approx(found.x, abs=1e-6)
    assert np.sqrt(np.sum(misfit(mine) ** 2) / len(x)) == pytest.approx(out.rms_px, rel=1e-9)
    assert 0.0 < out.rms_px < 0.2


def covariance_of(name: str, relative: float = 1e-3) -> np.ndarray:
    """Return a covariance with correlations whose sigmas are some ``relative`` of each value."""
    values = np.array(list(VALUES[name].values()))
    k = len(values)
    mixing = np.random.default_rng(8).normal(size=(k, 2 * k))
    q = mixing @ mixing.T / (2 * k)
    sigma = relative * np.abs(values)
    return q * np.outer(sigma, sigma)


@pytest.mark.oracle
@pytest.mark.parametrize(("source", "target"), [
    ("opencv", "metashape"), ("metashape", "metashape"), ("opencv", "colmap-full-opencv"), ("dbat", "dbat"),
    ("balanced", "australis"), ("australis", "balanced"), ("photomodeler", "balanced"),
])  # fmt: skip
def test_exact_covariance_by_monte_carlo(source: str, target: str) -> None:
    covariance = covariance_of(source)
    out = convert(source, target, covariance)
    assert out.is_exact and out.covariance is not None
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(list(VALUES[source].values()), covariance, 20_000, method="cholesky")
    one, two = CONVENTIONS[source], CONVENTIONS[target]
    order = [list(VALUES[source]).index(n) if n in VALUES[source] else -1 for n in one.names[: len(one.parsed)]]
    padded = np.column_stack([draws, np.zeros(len(draws))])
    found = two.values(one.camera(padded[:, order].T, IMAGE), IMAGE)  # values of all draws at once
    n = len(found)
    spread = np.cov(found)
    sigma = np.sqrt(out.covariance.diagonal())[:n]
    seen = sigma > 0.0
    assert np.sqrt(spread.diagonal())[seen] == pytest.approx(sigma[seen], rel=0.03)
    assert np.abs(spread / np.outer(*(np.where(seen, sigma, 1.0),) * 2)
                  - out.covariance[:n, :n] / np.outer(*(np.where(seen, sigma, 1.0),) * 2)).max() < 0.03  # fmt: skip


@pytest.mark.slow
@pytest.mark.oracle
def test_covariance_of_a_fit_by_monte_carlo() -> None:
    """The covariance of a fitted conversion equals the scatter of 20 000 fits within 3 %.

    PhotoModeler is converted to COLMAP's RADIAL by normal equations, linear in f, cx, cy, f k1, f k2.
    """
    covariance = covariance_of("photomodeler", 1e-2)
    out = convert("photomodeler", "colmap-radial", covariance)
    assert not out.is_exact and out.covariance is not None
    line, sample = (g.ravel() for g in np.meshgrid(np.linspace(0, LINES - 1, 41), np.linspace(0, SAMPLES - 1, 41)))
    values = list(VALUES["photomodeler"].values())
    draws = np.random.default_rng(2).multivariate_normal(values, covariance, 20_000, method="cholesky")
    found = np.empty((len(draws), 5))
    ones, zeros = np.ones(len(line)), np.zeros(len(line))
    for i, draw in enumerate(draws):
        x, y = backward("photomodeler", dict(zip(VALUES["photomodeler"], draw, strict=True)), sample, line)
        r = x * x + y * y
        rows = ((x, y), (ones, zeros), (zeros, ones), (x * r, y * r), (x * r**2, y * r**2))
        a = np.array([np.concatenate(row) for row in rows])
        f, cx, cy, fk1, fk2 = np.linalg.solve(a @ a.T, a @ np.r_[sample + 0.5, line + 0.5])
        found[i] = f, cx, cy, fk1 / f, fk2 / f
    sigma = np.array(list(out.sigma.values()))
    assert found.std(axis=0) == pytest.approx(sigma, rel=0.03)
    assert np.corrcoef(found.T) == pytest.approx(out.covariance / np.outer(sigma, sigma), abs=0.03)


@pytest.mark.oracle
@pytest.mark.parametrize(("source", "target"), [
    ("photomodeler", "opencv"), pytest.param("dbat", "metashape", marks=pytest.mark.slow),
    pytest.param("colmap-opencv", "australis", marks=pytest.mark.slow), ("opencv", "opencv-fisheye"),
    pytest.param("metashape", "colmap-radial", marks=pytest.mark.slow),
])  # fmt: skip
def test_derivatives_of_fits_by_differences(source: str, target: str) -> None:
    """Each standard deviation of a fitted conversion equals the difference of two further fits within 1e-3."""
    for k, (name, value) in enumerate(VALUES[source].items()):
        step = 1e-4 * abs(value)
        covariance = np.zeros((len(VALUES[source]),) * 2)
        covariance[k, k] = step**2
        out = convert(source, target, covariance)
        more, less = (convert(source, target, None, **{name: value + s}) for s in (step, -step))
        expected = np.array([0.5 * abs(more.values[n] - less.values[n]) for n in out.values])
        sigma = np.array(list(out.sigma.values()))
        scale = np.array([max(abs(v), 1e-4) for v in out.values.values()])
        least = 1e-5 * (expected / scale).max()  # of the largest effect
        assert sigma / scale == pytest.approx(expected / scale, rel=1e-3, abs=least), name


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(("change", "word"), [
    ({"source": "opencl"}, "opencl"), ({"target": "micmac"}, "micmac"), ({"values": ONE}, "fx, fy"),
    ({"values": TWO | {"k9": 1.0}}, "k9"), ({"values": TWO | {"k1": np.nan}}, "k1"),
    ({"values": TWO | {"fy": 0.0}}, "focal"), ({"source": "pix4d", "values": ONE | {"t1": 1e-4}}, "t1, t2|t1 t2"),
    ({"source": "colmap-full-opencv", "values": TWO | {"k6": 0.1}}, "k6"),
    ({"target": "metashape", "image_size": (0, 0)}, "image_size"), ({"target": "dbat"}, "pixel_mm"),
    ({"target": "balanced", "pixel_mm": 0.01}, "r0_mm"), ({"target": "dbat", "pixel_mm": -1.0}, "pixel_mm"),
    ({"target": "colmap-radial", "image_size": (0, 0)}, "image_size"),
    ({"covariance": np.eye(3)}, "4 x 4"), ({"covariance": -np.eye(4)}, "4 x 4"),
    ({"covariance": np.diag([np.nan, 1, 1, 1])}, "4 x 4"),
])  # fmt: skip
def test_refusals(change: dict[str, object], word: str) -> None:
    given = {"values": TWO, "source": "opencv", "target": "colmap-opencv", "image_size": (LINES, SAMPLES)} | change
    with pytest.raises(fg.InputError, match=word) as caught:
        fg.convert_camera(**given)  # type: ignore[arg-type]
    assert len(str(caught.value).splitlines()) == 1
    assert "micmac" in REFUSED


@pytest.mark.behaviour
def test_camera_files_have_conventions(tmp_path: Path) -> None:
    """A camera file in another convention is read as a camera and converted there and back with its covariance."""
    source, there, back = (tmp_path / f"{name}.toml" for name in ("source", "there", "back"))
    covariance = covariance_of("australis")
    write_convention(source, convert("australis", "australis", covariance), PIXEL_MM, None)
    assert read_camera(source).focal_px == pytest.approx(4.56 / PIXEL_MM)
    ended = in_process("camera", "convert", source, "--to", "balanced", "--r0-mm", R0_MM, "--out", there, "--json")
    expected = convert("australis", "balanced", covariance)
    assert ended.code == 0 and ended.json["exact"] is True
    assert ended.json["values"] == pytest.approx(expected.values)
    assert ended.json["sigma"] == pytest.approx(expected.sigma)
    assert in_process("camera", "convert", there, "--to", "australis", "--out", back).code == 0
    again = read_convention(back)
    assert again is not None and again.covariance is not None
    assert again.values == pytest.approx(VALUES["australis"])
    sigma = np.sqrt(covariance.diagonal())
    assert np.array(again.covariance) / np.outer(sigma, sigma) == pytest.approx(covariance / np.outer(sigma, sigma),
                                                                               abs=1e-9)  # fmt: skip
    there.write_text(there.read_text("utf-8").replace("pixel_mm", "# pixel_mm"), "utf-8")  # given as an option instead
    assert in_process("camera", "convert", there, "--to", "australis", "--out", tmp_path / "c.toml", "--pixel-mm",
                      PIXEL_MM).code == 0  # fmt: skip
    model = in_process("camera", "convert", back, "--to", "brown_ideal_to_measured", "--out", tmp_path / "b.toml")
    ours = in_process(
        "camera", "convert", tmp_path / "b.toml", "--to", "opencv", "--out", tmp_path / "o.toml", "--json"
    )
    assert (model.code, ours.code) == (0, 0) and ours.json["exact"] is True and ours.json["sigma"] == {}


@pytest.mark.behaviour
@pytest.mark.parametrize(("old", "new", "words"), [
    ('convention = "australis"', 'convention = "micmac"', "micmac"),
    ("pixel_mm", "# pixel_mm", "--pixel-mm"), ("k1 = ", "k7 = ", "k7"),
    ("\nc = ", "\n# c = ", "give c"), ("[values]", "[valuess]", "values"), ("lines = 1000", "lines = 0", "lines"),
    ("xp = ", "xp = nan # ", "xp"),
])  # fmt: skip
def test_damaged_camera_files(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "camera.toml"
    write_convention(path, convert("australis", "australis"), PIXEL_MM, None)
    change_file(path, (old, new))
    ended = in_process("camera", "convert", path, "--to", "opencv", "--out", tmp_path / "out.toml")
    assert ended.code == 2 and words in ended.stderr and "camera.toml" in ended.stderr
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.repository
def test_page_lists_the_conventions(repository: Path) -> None:
    text = (repository / "docs" / "frame-cameras.md").read_text("utf-8")
    for name, convention in CONVENTIONS.items():
        row = next((line for line in text.splitlines() if line.startswith(f"| `{name}` |")), "")
        assert all(f"{n}" in row for n in convention.names) and convention.evidence in row, name
