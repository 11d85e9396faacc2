"""Backends of a comparison: each computes a row from EOP set and solver, also for a failure."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from factors._preparation import working_clock
from factors.arrays import Array
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.linear.l_curve import l_curve_of
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, numerical_rank, singular_values, unit_columns
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError, finding
from fg_orient.model.names import EOP_SETS, Status
from fg_orient.model.parameters import eop_codes
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.deficiency import judge_observability
from fg_orient.quality.observability import affordable, analyse_block
from fg_orient.studies.comparison.model import AXES, GRAPH_SOLVER, Curve, Direction, Row, Spectrum
from fg_orient.studies.two_stage import Kind, TwoStage
from fg_orient.studies.two_stage_results import TwoStageResult

#: Cramer's rule takes u^2 determinants of order u - 1: minutes per solution beyond this many unknowns.
CRAMER_LIMIT = 120


def row(eop_set: int, solver: str, backend: str, kind: int | None = None, **values: Any) -> Row:
    """Make a row."""
    return Row(eop_set, EOP_SETS[eop_set].name, solver, backend, kind, **values)


def one_line(error: FgOrientError) -> str:
    """Problems of an error in one line."""
    return " | ".join(map(str, error.problems))


def spectra_of(design: Array, eop_set: int, system: str) -> tuple[Spectrum, Spectrum]:
    """Singular values of a design matrix, raw and with columns of unit length (a zero column stays zero)."""
    return (
        Spectrum(eop_set, system, "raw", singular_values(design)),
        Spectrum(eop_set, system, "columns", singular_values(unit_columns(design))),
    )


def _conditioning(raw: Spectrum, columns: Spectrum, n_rows: int) -> dict[str, Any]:
    """Columns of a row that describe its matrix; numerical rank of A as in MATLAB."""
    order = len(raw.values)
    return {
        "cond_raw": raw.condition, "cond_scaled": columns.condition, "order": order,
        "rank": numerical_rank(raw.values, max(n_rows, order)),
    }  # fmt: skip


def _reason_to_leave_out(solver: str, order: int, *, iterated: bool) -> str:
    """Reason for not trying an adjustment; "" if it is tried."""
    if order > MAX_UNKNOWNS:
        return str(finding("linear.too_large", place=solver, value=order, limit=MAX_UNKNOWNS))
    if solver == "cramer_inverse" and order > CRAMER_LIMIT:
        return str(finding("compare.slow", place=solver, value=order, limit=CRAMER_LIMIT))
    if iterated and registry.solver(solver).family == "tikhonov":
        return str(finding("compare.damped", place=solver))
    return ""


class Published:
    """The published two-stage procedure with one EOP set, one-iteration bundle.

    Parameters
    ----------
    block : Block
    eop_set : int
    as_run : bool
        As the authors' program works.
    """

    def __init__(self, block: Block, eop_set: int, as_run: bool) -> None:
        self.eop_set, self.failure = eop_set, ""
        self.spectra, self.curves = list[Spectrum](), list[Curve]()
        try:
            self.stage = TwoStage(block, as_run=as_run)
            self.order = len(block.images) * len(eop_codes(eop_set)) + 3 * len(self.stage.check_ids)
            _ = self.stage.pre_adjusted  # its time is not that of the first solver
        except FgOrientError as error:
            self.failure = one_line(error)

    def run(self, kind: int, solver: str) -> Row:
        """Adjust with one type and solver."""
        new = partial(row, self.eop_set, solver, "faithful", kind)
        if self.failure:
            return new(failure=self.failure)
        if reason := _reason_to_leave_out(solver, self.order, iterated=False):
            return new(failure=reason, left_out=True, order=self.order)
        start = working_clock()
        try:
            with np.errstate(all="ignore"):  # large corrections overflow; the result is then reported as failed
                bundle = self.stage.bundle(self.eop_set, cast(Kind, kind), solver)
        except FgOrientError as error:
            return new(failure=one_line(error))
        return new(seconds=working_clock() - start, **self._values(bundle, kind))

    def _values(self, bundle: TwoStageResult, kind: int) -> dict[str, Any]:
        """Columns of a row; the spectra and the L-curve of a type are those of its first solver."""
        kappa, system = bundle.solution.kappa, f"published {kind}"
        values: dict[str, Any] = {
            "failure": bundle.failure, "iterations": 1, "order": bundle.n_unknowns, "notes": bundle.solution.notes,
            "kappa": np.nan if kappa is None else kappa,
        }  # fmt: skip
        if bundle.system is not None:
            design, _ = bundle.system.require_design("spectrum")
            pair = spectra_of(design, self.eop_set, system)
            if all(other.system != system for other in self.spectra):
                self.spectra += pair
            values |= _conditioning(*pair, len(design))
            if kappa is not None and all(other.type != kind for other in self.curves):
                self.curves.append(Curve(self.eop_set, kind, l_curve_of(bundle.system)))
        if not bundle.failure:
            redundancy = bundle.n_observations - bundle.n_unknowns
            values["m0_rad"] = float(np.sqrt(bundle.v @ bundle.v / redundancy)) if redundancy > 0 else np.nan
            values |= _axes("control", bundle.accuracy.gcp_rmse) | _axes("check", bundle.accuracy.icp_rmse)
        return values


def _axes(role: str, rmse: Array) -> dict[str, float]:
    """RMSE of a role: the largest axis (nan if any is) and the three."""
    named = {f"{role}_rmse_{axis}_m": float(value) for axis, value in zip(AXES, rmse, strict=True)}
    return {f"{role}_rmse_m": float(np.max(rmse))} | named


class Adjustments:
    """:func:`fg_orient.adjust` with one EOP set: graph, and dense with any solver.

    Parameters
    ----------
    block : Block
    eop_set : int

    Raises
    ------
    InputError
        The block cannot be adjusted with any set.
    """

    def __init__(self, block: Block, eop_set: int) -> None:
        self.block, self.eop_set = replace(block, options=replace(block.options, eop_set=eop_set)), eop_set
        self.problem = compile_problem(self.block)
        self.spectra: tuple[Spectrum, ...] = ()
        self.directions = directions_of(self.problem)
        self.matrix: dict[str, Any] = {"order": self.problem.n_unknowns}
        if self.problem.n_unknowns <= MAX_UNKNOWNS:
            self._describe()

    def _describe(self) -> None:
        """Singular values at the start: with and without priors; raw, columns of unit length, prior sigmas."""
        design = assemble(self.problem, self.problem.start)[1]
        physical = _per_physical_unit(self.problem, design)
        raw, columns = spectra_of(physical, self.eop_set, "adjustment")
        spectra = [raw, columns, Spectrum(self.eop_set, "adjustment", "priors", singular_values(design))]
        self.matrix |= _conditioning(raw, columns, len(design))
        if self.block.options.priors:
            free = _without_priors(self.problem, design)
            spectra += spectra_of(_per_physical_unit(self.problem, free), self.eop_set, "no priors")
            spectra.append(Spectrum(self.eop_set, "no priors", "priors", singular_values(free)))
        self.spectra = tuple(spectra)

    def graph(self) -> tuple[Solution | None, Row]:
        """Adjust through the graph: solution, if there is one, and row."""
        return self._run(GRAPH_SOLVER, "graph", {"backend": "graph"})

    def dense(self, solver: str, reference: Solution | None) -> Row:
        """Adjust with dense matrices and one solver; ``reference`` is the graph's solution."""
        reason = _reason_to_leave_out(solver, self.problem.n_unknowns, iterated=True)
        if reason:
            return row(self.eop_set, solver, "dense", failure=reason, left_out=True, **self.matrix)
        solution, row_ = self._run(solver, "dense", {"backend": "dense", "solver": solver})
        if solution is None or reference is None:
            return row_
        ours, theirs = solution.state, reference.state
        apart = np.abs(ours.ground - theirs.ground)
        return replace(
            row_, difference_sigmas=float(np.abs(ours.image - theirs.image).max()),
            difference_m=float(np.nanmax(apart)) if np.isfinite(apart).any() else np.nan,
        )  # fmt: skip

    def _run(self, solver: str, backend: str, options: dict[str, Any]) -> tuple[Solution | None, Row]:
        new = partial(row, self.eop_set, solver, backend, **self.matrix)
        try:
            with np.errstate(all="ignore"):  # a step with a singular matrix may overflow; the loop then reports it
                solution = adjust(self.block, **options)
        except FgOrientError as error:
            return None, new(failure=one_line(error))
        new = partial(new, iterations=solution.iterations, seconds=solution.seconds.structure + solution.seconds.solve)
        if solution.status is Status.NOT_CONVERGED:
            return None, new(failure=solution.reason)
        accuracy = _accuracy("control", solution.accuracy.control) | _accuracy("check", solution.accuracy.check)
        notes = (solution.reason,) if solution.status is Status.NOT_TRUSTWORTHY else ()
        return solution, new(sigma0=solution.sigma0, notes=notes, **accuracy)


