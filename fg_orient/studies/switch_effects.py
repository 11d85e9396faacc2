"""Effect of each switch between the published equations and the authors' program, on one twin.

Each procedure is measured by the same numbers: the equations, the program, the equations with one switch on, the
program with one switch off (docs/program-as-run.md). All use the twin with radial velocity and attitude.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.conditioning import diagnose
from fg_orient.adjustment.linear.registry import attempt
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.studies.claims import AS_RUN_TWIN, Study
from fg_orient.studies.switches import PROGRAM, TEXT, Switches, names
from fg_orient.studies.two_stage import TwoStage
from fg_orient.studies.two_stage_results import AxisErrors

SOLVER: Final = "gauss_inverse"
PSEUDO_INVERSE: Final = "moore_penrose_inverse"
#: EOP sets whose type-2 bundle is measured.
BUNDLES: Final = (1, 14, 15, 16, 18, 19)
#: Words and unit of each measure.
MEASURES: Final[dict[str, tuple[str, str]]] = {
    "uncorrected": ("control points without corrections", "m"),
    "step_1": ("control points after step 1", "m"),
    "step_1_check": ("check points after step 1", "m"),
    "w_rms": ("misclosures of step 2, rms", "rad"),
    "dp_1": ("largest correction of step 2, set 1", "m"),
    **{f"bundle_{k}": (f"control points after the type-2 bundle, set {k}", "m") for k in BUNDLES},
    "cured_13": ("control points after the type-2 bundle, set 13, Moore-Penrose", "m"),
    "check_1": ("check points after the type-2 bundle, set 1", "m"),
    "rank_a_5": ("rank of A, set 5 (9 unknowns)", ""),
    "rank_a_13": ("rank of A, set 13 (18 unknowns)", ""),
    "rank_n_1": ("rank of N, set 1 (9 unknowns)", ""),
    "cond_1": ("|N| |N^-1|, set 1", ""),
    "cond_15": ("|N| |N^-1|, set 15", ""),
    "cond_19": ("|N| |N^-1|, set 19", ""),
    "iterations_19": ("iterations of step 2, set 19, misclosures of 1e-8 rad", ""),
}


def effects(
    seed: int, switches: Sequence[str] | None = None, progress: Callable[[int, int], None] | None = None
) -> dict[str, dict[str, float]]:
    """Measure the equations, the program, and both with each switch turned.

    Parameters
    ----------
    seed : int
        Of the twin.
    switches : sequence of str, optional
        Names of switches; all if not given.
    progress : callable, optional
        Called with procedures done and procedures in all.

    Returns
    -------
    dict
        "text", "program", "text + NAME" and "program - NAME" to the values of :data:`MEASURES`.
    """
    chosen = names() if switches is None else tuple(switches)
    procedures = {"text": TEXT, "program": PROGRAM}
    procedures |= {f"text + {name}": TEXT.with_(name) for name in chosen}
    procedures |= {f"program - {name}": PROGRAM.without(name) for name in chosen}
    out = {}
    for done, (name, which) in enumerate(procedures.items(), start=1):
        out[name] = measure(seed, which)
        if progress is not None:
            progress(done, len(procedures))
    return out


def measure(seed: int, switches: Switches) -> dict[str, float]:
    """Values of :data:`MEASURES`; nan where the solver breaks down. Errors are 3-D RMSE."""
    with one_blas_thread():  # rounding noise is part of what is measured
        run = Study(seed, switches, AS_RUN_TWIN).two_stage
        step_1 = run.look_only()
        first = run.pre_adjust(0, 1, SOLVER)
        _, w = first.system.require_design("w")
        out = {
            "uncorrected": _length(run.uncorrected().gcp_rmse), "step_1": _length(step_1.gcp_rmse),
            "step_1_check": _length(step_1.icp_rmse), "w_rms": float(np.sqrt(np.mean(w**2))),
            "dp_1": float(np.abs(first.dP).max()),
        }  # fmt: skip
        errors = {number: _bundle(run, number) for number in BUNDLES}
        out["cured_13"] = _length(_bundle(run, 13, PSEUDO_INVERSE).gcp_rmse)
        out |= {f"bundle_{number}": _length(found.gcp_rmse) for number, found in errors.items()}
        out["check_1"] = _length(errors[1].icp_rmse)
        out |= {f"rank_a_{number}": float(np.linalg.matrix_rank(_design(run, number))) for number in (5, 13)}
        out["rank_n_1"] = float(diagnose(first.system).rank)
        out |= {f"cond_{number}": norm_condition(run.pre_adjust(0, number, SOLVER).system) for number in (1, 15, 19)}
        out["iterations_19"] = float(run.pre_adjust(0, 19, SOLVER, polynomial_misclosures=True).repeats)
    return {name: out[name] for name in MEASURES}


def norm_condition(system: LinearSystem, solver: str = SOLVER) -> float:
    """|N| |N^-1| from the inverse as it is formed, T(3.11), Frobenius norm; nan where it cannot be formed.

    The smallest singular value of a matrix like these is rounding of the largest; its explicit inverse is not. T(3.11)
    names no norm; the program's numbers for sets 1, 15 and 19 are those of this one.
    """
    inverse = attempt(solver, system).inverse
    if inverse is None:
        return math.nan
    return float(np.linalg.norm(system.normal) * np.linalg.norm(inverse))


def _bundle(run: TwoStage, number: int, solver: str = SOLVER) -> AxisErrors:
    return run.bundle(number, 2, solver).accuracy


def _design(run: TwoStage, number: int) -> np.ndarray:
    """A of step 2, left image."""
    return run.pre_adjust(0, number, PSEUDO_INVERSE).system.require_design("A")[0]


def _length(rmse: np.ndarray) -> float:
    return float(np.linalg.norm(rmse))
