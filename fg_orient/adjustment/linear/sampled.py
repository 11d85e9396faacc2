"""Tikhonov solutions for all kappa of a large system, with sampled traces.

The system is too large for a singular value decomposition. Therefore the normal matrix N
is factored for each kappa. The trace of ``(N + kappa I)^-1`` is estimated by the mean of
``v^T (N + kappa I)^-1 v`` over probes v, which are vectors of independent signs
(Hutchinson 1990). The probes are the same for all kappa, so that the curves of a rule are
smooth. The scatter of the probes gives the standard error of the mean. Resampling of the
probes gives an interval of kappa (Efron 1979).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.ridge import RidgeCurves

#: Number of probes and their seed.
PROBES: Final = 32
SEED: Final = 0
#: Number of kappas at which a rule searches first.
GRID_POINTS: Final = 33
#: Range of these kappas relative to the largest eigenvalue. Smaller eigenvalues are lost in normal
#: equations.
LEAST, MOST = 1e-12, 1e3
#: Number of resamples of the probes, and probability of the interval.
RESAMPLES: Final = 400
LEVEL: Final = 0.95

#: Function of kappa that returns a function, which solves ``N + kappa I`` for columns (z, k).
Factor = Callable[[float], Callable[[Array], Array]]


class _At(NamedTuple):
    """Results for one kappa with M = N + kappa I: x = M^-1 b, y = M^-1 x, z = M^-1 y, traces of M^-1 by probe."""

    x: Array
    y: Array
    z: Array
    traces: Array


class SampledRidge(RidgeCurves):
    """See :class:`RidgeCurves`.

    Parameters
    ----------
    factor : callable
        See :data:`Factor`.
    rhs : (z,) array
        b = A^T l.
    squares : float
        |l|^2.
    rows : int
        Number of observations.
    largest : float
        Largest eigenvalue of N, or a bound.
    rule : str
    probes : (z, k) array, optional
        Signs; default: :data:`PROBES` random ones.
    """

    def __init__(
        self,
        factor: Factor,
        rhs: Array,
        squares: float,
        rows: int,
        largest: float,
        rule: str,
        probes: Array | None = None,
    ) -> None:
        self._factor, self._rhs, self._squares, self.rows, self.rule = factor, rhs, squares, rows, rule
        self._largest = largest
        self.probes = signs(len(rhs), PROBES, SEED) if probes is None else probes
        self._known: dict[float, _At] = {}

    def _at(self, kappa: float) -> _At:
        if kappa not in self._known:
            solve = self._factor(kappa)
            columns = solve(np.column_stack([self._rhs, self.probes]))
            x, traces = columns[:, 0], np.einsum("zk,zk->k", self.probes, columns[:, 1:])
            y = solve(x[:, None])
            self._known[kappa] = _At(x, y[:, 0], solve(y)[:, 0], traces)
        return self._known[kappa]

    @property
    def grid(self) -> Array:
        """See :class:`RidgeCurves`."""
        return np.geomspace(LEAST * self._largest, self._largest, GRID_POINTS)

    @property
    def wide(self) -> Array:
        """See :class:`RidgeCurves`."""
        return np.geomspace(LEAST * self._largest, MOST * self._largest, GRID_POINTS)

    def norm2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        x = self._at(kappa).x
        return float(x @ x)

    def norm2_slopes(self, kappa: float) -> tuple[float, float]:
        """See :class:`RidgeCurves`."""
        at = self._at(kappa)
        return -2.0 * float(at.x @ at.y), 6.0 * float(at.y @ at.y)

    def residual2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`: ``l^T l - b^T x - kappa x^T x``."""
        x = self._at(kappa).x
        return self._squares - float(self._rhs @ x) - kappa * float(x @ x)

    def traces(self, kappa: float) -> Array:
        """Return the trace of the hat matrix (k,) by each probe."""
        return len(self._rhs) - kappa * self._at(kappa).traces

    def trace(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        return float(np.mean(self.traces(kappa)))

    def trace_error(self, kappa: float) -> float:
        """Return the standard error of :meth:`trace`."""
        traces = self.traces(kappa)
        return float(np.std(traces, ddof=1) / np.sqrt(len(traces)))

    def change2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        y = self._at(kappa).y
        return kappa**2 * float(y @ y)

    def change2_slope(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        at = self._at(kappa)
        return kappa**2 * float(at.y @ at.y) - 2.0 * kappa**3 * float(at.y @ at.z)

    def gcv_interval(self, kappa: float) -> tuple[float, float]:
        """Return an interval for the kappa of GCV that shows the error of the traces.

        The probes are resampled.
        """
        grid, rng = self.grid, np.random.default_rng(SEED)
        residuals = np.log([self.residual2(k) for k in grid])
        traces = np.array([self.traces(k) for k in grid])

        def place(drawn: Array) -> float:
            return _least(np.log(grid), residuals - 2.0 * np.log(self.rows - drawn.mean(axis=1)))

        n = traces.shape[1]
        moved = [place(traces[:, rng.integers(0, n, n)]) for _ in range(RESAMPLES)]
        low, high = np.quantile(moved, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0]) - place(traces)
        return kappa * float(np.exp(low)), kappa * float(np.exp(high))


def signs(unknowns: int, probes: int, seed: int) -> Array:
    """Return random independent signs (unknowns, probes), that is, Rademacher variables."""
    return np.random.default_rng(seed).choice([-1.0, 1.0], (unknowns, probes))


def _least(x: Array, y: Array) -> float:
    """Locate the minimum of a sampled function, by a parabola through the least value and its neighbours."""
    k = int(np.argmin(y))
    if k in (0, len(y) - 1):
        return float(x[k])
    left, right = y[k - 1] - y[k], y[k + 1] - y[k]
    return float(x[k] + 0.5 * (x[1] - x[0]) * (left - right) / (left + right))
