"""One seed of the twin as the claims look at it: everything is computed once and kept."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.registry import solvers
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from fg_orient.studies.switches import TEXT, Switches
from fg_orient.studies.two_stage import Kind, TwoStage
from fg_orient.studies.two_stage_results import Bundle, PreAdjustment

Array = npt.NDArray[np.float64]

#: The twin of the published experiments: 1 px of image noise, look angles bent by 3 microrad.
TWIN = ZonguldakOptions(point_set="H-10", image_noise_px=1.0, distortion_rad=3e-6)
#: The same as the program is run on it, with the radial velocity and the attitude of real SPOT-5 scenes: on a circular
#: orbit without attitude its matrices are orthonormal and its constant residual does not show.
AS_RUN_TWIN = replace(TWIN, radial_velocity_m_s=8.0, attitude_rad=(-1.6e-4, -7.2e-4, 9e-4))
#: Unknown in full beside what it duplicates: the sets the thesis calls ill-conditioned.
ILL_CONDITIONED = (5, 13, 15, 17, 19, 20)
#: Those that hold the velocity: wild with plain least squares.
WITH_VELOCITY = (5, 13, 17, 19, 20)
TARGET_M = 5.0
#: Solutions of N x = b that use no threshold and no regularisation. Cramer's rule is one, too, but is left out: the
#: minors of a matrix in raw units lose more digits than any elimination of it (claims C8 and C11 give its figures).
EXACT = ("pivot_inverse", "gauss_inverse", "cholesky_inverse", "gauss_elimination", "gauss_partial_pivot_elimination",
         "cholesky_elimination")  # fmt: skip


def published_solvers() -> tuple[str, ...]:
    """Names of the solvers of Terlemezoğlu 2019, Tikhonov rules included."""
    return tuple(name for name, solver in solvers().items() if solver.published)


class Study:
    """The published procedure on the twin of one seed.

    Parameters
    ----------
    seed : int
    switches : Switches
        Departures of the authors' program; with any the twin has the radial velocity and attitude of a real scene.
    twin : ZonguldakOptions, optional
        Another twin.
    """

    def __init__(self, seed: int, switches: Switches = TEXT, twin: ZonguldakOptions | None = None) -> None:
        self.seed, self.switches = seed, switches
        self.twin = twin or (TWIN if switches == TEXT else AS_RUN_TWIN)
        self.bundle = lru_cache(maxsize=None)(self._bundle)
        self.pre_adjust = lru_cache(maxsize=None)(self._pre_adjust)
        self.variant = lru_cache(maxsize=None)(self._variant)

    def options(self, **changes: object) -> ZonguldakOptions:
        """Options of the twin of this seed, changed where named."""
        return replace(self.twin, seed=self.seed, **changes)  # type: ignore[arg-type]

    def procedure(self, **changes: object) -> TwoStage:
        """The procedure on the twin with these options."""
        return TwoStage(zonguldak_block(self.options(**changes))[0], as_run=self.switches)

    @cached_property
    def two_stage(self) -> TwoStage:
        """The twin as published: H-10, 1 px."""
        return self.procedure()

    def _variant(self, point_set: str = "H-10", noise_px: float = 1.0) -> TwoStage:
        """The same seed with another point set or image noise."""
        return self.procedure(point_set=point_set, image_noise_px=noise_px)

    def _bundle(self, eop_set: int | None, kind: Kind, solver: str, iterations: int = 1) -> Bundle:
        return self.two_stage.bundle(eop_set, kind, solver, iterations)

    def _pre_adjust(self, image: int, eop_set: int, solver: str) -> PreAdjustment:
        return self.two_stage.pre_adjust(image, eop_set, solver)

    def control_jacobian(self, image: int, eop_set: int) -> Array:
        """Jacobian A (r, u) of step 2 of one image, raw units."""
        design, _ = self.pre_adjust(image, eop_set, EXACT[-2]).system.require_design("A")
        return design

    @cached_property
    def icp_without_eop(self) -> tuple[Array, Array]:
        """Check-point RMSE (3,) of the bundle with held EOPs, and of the intersection before it."""
        return self._bundle(None, 1, EXACT[-2]).accuracy.icp_rmse, self.two_stage.look_only().icp_rmse
