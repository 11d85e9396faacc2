"""What a regularised solver did to an adjustment: its L-curve, and the kappa of each step.

A Tikhonov solver of the dense backend shortens every step, with a kappa chosen anew. The step that tells is the one
from the start values: it goes nearly all the way, and at the solution of the unregularised equations every step is zero
and a curve would be rounding. So the curve is that of the equations at the start values, with the sigmas, and under a
loss the weights, that the result stands on; without a loss these are the equations of the first Gauss-Newton step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from fg_orient.adjustment.dense import DenseBackend
from fg_orient.adjustment.linear.l_curve import LCurve, l_curve_of
from fg_orient.adjustment.linear.registry import attempt, solver
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.problem import Problem


@dataclass(frozen=True)
class Regularisation:
    """How strongly an adjustment was regularised.

    Parameters
    ----------
    solver, label : str
        "tikhonov_l_curve", "Tikhonov L-curve".
    rule : str
        The kappa rule of the solver; "" if it has none.
    curve : LCurve
        At the start values. Unknowns are prior sigmas (images) and metres (ground points), residuals are sigmas.
    kappa : float or None
        What the solver chooses there; None where it finds none (``failure`` says why).
    kappas : tuple of (int, float)
        Iteration and kappa of each step taken.
    """

    solver: str
    label: str
    rule: str
    curve: LCurve
    kappa: float | None
    kappas: tuple[tuple[int, float], ...]
    failure: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Give the section ``regularisation`` of a record."""
        curve = asdict(self.curve)
        return {
            "solver": self.solver, "label": self.label, "rule": self.rule or None, "kappa": self.kappa,
            "failure": self.failure, "rules": curve.pop("choices"), "curve": curve,
            "steps": [{"iteration": number, "kappa": kappa} for number, kappa in self.kappas],
        }  # fmt: skip


def regularisation(judged: Problem, name: str, log: Sequence[IterationRecord]) -> Regularisation | None:
    """Describe the regularisation of an adjustment; None for a solver that does not regularise.

    Parameters
    ----------
    judged : Problem
        What was solved; under a loss with the weights at the solution.
    name : str
        Solver of the dense backend; "" for the other backends.
    log : sequence of IterationRecord

    Raises
    ------
    Breakdown
        The equations at the start values are zero.
    """
    if not name or solver(name).family != "tikhonov":
        return None
    system = DenseBackend(judged, name).linearise(judged.start).equations()
    found = attempt(name, system)
    kappas = tuple((record.iteration, record.kappa) for record in log if record.accepted)
    return Regularisation(name, solver(name).label, found.rule, l_curve_of(system), found.kappa, kappas, found.failure)
