"""Tables 1 and 2 of Topan & Maktav (2010) on the twin: RMSE by point set, stage and EOP set."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from fg_orient.model.cells import CellKey
from fg_orient.model.names import COMPONENTS, EOP_SETS
from fg_orient.model.parameters import N_EOP
from fg_orient.studies.switches import Switches
from fg_orient.studies.tables_twin import LEAST_SQUARES, Cells, Progress, collect, rmse_cells, twin
from fg_orient.studies.two_stage import TwoStage

Array = npt.NDArray[np.float64]

POINT_SETS = ("H-0", "H-20", "G-A", "G-B")
#: Sets of the paper; set 20 was added by Terlemezoğlu 2019.
PAPER_SETS = tuple(number for number in EOP_SETS if number <= 19)


def compute(
    tables: Collection[str], seeds: Sequence[int], *, as_run: bool | Switches = False,
    progress: Progress | None = None,
) -> dict[CellKey, Array]:  # fmt: skip
    """Compute the cells of some tables.

    Parameters
    ----------
    tables : collection of str
        Of "text", "1", "2".
    seeds : sequence of int
        One twin each.
    as_run : bool or Switches
        As the authors' program works, on a twin with radial velocity and attitude.
    progress : callable, optional
        Called with runs done and runs in all.

    Returns
    -------
    dict
        Cell to values (n,), one per seed; nan where the procedure broke down.
    """

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
    """Numbers of the text that follow from the twin."""
    name = point_set.replace("-", "").lower()
    n_lines = run.block.images[0].sensor.n_lines
    counts = {
        f"{name}_n_gcp": len(run.control_ids), f"{name}_n_icp": len(run.check_ids),
        "n_points_total": len(run.control_ids) + len(run.check_ids),
        "hrg_n_lines": n_lines, "n_eop_types": len(COMPONENTS), "n_eop_unmodelled": n_lines * len(COMPONENTS),
        "n_gcp_needed_unmodelled_printed": -(-n_lines * len(COMPONENTS) // 2),
        "n_gcp_needed_unmodelled": -(-n_lines * len(COMPONENTS) // 2),
        "n_eop_coefficients": N_EOP, "n_gcp_needed_modelled": -(-N_EOP // 2),
        "eop_polynomial_degree": N_EOP // len(COMPONENTS) - 1,
    }  # fmt: skip
    return {CellKey("text", quantity=key): float(value) for key, value in counts.items()}


def _table_1(run: TwoStage, point_set: str) -> Cells:
    """Look angles alone: uncorrected (third look component +1, as printed), step 1, bundle with fixed EOPs."""
    key = CellKey("1", method="look_angles_only", point_set=point_set)
    stages = {"uncorrected": run.uncorrected(look_sign=1.0), "pre-adjusted": run.look_only(),
              "bundle": run.bundle(None, 1, LEAST_SQUARES).accuracy}  # fmt: skip
    out: Cells = {}
    for stage, errors in stages.items():
        out |= rmse_cells(key._replace(stage=stage), errors.gcp_rmse, errors.icp_rmse)
    return out


def _table_2(run: TwoStage, point_set: str) -> Cells:
    """The bundle with each EOP set."""
    out: Cells = {}
    for number in PAPER_SETS:
        errors = run.bundle(number, 1, LEAST_SQUARES).accuracy
        key = CellKey("2", str(number), "bundle", method="gauss_helmert_bundle", point_set=point_set)
        out |= rmse_cells(key, errors.gcp_rmse, errors.icp_rmse)
    return out
