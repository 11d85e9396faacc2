"""The twin as a linear problem gives residuals of thousands of simulated adjustments by projection."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import fg_orient as fg
from fg_orient.quality.suspects import Kind, Suspects, suspects
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import turned_design


@dataclass(frozen=True)
class LinearTwin:
    """A solution, and an orthonormal basis (N, u) of its whitened design matrix, control points in East, North, Up."""

    solution: fg.Solution
    basis: np.ndarray

    @property
    def redundancy(self) -> int:
        return self.solution.redundancy

    def residuals(self, noise: np.ndarray) -> np.ndarray:
        """Return the whitened residuals (runs, N) of adjustments with these whitened errors (runs, N)."""
        return noise - (noise @ self.basis) @ self.basis.T

    def noise(self, seed: int, runs: int) -> np.ndarray:
        """Return the errors (runs, N) of all observations, priors included, with sigmas as stated."""
        return np.random.default_rng(seed).normal(size=(runs, len(self.basis)))

    def suspects(self, kind: Kind = "groups") -> list[Suspects]:
        return suspects(self.solution.residual_cofactors, kind)

    def rows(self, found: Suspects) -> np.ndarray:
        """Return the rows (n, m) of the suspects' residuals among all rows."""
        problem = self.solution.problem
        n, control = len(problem.observations), np.flatnonzero(problem.observed)
        if found.part in ("image", "line", "sample"):
            return 2 * found.row[:, None] + np.arange(2)
        at = 2 * n + 3 * np.searchsorted(control, found.point)[:, None] + np.arange(3)
        if found.part != "point":
            return at
        out = []
        for j, own in zip(found.point, at, strict=True):
            rays = np.flatnonzero(problem.observations.point == j)
            image = (2 * rays[:, None] + np.arange(2)).ravel()
            out.append(np.concatenate([image, own]) if problem.observed[j] else image)
        return np.array(out)

    def drawn(self, found: Suspects, v: np.ndarray) -> Suspects:
        """Return the suspects with simulated residuals (runs, n, m)."""
        return replace(found, v=v[:, self.rows(found)])


@cache
def linear_twin() -> LinearTwin:
    """Return the Zonguldak twin at its solution."""
    block, _ = zonguldak_block(ZonguldakOptions(seed=1))
    solution = fg.adjust(block, backend="dense")
    design = turned_design(solution.problem, solution.state)
    return LinearTwin(solution, np.linalg.qr(design / np.linalg.norm(design, axis=0))[0])
