"""Predict the effort of an adjustment by each engine: operations, elements of the factor, fill, memory, time.

Operations belong to one iteration. A multiplication and an addition count as two
operations. For full matrices, these are the operations of normal equations or QR (Golub &
Van Loan 2013, tables 5.5 and 8.6). For sparse engines, they are the elimination of the
ground points and the Cholesky factor of the remaining matrix. If a variable of s unknowns
is linked with d other unknowns, its elimination needs ``s^3/3 + s^2 d + s d^2``
operations. Memory and time are used only to decide which adjustments are not tried. Their
constants were measured and rounded to the safe side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from fg_orient.adjustment.graph_structure import Structure, explicit_structure
from fg_orient.adjustment.memory import EXPLICIT, need_of
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.reduced_choice import (
    GTSAM,
    STEPS,
    Pattern,
    elimination_degrees,
    farthest,
    narrowest,
    pattern_of,
)
from fg_orient.model.errors import finding
from fg_orient.model.machine import allowed_bytes, in_gb

#: Up to this number of image points, the graph is eliminated symbolically. For larger blocks, formulas are used.
COUNTED: Final = 20_000
#: Up to this number of blocks, GTSAM eliminates the reduced matrix symbolically.
BLOCKS: Final = 100_000
#: Up to this number of images, an elimination by least degree is used.
SYMBOLIC: Final = 5000
#: Number of iterations that is assumed for the time of an adjustment.
ITERATIONS: Final = 6
#: Operations per second of one processor. It is the lowest rate of the solvers except the
#: exchange step (measured: 1 to 25e9).
RATE: Final = 2e9
#: Processor time of an image point in an iteration, s: with compiled kernels; with groups
#: of points as factors; with a factor for each image point.
KERNELS, GROUPS, FACTORS = 2e-6, 4e-6, 6e-5
#: Processor time of an iteration of GTSAM's optimisers for each pair of factors, s
#: (measured: 7e-8 at 5000 factors, 1e-7 at 10 000). If linearisation and elimination are
#: called separately, their time is proportional to the factors.
PAIRS: Final = 1e-7

Cost = Callable[[float, float], float]


def _of_normal(cost: Callable[[float], float]) -> Cost:
    """Return the operations of normal equations (n u^2) plus the operations of a method for u unknowns."""
    return lambda n, u: n * u**2 + cost(u)


def _svd(n: float, u: float) -> float:
    return 6.0 * n * u**2 + 20.0 * u**3


#: Operations of the registered solvers with n observations and u unknowns.
DENSE: Final[dict[str, Cost]] = {
    "cramer_inverse": _of_normal(lambda u: 2.0 / 3.0 * u**5),
    "pivot_inverse": _of_normal(lambda u: 2.0 * u**3),
    "gauss_inverse": _of_normal(lambda u: 10.0 / 3.0 * u**3),
    "moore_penrose_inverse": _of_normal(lambda u: 28.0 * u**3),
    "moore_penrose_scaled": _of_normal(lambda u: 28.0 * u**3),
    "cholesky_inverse": _of_normal(lambda u: 8.0 / 3.0 * u**3),
    "gauss_elimination": _of_normal(lambda u: 2.0 / 3.0 * u**3),
    "gauss_partial_pivot_elimination": _of_normal(lambda u: 2.0 / 3.0 * u**3),
    "cholesky_elimination": _of_normal(lambda u: u**3 / 3.0),
    "lapack_cholesky": _of_normal(lambda u: u**3 / 3.0),
    "lapack_cholesky_scaled": _of_normal(lambda u: u**3 / 3.0),
    "lapack_lu": _of_normal(lambda u: 2.0 / 3.0 * u**3),
    "qr": lambda n, u: 2.0 * n * u**2 - 2.0 / 3.0 * u**3,
    "qr_scaled": lambda n, u: 2.0 * n * u**2 - 2.0 / 3.0 * u**3,
} | dict.fromkeys(("svd", "svd_scaled", "truncated_svd", "truncated_svd_scaled"), _svd)  # fmt: skip


def dense_operations(solver: str, n: int, u: int) -> float:
    """Return the operations of a registered solver; nan if they are not known here."""
    cost = DENSE.get(solver, _svd if solver.startswith("tikhonov_") else None)
    return math.nan if cost is None else float(cost(float(n), float(u)))


@dataclass(frozen=True)
class Work:
    """Predicted effort of an adjustment.

    Parameters
    ----------
    operations : float
        Number of operations of one iteration.
    factor, fill : float
        Number of elements of the factor, and number of those that are zero in the normal matrix.
    memory : float
        Memory of the adjustment, bytes.
    seconds : float
        Processor seconds of the adjustment.
    """

    operations: float = math.nan
    factor: float = math.nan
    fill: float = math.nan
    memory: float = math.nan
    seconds: float = math.nan

    def columns(self) -> dict[str, float]:
        """Return the effort as columns of a row."""
        return {"operations": self.operations, "factor_elements": self.factor, "fill": self.fill}


@dataclass(frozen=True)
class Limits:
    """Limits of the predicted memory, bytes (None: unknown), and of the processor time of an adjustment, s."""

    memory: int | None
    seconds: float

    @classmethod
    def of(cls, memory_gb: float | None, seconds: float) -> Limits:
        """Return the limits of the options; if there is no limit, 80 % of the available memory."""
        return cls(allowed_bytes(memory_gb), seconds)

    def reason(self, engine: str, work: Work) -> str:
        """Return the reason why an engine is not tried; "" if it is tried."""
        if self.memory is not None and work.memory > self.memory:
            return str(finding("compare.memory", place=engine, needed=in_gb(work.memory), allowed=in_gb(self.memory)))
        if work.seconds > self.seconds:
            return str(finding("compare.time", place=engine, seconds=work.seconds, limit=self.seconds))
        return ""


class Sparsity:
    """Numbers of elements and operations of a problem; they do not depend on its values.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.n, self.u, self.images = len(problem.observations), problem.n_unknowns, problem.n_free_unknowns
        o, size = problem.observations, np.diff(problem.first)
        free = problem.active[o.point]
        wide = np.bincount(o.point[free], weights=size[o.image[free]], minlength=len(problem.active))[problem.active]
        #: Number of elements of the normal matrix and of the factor in the rows of the ground points.
        self.of_points = float(np.sum(6.0 + 3.0 * wide))
        #: Number of operations of the normal equations of all rows, and of the elimination of the points.
        self.eliminating = float(2.0 * np.sum((size[o.image] + 3.0) ** 2) + np.sum(9.0 + 9.0 * wide + 3.0 * wide**2))

    @cached_property
    def pattern(self) -> Pattern:
        """Return the pattern of images that share points."""
        return pattern_of(self.problem)

    @cached_property
    def band(self) -> int:
        """Return the number of elements below the diagonal in a column of the reduced matrix's band."""
        return narrowest(self.pattern, self.problem.first).band

    @cached_property
    def structure(self) -> Structure | None:
        """Return the graph with explicit points; None for a large block."""
        return explicit_structure(self.problem) if self.n <= COUNTED else None

    @cached_property
    def reduced(self) -> Structure:
        """Return the graph of the image vectors after the elimination of the points."""
        if self.structure is not None:
            return self.structure.without_points
        images = range(self.problem.n_images)
        names = tuple(f"image:{k}" for k in images)
        factors = tuple(zip(self.pattern.block_row.tolist(), self.pattern.block_column.tolist(), strict=True))
        pairs = tuple(pair for pair in factors if pair[0] != pair[1])
        return Structure(names, self.pattern.size, ("images",) * len(pairs), pairs, (0,) * len(pairs))

    @property
    def is_plain(self) -> bool:
        """Return whether the formulas are valid for a block that is not eliminated symbolically."""
        return self.structure is not None or (self.problem.ties is None and not self.problem.block.extra)

    @cached_property
    def normal(self) -> float:
        """Return the number of nonzero elements of the normal matrix's lower triangle; nan if unknown."""
        if self.structure is not None:
            sizes = self.structure.sizes
            own = float((sizes * (sizes + 1) // 2).sum())
            return own + float(sum(sizes[a] * sizes[b] for a, b in self.structure.pairs))
        size = self.pattern.size
        return self.of_points + float((size * (size + 1) // 2).sum()) if self.is_plain else math.nan

    def factor_of_images(self, ordering: str) -> tuple[float, float]:
        """Return operations and elements of the sparse factor of the images; for very many blocks, by least degree."""
        if len(self.pattern.block_row) <= BLOCKS:
            tree = self.reduced.eliminated(self.reduced.ordering(ordering))
            return tree.operations, float(tree.counts["nonzeros_factor"])
        if len(self.pattern.size) > SYMBOLIC:
            return math.inf, math.inf
        k = float(self.pattern.size.max(initial=1))
        degree = k * elimination_degrees(self.pattern).astype(float)
        return float(np.sum(k**3 / 3.0 + k**2 * degree + k * degree**2)), float(np.sum(k * (k + 1) / 2.0 + k * degree))

    @cached_property
    def colamd(self) -> tuple[float, float]:
        """Return operations and elements of the sparse factor of the images with the order of COLAMD."""
        return self.factor_of_images("COLAMD")

    # --- engines ----------------------------------------------------------------------------------

    def dense(self, solver: str) -> Work:
        """Predict the effort with full matrices."""
        operations = dense_operations(solver, self.problem.n_observations, self.u)
        known = operations if math.isfinite(operations) else _svd(self.problem.n_observations, self.u)
        return self._work(
            operations, self.u * (self.u + 1) / 2.0, self._memory("dense"), ITERATIONS * known / RATE
        )  # fmt: skip

    def schur(self, kind: str) -> Work:
        """Predict the effort with compiled elimination of the points and a method for the reduced system."""
        u, blocks = float(self.images), self.reduced_elements
        steps = STEPS * farthest(self.pattern) if kind in ("iterative", "implicit") else 0
        operations, factor = {
            "dense": lambda: (u**3 / 3.0, u * (u + 1.0) / 2.0),
            "banded": lambda: (u * float(self.band) ** 2, u * (self.band + 1.0)),
            "graph": lambda: self.colamd,
            "iterative": lambda: (4.0 * blocks * steps, blocks),
            "implicit": lambda: (8.0 * self.of_points * steps, 0.0),
        }[kind]()
        stored = 8.0 * 3.0 * (u**2 if kind == "dense" else factor)
        slow = GTSAM if kind == "graph" else 1.0
        seconds = ITERATIONS * (self.n * KERNELS + (self.eliminating + slow * operations) / RATE)
        return self._work(
            self.eliminating + operations, self.of_points + factor, self._memory("schur") + stored, seconds
        )  # fmt: skip

    def graph(self) -> Work:
        """Predict the effort with groups of points as factors and images in the order of COLAMD."""
        operations, factor = self.colamd
        seconds = ITERATIONS * (self.n * GROUPS + (self.eliminating + GTSAM * operations) / RATE)
        return self._work(self.eliminating + operations, self.of_points + factor, self._memory("graph"), seconds)

    def explicit(self, *, native: bool = False) -> Work:
        """Predict the effort with a factor for each image point, points first; ``native``: by GTSAM's optimisers."""
        operations, factor = self.factor_of_images("natural")
        each = self.n * FACTORS + (self.n**2 * PAIRS if native else 0.0)
        seconds = (ITERATIONS + 2.0) * (each + GTSAM * operations / RATE)
        memory = self.n * EXPLICIT + 8.0 * 2.0 * self.images**2
        return self._work(self.eliminating + operations, self.of_points + factor, memory, seconds)

    @cached_property
    def reduced_elements(self) -> float:
        """Return the number of nonzero elements of the reduced matrix's lower triangle."""
        if len(self.pattern.block_row) > BLOCKS:
            return float(self.pattern.size.max(initial=1)) ** 2 * len(self.pattern.block_row)
        sizes = self.reduced.sizes
        return float((sizes * (sizes + 1) // 2).sum() + sum(sizes[a] * sizes[b] for a, b in self.reduced.pairs))

    def _work(self, operations: float, factor: float, memory: float, seconds: float) -> Work:
        return Work(operations, factor, max(factor - self.normal, 0.0), memory, seconds)

    def _memory(self, backend: str) -> float:
        """Return the bytes of an adjustment without statistics."""
        block = self.problem.block
        options = replace(block.options, backend=backend, statistics="basic")  # type: ignore[arg-type]
        return float(need_of(replace(block, options=options)).needed)


def published_work(solver: str, block_points: int, unknowns: int) -> Work:
    """Predict the effort of the published bundle, which is one solution of full matrices."""
    n = 2 * block_points
    known = dense_operations(solver, n, unknowns)
    return Work(
        known, unknowns * (unknowns + 1) / 2.0, math.nan, 8.0 * (4.0 * n * unknowns + 4.0 * unknowns**2),
        (known if math.isfinite(known) else _svd(n, unknowns)) / RATE,
    )  # fmt: skip
