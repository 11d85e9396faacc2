"""Cholesky factor of a banded matrix against LAPACK's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import lapack

from fg_orient.kernels.batch_band import MARGIN, TILE, factorise_band

Array = npt.NDArray[np.float64]


def banded(n: int, band: int, seed: int) -> Array:
    """A positive definite matrix, element (r, c) of its lower triangle at ``[c, r - c]``."""
    rng, k = np.random.default_rng(seed), np.arange(n)
    root = rng.normal(size=(n, n)) * (abs(k[:, None] - k) <= band // 2)
    whole = root @ root.T + np.eye(n)
    out = np.zeros((n, band + 1))
    for c in range(n):
        below = whole[c : min(n, c + band + 1), c]
        out[c, : len(below)] = below
    return out


def padded(matrix: Array) -> Array:
    """Room for whole tiles, ones on the diagonal behind the matrix."""
    n, width = matrix.shape
    out = np.zeros((-(-n // TILE) * TILE, width + MARGIN))
    out[:n, :width], out[n:, 0] = matrix, 1.0
    return out


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "band"), [
    (1, 0), (5, 4), (24, 23), (30, 3), (47, 46), (49, 24), (60, 0), (100, 25), (143, 71), (200, 23), (161, 150),
])  # fmt: skip
def test_the_factor_is_lapacks(n: int, band: int) -> None:
    matrix = banded(n, band, seed=n)
    expected, info = lapack.dpbtrf(matrix.T, lower=1)
    assert info == 0
    found = padded(matrix)
    assert factorise_band(found, band) == 0
    inside = np.arange(n)[:, None] + np.arange(band + 1) < n
    scale = np.abs(expected).max()
    assert np.abs(found[:n, : band + 1] - expected.T)[inside].max() < 50 * n * np.finfo(float).eps * scale
    outside = found.copy()
    outside[:n, : band + 1][inside] = 0.0
    outside[n:, 0] -= 1.0
    assert not outside.any()


@pytest.mark.behaviour
@pytest.mark.parametrize("column", [0, 23, 24, 77])
def test_an_indefinite_matrix_is_refused_where_it_is(column: int) -> None:
    matrix = banded(100, 30, seed=1)
    matrix[column, 0] = -1.0
    assert factorise_band(padded(matrix), 30) == column // TILE * TILE + 1
    matrix[column, 0] = np.nan
    assert factorise_band(padded(matrix), 30) == column // TILE * TILE + 1
