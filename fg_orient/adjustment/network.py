"""Small adjustments of any registered equations: variables, observations with a sigma, hard conditions.

A hard condition has sigma 0: its residual vanishes at the solution. The dense backend borders the normal equations with
correlates (Helmert; Ayhan 1996, eqs. 107-110):

    [N + d I  C^T] [x]   [-J^T r]
    [C        0  ] [k] = [-c    ]

``network_graph`` gives the same conditions to GTSAM. Both are driven by ``adjustment.loop``. What it judges is the
augmented Lagrangian ``r^T r/2 + k^T c + rho c^T c/2`` with the correlates of the step: the decrease that the linear
model predicts is ``|J x|^2/2 + d |x|^2 + rho |c|^2/2``, never negative, so that a step which only mends conditions is
taken although the sum of squares grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, NotFiniteError, check_blocks

Array = npt.NDArray[np.float64]

#: A hard condition whose row depends on the others to this part of its length says nothing new, or contradicts them.
DEPENDENT: Final = 1e-10


@dataclass(frozen=True)
class Variable:
    """Unknowns that belong together.

    Parameters
    ----------
    name : str
        For messages.
    start : (k,) array
    labels : tuple of str
        Of the elements.
    is_point : bool
        GTSAM holds it as a Point3.
    """

    name: str
    start: Array
    labels: tuple[str, ...]
    is_point: bool = False


@dataclass(frozen=True)
class Observation:
    """An equation between variables.

    Parameters
    ----------
    equation : Equation
    unknowns : tuple of int or array
        A variable by its number, or a constant, per argument of the equation.
    record, setup : arrays
        See ``factors._contract``.
    n_residuals : int
    label : str
        For messages.
    hard : bool
        The residual must vanish.
    """

    equation: Equation
    unknowns: tuple[int | Array, ...]
    record: Array
    setup: Array
    n_residuals: int
    label: str
    hard: bool = False


@dataclass(frozen=True)
class Rows:
    """Residuals and derivatives at a state: soft ones (n,), (n, u), hard ones (h,), (h, u)."""

    residual: Array
    design: Array
    condition: Array
    border: Array


@dataclass(frozen=True)
class Network:
    """Variables and what was observed of them.

    Parameters
    ----------
    variables : tuple of Variable
    observations : tuple of Observation
    """

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
        """Hard conditions."""
        return sum(o.n_residuals for o in self.observations if o.hard)

    @cached_property
    def n_soft(self) -> int:
        """Observations with a sigma."""
        return sum(o.n_residuals for o in self.observations if not o.hard)

    @property
    def redundancy(self) -> int:
        """Observations and conditions minus unknowns."""
        return self.n_soft + self.n_hard - self.n_unknowns

    @property
    def start(self) -> Array:
        """Start values (u,)."""
        return np.concatenate([v.start for v in self.variables])

    @property
    def labels(self) -> list[str]:
        """Names of all unknowns."""
        return [f"{v.name} {label}".strip() for v in self.variables for label in v.labels]

    def part(self, k: int) -> slice:
        """Where a variable stands in a state."""
        return slice(self.first[k], self.first[k + 1])

    def rows(self, state: Array, *, jacobian: bool = True) -> Rows:
        """Evaluate all observations; without ``jacobian`` the derivatives are (0, u).

        Raises
        ------
        NotFiniteError
            A residual or derivative is not finite; names the observation.
        """
        out: dict[bool, tuple[list[Array], list[Array]]] = {False: ([], []), True: ([], [])}
        for o in self.observations:
            value, design = self.evaluated(o, state, jacobian=jacobian)
            out[o.hard][0].append(value)
            out[o.hard][1].append(design)
        none, empty = np.zeros(0), np.zeros((0, self.n_unknowns))
        (r, j), (c, b) = out[False], out[True]
        return Rows(np.concatenate([none, *r]), np.vstack([empty, *j]), np.concatenate([none, *c]),
                    np.vstack([empty, *b]))  # fmt: skip

    def evaluated(self, o: Observation, state: Array, *, jacobian: bool) -> tuple[Array, Array]:
        """Residual (m,) and derivatives (m, u) of an observation."""
        x = [u if isinstance(u, np.ndarray) else state[self.part(u)] for u in o.unknowns]
        with np.errstate(all="ignore"):  # what overflows is not finite, which is refused by name
            blocks = o.equation.kernel(o.record, o.setup, *x, jacobian)
        sizes = tuple(len(v) for v in x) if jacobian else ()
        check_blocks(o.equation.name, o.label, blocks if jacobian else blocks[:1], sizes, o.n_residuals)
        out = np.zeros((o.n_residuals if jacobian else 0, self.n_unknowns))
        if jacobian:
            for u, block in zip(o.unknowns, blocks[1:], strict=True):
                if not isinstance(u, np.ndarray):
                    out[:, self.part(u)] += block
        return blocks[0], out


@dataclass(frozen=True)
class NetworkStep:
    """A step (u,) with its correlates (h,); see ``loop.Step``."""

    data: Array
    length: float
    predicted_error: float
    correlates: Array


#: Step (u,) of rows under a damping.
Solve = Callable[[float], Array]


class Merit:
    """What both backends judge steps by; see the module docstring."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self.correlates: Array = np.zeros(network.n_hard)
        self.rho: Array = np.zeros(network.n_hard)

    def __call__(self, rows: Rows) -> float:
        """The augmented Lagrangian with the correlates of the last step."""
        c = rows.condition
        return 0.5 * float(rows.residual @ rows.residual) + float(self.correlates @ c + 0.5 * (self.rho * c) @ c)

    def at(self, state: Array) -> float:
        """Its value at a trial state; inf outside the model."""
        try:
            return self(self.network.rows(state, jacobian=False))
        except NotFiniteError:
            return float("inf")

    def weigh(self, rows: Rows) -> None:
        """Weights of the conditions: the curvature of the squares along them."""
        squares = np.sum(rows.border**2, axis=1)
        self.rho = np.sum((rows.design @ rows.border.T) ** 2, axis=0) / np.where(squares > 0.0, squares, 1.0) ** 2


