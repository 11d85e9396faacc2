"""Small adjustments of any registered equations: variables, observations with a sigma, hard conditions.

A hard condition has sigma 0: its residual vanishes at the solution. The dense backend extends the normal equations by
correlates (Helmert; Ayhan 1996, eqs. 107-110):

    [N + d I  C^T] [x]   [-J^T r]
    [C        0  ] [k] = [-c    ]

The graph backend adds the same conditions to GTSAM as factors of sigma 0. GTSAM's constrained optimisers do not accept
Python factors: here GTSAM eliminates by QR, conditions first.

``adjustment.loop`` drives both backends. It compares values of the augmented Lagrangian
``r^T r/2 + k^T c + rho c^T c/2`` with the correlates of the step. The decrease that the linear model predicts is
``|J x|^2/2 + d |x|^2 + rho |c|^2/2``. It is never negative: a step that only corrects conditions is accepted although
the sum of squares increases.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, NotFiniteError, check_blocks
from fg_orient.adjustment.loop import Step

if TYPE_CHECKING:
    import gtsam

Array = npt.NDArray[np.float64]

#: Limit for the part of a condition's row that is orthogonal to the rows before; below it the row is dependent.
DEPENDENT: Final = 1e-10


@dataclass(frozen=True)
class Variable:
    """Unknowns that belong together: name for messages, approximate values (k,), names of the elements.

    ``is_point``: GTSAM uses a Point3.
    """

    name: str
    start: Array
    labels: tuple[str, ...]
    is_point: bool = False


@dataclass(frozen=True)
class Observation:
    """An equation between variables.

    ``unknowns`` contains the number of a variable, or a constant, for each argument of the equation. ``record`` and
    ``setup``: see ``factors._contract``. ``label`` is for messages. ``hard``: the residual must vanish.
    """

    equation: Equation
    unknowns: tuple[int | Array, ...]
    record: Array
    setup: Array
    n_residuals: int
    label: str
    hard: bool = False


class NetworkRows(NamedTuple):
    """Residuals and derivatives at a state: of observations (n,), (n, u), of hard conditions (h,), (h, u)."""

    residual: Array
    design: Array
    condition: Array
    border: Array


@dataclass(frozen=True)
class Network:
    """Variables and their observations."""

    variables: tuple[Variable, ...]
    observations: tuple[Observation, ...]
    first: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "first", tuple(accumulate((len(v.start) for v in self.variables), initial=0)))

    @property
    def n_unknowns(self) -> int:
        """Length of a state."""
        return self.first[-1]

    @cached_property
    def n_hard(self) -> int:
        """Number of hard conditions."""
        return sum(o.n_residuals for o in self.observations if o.hard)

    @property
    def redundancy(self) -> int:
        """Observations and conditions minus unknowns."""
        return sum(o.n_residuals for o in self.observations) - self.n_unknowns

    @property
    def start(self) -> Array:
        """Start values (u,)."""
        return np.concatenate([v.start for v in self.variables])

    @property
    def labels(self) -> list[str]:
        """Names of all unknowns."""
        return [f"{v.name} {label}".strip() for v in self.variables for label in v.labels]

    def part(self, k: int) -> slice:
        """Elements of a variable in a state."""
        return slice(self.first[k], self.first[k + 1])

    def rows(self, state: Array, *, jacobian: bool = True) -> NetworkRows:
        """Evaluate all observations; without ``jacobian`` the derivatives are (0, u).

        NotFiniteError: a residual or derivative is not finite; names the observation.
        """
        out: dict[bool, tuple[list[Array], list[Array]]] = {False: ([], []), True: ([], [])}
        for o in self.observations:
            value, design = self.evaluated(o, state, jacobian=jacobian)
            out[o.hard][0].append(value)
            out[o.hard][1].append(design)
        none, empty = np.zeros(0), np.zeros((0, self.n_unknowns))
        (r, j), (c, b) = out[False], out[True]
        return NetworkRows(np.concatenate([none, *r]), np.vstack([empty, *j]), np.concatenate([none, *c]),
                    np.vstack([empty, *b]))  # fmt: skip

    def evaluated(self, o: Observation, state: Array, *, jacobian: bool) -> tuple[Array, Array]:
        """Residual (m,) and derivatives (m, u) of an observation."""
        x = [u if isinstance(u, np.ndarray) else state[self.part(u)] for u in o.unknowns]
        with np.errstate(all="ignore"):  # values that are not finite are refused with their label
            blocks = o.equation.kernel(o.record, o.setup, *x, jacobian)
        sizes = tuple(len(v) for v in x) if jacobian else ()
        check_blocks(o.equation.name, o.label, blocks if jacobian else blocks[:1], sizes, o.n_residuals)
        out = np.zeros((o.n_residuals if jacobian else 0, self.n_unknowns))
        if jacobian:
            for u, block in zip(o.unknowns, blocks[1:], strict=True):
                if not isinstance(u, np.ndarray):
                    out[:, self.part(u)] += block
        return blocks[0], out


#: Step (u,) of rows under a damping.
Solve = Callable[[float], Array]


class Merit:
    """Augmented Lagrangian by which both backends compare steps; see the module docstring."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self.correlates: Array = np.zeros(network.n_hard)
        self.rho: Array = np.zeros(network.n_hard)

    def __call__(self, rows: NetworkRows) -> float:
        """Value for the correlates of the last step."""
        c = rows.condition
        return 0.5 * float(rows.residual @ rows.residual) + float(self.correlates @ c + 0.5 * (self.rho * c) @ c)

    def weigh(self, rows: NetworkRows) -> None:
        """Set the weights of the conditions to the curvature of the sum of squares along them."""
        squares = np.sum(rows.border**2, axis=1)
        self.rho = np.sum((rows.design @ rows.border.T) ** 2, axis=0) / np.where(squares > 0.0, squares, 1.0) ** 2


