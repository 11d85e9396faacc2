"""Tables 4.35-4.55 of Terlemezoğlu (2019), as run: sensor-independent RFM of the SPOT-6 scene, degrees 1-3.

The control points are public. Therefore numbers that are not rounding noise can agree in all digits. Rounding noise
changes by powers of ten with the order of the rows. All numbers are computed with the points in the order of their file
(run 0), and with seeded permutations of this order. The computation is always as run. Inverses are formed and
multiplied with b. Negative radicands have complex roots. |N^-1| is computed from the inverse as formed.
Eigenvalues are computed from the upper triangle of N, which MATLAB's eig reads. Table 4.45 uses
Cramer's inverse. x is the sample, y the line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import eigh

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import KappaChoice, clamped
from fg_orient.adjustment.linear.registry import attempt
from fg_orient.adjustment.linear.ridge import regularised_system
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem, diagnose
from fg_orient.model.names import CellKey
from fg_orient.rpc.estimate import linear_system
from fg_orient.rpc.fit import RfmFit
from fg_orient.rpc.form import DEGREES, RfmForm
from fg_orient.rpc.points import ControlPoints, Scaling
from fg_orient.studies.tables_twin import AXES, Cells, Progress, collect, conditioning_cells

#: Printed kappas for Table 4.45, by method and degree.
Kappas = Mapping[tuple[str, int], float]

#: Methods in the order of the tables.
METHODS: Final = (
    "cramer_inverse",
    "pivot_inverse",
    "cholesky_inverse",
    "gauss_inverse",
    "moore_penrose_inverse",
    "gauss_partial_pivot_elimination",
    "cholesky_elimination",
)
RAW: Final = {f"4.{35 + k}": method for k, method in enumerate(METHODS)}
NORMALISED: Final = {f"4.{46 + k}": method for k, method in enumerate(METHODS)}
CRAMER: Final = "cramer_inverse"
TIKHONOV: Final = {"tikhonov_hkb": "hkb", "tikhonov_lw": "lw", "tikhonov_od": "od"}
TABLES: Final = tuple(f"4.{k}" for k in range(35, 56))
#: Table name under which the published computation with printed kappas is reported, in addition to Table 4.45.
WITH_PRINTED_KAPPA: Final = "4.45 printed kappa"
#: Additional quantity, which the source does not give: m0 of the true image residuals.
TRUE_M0: Final = "m0_true"
#: Number of permutations, with seeds 1 to 50.
PERMUTATIONS: Final = 50
_AS_IT_IS: Final = Scaling(np.zeros(5), np.ones(5))


@dataclass(frozen=True)
class Run:
    """Solutions for one order of the points and one degree, normalised or not; each is computed once.

    Parameters
    ----------
    points : ControlPoints
        Points in the order of the run.
    degree : int
    normalised : bool
    """

    points: ControlPoints
    degree: int
    normalised: bool

    @cached_property
    def prepared(self) -> ControlPoints:
        """Points used in the equations: raw, or normalised by T(3.51) in the printed order of operations."""
        if not self.normalised:
            return self.points
        values = self.points.columns
        low, high = values.min(axis=0), values.max(axis=0)
        line, sample, *ground = ((2.0 * values - high - low) / (high - low)).T
        return ControlPoints(line, sample, np.column_stack(ground))

    @cached_property
    def pixels(self) -> Array:
        """Number of pixels per unit of line and of sample: (2,)."""
        return 0.5 * np.ptp(self.points.columns[:, :2], axis=0) if self.normalised else np.ones(2)

    @cached_property
    def form(self) -> RfmForm:
        """Separate denominators, with all coefficients."""
        return RfmForm(self.degree)

    @cached_property
    def system(self) -> LinearSystem:
        """Normal equations of the linear form."""
        return linear_system(self.prepared, self.form, _AS_IT_IS)

    @cached_property
    def _solutions(self) -> dict[tuple[str, bytes], LinearSolution]:
        return {}

    def solution(self, method: str, system: LinearSystem | None = None) -> LinearSolution:
        """Return the solution by a published method; nan if it breaks down."""
        used = system or self.system
        key = method, used.normal.tobytes()
        if key not in self._solutions:
            self._solutions[key] = attempt(method, used, as_run=True)
        return self._solutions[key]

    def residuals_px(self, x: Array) -> Array:
        """Return the residuals A x - l in pixels: (2, n), x (sample) and y (line)."""
        design, observed = self.system.require_design("residuals")
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray((design @ x - observed).reshape(2, -1) * self.pixels[::-1, None])

    def m0_px(self, x: Array) -> float:
        """Return m0 = sqrt(([vv]_x + [vv]_y)/(n - u)); nan if there is no solution."""
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.sqrt(np.sum(self.residuals_px(x) ** 2) / self.system.redundancy))

    def true_m0_px(self, x: Array) -> float:
        """Return m0 of x - f1/f2 and y - f3/f4; inf at a pole."""
        if not np.isfinite(x).all():
            return math.nan
        v = RfmFit(self.form, _AS_IT_IS, self.prepared, x, "as run").residuals_px() * self.pixels
        return float(np.sqrt(np.sum(v**2) / self.system.redundancy))


def compute(
    tables: Collection[str],
    points: ControlPoints,
    *,
    permutations: int = PERMUTATIONS,
    degrees: Sequence[int] = DEGREES,
    kappas: Kappas | None = None,
    progress: Progress | None = None,
) -> dict[CellKey, Array]:
    """Compute the cells of some tables.

    Parameters
    ----------
    tables : collection of str
        Some of "4.35" ... "4.55"; other tables are ignored.
    points : ControlPoints
        The 99 points of the scene.
    permutations : int
        Number of seeded orders of the points, in addition to the order of the file; seeds 1 to n.
    degrees : sequence of int
        Some of 1, 2, 3. Cramer's inverse makes degree 3 slow: it takes seconds per permutation.
    kappas : mapping, optional
        Printed kappas, with which Table 4.45 is also computed.
    progress : callable, optional
        Function called with runs done and number of runs.

    Returns
    -------
    dict
        Values (1 + permutations,) of each cell, the order of the file first; nan if a solver broke down.
    """
    chosen = [table for table in TABLES if table in tables]

    def one_run(seed: int) -> Cells:
        ordered = points if seed == 0 else points.take(np.random.default_rng(seed).permutation(len(points)))
        out: Cells = {}
        for degree in degrees:
            out |= _cells(chosen, ordered, degree, kappas or {})
        return out

    return collect(one_run, range(permutations + 1 if chosen else 0), progress)


def _cells(tables: Sequence[str], points: ControlPoints, degree: int, kappas: Kappas) -> Cells:
    """Return the cells of one degree and one order of the points."""
    runs = {normalised: Run(points, degree, normalised) for normalised in (False, True)}
    makers: dict[str, tuple[bool, Callable[[Run, str], Cells]]] = {
        "4.42": (False, _conditioning), "4.43": (False, _coefficients), "4.44": (False, _accuracy),
        "4.53": (True, _conditioning), "4.54": (True, _coefficients), "4.55": (True, _accuracy),
    }  # fmt: skip
    out: Cells = {}
    for table in tables:
        if table in RAW or table in NORMALISED:
            out |= _conditions(runs[table in NORMALISED], table)
        elif table == "4.45":
            out |= _tikhonov(runs[False], table, {})
            if kappas:
                out |= _tikhonov(runs[False], WITH_PRINTED_KAPPA, kappas)
        else:
            normalised, make = makers[table]
            out |= make(runs[normalised], table)
    return out


def stage(degree: int) -> str:
    """Return the name of a degree in a cell's address."""
    return f"rfm degree {degree}"


