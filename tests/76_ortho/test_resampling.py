"""Resampling agrees with scipy and with kernels written out here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from fg_orient.kernels.resampling import BILINEAR, CUBIC, NEAREST, resample

Array = np.ndarray


def resampled(image: Array, line: Array, sample: Array, kind: int, a: float = 0.0) -> Array:
    out = np.empty(line.shape)
    n = resample(image, 0, 0, line, sample, kind, a, out)
    assert n == np.isfinite(out).sum()
    return out


@pytest.fixture
def image(rng: np.random.Generator) -> Array:
    return rng.uniform(0.0, 255.0, (23, 31))


@pytest.fixture
def places(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random places in the whole image, with its half pixel of border."""
    return rng.uniform(-0.5, 22.5, (20, 25)), rng.uniform(-0.5, 30.5, (20, 25))


@pytest.mark.oracle
@pytest.mark.parametrize(("kind", "order"), [(NEAREST, 0), (BILINEAR, 1)])
def test_nearest_and_bilinear_as_scipy(image: Array, places: tuple[Array, Array], kind: int, order: int) -> None:
    expected = map_coordinates(image, places, order=order, mode="nearest")
    assert np.abs(resampled(image, *places, kind) - expected).max() < 1e-11


@pytest.mark.oracle
@pytest.mark.parametrize("a", [-0.5, -1.0])
def test_cubic_as_the_kernel_is_printed(image: Array, places: tuple[Array, Array], a: float) -> None:
    """Cubic resampling equals the kernel of Keys 1981, eq. 4, summed over all pixels with repeated borders."""

    def kernel(x: Array) -> Array:
        x = np.abs(x)
        near = (a + 2) * x**3 - (a + 3) * x**2 + 1
        far = a * x**3 - 5 * a * x**2 + 8 * a * x - 4 * a
        return np.where(x <= 1, near, np.where(x < 2, far, 0.0))

    wide = np.pad(image, 3, mode="edge")
    rows, columns = (kernel(p[..., None] - (np.arange(n) - 3)) for p, n in zip(places, wide.shape, strict=True))
    expected = np.einsum("...i,...j,ij->...", rows, columns, wide)
    assert np.abs(resampled(image, *places, CUBIC, a) - expected).max() < 1e-10


@pytest.mark.truth
def test_cubic_reproduces_what_its_slope_promises() -> None:
    """Cubic resampling with a = -1/2 reproduces quadratic surfaces (Keys 1981); a = -1 does not."""
    y, x = np.mgrid[0.0:12.0, 0.0:12.0]
    image = 3.0 + 2.0 * x - y + 0.5 * x * y - 0.3 * x**2 + 0.2 * y**2
    q, p = np.meshgrid(np.linspace(2.0, 8.9, 17), np.linspace(2.0, 8.9, 13))
    expected = 3.0 + 2.0 * q - p + 0.5 * q * p - 0.3 * q**2 + 0.2 * p**2
    assert np.abs(resampled(image, p, q, CUBIC, -0.5) - expected).max() < 1e-12
    assert np.abs(resampled(image, p, q, CUBIC, -1.0) - expected).max() > 0.01


@pytest.mark.behaviour
def test_nodata_spreads_over_the_kernel_and_no_further(image: Array) -> None:
    image[10, 10] = np.nan
    line, sample = np.meshgrid(np.arange(5.0, 16.0, 0.25), np.arange(5.0, 16.0, 0.25), indexing="ij")
    far = np.maximum(np.abs(line - 10.0), np.abs(sample - 10.0))
    for kind, reach in ((NEAREST, 0.5), (BILINEAR, 1.0), (CUBIC, 2.0)):
        empty = np.isnan(resampled(image, line, sample, kind, -0.5))
        assert not empty[far > reach].any()
        touched = far < reach
        if kind == CUBIC:  # weights are zero at whole distances
            touched &= (np.abs(line - 10.0) != 1.0) & (np.abs(sample - 10.0) != 1.0)
        assert empty[touched].all()


@pytest.mark.behaviour
def test_places_without_image_stay_empty(image: Array) -> None:
    place = np.array([[np.nan, 3.0]])
    assert np.isnan(resampled(image, place, place, BILINEAR)).tolist() == [[True, False]]
