"""Tables 4.1-4.34, equations 4.1-4.6 and numbers of the text of Terlemezoğlu (2019), from a synthetic block.

The point set is H-10. Two assumptions are not stated in the source: tables 4.3-4.16 belong to a bundle without EOP
pre-adjustment (type 1), and its matrices to whitened conditions. As run, the RMSE of type 1 in tables 4.25-4.34 belong
to the procedure without bundle (:meth:`fg_orient.studies.two_stage.TwoStage.step_two_only`), because its check points
diverge like the printed ones. As run, tables 4.3-4.23 follow a step 1 that ends at the level of rounding (D4 off): the
printed [Delta Delta] is 1e-33, which misclosures of 1e-10 cannot give.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import combinations

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear import system as linear
from fg_orient.adjustment.linear.l_curve import LCurve, l_curve_of
from fg_orient.adjustment.linear.registry import attempt
from fg_orient.adjustment.linear.system import LinearSystem, diagnose
from fg_orient.model.names import COMPONENTS, EOP_SETS, CellKey, Role
from fg_orient.model.parameters import N_EOP, eop_codes
from fg_orient.simulate.zonguldak import CHECK_COUNT
from fg_orient.studies import tables_twin
from fg_orient.studies.claims import ILL_CONDITIONED
from fg_orient.studies.switches import TEXT, Switches
from fg_orient.studies.tables_twin import LEAST_SQUARES, Cells, labels, twin
from fg_orient.studies.two_stage import Kind, TwoStage

#: Number of points of the SPOT-6 scene (T sect. 4.3.1).
SPOT6_POINTS = 99
#: EOP sets in the tables of Terlemezoğlu (2019).
PUBLISHED_SETS = tuple(number for number in EOP_SETS if number <= 20)
#: EOP set of each table in the series 4.3-4.9, 4.10-4.16 and 4.17-4.23.
_SETS = (1, *ILL_CONDITIONED)
SET_OF = {f"4.{first + k}": number for first in (3, 10, 17) for k, number in enumerate(_SETS)}
#: Tables that, as run, follow a step 1 that ends at the level of rounding (assumption; see the module docstring).
STEP_1_CLOSED = frozenset(SET_OF)


def counts(run: TwoStage) -> Cells:
    """Return all cells that contain counts, for a run with point set H-10."""
    return _equations(run) | _sets() | _text(run)


def rfm_unknowns(degree: int) -> int:
    """Return coefficients of a rational function model: two numerators, two denominators with constant 1 (T 2.53)."""
    return 4 * math.comb(degree + 3, 3) - 2


def _equations(run: TwoStage) -> Cells:
    """Return the counts of observations and unknowns, taken from the systems themselves."""
    block = run.block
    control = block.points.where(Role.CONTROL)
    left = int(np.sum((block.observations.image == 0) & np.isin(block.observations.point, control)))
    out = {
        CellKey("eq4.1", stage="pre-adjustment", quantity="n_observations"): 2 * left,
        CellKey("eq4.2", stage="bundle", quantity="n_observations"): 2 * len(block.observations),
        CellKey("eq4.5", stage="rfm", quantity="n_observations"): 2 * SPOT6_POINTS,
    }
    for number in _SETS:
        system = run.pre_adjust(0, number, LEAST_SQUARES).system
        out[CellKey("eq4.3", str(number), "pre-adjustment", quantity="n_unknowns")] = len(system)
        unknowns = len(block.images) * len(eop_codes(number)) + 3 * len(run.check_ids)
        out[CellKey("eq4.4", str(number), "bundle", quantity="n_unknowns")] = unknowns
    for degree in (1, 2, 3):
        out[CellKey("eq4.6", stage=f"rfm degree {degree}", quantity="n_unknowns")] = rfm_unknowns(degree)
    return {key: float(value) for key, value in out.items()}


def _sets() -> Cells:
    """Return the polynomial degree of each EOP, the size of each EOP set, and the position of each member."""
    degree, names = float(N_EOP // len(COMPONENTS) - 1), tables_twin.PUBLISHED_COMPONENTS
    out: Cells = {CellKey("4.1", quantity="degree", parameter=name): degree for name in names}
    for number in PUBLISHED_SETS:
        out[CellKey("4.2", str(number), quantity="n_unknowns")] = float(len(eop_codes(number)))
        for place, name in enumerate(labels(number), start=1):
            out[CellKey("4.2", str(number), quantity="order", parameter=name)] = float(place)
    return out


def _text(run: TwoStage) -> Cells:
    """Return the numbers of the text that are counts or constants of this package."""
    homogeneous = [name for name in CHECK_COUNT if name.startswith("H")]
    n_gcp, n_icp = len(run.control_ids), len(run.check_ids)
    values = {
        "n_points_total_spot5": n_gcp + n_icp,
        "h10_n_gcp": n_gcp,
        "h10_n_icp": n_icp,
        "n_point_distributions": len(CHECK_COUNT),
        "n_distributions_homogeneous": len(homogeneous),
        "n_distributions_grouped": len(CHECK_COUNT) - len(homogeneous),
        "n_eop_sets": len(PUBLISHED_SETS),
        "n_images_spot5": len(run.block.images),
        "rfm_coefficients_degree3": rfm_unknowns(3),
        "cond_norm_limit": linear.NORM_LIMIT,
        "cond_spectral_limit": linear.SPECTRAL_LIMIT,
        "cond_hadamard_limit": linear.HADAMARD_LIMIT,
    }
    return {CellKey("text", quantity=key): float(value) for key, value in values.items()}


#: Solvers of tables 4.17-4.23.
SOLVERS = (
    "cramer_inverse",
    "pivot_inverse",
    "gauss_inverse",
    "moore_penrose_inverse",
    "cholesky_inverse",
    "gauss_elimination",
    "gauss_partial_pivot_elimination",
    "cholesky_elimination",
)
#: Solvers for which the source has no bundle.
_NOT_FOR_BUNDLES = ("cramer_inverse",)
#: Solver of each bundle table.
SOLVER_OF = {
    "4.24": LEAST_SQUARES, "4.25": "tikhonov_hkb", "4.26": "tikhonov_lw", "4.27": "tikhonov_od",
    "4.28": "pivot_inverse", "4.29": "gauss_inverse", "4.30": "moore_penrose_inverse", "4.31": "cholesky_inverse",
    "4.32": "gauss_elimination", "4.33": "gauss_partial_pivot_elimination", "4.34": "cholesky_elimination",
}  # fmt: skip
#: Tables whose solvers choose a kappa.
TIKHONOV_TABLES = frozenset(table for table, name in SOLVER_OF.items() if name.startswith("tikhonov"))
#: Tables whose type 1, as run, has no bundle: inferred from the printed check points.
WITHOUT_BUNDLE = frozenset(SOLVER_OF) - {"4.24"}
#: Tables whose ``method`` is not their solver. Table 4.24 repeats the bundles of Topan 2009, which have no set 20.
_METHOD_OF = {"4.24": "least_squares_topan2009"}
PRE_STAGES = ("pre-left", "pre-right")
TYPES: tuple[Kind, ...] = (1, 2)


def compute(
    tables: Collection[str],
    seeds: Sequence[int],
    *,
    as_run: bool | Switches = False,
    progress: tables_twin.Progress | None = None,
) -> dict[CellKey, Array]:
    """Compute the cells of some tables.

    Parameters
    ----------
    tables : collection of str
        Some of "text", "eq4.1" ... "eq4.6", "4.1" ... "4.34", "s4.2.2".
    seeds : sequence of int
        Seeds; each defines one synthetic block.
    as_run : bool or Switches
        True or switches: use the procedure of the authors' program, on blocks with radial velocity and attitude.
    progress : callable, optional
        Function called with runs done and number of runs.

    Returns
    -------
    dict
        Values (n,) of each cell, one per seed; nan if a solver broke down.
    """

    def one_run(seed: int) -> Cells:
        run = closed = twin(seed, as_run=as_run)
        if run.switches.test_after and any(table in STEP_1_CLOSED for table in tables):
            closed = twin(seed, as_run=run.switches.without("test_after"))
        out = counts(run)
        for table in tables:
            make = _MAKERS.get(table)
            out |= make(closed if table in STEP_1_CLOSED else run, table) if make else {}
        return out

    return tables_twin.collect(one_run, seeds, progress)


def _conditions(run: TwoStage, table: str) -> Cells:
    """Return the usability conditions (T sect. 3.5): counts, [v], [vv], smallest and largest |N dP - b|.

    These numbers depend only on the solver, which the source does not name; so each has one value per solver.
    """
    number = SET_OF[table]
    out: dict[CellKey, list[float]] = {}
    for method in SOLVERS:
        stages = PRE_STAGES if method in _NOT_FOR_BUNDLES else (*PRE_STAGES, "bundle")
        for stage, system, x, residual in _solved(run, number, method, stages):
            key = CellKey(table, str(number), stage, method="least_squares")
            for name, value in _condition_values(system, x, residual).items():
                out.setdefault(key._replace(quantity=name), []).append(value)
    return dict(out)


def _solved(
    run: TwoStage, number: int, method: str, stages: Sequence[str]
) -> Iterator[tuple[str, LinearSystem, Array, Array]]:
    """Yield stage, system, dP and residuals of the pre-adjustments and of the bundle."""
    for stage in stages:
        if stage == "bundle":
            bundle = run.bundle(number, 1, method)
            if bundle.system is not None:
                yield stage, bundle.system, bundle.solution.x, bundle.v
        else:
            step = run.pre_adjust(PRE_STAGES.index(stage), number, method)
            yield stage, step.system, step.solution.x, step.delta


def _condition_values(system: LinearSystem, x: Array, residual: Array) -> dict[str, float]:
    """Return the counts, and the numbers for conditions 1-3; nan if the solver broke down."""
    design, _ = system.require_design("conditions")
    counted = {"n_observations": float(len(design)), "n_unknowns": float(len(system))}
    names = ("sum_residual", "sum_squared_residual", "normal_residual_abs_min", "normal_residual_abs_max")
    if not (np.isfinite(x).all() and np.isfinite(residual).all()):
        return counted | dict.fromkeys(names, math.nan)
    misfit = np.abs(system.normal @ x - system.rhs)
    values = map(float, (residual.sum(), residual @ residual, misfit.min(), misfit.max()))
    return counted | dict(zip(names, values, strict=True))


def _conditioning(run: TwoStage, table: str) -> Cells:
    """Return the order, rank, determinant and three condition numbers of A^T A."""
    number = SET_OF[table]
    out: Cells = {}
    for stage, system, _, _ in _solved(run, number, LEAST_SQUARES, (*PRE_STAGES, "bundle")):
        formed = math.nan if run.switches == TEXT else norm_condition(system, LEAST_SQUARES)
        other = {} if math.isnan(formed) else {"cond_norm": formed}
        out |= tables_twin.conditioning_cells(CellKey(table, str(number), stage), diagnose(system), **other)
    return out


def norm_condition(system: LinearSystem, solver: str) -> float:
    """Return |N| |N^-1|, T(3.11), Frobenius norm, from the inverse formed by the solver; nan if it forms none.

    The smallest singular value of such a matrix is a rounding error of the largest one; its explicit inverse is not.
    T(3.11) names no norm. The program's numbers for sets 1, 15 and 19 result from the Frobenius norm.
    """
    inverse = attempt(solver, system).inverse
    if inverse is None:
        return math.nan
    return float(np.linalg.norm(system.normal) * np.linalg.norm(inverse))


def _corrections(run: TwoStage, table: str) -> Cells:
    """Return EOP corrections dP of the left image's pre-adjustment, by solver; per line and line squared."""
    number = SET_OF[table]
    out: Cells = {}
    for method in SOLVERS:
        dp = run.pre_adjust(0, number, method).dP
        for name, value in zip(labels(number), dp, strict=True):
            out[CellKey(table, str(number), "pre-left", quantity="dP", method=method, parameter=name)] = float(value)
    return out


