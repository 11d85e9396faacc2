"""The module makes random linear systems."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.system import LinearSystem

Array = npt.NDArray[np.float64]


def positive_definite(rng: np.random.Generator, u: int, log_cond: float) -> Array:
    """Return the symmetric matrix (u, u) with eigenvalues from 1 to 10**log_cond and random axes."""
    axes = np.linalg.qr(rng.normal(size=(u, u)))[0]
    matrix: Array = (axes * np.logspace(0.0, log_cond, u)) @ axes.T
    return 0.5 * (matrix + matrix.T)


def design_system(rng: np.random.Generator, rows: int, u: int, log_cond: float) -> LinearSystem:
    """Return the system of a random design with cond(N) = 10**log_cond and random observations."""
    left = np.linalg.qr(rng.normal(size=(rows, u)))[0]
    right = np.linalg.qr(rng.normal(size=(u, u)))[0]
    return LinearSystem.from_design((left * np.logspace(0.0, 0.5 * log_cond, u)) @ right.T, rng.normal(size=rows))


def vandermonde(seed: int, noise: float = 1e-3) -> tuple[LinearSystem, Array, Array]:
    """Return the ill-conditioned polynomial fit, its true coefficients and its noise (cond(A) = 1e7)."""
    rng = np.random.default_rng(seed)
    design = np.vander(np.linspace(0.0, 1.0, 40), 12, increasing=True)
    truth, error = rng.normal(size=12), noise * rng.normal(size=40)
    return LinearSystem.from_design(design, design @ truth + error), truth, error
