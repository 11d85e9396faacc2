"""Runs of Börlin and Grussenmeyer (2016) on exports of PhotoModeler give the printed values of DBAT."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.solve import solve
from fg_orient.formats.exchange.photomodeler import read_photomodeler
from fg_orient.quality.covariance import cofactors_of
from tests.support import dbat, photomodeler

pytestmark = pytest.mark.truth


@dataclass(frozen=True)
class Run:
    """Folder, export, control points, report; sigma of image points (px); whether centres are observed.

    ``whole``: the report prints coordinates of the control points' system, not of the export's.
    """

    folder: str
    export: str
    control: str
    report: str
    sigma_px: float
    observed: bool = False
    whole: bool = False


RUNS = {
    "1.78095": Run("cam", "fixed", "fixed", "fixed-with-orient", 0.1),
    "1.60984": Run("cam", "weighted", "weighted", "weighted-with-orient", 0.1),
    "1.0419": Run("sxb", "f-op0", "fixed", "f-op0-with-orient", 1.0),
    "0.984904": Run("sxb", "w-op0", "weighted", "w-op0-with-orient", 1.0),
    "0.965375": Run("sxb", "w-op1", "weighted", "w-op1-with-orient", 1.0),
    "1.07447": Run("sxb", "wsmart", "weighted", "wsmart-with-orient", 1.0),
    "1.06942": Run("sxb", "wsmart", "weighted", "sxb-prior-eo", 1.0, observed=True, whole=True),
}


@pytest.mark.real_data
@pytest.mark.parametrize("sigma0", RUNS)
def test_prague_of_dbat(real_data: Path, sigma0: str) -> None:
    run = RUNS[sigma0]
    folder = real_data / "dbat" / "prague2016" / run.folder
    export = read_photomodeler(folder / "pmexports" / f"{run.export}-with-orient-pmexport.txt")
    control = photomodeler.read_control(folder / "ref" / f"ctrlpts-{run.control}.txt")
    centres = photomodeler.read_centres(folder / "ref" / "fake-camera-positions.txt") if run.observed else {}
    block = photomodeler.block(export, control, run.sigma_px, centres)
    backend = "graph" if centres else "schur"  # own observations
    problem = compile_problem(replace(block, options=replace(block.options, backend=backend)))
    estimate = solve(problem)
    figures, printed = dbat.report(folder / "dbatexports" / f"{run.report}-dbatreport.txt")
    assert estimate.converged and figures["Sigma0"] == sigma0
    found = dbat.same_figures(problem, estimate, figures)
    shift = photomodeler.shift_of(export, control) * run.whole
    q, ours = cofactors_of(problem, estimate), {}
    for k in range(problem.n_images):
        values = dbat.photo_values(problem, estimate.state, q, k)
        moved = {n: (values[n][0] + s, values[n][1]) for n, s in zip(("Xc", "Yc", "Zc"), shift.tolist(), strict=True)}
        ours[str(k + 1)] = values | moved
    # they stop once |J step| <= 1e-6 |r|: no unknown moves by more than 1e-6 sqrt(redundancy) of its deviation
    units = dbat.units_apart(ours, printed, found, 1e-6 * float(np.sqrt(problem.redundancy)))
    assert len(units) == 12 * problem.n_images
    assert max(units) < 1.0
