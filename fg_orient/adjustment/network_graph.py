"""The graph backend of :mod:`fg_orient.adjustment.network`: hard conditions are GTSAM factors of sigma 0.

GTSAM's constrained optimisers cannot be fed with Python factors; here our loop linearises and GTSAM eliminates by QR,
conditions first. Only marginals of single variables are asked for: a joint marginal of variables that one hard
condition ties counts that condition as an observation of sigma 1 (GTSAM 4.3; tests/79_closebundle).
"""

from __future__ import annotations

import gtsam
import numpy as np
import numpy.typing as npt

from factors.graph import factor
from fg_orient.adjustment.network import Network, NetworkBackend, NetworkSystem

Array = npt.NDArray[np.float64]


class GraphNetwork(NetworkBackend):
    """A network as a GTSAM graph."""

    name = "graph"

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self.graph = gtsam.NonlinearFactorGraph()
        for o in network.observations:
            sizes = [len(u) if isinstance(u, np.ndarray) else len(network.variables[u].start) for u in o.unknowns]
            self.graph.add(factor(o.equation, list(o.unknowns), sizes, o.record, o.setup, label=o.label,
                                  n_residuals=o.n_residuals, hard=o.hard))  # fmt: skip
        self.ordering = gtsam.Ordering()
        every = range(len(network.variables))
        for k in sorted(every, key=lambda k: not network.variables[k].is_point):
            self.ordering.push_back(k)

    def values(self, state: Array) -> gtsam.Values:
        """GTSAM values of a state."""
        values = gtsam.Values()
        for k, variable in enumerate(self.network.variables):
            part = state[self.network.part(k)]
            if variable.is_point:
                values.insertPoint3(k, part)
            else:
                values.insert(k, part)
        return values

    def linearise(self, state: Array) -> NetworkSystem:
        """Linearise at a state."""
        rows = self.network.rows(state)
        self.merit.weigh(rows)
        linear = self.graph.linearize(self.values(state))
        return NetworkSystem(self.merit, rows, lambda damping: self._step(linear, damping))

    def _step(self, linear: gtsam.GaussianFactorGraph, damping: float) -> Array:
        if damping > 0.0:
            undamped, linear = linear, gtsam.GaussianFactorGraph()
            linear.push_back(undamped)
            for k, variable in enumerate(self.network.variables):
                n = len(variable.start)
                unit = gtsam.noiseModel.Unit.Create(n)
                linear.add(gtsam.JacobianFactor(k, np.sqrt(damping) * np.eye(n), np.zeros(n), unit))
        try:
            delta = linear.optimize(self.ordering, gtsam.EliminateQR)
        except RuntimeError as error:  # GTSAM's words: a page on its own numbers of variables
            raise RuntimeError("singular normal equations") from error
        step = np.concatenate([delta.at(k) for k in range(len(self.network.variables))])
        if not np.isfinite(step).all():
            raise RuntimeError("singular normal equations")
        return step

    def cofactors(self, state: Array) -> list[Array]:
        """Cofactors (k, k) of each variable."""
        marginals = gtsam.Marginals(self.graph, self.values(state))
        return [np.asarray(marginals.marginalCovariance(k)) for k in range(len(self.network.variables))]