def _key(table: str, run: Run, **fields: str) -> CellKey:
    return CellKey(table, stage=stage(run.degree), **fields)


def _conditions(run: Run, table: str) -> Cells:
    """Return counts, [v] and [vv] per axis in pixels, and smallest and largest |N x - b| (T sect. 3.5)."""
    method = RAW.get(table) or NORMALISED[table]
    x = run.solution(method).x
    key = _key(table, run, method=method)
    out: Cells = {}
    with np.errstate(over="ignore", invalid="ignore"):
        misfit = np.abs(run.system.normal @ x - run.system.rhs)
        for axis, v in zip(AXES[:2], run.residuals_px(x), strict=True):
            values = {
                "n_observations": 2.0 * len(run.points),
                "n_unknowns": float(len(x)),
                "sum_residual": float(v.sum()),
                "sum_squared_residual": float(v @ v),
            }
            out |= {key._replace(quantity=name, parameter=axis): value for name, value in values.items()}
    out[key._replace(quantity="normal_residual_abs_min")] = float(misfit.min())
    out[key._replace(quantity="normal_residual_abs_max")] = float(misfit.max())
    return out


def _conditioning(run: Run, table: str) -> Cells:
    """Return the order, rank, determinant and three condition numbers of A^T A, as run."""
    normal = run.system.normal
    with np.errstate(all="ignore"):
        try:
            cond_norm = float(np.linalg.norm(normal, 2) * np.linalg.norm(np.linalg.inv(normal), 2))
        except np.linalg.LinAlgError:
            cond_norm = math.inf
        eigenvalues = eigh(normal, lower=False, eigvals_only=True)
        cond_spectral = float(eigenvalues[-1] / eigenvalues[0])
    return conditioning_cells(_key(table, run), diagnose(run.system), cond_norm=cond_norm, cond_spectral=cond_spectral)


