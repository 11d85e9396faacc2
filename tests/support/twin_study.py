"""Runs over seeds of the twin give accuracy by EOP set and calibration for the claims."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fg_orient.model.names import Role, Status
from fg_orient.orientation.orient import adjust
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

EOP_SETS = tuple(range(1, 21))
#: These sets hold no constant term of position, yaw, pitch and roll: a constant offset does not fit them.
CANNOT_SHIFT = (3, 4, 5, 6, 7, 8, 11, 12)


@dataclass(frozen=True)
class Run:
    """Figures of one adjustment at the check points."""

    enu_m: np.ndarray
    ecef_m: np.ndarray
    rmse_3d_m: float
    sigma0: float
    iterations: int
    status: Status
    reason: str


def run_sets(seeds: Iterable[int], look_polynomial: int | None) -> dict[tuple[int, int], Run]:
    """Return all 20 sets on H-10 with constant errors: (set, seed) -> figures."""
    out = {}
    for seed in seeds:
        block, _ = zonguldak_block(ZonguldakOptions(seed=seed))
        for eop_set in EOP_SETS:
            solution = adjust(block, eop_set=eop_set, look_polynomial=look_polynomial)
            check = solution.accuracy.check
            assert len(check) == 10
            out[eop_set, seed] = Run(
                np.sqrt(np.mean(check.enu_m**2, axis=0)), np.sqrt(np.mean(check.ecef_m**2, axis=0)),
                float(np.sqrt(np.mean((check.enu_m**2).sum(axis=1)))), solution.sigma0, solution.iterations,
                solution.status, solution.reason,
            )  # fmt: skip
    return out


def table(runs: dict[tuple[int, int], Run], title: str) -> str:
    """Return the medians over the seeds, largest values in brackets."""
    lines = [title, "set   east m        north m       up m          3-D m least   sigma0 least  iterations"]
    for eop_set in EOP_SETS:
        mine = [run for (number, _), run in runs.items() if number == eop_set]
        enu = np.array([run.enu_m for run in mine])
        cells = [f"{m:5.2f} ({x:5.2f})" for m, x in zip(np.median(enu, axis=0), enu.max(axis=0), strict=True)]
        least = min(r.rmse_3d_m for r in mine), min(r.sigma0 for r in mine)
        most = max(r.iterations for r in mine)
        lines.append(f"{eop_set:3d}   {'   '.join(cells)}   {least[0]:8.2f}      {least[1]:6.2f}      {most}")
    return "\n".join(lines)


@dataclass(frozen=True)
class Calibration:
    """One seed: normalised errors of the joint unknowns and the global test."""

    nees_eop: float
    nees_check: float
    single: np.ndarray  # (84,) error / sigma: 54 EOP unknowns, 30 check coordinates
    chi2: float
    redundancy: int


def calibrate(seed: int, errors: str) -> Calibration:
    """Adjust the twin with set 20 and compare with the truth; C is the prior-scale covariance."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=seed, errors=errors))
    solution = adjust(block, eop_set=20)
    assert solution.status in (Status.CONVERGED, Status.NOT_TRUSTWORTHY) and solution.cofactors is not None
    sigma = solution.problem.parameters[0].sigma
    codes = list(solution.problem.parameters[0].codes)
    true = np.stack([c.eop.ravel()[codes] for c in truth.corrections]) / sigma
    e_eop = (solution.state.image - true).ravel()
    q_eop = solution.cofactors.joint((0, 1), ())
    check = tuple(int(j) for j in block.points.where(Role.CHECK))
    e_check = (solution.ground_m - truth.ecef_m)[list(check)].ravel()
    q_check = solution.cofactors.joint((), check)
    assert (len(e_eop), len(e_check)) == (54, 30)
    single = np.concatenate([e_eop / np.sqrt(np.diag(q_eop)), e_check / np.sqrt(np.diag(q_check))])
    nees = [float(e @ np.linalg.solve(q, e)) for e, q in ((e_eop, q_eop), (e_check, q_check))]
    return Calibration(nees[0], nees[1], single, solution.chi2, solution.redundancy)
