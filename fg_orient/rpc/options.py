"""Options of work on RPC; each field is the only declaration of its option (``fg_orient.model.options``).

The types are read when the program runs, so annotations are not postponed here.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.declaration import Group, documented, option, require_allowed
from fg_orient.model.errors import InputError
from fg_orient.model.names import FIRST_PIXELS

Denominators = Literal["separate", "common", "one"]
Penalty = Literal["beyond_affine", "identity"]

MODEL: Final = Group("Model")
POINTS: Final = Group("Fit to control points (POINTS)")
#: Default selection: the method with the smallest cross-validated errors at real points.
SELECTION: Final = "ridge_press"
NO_SELECTION: Final = "none"
#: Maximum number of subsets of coefficients that a random search evaluates.
EVALUATIONS: Final = 2000

# fmt: off


@documented
@dataclass(frozen=True)
class FileOptions:
    """Conventions of an RPC file."""

    order: str = option("RPC00B", MODEL, "Order of the coefficients in FILE: RPC00B, RPC00A or T2.54.")
    first_pixel: float | None = option(
        None, MODEL, "Coordinate of the first pixel's centre in FILE.", within=FIRST_PIXELS,
        left_out="the convention of the format",
    )


@documented
@dataclass(frozen=True)
class RefineOptions:
    """Options of a refinement with control points."""

    compensation: str = option("shift", MODEL, "shift (at least 1 point), shift_drift (2) or affine (3).")
    extrapolate: bool = option(False, MODEL, "Use points outside the validity range of the model.")


@documented
@dataclass(frozen=True)
class FitOptions:
    """Options of a fit to control points. A fit to a sensor uses only degree, denominators and seed."""

    degree: int = option(3, MODEL, "Degree of the polynomials.", within=(1, 3))
    denominators: Denominators = option(
        "separate", MODEL, "Denominators: separate, common (one for both coordinates) or one (polynomials).",
    )
    equations: Literal["true", "linear", "weighted"] = option(
        "true", POINTS, "Equations: true, linear (as published) or weighted.",
    )
    selection: str | None = option(
        None, POINTS, "Method to select the coefficients: ridge_press, ridge_gcv, ridge_l_curve, lasso, nested, uss, "
        "scatter, genetic, particle_swarm or none.", left_out="ridge_press for true equations without kappa",
        spelled="select",
    )
    evaluations: int = option(
        EVALUATIONS, POINTS, "Models that a genetic or particle-swarm search evaluates at most.", within=(1, math.inf),
    )
    kappa: float | None = option(
        None, POINTS, "Penalty on squared normalised coefficients, instead of `select`.", within=(0.0, 1e100),
    )
    penalty: Penalty = option("beyond_affine", POINTS, "Coefficients that kappa keeps near zero.")
    solver: str | None = option(None, POINTS, "Solver of the linear form, such as svd_scaled.")
    normalise: bool = option(True, POINTS, "Scale coordinates to the range -1 to 1.")
    folds: int | None = option(
        None, POINTS, "Parts of the cross-validation.", within=(2, math.inf), left_out="10, or all points if fewer",
    )
    seed: int = option(
        1, MODEL, "Random seed of the folds, of a search, or of the independent points.", within=(0, math.inf),
    )

    def __post_init__(self) -> None:
        require_allowed(self)
        if self.selection not in (None, NO_SELECTION):
            clashes = {"kappa": self.kappa is not None, "equations": self.equations != "true",
                       "no_normalise": not self.normalise}
            for name in (name for name, clash in clashes.items() if clash):
                raise InputError.of("options.two_ways", option=f"select, {name}")
        if self.solver is not None and self.equations != "linear":
            raise InputError.of("rpc.solver_form", option="solver", value=self.solver)

    @property
    def selector(self) -> str | None:
        """Selection that the fit uses; None for a plain or a penalised fit."""
        if self.selection is not None:
            return None if self.selection == NO_SELECTION else self.selection
        return SELECTION if self.equations == "true" and self.kappa is None and self.normalise else None
