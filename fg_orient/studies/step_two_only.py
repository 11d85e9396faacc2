"""The published procedure without its bundle: EOPs of step 2, then all points intersected.

An inference, not a statement of the sources: the check points of type 1 in T-Tables 4.25 to 4.34 diverge as the
control points do. Those of a bundle are its unknowns and stay at one pixel; these here are intersected with the wild
orientation. The right-hand side of step 2 is then what the EOP polynomials leave of the conditions that step 1 has
closed with EOPs interpolated at the line, 1e-8 rad; it is solved once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fg_orient.studies.axis_errors import AxisErrors
from fg_orient.studies.two_stage import TwoStage
from fg_orient.studies.two_stage_results import PreAdjustment


@dataclass(frozen=True)
class StepTwoOnly:
    """Result of the procedure without bundle.

    Parameters
    ----------
    steps : tuple of PreAdjustment
        Step 2 of each image.
    accuracy : AxisErrors
        Control and check points, both intersected; nan where a solver broke down.
    failure : str
        Why the solver broke down; "" if it did not.
    """

    steps: tuple[PreAdjustment, ...]
    accuracy: AxisErrors
    failure: str = ""


def step_two_only(run: TwoStage, eop_set: int, solver: str) -> StepTwoOnly:
    """Step 2 of all images, then the intersection of all points.

    Parameters
    ----------
    run : TwoStage
        The misclosures differ from rounding only with the switch ``line_exact``.
    eop_set : int
        Number of the set.
    solver : str
        Name in the registry of ``fg_orient.adjustment.linear``.

    Raises
    ------
    InputError
        No such EOP set; no such solver.
    """
    images = range(len(run.block.images))
    steps = tuple(run.pre_adjust(k, eop_set, solver, polynomial_misclosures=True, once=True) for k in images)
    failure = next((step.solution.failure for step in steps if step.solution.failure), "")
    return StepTwoOnly(steps, run.intersected(eop_set, np.array([step.dP for step in steps])), failure)
