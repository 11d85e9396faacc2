"""What the steps of the two-stage procedure give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem
from fg_orient.studies.axis_errors import AxisErrors

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LookAngles:
    """Result of step 1.

    Parameters
    ----------
    adjusted_rad : (n, 2) array
        psi_x, psi_y of every image point; those of check points from the polynomial.
    v_rad : (n, 2) array
        Adjusted minus file; of check points what the polynomial adds.
    cycles : int
    largest_misclosure : float
        max |F| at the control points afterwards.
    m0_rad : float
        ``sqrt(v^T v / n)`` over the control points: it reflects the errors of the input.
    """

    adjusted_rad: Array
    v_rad: Array
    cycles: int
    largest_misclosure: float
    m0_rad: float


@dataclass(frozen=True)
class PreAdjustment:
    """Result of step 2 for one image.

    Parameters
    ----------
    system : LinearSystem
        Raw units; ``design`` is A, ``observed`` is -w.
    solution : LinearSolution
    dP : (k,) array
        EOP corrections, nan if the solver broke down.
    delta : (r,) array
        ``A dP + w``.
    names : tuple of str
    repeats : int
    """

    system: LinearSystem
    solution: LinearSolution
    dP: Array
    delta: Array
    names: tuple[str, ...]
    repeats: int = 1


@dataclass(frozen=True)
class Bundle:
    """Result of the bundle adjustment.

    Parameters
    ----------
    system : LinearSystem or None
        Of the last iteration, rows whitened by B; None without unknowns.
    solution : LinearSolution
    v : (r,) array
        Residuals of the look angles psi_y, psi_x per image point, rad.
    dP : (M, k) array
        EOP corrections in all.
    names : tuple of str
    accuracy : AxisErrors
        nan where the solver broke down.
    n_observations, n_unknowns : int
    failure : str
        Why the solver broke down; "" if it did not.
    """

    system: LinearSystem | None
    solution: LinearSolution
    v: Array
    dP: Array
    names: tuple[str, ...]
    accuracy: AxisErrors
    n_observations: int
    n_unknowns: int
    failure: str = ""
