"""What the experiments on the twin share: the run of one seed, words of the tables, collecting over seeds.

The points of the publications are unpublished, so each seed draws a twin of its own: points, roles, errors
of the metadata, noise of image and ground (Terlemezoğlu 2019, sect. 4.2; Topan & Maktav 2010).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.model.cells import CellKey
from fg_orient.model.parameters import eop_codes
from fg_orient.studies.study import Study
from fg_orient.studies.switches import Switches, switches_of
from fg_orient.studies.two_stage import TwoStage

Array = npt.NDArray[np.float64]
# Cells of one run; several values where the source leaves open which of several computations it shows.
# (No '#:': autodoc cannot format this alias.)
Cells = dict[CellKey, float | list[float]]
#: Told after each run: runs done, runs in all.
Progress = Callable[[int, int], None]

#: Plain least squares of both sources: an inverse is formed with pivoting, then multiplied with b.
LEAST_SQUARES = "pivot_inverse"
AXES = ("x", "y", "z")
_PUBLISHED_COMPONENTS = ("X", "Y", "Z", "VX", "VY", "VZ", "ar", "ap", "ay")


def twin(seed: int, point_set: str = "H-10", *, as_run: bool | Switches = False) -> TwoStage:
    """Start the published procedure on the twin of a seed; with switches it has radial velocity and attitude."""
    return Study(seed, switches_of(as_run)).procedure(point_set=point_set)


def labels(eop_set: int) -> tuple[str, ...]:
    """Coefficients of an EOP set in the words of the tables: X0, VY1, ar2 ..."""
    return tuple(f"{component_label(code // 3)}{code % 3}" for code in eop_codes(eop_set))


def component_label(component: int) -> str:
    """One of the nine EOPs in the words of the tables: X, VX, ar (roll), ap (pitch), ay (yaw)."""
    return _PUBLISHED_COMPONENTS[component]


def rmse_cells(key: CellKey, gcp_rmse: Array, icp_rmse: Array) -> Cells:
    """Cells of RMSE per axis at control and check points."""
    out: Cells = {}
    for role, values in (("gcp", gcp_rmse), ("icp", icp_rmse)):
        for axis, value in zip(AXES, values, strict=True):
            out[key._replace(point_role=role, quantity=f"rmse_{axis}")] = float(value)
    return out


def collect(
    one_run: Callable[[int], Cells], seeds: Sequence[int], progress: Progress | None = None
) -> dict[CellKey, Array]:
    """Run all seeds: values (n,) of every cell, nan where a solver broke down.

    Parameters
    ----------
    one_run : callable
        Gives the cells of a seed.
    seeds : sequence of int
    progress : callable, optional
    """
    values: dict[CellKey, list[float]] = {}
    for done, seed in enumerate(seeds, start=1):
        with one_blas_thread():  # else the number of cores decides the rounding noise that many cells are
            cells = one_run(seed)
        for key, value in cells.items():
            values.setdefault(key, []).extend(value if isinstance(value, list) else [value])
        if progress is not None:
            progress(done, len(seeds))
    return {key: np.array(found) for key, found in values.items()}
