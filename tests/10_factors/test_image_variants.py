"""Variants of radial distortion and film deformation agree with printed formulas and have right derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from factors.cameras import image_variants as variants

RADIUS = 2.0


def displacement(c: np.ndarray, x: complex, y: complex) -> np.ndarray:
    return variants.terms(x, y, RADIUS) @ c


@pytest.mark.oracle
def test_terms_are_those_of_the_formulas() -> None:
    x, y = 0.7, -1.1
    r = np.hypot(x, y)
    u = r / RADIUS
    along = [r, r**2, r**4, r**6, 3 * u**3 - 2 * u, 10 * u**5 - 12 * u**3 + 3 * u,
             35 * u**7 - 60 * u**5 + 30 * u**3 - 4 * u]  # fmt: skip
    found = variants.terms(x, y, RADIUS)
    assert found[:, :7] == pytest.approx(np.outer([x / r, y / r], along), rel=1e-14, abs=0.0)
    assert found[:, 7:9].tolist() == [[x, 0.0], [0.0, x]]
    assert found[:, 9] == pytest.approx(np.array([x, y]) * r**8, rel=1e-14, abs=0.0)
    rim = variants.terms(RADIUS, 0.0, RADIUS)
    assert rim[0, 4:7].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.oracle
def test_slopes_by_complex_step(rng: np.random.Generator) -> None:
    for _ in range(20):
        c, (x, y) = rng.normal(size=10), rng.normal(size=2)
        by_x, by_y = (displacement(c, x + dx, y + dy).imag / 1e-30 for dx, dy in ((1e-30j, 0j), (0j, 1e-30j)))
        assert variants.slopes(c, x, y, RADIUS) == pytest.approx([by_x[0], by_y[0], by_x[1], by_y[1]], rel=1e-12)
    centre = variants.slopes(np.ones(10), 0.0, 0.0, RADIUS)  # only what is linear in x and y has a slope there
    assert centre == pytest.approx([1.0 + (-2.0 + 3.0 - 4.0) / RADIUS + 1.0, 0.0, 1.0, 1.0 - 3.0 / RADIUS])


@pytest.mark.oracle
def test_displacements_are_orthogonal_on_the_disk() -> None:
    """The scaled radial terms are orthogonal on the disk of the image within 1e-14.

    Gauss's quadrature is exact for their products, which have degree 15 in r.
    """
    at, weight = np.polynomial.legendre.leggauss(12)
    r = RADIUS * 0.5 * (at + 1.0)
    rows = np.array([variants.terms(v, 0.0, RADIUS)[0, [0, 4, 5, 6]] for v in r])
    gram = rows.T @ (rows * (weight * r)[:, None])
    scale = np.sqrt(np.outer(gram.diagonal(), gram.diagonal()))
    assert np.abs(gram / scale - np.eye(4)).max() <= 1e-14