class NetworkSystem:
    """One linearisation; see ``loop.System``."""

    def __init__(self, merit: Merit, rows: NetworkRows, solve: Solve) -> None:
        self._merit, self.rows, self._solve = merit, rows, solve

    @property
    def error(self) -> float:
        """See ``loop.System``; for the correlates of the last step."""
        return self._merit(self.rows)

    def solve(self, damping: float) -> Step:
        """Solve with ``damping`` times the identity added to the normal equations.

        RuntimeError: the equations are singular.
        """
        rows, x = self.rows, self._solve(damping)
        if not np.isfinite(x).all():
            raise RuntimeError("singular normal equations")
        after = rows.residual + rows.design @ x
        if len(rows.condition):
            gradient = rows.design.T @ after + damping * x
            self._merit.correlates = np.asarray(np.linalg.lstsq(rows.border.T, -gradient, rcond=None)[0], np.float64)
        return Step(x, float(np.abs(x).max()), 0.5 * float(after @ after))


class NetworkBackend(ABC):
    """A network driven by ``fg_orient.adjustment.loop``; the state is the vector (u,)."""

    def __init__(self, network: Network) -> None:
        self.network, self.merit = network, Merit(network)

    def linearise(self, state: Array) -> NetworkSystem:
        """Linearise at a state."""
        rows = self.network.rows(state)
        self.merit.weigh(rows)
        return NetworkSystem(self.merit, rows, self.solver(state, rows))

    def error(self, state: Array) -> float:
        """Value of :class:`Merit` at a trial state; inf outside the model."""
        try:
            return self.merit(self.network.rows(state, jacobian=False))
        except NotFiniteError:
            return float("inf")

    def retract(self, state: Array, step: Step) -> Array:
        """State after a step."""
        return np.asarray(state + step.data)

    @abstractmethod
    def solver(self, state: Array, rows: NetworkRows) -> Solve:
        """Solver of the equations that are linearised at a state."""

    @abstractmethod
    def cofactors(self, state: Array) -> list[Array]:
        """Cofactors (k, k) of each variable."""


class DenseNetwork(NetworkBackend):
    """Normal equations bordered by the conditions, with correlates; see the module docstring."""

    name = "dense"

    def solver(self, state: Array, rows: NetworkRows) -> Solve:
        """See :class:`NetworkBackend`."""
        return lambda damping: bordered_step(rows, damping)

    def cofactors(self, state: Array) -> list[Array]:
        """See :class:`NetworkBackend`."""
        whole = bordered_inverse(self.network.rows(state))
        parts = [self.network.part(k) for k in range(len(self.network.variables))]
        return [whole[p, p] for p in parts]


