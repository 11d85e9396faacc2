"""Make rows of engines from failures, matrices and errors; run the published procedure."""

from __future__ import annotations

from functools import partial
from typing import Any, cast

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.l_curve import l_curve_of
from fg_orient.adjustment.linear.system import LinearSystem, numerical_rank, singular_values, unit_columns
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError
from fg_orient.model.machine import measured
from fg_orient.model.names import EOP_SETS
from fg_orient.model.parameters import eop_codes
from fg_orient.studies.comparison import reference, work
from fg_orient.studies.comparison.model import AXES, Curve, ErrorVectors, Row, Spectrum
from fg_orient.studies.comparison.work import Limits
from fg_orient.studies.error_maps import errors_of
from fg_orient.studies.two_stage import Kind, TwoStage
from fg_orient.studies.two_stage_results import TwoStageResult


def row(eop_set: int, solver: str, backend: str, kind: int | None = None, **values: Any) -> Row:
    """Return a row with these columns."""
    return Row(eop_set, EOP_SETS[eop_set].name, solver, backend, kind, **values)


def one_line(error: FgOrientError) -> str:
    """Return the problems of an error as one line."""
    return " | ".join(map(str, error.problems))


def spectra_of(design: Array, eop_set: int, system: str) -> tuple[Spectrum, Spectrum]:
    """Compute the singular values of a design matrix, raw and with columns of unit length.

    Zero columns stay zero.
    """
    return (
        Spectrum(eop_set, system, "raw", singular_values(design)),
        Spectrum(eop_set, system, "columns", singular_values(unit_columns(design))),
    )


def conditioning(raw: Spectrum, columns: Spectrum, n_rows: int) -> dict[str, Any]:
    """Return the columns of a row that describe its matrix.

    The numerical rank of A is defined as in MATLAB.
    """
    order = len(raw.values)
    return {
        "cond_raw": raw.condition, "cond_scaled": columns.condition, "order": order,
        "rank": numerical_rank(raw.values, max(n_rows, order)),
    }  # fmt: skip


def axes(role: str, rmse: Array) -> dict[str, float]:
    """Return the RMSE of a role: of the worst axis (nan if any axis is nan), and of the three axes."""
    named = {f"{role}_rmse_{axis}_m": float(value) for axis, value in zip(AXES, rmse, strict=True)}
    return {f"{role}_rmse_m": float(np.max(rmse))} | named


class Published:
    """Published two-stage procedure with one EOP set and a bundle of one iteration.

    Parameters
    ----------
    block : Block
    eop_set : int
    as_run : bool
        Whether to compute as the authors' program does.
    limits : Limits
    """

    def __init__(self, block: Block, eop_set: int, as_run: bool, limits: Limits) -> None:
        self.eop_set, self.failure, self._limits = eop_set, "", limits
        self.spectra, self.curves, self.vectors = list[Spectrum](), list[Curve](), list[ErrorVectors]()
        try:
            self.stage = TwoStage(block, as_run=as_run)
            self.order = len(block.images) * len(eop_codes(eop_set)) + 3 * len(self.stage.check_ids)
            self._points = len(block.observations)
            _ = self.stage.pre_adjusted  # computed here, so that its time is not added to the first solver
        except FgOrientError as error:
            self.failure = one_line(error)

    def run(self, kind: int, solver: str) -> Row:
        """Adjust with one type and solver."""
        new = partial(row, self.eop_set, solver, "faithful", kind)
        if self.failure:
            return new(failure=self.failure, left_out=True)
        predicted = work.published_work(solver, self._points, self.order)
        new = partial(new, **predicted.columns())
        if reason := self._limits.reason(solver, predicted):
            return new(failure=reason, left_out=True, order=self.order)
        try:
            # large corrections overflow; the result is then reported as failed
            with np.errstate(all="ignore"), measured() as effort:
                bundle = self.stage.bundle(self.eop_set, cast(Kind, kind), solver)
        except FgOrientError as error:
            return new(failure=one_line(error))
        if not bundle.failure:
            errors = errors_of(self.stage.block, bundle.accuracy)
            self.vectors.append(ErrorVectors(
                self.eop_set, kind, solver, {role: tuple(own.ids) for role, own in errors.items()},
                {role: own.enu_m for role, own in errors.items()},
            ))  # fmt: skip
        return new(processor_s=effort.processor_s, peak_bytes=effort.peak_bytes, **self._values(bundle, kind))

    def _values(self, bundle: TwoStageResult, kind: int) -> dict[str, Any]:
        """Return the columns of a row.

        The spectra and the L-curve of a type are stored at its first solver.
        """
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
            values |= conditioning(*pair, len(design))
            if not bundle.failure and values["rank"] == len(design[0]):
                values["forward_error"] = _error_of_step(bundle.system, bundle.solution.x)
            if kappa is not None and all(other.type != kind for other in self.curves):
                self.curves.append(Curve(self.eop_set, kind, l_curve_of(bundle.system)))
        if not bundle.failure:
            redundancy = bundle.n_observations - bundle.n_unknowns
            values["m0_rad"] = float(np.sqrt(bundle.v @ bundle.v / redundancy)) if redundancy > 0 else np.nan
            values |= axes("control", bundle.accuracy.gcp_rmse) | axes("check", bundle.accuracy.icp_rmse)
        return values


def _error_of_step(system: LinearSystem, x: Array) -> float:
    """Return the forward error of a solution.

    Unknowns are multiplied by the lengths of their columns of A.
    """
    design, observed = system.require_design("reference")
    exact, lengths = reference.exact(design, observed, reference.LIMIT_OF_ROW), np.linalg.norm(design, axis=0)
    return reference.forward_error(x * lengths, None if exact is None else exact * lengths)
