"""The module computes the doubts of docs/verdict.md in a linear model from their formulas, without code of fg_orient.

A is the whitened Jacobian of observations and priors at the truth,
``Q = (A^T A)^-1`` and ``R = I - A Q A^T``. Errors e of the observations, in sigmas, make the
residuals ``v = -R e`` and move the check points by ``J Q A^T e``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import stats

from benchmarks.drawn import Drawn
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.quality.deficiency import compiled_problem

Array = npt.NDArray[np.float64]
#: The shares are those of docs/verdict.md; then follow Baarda's level and the least factor of sigmas.
SHARE: Final = {"sigma0": 0.0005, "gross": 0.002, "prior": 0.001, "far": 0.001, "beyond": 0.001, "sigmas": 0.001}
BAARDA: Final = 0.001
MATTERS: Final = 1.25


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """A linear block is the linear model of a block at the truth.

    Parameters
    ----------
    problem : Problem
    n_image, n_control : int
        Numbers of rows of image points and of control points (East, North, Up); the priors
        follow.
    q, r : (u, u), (n, n) arrays
    effect : (u, n) array
        ``Q A^T``.
    check : (3k, u) array
        Derivatives of the check coordinates East, North, Up by the unknowns.
    check_sigma : (3k,) array
    """

    problem: Problem
    n_image: int
    n_control: int
    q: Array
    r: Array
    effect: Array
    check: Array
    check_sigma: Array

    @classmethod
    def of(cls, block: Block, drawn: Drawn) -> LinearBlock:
        """Return the linear model of a block without errors."""
        problem = compiled_problem(block)
        state = State(np.zeros_like(problem.start.image), drawn.truth_m - problem.origin_m)
        _, a = assemble(problem, state)
        n_image, control = 2 * len(problem.observations), np.flatnonzero(problem.observed)
        for k, j in enumerate(control):  # rows of control points in East, North, Up
            rows = slice(n_image + 3 * k, n_image + 3 * k + 3)
            axes = problem.axes(drawn.truth_m[j][None])[0]
            a[rows] = 0.0
            a[rows, problem.point_slice(int(j))] = axes / block.points.known.sigma_enu_m[j][:, None]
        length = np.linalg.norm(a, axis=0)
        inverse = np.linalg.pinv(a / length, rcond=1e-13) / length[:, None]
        rows = block.points.where(Role.CHECK)
        check = np.zeros((3 * len(rows), a.shape[1]))
        for k, j in enumerate(rows):
            check[3 * k : 3 * k + 3, problem.point_slice(int(j))] = problem.axes(drawn.truth_m[j][None])[0]
        sigma = block.withheld.open().sigma_enu_m.ravel() if len(rows) else np.zeros(0)
        return cls(problem, n_image, 3 * len(control), inverse @ inverse.T, np.eye(len(a)) - a @ inverse, inverse,
                   check, sigma)  # fmt: skip

    def errors(self, block: Block, drawn: Drawn) -> tuple[Array, Array]:
        """Return the errors of a mistake: (n,) of all rows in stated sigmas, and (3k,) of check coordinates, m."""
        o, e = block.observations, np.zeros(len(self.r))
        shown = drawn.pixels
        given = np.stack([o.line, o.sample], axis=1)
        if block.images is not drawn.block.images:  # with other metadata the projections differ by this amount
            other = np.empty_like(shown)
            for k, (image, correction) in enumerate(zip(block.images, drawn.corrections, strict=True)):
                rows = o.image == k
                other[rows] = np.stack(image.sensor.project(drawn.truth_m[o.point[rows]], correction), axis=1)
            given, shown = shown, np.where(np.isfinite(other), other, 1e5)
        sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
        e[: self.n_image] = ((given - shown) / sigma).ravel()
        control = np.flatnonzero(self.problem.observed)
        away = block.points.known.ecef_m[control] - drawn.truth_m[control]
        axes = self.problem.axes(drawn.truth_m[control])
        enu = np.einsum("nij,nj->ni", axes, away) / block.points.known.sigma_enu_m[control]
        e[self.n_image : self.n_image + self.n_control] = enu.ravel()
        rows = block.points.where(Role.CHECK)
        if not len(rows):
            return e, np.zeros(0)
        away = block.withheld.open().ecef_m - drawn.truth_m[rows]
        return e, np.einsum("nij,nj->ni", self.problem.axes(drawn.truth_m[rows]), away).ravel()

    def noncentrality(self, block: Block, drawn: Drawn) -> float:
        """Return the root of the sum of squares that the mistake makes in residuals and differences at check points."""
        e, check = self.errors(block, drawn)
        k = self.check @ (self.effect @ e) - check
        s = self.check @ self.q @ self.check.T + np.diag(self.check_sigma**2)
        return float(np.sqrt(max(e @ self.r @ e, 0.0) + (k @ np.linalg.solve(s, k) if len(k) else 0.0)))

    def power(self, block: Block, drawn: Drawn, draws: int, rng: np.random.Generator) -> float:
        """Return the share of draws with a doubt.

        The random errors have the sigmas of the block without the mistake.
        """
        e, check = self.errors(block, drawn)
        alarms = self.doubts(e, check, self._true_sigmas(block, drawn), draws, rng)
        return float(np.mean(np.any(np.stack(list(alarms.values())), axis=0)))

    def _true_sigmas(self, block: Block, drawn: Drawn) -> Array:
        """Return the true sigma divided by the stated sigma of each row."""
        out, o, true = np.ones(len(self.r)), block.observations, drawn.block.observations
        pairs = ((true.sigma_line_px, o.sigma_line_px), (true.sigma_sample_px, o.sigma_sample_px))
        out[: self.n_image] = np.stack([t / s for t, s in pairs], axis=1).ravel()
        control = np.flatnonzero(self.problem.observed)
        known = (drawn.block.points.known.sigma_enu_m / block.points.known.sigma_enu_m)[control]
        out[self.n_image : self.n_image + self.n_control] = known.ravel()
        return out

    def doubts(
        self, delta: Array, check: Array, factor: Array, draws: int, rng: np.random.Generator
    ) -> dict[str, npt.NDArray[np.bool_]]:
        """Return whether each doubt arises in each draw."""
        e = delta[:, None] + factor[:, None] * rng.standard_normal((len(delta), draws))
        v, x = -self.r @ e, self.effect @ e
        f = round(float(np.trace(self.r)))
        chi2 = np.sum(v**2, axis=0)
        out = {"sigma0": chi2 > stats.chi2.isf(SHARE["sigma0"], f)}
        gross, worst = self._gross(v, chi2, f)
        out["gross"] = gross
        u = self.problem.n_image_unknowns
        free = 1.0 - np.diag(self.q)[:u]
        prior = v[self.n_image + self.n_control :][:u]  # the residual of a prior is the adjusted unknown
        size = np.where(free > 1e-6, 1.0, 0.0)[:, None] * prior**2 / np.maximum(free, 1e-6)[:, None]
        out["prior"] = size.max(axis=0) > stats.chi2.isf(_sidak(SHARE["prior"], u), 1)
        if len(self.check):
            away = (
                self.check @ x - check[:, None] - self.check_sigma[:, None] * rng.standard_normal((len(check), draws))
            )
            c = self.check @ self.q @ self.check.T + np.diag(self.check_sigma**2)
            sigma = np.sqrt(np.diag(c))
            ratio = np.abs(away) / sigma[:, None]
            out["far"] = ratio.max(axis=0) > np.sqrt(stats.chi2.isf(_sidak(SHARE["far"], len(c)), 1))
            null = np.linalg.cholesky(c) @ rng.standard_normal((len(c), 20_000)) / sigma[:, None]
            counts = np.bincount((np.abs(null) > 3.0).sum(axis=0), minlength=len(c) + 1)
            tail = np.cumsum(counts[::-1])[::-1] / 20_000
            out["beyond"] = tail[(ratio > 3.0).sum(axis=0)] <= SHARE["beyond"]
        out["sigmas"] = self._sigmas(v, np.where(gross, worst, -1))
        return out

    def _suspects(self) -> list[npt.NDArray[np.intp]]:
        rays = np.arange(self.n_image).reshape(-1, 2)
        control = self.n_image + np.arange(self.n_control).reshape(-1, 3)
        return [*rays, *(row[:2] for row in control), *(row[2:] for row in control)]

    def _gross(self, v: Array, chi2: Array, f: int) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.intp]]:
        """Return whether the most unlikely suspect exceeds both limits, and the number of this suspect."""
        t, d = [], []
        for rows in self._suspects():
            size, axes = np.linalg.eigh(self.r[np.ix_(rows, rows)])
            kept = size > 1e-6
            t.append(np.sum((axes[:, kept].T @ v[rows]) ** 2 / size[kept, None], axis=0))
            d.append(int(kept.sum()))
        of, squares = np.array(d), np.array(t)
        tested = (of > 0) & (of < f)
        squares, dimension = squares[tested], of[tested][:, None]
        rest = np.maximum(chi2 - squares, 1e-12 * chi2)
        p = stats.f.sf(squares / dimension / (rest / (f - dimension)), dimension, f - dimension)
        apart = len(np.unique(np.round(squares[:, 0], 6)))  # suspects with the same T cannot be distinguished
        above = (p <= _sidak(SHARE["gross"], apart)) & (stats.chi2.sf(squares, dimension) <= BAARDA)
        return above.any(axis=0), np.flatnonzero(tested)[np.argmin(np.where(above, p, 2.0), axis=0)]

    def _sigmas(self, v: Array, worst: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Return whether the sigmas of a group are doubted; the suspect of a gross error does not count."""
        n, m = self.n_image, self.n_control
        control = n + np.arange(m).reshape(-1, 3)
        groups = [np.arange(n), control[:, :2].ravel(), control[:, 2]]
        groups = [g for g in groups if len(g)]
        every = [*groups, np.arange(n + m, len(v))]
        s = np.array([[np.sum(self.r[np.ix_(a, b)] ** 2) for b in every] for a in every])
        r = np.array([np.trace(self.r[np.ix_(g, g)]) for g in groups])
        squares = np.array([np.sum(v[g] ** 2, axis=0) for g in groups])
        inverse = np.linalg.pinv(s[:-1, :-1])
        variance = inverse @ (squares - s[:-1, -1:])
        sd = np.sqrt(2.0 * np.maximum(np.diag(inverse), 1.0 / r))[:, None] / 2.0
        suspects, out = self._suspects(), np.zeros(v.shape[1], bool)
        cut = squares.copy()
        for k in np.flatnonzero(worst >= 0):
            rows = suspects[worst[k]]
            t = v[rows, k] @ np.linalg.pinv(self.r[np.ix_(rows, rows)], rcond=1e-6) @ v[rows, k]
            cut[[bool(np.isin(rows, g).all()) for g in groups], k] -= t
        for g in range(len(groups)):
            if sd[g, 0] >= 0.5:
                continue
            p = stats.chi2.sf(np.maximum(cut[g], 0.0) * r[g] / s[g, g], r[g] ** 2 / s[g, g])
            factor = np.sqrt(np.maximum(variance[g], 1e-12))
            out |= (
                (p <= _sidak(SHARE["sigmas"], len(groups))) & (factor * (1.0 - 2.0 * sd[g]) > 1.0) & (factor >= MATTERS)
            )
        return out


def _sidak(level: float, n: int) -> float:
    return float(-np.expm1(np.log1p(-level) / max(n, 1)))


def power_of(linear: LinearBlock, block: Block, drawn: Drawn, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the share of draws with each doubt, and with any doubt."""
    e, check = linear.errors(block, drawn)
    alarms = linear.doubts(e, check, np.ones(len(e)), draws, rng)
    shares = {name: float(a.mean()) for name, a in alarms.items()}
    return shares | {"any": float(np.any(np.stack(list(alarms.values())), axis=0).mean())}