def _bundles(run: TwoStage, table: str) -> Cells:
    """Return RMSE and kappa of one-iteration bundles of the ill-conditioned sets, for both types of pre-adjustment."""
    out: Cells = {}
    method = _METHOD_OF.get(table, SOLVER_OF[table])
    for number in ILL_CONDITIONED:
        for kind in TYPES:
            bundle = run.bundle(number, kind, SOLVER_OF[table])
            key = CellKey(table, str(number), "bundle", str(kind), method=method)
            errors = bundle.accuracy
            if kind == 1 and table in WITHOUT_BUNDLE and run.switches != TEXT:
                errors = run.step_two_only(number, SOLVER_OF[table])
            out |= tables_twin.rmse_cells(key, errors.gcp_rmse, errors.icp_rmse)
            if bundle.solution.kappa is not None:
                out[key._replace(quantity="kappa")] = float(bundle.solution.kappa)
    return out


def tikhonov_curves(tables: Collection[str], seed: int, *, as_run: bool | Switches = False) -> dict[int, LCurve]:
    """Return the L-curve of the bundle of tables 4.25-4.27 for each ill-conditioned set; empty without these tables.

    The bundle has no EOP pre-adjustment (type 1).
    """
    if not set(tables) & TIKHONOV_TABLES:
        return {}
    run = twin(seed, as_run=as_run)
    systems = {number: run.bundle(number, 1, SOLVER_OF["4.25"]).system for number in ILL_CONDITIONED}
    return {number: l_curve_of(system) for number, system in systems.items() if system is not None}


