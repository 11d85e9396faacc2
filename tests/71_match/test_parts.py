"""Parts of matching agree with independent computations: windows, candidates, trend, sigmas, distribution."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage, optimize

from fg_orient.formats.project import read_images
from fg_orient.kernels.matching import AFFINE, CURVED, FIT, SHIFT, SLOPE, fit_window
from fg_orient.orientation.match.blocks import spline_of, spread, variance_along
from fg_orient.orientation.match.consistency import calibrate, fits_neighbours, trend_of
from fg_orient.orientation.match.epipolar import Curves, Pair, parallax_sigma_px
from fg_orient.orientation.match.features import Features, candidates
from tests.support.command import in_process

SIZE, CENTRE = 64, 32


def texture(line: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Return the smooth pattern, known everywhere."""
    x, y = line - CENTRE, sample - CENTRE
    return np.asarray(
        400.0 + 60.0 * np.sin(0.31 * x + 0.2 * y) + 50.0 * np.cos(0.17 * x - 0.29 * y + 0.5) + 40.0 * np.sin(0.4 * y)
    )


def pair(place: np.ndarray, a: np.ndarray, curvature: float, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a template, and an image of 1.5 times its contrast where q + A u + c u_line^2 e is the place of u."""
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij"), axis=-1).astype(float)
    template = texture(grid[..., 0], grid[..., 1])
    away = grid - place
    u = away @ np.linalg.inv(a).T
    for _ in range(30):  # inverse of the curved map
        u = (away - curvature * u[..., :1] ** 2 * direction) @ np.linalg.inv(a).T
    return template, 1.5 * texture(u[..., 0] + CENTRE, u[..., 1] + CENTRE) - 70.0


@pytest.mark.oracle
@pytest.mark.parametrize("kind", [SHIFT, SLOPE, AFFINE, CURVED])
def test_a_window_is_found_where_it_is(kind: int) -> None:
    """Each kind of window finds its place within 2e-3 px, and its unknowns; other unknowns are given."""
    direction = np.array([0.6, 0.8])
    known = np.array([[0.99, 0.06], [-0.05, 1.01]])
    free = {SHIFT: np.zeros((2, 2)), SLOPE: np.outer(direction, [0.04, -0.03]),
            CURVED: np.outer(direction, [0.02, 0.03]),
            AFFINE: np.array([[0.02, -0.03], [0.01, 0.03]])}[kind]  # fmt: skip
    place = np.array([30.37, 33.81])
    template, other = pair(place, known + free, 0.003 if kind == CURVED else 0.0, direction)
    out = np.zeros(FIT.size)
    start = np.r_[place + np.array([0.6, -0.5]), known.ravel()]
    assert fit_window(template.astype(np.float32), spline_of(other.astype(np.float32)), np.array([32.0, 32.0]), start,
                      direction, kind, 8, 4.0, 20, 3.0, out)  # fmt: skip
    assert out[FIT.place] == pytest.approx(place, abs=2e-3)
    assert out[FIT.affine] == pytest.approx((known + free).ravel(), abs=2e-3)
    assert out[FIT.gain] == pytest.approx(1.0 / 1.5, rel=1e-3)
    assert out[FIT.correlation] > 0.999  # of the residuals before the last step


@pytest.mark.oracle
def test_a_window_minimises_the_weighted_squares() -> None:
    """A fitted window has the place and covariance of scipy's least squares on noisy images.

    scipy's spline interpolates.
    """
    rng = np.random.default_rng(5)
    direction, place = np.array([0.0, 1.0]), np.array([31.4, 32.7])
    template, other = pair(place, np.eye(2), 0.0, direction)
    template, other = (np.float32(p + rng.normal(0.0, 5.0, p.shape)) for p in (template, other))
    half, spread_px = 7, 3.5
    out = np.zeros(FIT.size)
    assert fit_window(template, spline_of(other), np.array([32.0, 32.0]), np.r_[place, 1.0, 0.0, 0.0, 1.0], direction,
                      SLOPE, half, spread_px, 30, 3.0, out)  # fmt: skip
    u, v = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0), indexing="ij")
    weight = np.exp(-0.25 * (u**2 + v**2) / spread_px**2)  # root of the weights
    window = template[32 - half : 33 + half, 32 - half : 33 + half]

    def residual(x: np.ndarray) -> np.ndarray:
        at = np.stack([x[0] + u, x[1] + v + x[2] * u + x[3] * v])
        grey = ndimage.map_coordinates(other.astype(float), at, order=3, mode="mirror")
        return np.asarray((weight * (x[4] + x[5] * grey - window)).ravel())

    best = optimize.least_squares(residual, np.r_[place, 0.0, 0.0, 0.0, 1.0], x_scale="jac", xtol=1e-14)
    assert out[FIT.place] == pytest.approx(best.x[:2], abs=3e-3)
    cofactor = np.linalg.inv(best.jac.T @ best.jac)[:2, :2]
    noise = float(out[FIT.noise]) ** 2
    assert out[FIT.covariance] == pytest.approx(noise * cofactor[[0, 0, 1], [0, 1, 1]], rel=0.03, abs=1e-6)
    assert float(out[FIT.noise]) == pytest.approx(np.hypot(5.0 / 1.5, 5.0), rel=0.2)


@pytest.mark.behaviour
@pytest.mark.parametrize("where", ["template", "other"])
def test_a_window_with_nodata_is_not_matched(where: str) -> None:
    template, other = (p.astype(np.float32) for p in pair(np.array([32.0, 32.0]), np.eye(2), 0.0, np.array([0.0, 1.0])))
    (template if where == "template" else other)[36, 30] = np.nan
    out, start = np.zeros(FIT.size), np.array([32.0, 32.0, 1.0, 0.0, 0.0, 1.0])
    assert not fit_window(template, spline_of(other), np.array([32.0, 32.0]), start, np.array([0.0, 1.0]), SLOPE, 7,
                          3.5, 20, 3.0, out)  # fmt: skip


@pytest.mark.oracle
def test_candidates_are_those_of_a_plain_search() -> None:
    """Candidates are those of a plain search.

    They lie in the band, have similar size, are mutually best, and are better than any other candidate farther away.
    """
    rng = np.random.default_rng(2)
    n, m, ratio, half_width = 60, 150, 0.9, 6.0
    pixel_b = rng.uniform(0.0, 200.0, (m, 2))
    descriptor_b = rng.random((m, 8)).astype(np.float32)
    descriptor_b /= np.linalg.norm(descriptor_b, axis=1, keepdims=True)
    same = rng.integers(0, m, n)
    descriptor_a = descriptor_b[same] + rng.normal(0.0, 0.05, (n, 8)).astype(np.float32)
    descriptor_a /= np.linalg.norm(descriptor_a, axis=1, keepdims=True)
    size_a, size_b = np.full(n, 3.0), rng.choice([3.0, 8.0], m, p=[0.8, 0.2])
    angle = rng.uniform(0.0, np.pi, n)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = np.full(n, 40.0)
    c0 = pixel_b[same] + rng.normal(0.0, 4.0, (n, 2))
    curves = Curves(c0, half[:, None] * along, np.zeros((n, 2)), along, np.stack([-along[:, 1], along[:, 0]], 1), half)
    a = Features(np.zeros((n, 2)), size_a, np.ones(n), descriptor_a)
    b = Features(pixel_b, size_b, np.ones(m), descriptor_b)
    one = np.ones(n)
    found = candidates(a, b, curves, (-one, one), (0.0 * one, half_width), ratio, 1.0, 2.0)
    allowed = np.full((n, m), np.inf)
    for i in range(n):
        for j in range(m):
            away = pixel_b[j] - c0[i]
            if abs(away @ along[i]) <= 42.0 and abs(away @ curves.across[i]) <= half_width and size_b[j] == 3.0:
                allowed[i, j] = 2.0 - 2.0 * float(descriptor_a[i] @ descriptor_b[j])
    expected = set()
    for i in range(n):
        j = int(allowed[i].argmin())
        far = np.abs(pixel_b - pixel_b[j]).max(axis=1) > 3.0
        limit = min(float(allowed[i][far].min()), 0.6)
        if np.isfinite(allowed[i, j]) and allowed[:, j].argmin() == i and allowed[i, j] <= ratio**2 * limit:
            expected.add((i, j))
    assert len(expected) > 20
    assert set(zip(found.a.tolist(), found.b.tolist(), strict=True)) == expected


@pytest.mark.oracle
def test_a_trend_is_found_among_wrong_matches(rng: np.random.Generator) -> None:
    """The trend of the y-parallax is right within 0.3 px although a third of the matches is wrong.

    Without right matches there is none.
    """
    pixel = rng.uniform(0.0, 10_000.0, (600, 2))
    x = (pixel - 5000.0) / 5000.0
    true = 37.0 + 3.0 * x[:, 0] - 2.0 * x[:, 1] + 0.5 * x[:, 0] * x[:, 1]
    parallax = true + rng.normal(0.0, 0.4, 600)
    parallax[:200] = rng.uniform(-300.0, 300.0, 200)
    trend = trend_of(pixel, parallax, 300.0)
    assert trend is not None
    assert np.abs(trend.at(pixel) - true).max() < 0.3
    assert trend.scatter_px == pytest.approx(0.4, rel=0.2)
    assert trend_of(pixel, rng.uniform(-300.0, 300.0, 600), 300.0) is None


@pytest.mark.oracle
@pytest.mark.parametrize(("factor", "floor"), [(1.8, 0.0), (1.2, 0.05), (0.0, 0.1)])
def test_factor_and_floor_of_the_sigmas(rng: np.random.Generator, factor: float, floor: float) -> None:
    formal = rng.uniform(0.02, 0.2, 20_000) ** 2
    residual = rng.normal(0.0, np.sqrt(factor**2 * formal + floor**2))
    residual[:40] = rng.uniform(-6.0, 6.0, 40)  # wrong matches
    found = calibrate(residual, formal)
    assert found.variance(formal) == pytest.approx(factor**2 * formal + floor**2, rel=0.1)


@pytest.mark.oracle
def test_a_match_far_from_its_neighbours_is_wrong(rng: np.random.Generator) -> None:
    pixel = rng.uniform(0.0, 300.0, (500, 2))
    along = 0.1 * pixel[:, 0] + rng.normal(0.0, 0.3, 500)
    wrong = rng.choice(500, 25, replace=False)
    along[wrong] += rng.choice([-1.0, 1.0], 25) * rng.uniform(30.0, 200.0, 25)
    good = fits_neighbours(pixel, along, 2.0)
    assert not good[wrong].any()
    assert np.delete(good, wrong).mean() > 0.98


@pytest.mark.oracle
def test_points_are_spread(rng: np.random.Generator) -> None:
    """Selected points are 5 px apart at least, and 70 % lie outside a corner with strong features."""
    pixel = np.vstack([rng.uniform(0.0, 30.0, (900, 2)), rng.uniform(0.0, 300.0, (300, 2))])
    strength = np.r_[np.full(900, 10.0), np.ones(300)] + rng.random(1200)
    kept = spread(pixel, strength, 5.0, 100)
    assert len(kept) == 100
    apart = np.linalg.norm(pixel[kept][:, None] - pixel[kept][None], axis=2) + 100.0 * np.eye(100)
    assert apart.min() >= 5.0
    assert (pixel[kept].max(axis=1) > 30.0).mean() > 0.7


@pytest.mark.oracle
def test_variance_along_a_direction() -> None:
    covariance, direction = np.array([[4.0, 1.0, 9.0]]), np.array([[0.6, 0.8]])
    full = np.array([[4.0, 1.0], [1.0, 9.0]])
    assert variance_along(covariance, direction)[0] == pytest.approx(direction[0] @ full @ direction[0])


@pytest.mark.slow
@pytest.mark.oracle
def test_prior_sigma_of_the_y_parallax(tmp_path: Path, rng: np.random.Generator) -> None:
    """The prior sigma of the y-parallax is that of drawn orientations within 15 %, for each kind of sensor."""
    assert in_process("simulate", "mixed", "--out", tmp_path / "mixed").code == 0
    read = read_images(tmp_path / "mixed" / "project.toml")
    sensors = {image.id: image.sensor for image in read.images}
    for a, b in (("spot1", "pleiades1"), ("pleiades1", "pleiades2"), ("frame1", "frame2"), ("spot2", "spot1")):
        pair = Pair(sensors[a], sensors[b], 0.0, 1500.0)
        s = pair.a
        at = 0.5 * (s.first_line + s.last_line), 0.5 * (s.first_sample + s.last_sample)
        first, second = (sensors[name].image_model(read.options) for name in (a, b))
        curve = pair.curves(np.array([at[0]]), np.array([at[1]]))
        moved = []
        for _ in range(300):
            x, y = (rng.normal(size=len(m.parameters)) for m in (first, second))
            ground = pair.a.locate(*at, height_m=750.0, correction=first.correction(x))
            there = np.stack(pair.b.project(ground, second.correction(y)), axis=1)
            moved.append(float(curve.coordinates(there)[1][0]))
        assert parallax_sigma_px(pair, read.options, *at) == pytest.approx(np.std(moved), rel=0.15), (a, b)