class GraphNetwork(NetworkBackend):
    """A network as a GTSAM graph; hard conditions are factors of sigma 0.

    Cofactors are marginals of single variables only: a joint marginal of variables that one hard condition links
    counts this condition as an observation of sigma 1 (GTSAM 4.3; tests/79_closebundle).
    """

    name = "graph"

    def __init__(self, network: Network) -> None:
        import gtsam

        from factors.graph import factor

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
        import gtsam

        values = gtsam.Values()
        for k, variable in enumerate(self.network.variables):
            insert = values.insertPoint3 if variable.is_point else values.insert
            insert(k, state[self.network.part(k)])
        return values

    def solver(self, state: Array, rows: NetworkRows) -> Solve:
        """See :class:`NetworkBackend`."""
        linear = self.graph.linearize(self.values(state))
        return lambda damping: self._step(linear, damping)

    def _step(self, undamped: gtsam.GaussianFactorGraph, damping: float) -> Array:
        import gtsam

        linear = gtsam.GaussianFactorGraph()
        linear.push_back(undamped)
        if damping > 0.0:
            for k, variable in enumerate(self.network.variables):
                n = len(variable.start)
                unit = gtsam.noiseModel.Unit.Create(n)
                linear.add(gtsam.JacobianFactor(k, np.sqrt(damping) * np.eye(n), np.zeros(n), unit))
        try:
            delta = linear.optimize(self.ordering, gtsam.EliminateQR)
        except RuntimeError as error:  # GTSAM's message is long and names its keys
            raise RuntimeError("singular normal equations") from error
        return np.concatenate([delta.at(k) for k in range(len(self.network.variables))])

    def cofactors(self, state: Array) -> list[Array]:
        """See :class:`NetworkBackend`."""
        import gtsam

        marginals = gtsam.Marginals(self.graph, self.values(state))
        return [np.asarray(marginals.marginalCovariance(k)) for k in range(len(self.network.variables))]


def _bordered(rows: NetworkRows, damping: float) -> tuple[Array, Array]:
    """Normal matrix bordered by the conditions, scaled to a unit diagonal, and the scale of all its columns."""
    u, h = rows.design.shape[1], len(rows.condition)
    normal = rows.design.T @ rows.design
    # unknowns that occur only in hard conditions have no diagonal: their scale is the length of the conditions. The
    # root of the damping would give columns of 1e6 and more, and rounding would exceed the points.
    known = np.where(normal.diagonal() > 0.0, normal.diagonal(), np.sum(rows.border**2, axis=0))
    normal += damping * np.eye(u)
    across = 1.0 / np.sqrt(np.where(known > 0.0, known, 1.0))
    border = rows.border * across
    length = np.linalg.norm(border, axis=1)
    scale = np.concatenate([across, 1.0 / np.where(length > 0.0, length, 1.0)])
    out = np.zeros((u + h, u + h))
    out[:u, :u] = normal * np.outer(across, across)
    out[u:, :u] = border * scale[u:, None]
    out[:u, u:] = out[u:, :u].T
    return out, scale


def bordered_step(rows: NetworkRows, damping: float) -> Array:
    """Step (u,) of the bordered normal equations; RuntimeError if they are singular."""
    matrix, scale = _bordered(rows, damping)
    right = -np.concatenate([rows.design.T @ rows.residual, rows.condition])
    try:
        x = np.linalg.solve(matrix, right * scale) * scale
    except np.linalg.LinAlgError as error:
        raise RuntimeError("singular normal equations") from error
    return np.asarray(x[: rows.design.shape[1]])


def bordered_inverse(rows: NetworkRows) -> Array:
    """Cofactors (u, u) of all unknowns: the upper left part of the inverse of the bordered matrix."""
    matrix, scale = _bordered(rows, 0.0)
    u = rows.design.shape[1]
    inverse = np.linalg.inv(matrix)[:u, :u] * np.outer(scale[:u], scale[:u])
    return np.asarray(0.5 * (inverse + inverse.T))


def dependent(network: Network, rows: NetworkRows) -> str:
    """Label of the first hard observation whose rows depend on earlier rows; "" without such an observation."""
    labels = [o.label for o in network.observations if o.hard for _ in range(o.n_residuals)]
    length = np.linalg.norm(rows.border, axis=1)
    triangle = np.asarray(np.linalg.qr((rows.border / np.where(length > 0.0, length, 1.0)[:, None]).T, mode="r"))
    independent = np.zeros(len(labels))  # with more rows than unknowns the last rows are dependent
    independent[: len(triangle)] = np.abs(triangle.diagonal())
    return next((labels[k] for k in np.flatnonzero(independent <= DEPENDENT)), "")