def _correlations(run: TwoStage, table: str) -> Cells:
    """Return the correlations between equal position coefficients of EOP set 1, left image (T sect. 4.2.2).

    The columns are scaled to unit length: the correlations are unchanged, and N can be inverted.
    """
    design, _ = run.pre_adjust(0, 1, LEAST_SQUARES).system.require_design("correlations")
    r = np.linalg.qr(design / np.linalg.norm(design, axis=0), mode="r")
    root = np.linalg.inv(r)
    cofactors = root @ root.T
    sigma = np.sqrt(np.diag(cofactors))
    names = labels(1)
    key = CellKey(table, "1", "pre-left", quantity="correlation")
    return {
        key._replace(parameter=f"{names[i]} {names[j]}"): float(abs(cofactors[i, j]) / (sigma[i] * sigma[j]))
        for i, j in combinations(range(len(names)), 2)
    }


#: Functions that compute the cells of each table of adjustments.
_MAKERS: dict[str, Callable[[TwoStage, str], Cells]] = {
    **{f"4.{k}": _conditions for k in range(3, 10)}, **{f"4.{k}": _conditioning for k in range(10, 17)},
    **{f"4.{k}": _corrections for k in range(17, 24)}, **dict.fromkeys(SOLVER_OF, _bundles), "s4.2.2": _correlations,
}  # fmt: skip
