"""Experiments on synthetic blocks, one run per seed, and the tables of Topan & Maktav (2010).

The points of the publications are unpublished. Therefore each seed defines its own synthetic block: points, roles,
metadata errors, and noise of image and ground (Terlemezoğlu 2019, sect. 4.2; Topan & Maktav 2010). :func:`compute`
returns tables 1 and 2 of Topan & Maktav (2010): RMSE by point set, stage and EOP set.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.system import Conditioning
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.names import COMPONENTS, EOP_SETS, CellKey
from fg_orient.model.parameters import N_EOP, eop_codes
from fg_orient.studies.claims import Study
from fg_orient.studies.switches import Switches, switches_of
from fg_orient.studies.two_stage import TwoStage

# Cells of one run. A cell has several values if several computations are possible and the source does
# not name one.
Cells = dict[CellKey, float | list[float]]
#: Function called after each run with runs done and number of runs.
Progress = Callable[[int, int], None]

#: Solver of "least squares" in both sources: an inverse is formed with pivoting, then multiplied with b.
LEAST_SQUARES = "pivot_inverse"
AXES = ("x", "y", "z")
#: The nine EOPs as named in the tables; ar, ap, ay are roll, pitch, yaw.
PUBLISHED_COMPONENTS = ("X", "Y", "Z", "VX", "VY", "VZ", "ar", "ap", "ay")


def twin(seed: int, point_set: str = "H-10", *, as_run: bool | Switches = False) -> TwoStage:
    """Return the procedure on a seed's synthetic block, which has radial velocity and attitude with switches."""
    return Study(seed, switches_of(as_run)).procedure(point_set=point_set)


def labels(eop_set: int) -> tuple[str, ...]:
    """Return the coefficients of an EOP set as named in the tables: X0, VY1, ar2 ..."""
    return tuple(f"{PUBLISHED_COMPONENTS[code // 3]}{code % 3}" for code in eop_codes(eop_set))


def rmse_cells(key: CellKey, gcp_rmse: Array, icp_rmse: Array) -> Cells:
    """Return the cells of RMSE per axis at control points and check points."""
    out: Cells = {}
    for role, values in (("gcp", gcp_rmse), ("icp", icp_rmse)):
        for axis, value in zip(AXES, values, strict=True):
            out[key._replace(point_role=role, quantity=f"rmse_{axis}")] = float(value)
    return out


def conditioning_cells(key: CellKey, matrix: Conditioning, **other: float) -> Cells:
    """Return the order, rank, determinant and three condition numbers of A^T A; ``other`` replaces some of them."""
    with np.errstate(under="ignore", over="ignore"):  # 0 or inf outside the range of a double
        det = matrix.det_sign * np.float64(10.0) ** matrix.log10_det
    values = {
        "matrix_order": matrix.order,
        "rank": matrix.rank,
        "det": det,
        "cond_norm": matrix.cond_norm,
        "cond_spectral": matrix.cond_spectral,
        "cond_hadamard": matrix.cond_hadamard,
    } | other
    return {key._replace(quantity=name): float(value) for name, value in values.items()}


def collect(
    one_run: Callable[[int], Cells], seeds: Sequence[int], progress: Progress | None = None
) -> dict[CellKey, Array]:
    """Run all seeds, and return values (n,) of every cell; nan if a solver broke down.

    Parameters
    ----------
    one_run : callable
        Function that returns the cells of a seed.
    seeds : sequence of int
    progress : callable, optional
    """
    values: dict[CellKey, list[float]] = {}
    for done, seed in enumerate(seeds, start=1):
        with one_blas_thread():  # many cells are rounding noise, which depends on the number of threads
            cells = one_run(seed)
        for key, value in cells.items():
            values.setdefault(key, []).extend(value if isinstance(value, list) else [value])
        if progress is not None:
            progress(done, len(seeds))
    return {key: np.array(of_cell) for key, of_cell in values.items()}


POINT_SETS = ("H-0", "H-20", "G-A", "G-B")
#: EOP sets of the paper; Terlemezoğlu 2019 added set 20.
PAPER_SETS = tuple(number for number in EOP_SETS if number <= 19)


def compute(
    tables: Collection[str],
    seeds: Sequence[int],
    *,
    as_run: bool | Switches = False,
    progress: Progress | None = None,
) -> dict[CellKey, Array]:
    """Return the cells of the tables "text", "1", "2"; see :func:`fg_orient.studies.tables_spot5.compute`."""

    def one_run(seed: int) -> Cells:
        out: Cells = {}
        for point_set in POINT_SETS:
            run = twin(seed, point_set, as_run=as_run)
            if "text" in tables:
                out |= _counts(run, point_set)
            if "1" in tables:
                out |= _table_1(run, point_set)
            if "2" in tables:
                out |= _table_2(run, point_set)
        return out

    return collect(one_run, seeds, progress)


def _counts(run: TwoStage, point_set: str) -> Cells:
    """Return the numbers of the text that follow from the synthetic block."""
    name = point_set.replace("-", "").lower()
    n_lines = run.block.images[0].sensor.n_lines
    counts = {
        f"{name}_n_gcp": len(run.control_ids),
        f"{name}_n_icp": len(run.check_ids),
        "n_points_total": len(run.control_ids) + len(run.check_ids),
        "hrg_n_lines": n_lines,
        "n_eop_types": len(COMPONENTS),
        "n_eop_unmodelled": n_lines * len(COMPONENTS),
        "n_gcp_needed_unmodelled_printed": -(-n_lines * len(COMPONENTS) // 2),
        "n_gcp_needed_unmodelled": -(-n_lines * len(COMPONENTS) // 2),
        "n_eop_coefficients": N_EOP,
        "n_gcp_needed_modelled": -(-N_EOP // 2),
        "eop_polynomial_degree": N_EOP // len(COMPONENTS) - 1,
    }
    return {CellKey("text", quantity=key): float(value) for key, value in counts.items()}


def _table_1(run: TwoStage, point_set: str) -> Cells:
    """Compute RMSE with look angles only: uncorrected (third component +1, as printed), step 1, fixed EOPs."""
    key = CellKey("1", method="look_angles_only", point_set=point_set)
    stages = {
        "uncorrected": run.uncorrected(look_sign=1.0),
        "pre-adjusted": run.look_only(),
        "bundle": run.bundle(None, 1, LEAST_SQUARES).accuracy,
    }
    out: Cells = {}
    for stage, errors in stages.items():
        out |= rmse_cells(key._replace(stage=stage), errors.gcp_rmse, errors.icp_rmse)
    return out


def _table_2(run: TwoStage, point_set: str) -> Cells:
    """Compute the bundle with each EOP set."""
    out: Cells = {}
    for number in PAPER_SETS:
        errors = run.bundle(number, 1, LEAST_SQUARES).accuracy
        key = CellKey("2", str(number), "bundle", method="gauss_helmert_bundle", point_set=point_set)
        out |= rmse_cells(key, errors.gcp_rmse, errors.icp_rmse)
    return out