def _coefficients(run: Run, table: str) -> Cells:
    """Return the coefficients of degree 1 by each method."""
    if run.degree != 1:
        return {}
    out: Cells = {}
    for method in METHODS:
        for name, value in zip(run.form.names, run.solution(method).x, strict=True):
            out[_key(table, run, quantity="rpc", method=method, parameter=name)] = float(value)
    return out


def _accuracy(run: Run, table: str) -> Cells:
    """Return m0 of the linear form by each method, and m0 of the true image residuals with the same coefficients."""
    out: Cells = {}
    for method in METHODS:
        x = run.solution(method).x
        out[_key(table, run, quantity="m0", method=method)] = run.m0_px(x)
        out[_key(table, run, quantity=TRUE_M0, method=method)] = run.true_m0_px(x)
    return out


def _tikhonov(run: Run, table: str, kappas: Kappas) -> Cells:
    """Return kappa and m0 of three rules with Cramer's inverse; given kappas replace the kappas of the rules."""
    out: Cells = {}
    for method, rule in TIKHONOV.items():
        kappa = kappas[method, run.degree] if kappas else _kappa(run, rule)
        x = np.full(len(run.system), math.nan)
        if math.isfinite(kappa):
            x = run.solution(CRAMER, regularised_system(run.system, kappa)).x
        out[_key(table, run, quantity="kappa", method=method)] = kappa
        out[_key(table, run, quantity="m0", method=method)] = run.m0_px(x)
    return out


def _kappa(run: Run, rule: str) -> float:
    """Return kappa by the rules as run, from the solution by Cramer's inverse, clamped to [0, 1] as published.

    The printed kappas of degree 1, 4.4e-5 and 1.0e-19, follow from the printed coefficients with two differences from
    the equations. s0 replaces its square in T(3.5) and T(3.6); and dP_i with descending eigenvalues replaces the
    canonical coefficients in T(3.6).
    """
    system, x = run.system, run.solution(CRAMER).x
    eigenvalues = eigh(system.normal, lower=False, eigvals_only=True)
    if rule == "od":
        inside = eigenvalues[(eigenvalues >= 0.0) & (eigenvalues <= 1.0)]
        return float(inside.max()) if len(inside) else 0.0
    if not np.isfinite(x).all():
        return math.nan
    with np.errstate(all="ignore"):
        size = np.sum((eigenvalues[::-1] if rule == "lw" else 1.0) * x**2)
        return clamped(KappaChoice(float(len(x) * run.m0_px(x) / size), rule)).kappa