def directions_of(compiled: Problem) -> tuple[Direction, ...]:
    """Directions that the image observations do not determine: of each image, then of the whole block."""
    number, out = compiled.block.options.eop_set, list[Direction]()
    for image in judge_observability(compiled):
        words = [text.removeprefix(f"image {image.image}: ") for text in image.sentences]
        out += [Direction(number, image.image, text, "nothing") for text in words]
        out += [Direction(number, image.image, text, "prior") for text in image.held]
    view = analyse_block(compiled) if affordable(compiled) else None
    block = () if view is None else (*view.datum, *view.on_board)
    return (*out, *(Direction(number, "", text.removeprefix("block: "), "prior") for text in block))


def _accuracy(role: str, differences: PointDifferences) -> dict[str, float]:
    statistics = differences.statistics()
    return _axes(role, np.array([statistics.get(f"rmse_ecef_{axis}_m", np.nan) for axis in AXES]))


def _per_physical_unit(compiled: Problem, design: Array) -> Array:
    """Columns per m, m/s and rad instead of per prior sigma; columns of ground points are already per metre."""
    scale = np.ones(design.shape[1])
    scale[: compiled.n_image_unknowns] = np.concatenate([p.sigma for p in compiled.parameters])
    return design / scale


def _without_priors(compiled: Problem, design: Array) -> Array:
    """Drop the prior rows: compile the same block without them."""
    options = replace(compiled.block.options, priors=False)
    free = replace(compiled, block=replace(compiled.block, options=options))
    return assemble(free, free.start)[1]
