"""Two-stage orientation of Topan 2009, as used by Topan & Maktav 2010 and Terlemezoğlu 2019.

1. **Look-angle pre-adjustment** (first type, per image, only control points, P 19-20): every condition has its own
   observation. Therefore the corrections of the look angles absorb the whole misclosure, whatever its cause. A degree-2
   polynomial in the column gives the look angles of check points.
2. **EOP pre-adjustment** (second type, T 4.5): ``A dP + w = Delta`` is minimised per image at the look angles of step
   1. ``w`` is then rounding noise, and so is dP.
3. **Bundle** (P 21, T 2.71): both images, EOP coefficients and check-point coordinates, one iteration. The
   control-point accuracy results from a new intersection of the control points, the check-point accuracy from their
   coordinates in the bundle.

The module repeats the published procedure with its weaknesses (docs/ill-conditioning.md). For practical work use
:func:`fg_orient.adjust`. ``as_run`` selects the procedure of the authors' program instead of the equations of the text.
Each difference is a switch (:mod:`fg_orient.studies.switches`, docs/program-as-run.md).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.linear.registry import attempt
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.model.parameters import eop_codes, eop_set_number
from fg_orient.sensors import initial
from fg_orient.studies import conditions
from fg_orient.studies import two_stage_results as results
from fg_orient.studies.conditions import Conditions, Linearised
from fg_orient.studies.switches import Switches, switches_of
from fg_orient.studies.two_stage_results import AxisErrors, PreAdjustment, TwoStageResult

LookModel = Literal["angles", "corrections"]
Kind = Literal[1, 2]

#: Step 1 repeats until the largest condition is at most this value, or no longer decreases.
CLOSED = 1e-15
CLOSED_AS_RUN = np.radians(0.1 / 3600.0)
MAX_CYCLES = 10
#: The published program repeats step 2 while a correction exceeds 10 m (10" for sets of attitudes), at most
#: MAX_REPEATS times. If each unknown has its own limit (10 m or 10"), MAX_REPEATS_BY_UNKNOWN is sufficient.
REPEAT_AS_RUN_M = 10.0
REPEAT_AS_RUN_RAD = np.radians(10.0 / 3600.0)
MAX_REPEATS, MAX_REPEATS_BY_UNKNOWN = 1000, 10
#: First EOP code of the attitude.
FIRST_ATTITUDE = 18
LOOK_DEGREE = 2
LEFT = "the corrections have left the range in which the conditions can be computed"


class TwoStage:
    """Published procedure on a block of two or more images.

    Parameters
    ----------
    block : Block
        Block; its control points are held fixed at their coordinates, and its tie points count as check points without
        coordinates.
    as_run : bool or Switches
        Procedure of the authors' program: with all its differences from the text, or with the given ones.
    look_model : "angles" or "corrections"
        Quantity represented by the degree-2 polynomial for the check points. "angles": the look angles, as published;
        "corrections": their corrections, which do not contain the cubic part of the angle, about 3e-6 rad.

    Raises
    ------
    InputError
        There are fewer than two images, or control points in fewer than three columns of an image. At first use: the
        rays of a check or tie point do not intersect.
    """

    def __init__(self, block: Block, *, as_run: bool | Switches = False, look_model: LookModel = "angles") -> None:
        self.block, self.switches, self.look_model = block, switches_of(as_run), look_model
        self._require_enough()
        seen = np.unique(block.observations.point)
        control = block.points.where(Role.CONTROL)
        self._control: Index = control[np.isin(control, seen)]
        self._check: Index = np.setdiff1d(seen, self._control)
        self.control_ids = tuple(block.points.ids[j] for j in self._control)
        self.check_ids = tuple(block.points.ids[j] for j in self._check)

    def _require_enough(self) -> None:
        o, control = self.block.observations, self.block.points.where(Role.CONTROL)
        if len(self.block.images) < 2:
            raise InputError.of("classical.one_image", file=self.block.name, value=len(self.block.images))
        for k, image in enumerate(self.block.images):
            columns = np.unique(o.sample[(o.image == k) & np.isin(o.point, control)])
            if len(columns) <= LOOK_DEGREE:
                raise InputError.of(
                    "classical.few_control",
                    file=self.block.name,
                    place=f"image {image.id}",
                    value=len(columns),
                    least=LOOK_DEGREE + 1,
                )

    # --- step 1 ------------------------------------------------------------------------------

    @cached_property
    def _control_rows(self) -> Index:
        """True for image points of control points."""
        return np.flatnonzero(np.isin(self.block.observations.point, self._control))

    @cached_property
    def start(self) -> Conditions:
        """Conditions at the file's look angles and metadata orientation."""
        return self._built(line_exact=self.switches.line_exact)

    @cached_property
    def _polynomials(self) -> Conditions:
        """:attr:`start` with EOPs that are polynomials of the line, for A and later intersections."""
        return self._built(line_exact=False) if self.switches.line_exact else self.start

    def _built(self, *, line_exact: bool) -> Conditions:
        block = self.block
        ground = block.points.known.ecef_m.copy()
        # points without rays are not used; zero prevents nan
        ground[np.setdiff1d(np.arange(len(ground)), block.observations.point)] = 0.0
        ground = initial.ground_points(block.images, block.observations, block.points.ids, ground)
        return conditions.build(block.images, block.observations, ground, switches=self.switches, line_exact=line_exact)

    def _smooth(self, at: Conditions, rows: Index | None = None) -> Conditions:
        """Replace the EOPs of these conditions (or of the given rows) by polynomials."""
        if not self.switches.line_exact:
            return at
        return at.with_orbit(self._polynomials if rows is None else self._polynomials.take(rows))

    @cached_property
    def look(self) -> results.LookAngles:
        """Adjusted look angles of step 1, for all images."""
        rows, none = self._control_rows, np.zeros((len(self.block.images), 0))
        at = self.start.take(rows)
        coarse, after = self.switches.coarse_stop, self.switches.test_after
        limit, cycles, previous = CLOSED_AS_RUN if coarse else CLOSED, 0, np.inf
        lin = at.linearise((), none)
        while cycles < MAX_CYCLES:
            # the order is reversed: rows are psi_y, psi_x, columns of the record are psi_x, psi_y
            v = -(lin.value / lin.look)[:, ::-1]
            at, cycles, before = at.with_look(at.look_rad + v), cycles + 1, lin
            lin = at.linearise((), none)
            largest = float(np.abs((lin if after else before).value).max())
            if largest <= limit or (not coarse and largest >= previous):
                break
            previous = largest
        adjusted = self.start.look_rad
        adjusted[rows] = at.look_rad
        self._predict_check_angles(adjusted)
        v = adjusted - self.start.look_rad
        remaining = float(np.abs(lin.value).max())
        return results.LookAngles(adjusted, v, cycles, remaining, float(np.sqrt(np.mean(v[rows] ** 2))))

    def _predict_check_angles(self, adjusted_rad: Array) -> None:
        """Fill the rows of check points from the degree-2 polynomial in the column, for each image."""
        o, is_control = self.block.observations, np.zeros(len(adjusted_rad), bool)
        is_control[self._control_rows] = True
        base = np.zeros_like(adjusted_rad) if self.look_model == "angles" else self.start.look_rad
        for k, image in enumerate(self.block.images):
            known, wanted = (np.flatnonzero((o.image == k) & side) for side in (is_control, ~is_control))
            centre = (image.sensor.n_samples - 1) / 2.0
            powers = [
                ((o.sample[rows] - centre) / centre)[:, None] ** np.arange(LOOK_DEGREE + 1) for rows in (known, wanted)
            ]
            fitted = np.linalg.lstsq(powers[0], adjusted_rad[known] - base[known], rcond=None)[0]
            adjusted_rad[wanted] = base[wanted] + powers[1] @ fitted

    # --- accuracy without unknowns -----------------------------------------------------------

    def uncorrected(self, look_sign: float = -1.0) -> AxisErrors:
        """Intersect with metadata orientation and look angles ("L" of Topan & Maktav 2010, Table 1).

        ``look_sign=+1`` uses the third component of the viewing direction as printed. The rays then intersect above the
        satellites.
        """
        return self._errors(self._intersect(self.start, (), self._no_eop(), look_sign=look_sign))

    def look_only(self) -> AxisErrors:
        """Intersect with the look angles of step 1 ("L bar" of Topan & Maktav 2010, Table 1)."""
        return self._errors(self._intersect(self.pre_adjusted, (), self._no_eop()))

    @cached_property
    def pre_adjusted(self) -> Conditions:
        """Conditions at the look angles of step 1; check points are intersected with these angles."""
        at = self.start.with_look(self.look.adjusted_rad)
        ground = self._intersect(at, (), self._no_eop())
        ground[self._control] = self.block.points.known.ecef_m[self._control]
        return at.with_ground(ground[at.point])

    # --- step 2 ------------------------------------------------------------------------------

    def pre_adjust(
        self, image: int, eop_set: int, solver: str, *, polynomial_misclosures: bool = False, once: bool = False
    ) -> PreAdjustment:
        """Run step 2 for one image: EOP corrections at the look angles of step 1, which are held fixed.

        Parameters
        ----------
        image : int
            Position of the image in the block.
        eop_set : int
            Number of the EOP set.
        solver : str
            Name in the registry of ``fg_orient.adjustment.linear``.
        polynomial_misclosures : bool
            True to compute the misclosures of the first iteration from EOP polynomials too (1e-8 rad instead of
            rounding).
        once : bool
            True to run only one iteration, whatever the switches are.

        Raises
        ------
        InputError
            The EOP set or solver is unknown.
        """
        codes = _codes(eop_set)
        rows = self._control_rows[self.pre_adjusted.image[self._control_rows] == image]
        exact = self.pre_adjusted.take(rows)
        at = self._smooth(exact, rows)
        eop, repeats = self._no_eop(len(codes)), 0
        lin = at.linearise(codes, eop)
        if at is not exact and not polynomial_misclosures:
            lin = replace(lin, value=exact.linearise((), self._no_eop()).value)
        while True:
            system = LinearSystem.from_design(lin.eop.reshape(-1, len(codes)), -lin.value.ravel())
            solution, repeats = attempt(solver, system, as_run=self.switches.complex_roots), repeats + 1
            eop[image] += solution.x
            if once or not self._repeats(codes, solution.x, system, repeats):
                break
            lin = at.linearise(codes, eop)
            if not lin.is_finite:
                solution = LinearSolution(np.full(len(codes), np.nan), failure=LEFT)
                eop[image] = np.nan
                break
        design, observed = system.require_design("step 2")
        delta = design @ solution.x - observed
        return PreAdjustment(system, solution, eop[image], delta, repeats)

    def _repeats(self, codes: tuple[int, ...], dp: Array, system: LinearSystem, repeats: int) -> bool:
        """Return the program's condition for repeating: large corrections and a matrix of full rank."""
        most = MAX_REPEATS if self.switches.one_limit else MAX_REPEATS_BY_UNKNOWN
        if not self.switches.repeated_step_2 or repeats >= most or not np.isfinite(dp).all():
            return False
        attitude = np.array(codes) >= FIRST_ATTITUDE
        if self.switches.one_limit:
            attitude[:] = attitude.all()
        limit = np.where(attitude, REPEAT_AS_RUN_RAD, REPEAT_AS_RUN_M)
        design, _ = system.require_design("step 2")
        return bool((np.abs(dp) > limit).any() and np.linalg.matrix_rank(design) == len(codes))

    def step_two_only(self, eop_set: int, solver: str) -> AxisErrors:
        """Run the procedure without bundle: step 2 of all images, then the intersection of all points.

        This procedure is inferred; the sources do not describe it. The check points of type 1 in T-Tables 4.25 to 4.34
        diverge like the control points. In a bundle, check points are unknowns and remain within one pixel; here they
        are intersected with the diverging orientation. Step 1 satisfies the conditions with EOPs interpolated at the
        line. With EOP polynomials, misclosures of 1e-8 rad remain. They are the right-hand side of step 2, which is
        solved once. These misclosures exceed rounding errors only with the switch ``line_exact``.

        Parameters
        ----------
        eop_set : int
            1-20.
        solver : str
            Name in the registry of ``fg_orient.adjustment.linear``.

        Returns
        -------
        AxisErrors
            nan if the solver breaks down.

        Raises
        ------
        InputError
            The EOP set or solver is unknown.
        """
        images = range(len(self.block.images))
        steps = [self.pre_adjust(k, eop_set, solver, polynomial_misclosures=True, once=True) for k in images]
        at, eop = self._smooth(self.pre_adjusted), np.array([step.dP for step in steps])
        ground = self._intersect(at, _codes(eop_set), eop, metadata_position=self.switches.metadata_positions)
        return self._errors(ground)

    # --- bundle ------------------------------------------------------------------------------

    def bundle(self, eop_set: int | None, kind: Kind, solver: str, iterations: int = 1) -> TwoStageResult:
        """Adjust the bundle of all images.

        Parameters
        ----------
        eop_set : int or None
            Number of the EOP set; None holds the EOPs fixed ("B" of Topan & Maktav 2010, Table 1).
        kind : 1 or 2
            1 starts from the metadata EOPs, 2 from the EOPs of step 2.
        solver : str
            Name in the registry of ``fg_orient.adjustment.linear``; step 2 uses it too.
        iterations : int
            One iteration is published. Further iterations use the adjusted observations as new observations, as the
            sources do.

        Raises
        ------
        InputError
            The EOP set, kind or solver is unknown, or the number of iterations is below one.
        """
        if kind not in (1, 2) or iterations < 1:
            raise InputError.of("classical.bundle", place="bundle", value=f"kind {kind}, {iterations} iterations")
        codes = () if eop_set is None else _codes(eop_set)
        at, eop = self.pre_adjusted, self._no_eop(len(codes))
        v, system, solution = np.zeros((len(at.image), 2)), None, LinearSolution(np.zeros(0))
        if kind == 2 and eop_set is not None:
            steps = [self.pre_adjust(k, eop_set, solver) for k in range(len(self.block.images))]
            eop = np.array([step.dP for step in steps])
            solution = next((step.solution for step in steps if step.solution.failure), solution)
        if kind == 2 and not solution.failure:
            at = self._with_check_points(at, self._intersect(self._smooth(at), codes, eop))
        broken, k = bool(solution.failure), 0
        while not broken and k < iterations:
            lin = self._bundle_conditions(at, codes, eop, first=k == 0)
            if not lin.is_finite:
                solution, broken = LinearSolution(np.zeros(0), failure=LEFT), True
                break
            at, eop, step_v, system, solution = self._iterate(at, lin, eop, solver)
            v, k = v + step_v, k + 1
            broken = bool(solution.failure) or not (np.isfinite(eop).all() and np.isfinite(at.approximate_m).all())
        ground = np.full((len(self.block.points.ids), 3), np.nan)
        if not broken:
            ground = self._intersect(self._smooth(at), codes, eop, metadata_position=self.switches.metadata_positions)
            ground[self._check] = self._by_point(at)[self._check]
            broken = not np.isfinite(ground[self._assessed]).all()
        failure = (solution.failure or "the result is not finite") if broken else ""
        if broken:
            v, eop, ground = 0.0 * v + np.nan, 0.0 * eop + np.nan, 0.0 * ground + np.nan
        n_unknowns = eop.size + 3 * len(self._check)
        residuals = v[:, ::-1].ravel()
        return TwoStageResult(system, solution, residuals, eop, self._errors(ground), v.size, n_unknowns, failure)

    def _bundle_conditions(self, at: Conditions, codes: tuple[int, ...], eop: Array, *, first: bool) -> Linearised:
        """Return misclosures and derivatives of one iteration; its first misclosures may come from other EOPs."""
        lin = self._smooth(at).linearise(codes, eop)
        at_metadata = first and self.switches.metadata_misclosures
        if at_metadata or (first and self.switches.line_exact):
            lin = replace(lin, value=at.linearise(codes, 0.0 * eop if at_metadata else eop).value)
        return lin

    def _iterate(
        self, at: Conditions, lin: Linearised, eop: Array, solver: str
    ) -> tuple[Conditions, Array, Array, LinearSystem | None, LinearSolution]:
        """Return one linearised adjustment: new conditions, EOPs, residuals (psi_x, psi_y), system, solution."""
        system = self._system(at, lin)
        if system is None:
            v = -(lin.value / lin.look)
            return at.with_look(at.look_rad + v[:, ::-1]), eop, v[:, ::-1], None, LinearSolution(np.zeros(0))
        solution = attempt(solver, system, as_run=self.switches.complex_roots)
        design, observed = system.require_design("bundle")
        residual = (design @ solution.x - observed).reshape(-1, 2)  # residuals are B^-1 (A dP + w), because B is square
        v = -np.sign(lin.look) * residual
        n_images, k = eop.shape
        eop = eop + solution.x[: n_images * k].reshape(n_images, k)
        ground = self._by_point(at)
        ground[self._check] += solution.x[n_images * k :].reshape(-1, 3)
        moved = at.with_look(at.look_rad + v[:, ::-1])
        return self._with_check_points(moved, ground), eop, v[:, ::-1], system, solution

    def _system(self, at: Conditions, lin: Linearised) -> LinearSystem | None:
        """Return the whitened design of the bundle; no system if there are no unknowns."""
        n, k, n_images = len(at.image), lin.eop.shape[2], len(self.block.images)
        u = n_images * k + 3 * len(self._check)
        if not u:
            return None
        design = np.zeros((n, 2, u))
        for column in range(k):
            design[np.arange(n), :, at.image * k + column] = lin.eop[:, :, column]
        rows = np.flatnonzero(np.isin(at.point, self._check))
        first = n_images * k + 3 * np.searchsorted(self._check, at.point[rows])
        for axis in range(3):
            design[rows, :, first + axis] = lin.ground[rows, :, axis]
        weight = 1.0 / np.abs(lin.look)  # weights follow from M = B B^T, which is diagonal
        whitened = (design * weight[:, :, None]).reshape(2 * n, u)
        return LinearSystem.from_design(whitened, -(lin.value * weight).ravel())

    # --- geometry ----------------------------------------------------------------------------

    def _no_eop(self, count: int = 0) -> Array:
        return np.zeros((len(self.block.images), count))

    def _by_point(self, at: Conditions) -> Array:
        """Return the approximate coordinates (N, 3), by ground point."""
        out = np.full((len(self.block.points.ids), 3), np.nan)
        out[at.point] = at.approximate_m
        return out

    def _with_check_points(self, at: Conditions, ground_m: Array) -> Conditions:
        """Move the check points, but not the control points, to these coordinates (N, 3)."""
        ground = self._by_point(at)
        ground[self._check] = ground_m[self._check]
        return at.with_ground(ground[at.point])

    def _intersect(
        self,
        at: Conditions,
        codes: tuple[int, ...],
        eop: Array,
        *,
        metadata_position: bool = False,
        look_sign: float = -1.0,
    ) -> Array:
        """Intersect the rays of all points, and return their coordinates (N, 3), ECEF m."""
        n = len(self.block.points.ids)
        with np.errstate(all="ignore"):  # large corrections overflow: these points become nan
            centre, direction = at.rays(codes, eop, metadata_position=metadata_position, look_sign=look_sign)
            if len(self.block.images) == 2:
                return results.from_two_rays(centre, direction, at.image, at.point, n, midpoint=self.switches.midpoint)
            return initial.nearest_points(centre, direction, at.point, n)[0]

    @cached_property
    def _assessed(self) -> Index:
        """True for control points that can be intersected: in two images, with rays that are not nearly parallel."""
        ground = self._intersect(self.start, (), self._no_eop())[self._control]
        return self._control[np.isfinite(ground).all(axis=1)]

    def _errors(self, ground_m: Array) -> AxisErrors:
        """Return measured minus computed coordinates; this opens the coordinates of the check points."""
        known, points = self.block.points.known, self.block.points
        gcp = known.ecef_m[self._assessed] - ground_m[self._assessed]
        check = [j for j in self._check if points.roles[j] is Role.CHECK]
        icp = np.zeros((0, 3))
        if check:
            withheld = self.block.withheld
            rows = [withheld.ids.index(points.ids[j]) for j in check]
            icp = withheld.open().ecef_m[rows] - ground_m[check]
        names = tuple(points.ids[j] for j in self._assessed), tuple(points.ids[j] for j in check)
        return AxisErrors(gcp, icp, *names)


def _codes(eop_set: int) -> tuple[int, ...]:
    return eop_codes(eop_set_number(eop_set))