class NetworkSystem:
    """One linearisation; see ``loop.System``."""

    def __init__(self, merit: Merit, rows: Rows, solve: Solve) -> None:
        self._merit, self.rows, self._solve = merit, rows, solve

    @property
    def error(self) -> float:
        """See ``loop.System``; with the correlates of the last step."""
        return self._merit(self.rows)

    def solve(self, damping: float) -> NetworkStep:
        """Solve with ``damping`` times the identity added to the normal equations.

        Raises
        ------
        RuntimeError
            The equations are singular.
        """
        rows, x = self.rows, self._solve(damping)
        after = rows.residual + rows.design @ x
        if len(rows.condition):
            gradient = rows.design.T @ after + damping * x
            self._merit.correlates = np.asarray(np.linalg.lstsq(rows.border.T, -gradient, rcond=None)[0], np.float64)
        return NetworkStep(x, float(np.abs(x).max()), 0.5 * float(after @ after), self._merit.correlates)


class NetworkBackend:
    """A network driven by ``fg_orient.adjustment.loop``; the state is the vector (u,)."""

    def __init__(self, network: Network) -> None:
        self.network, self.merit = network, Merit(network)

    def error(self, state: Array) -> float:
        """See :class:`Merit`."""
        return self.merit.at(state)

    def retract(self, state: Array, step: NetworkStep) -> Array:
        """State after a step."""
        return np.asarray(state + step.data)


class DenseNetwork(NetworkBackend):
    """Normal equations bordered by the conditions, with correlates; see the module docstring."""

    name = "dense"

    def linearise(self, state: Array) -> NetworkSystem:
        """Linearise at a state."""
        rows = self.network.rows(state)
        self.merit.weigh(rows)
        return NetworkSystem(self.merit, rows, lambda damping: bordered_step(rows, damping))

    def cofactors(self, state: Array) -> list[Array]:
        """Cofactors (k, k) of each variable."""
        whole = bordered_inverse(self.network.rows(state))
        parts = [self.network.part(k) for k in range(len(self.network.variables))]
        return [whole[p, p] for p in parts]


def _bordered(rows: Rows, damping: float) -> tuple[Array, Array]:
    """Normal matrix bordered by the conditions, scaled to a unit diagonal, and the scale of all its columns."""
    u, h = rows.design.shape[1], len(rows.condition)
    normal = rows.design.T @ rows.design
    # figures that only hard conditions know have no diagonal: the length of their condition then, and not the damping,
    # whose root would make columns of 1e6 and more, in which the points are lost in rounding
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


def bordered_step(rows: Rows, damping: float) -> Array:
    """Step (u,) of the bordered normal equations.

    Raises
    ------
    RuntimeError
        They are singular.
    """
    matrix, scale = _bordered(rows, damping)
    right = -np.concatenate([rows.design.T @ rows.residual, rows.condition])
    try:
        x = np.linalg.solve(matrix, right * scale) * scale
    except np.linalg.LinAlgError as error:
        raise RuntimeError("singular normal equations") from error
    if not np.isfinite(x).all():
        raise RuntimeError("singular normal equations")
    return np.asarray(x[: rows.design.shape[1]])


def bordered_inverse(rows: Rows) -> Array:
    """Cofactors (u, u) of all unknowns: the upper left part of the inverse of the bordered matrix."""
    matrix, scale = _bordered(rows, 0.0)
    u = rows.design.shape[1]
    inverse = np.linalg.inv(matrix)[:u, :u] * np.outer(scale[:u], scale[:u])
    return np.asarray(0.5 * (inverse + inverse.T))


def dependent(network: Network, rows: Rows) -> str:
    """Label of the first hard observation whose rows depend on those before it; "" if none does."""
    labels = [o.label for o in network.observations if o.hard for _ in range(o.n_residuals)]
    length = np.linalg.norm(rows.border, axis=1)
    basis: Array = np.zeros((0, rows.border.shape[1]))
    for label, row, size in zip(labels, rows.border, length, strict=True):
        unit = row / size if size > 0.0 else row
        rest: Array = unit - basis.T @ (basis @ unit)
        rest = rest - basis.T @ (basis @ rest)  # twice is enough (Kahan)
        if np.linalg.norm(rest) <= DEPENDENT:
            return label
        basis = np.asarray(np.vstack([basis, rest / np.linalg.norm(rest)]), float)
    return ""
