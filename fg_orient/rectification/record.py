"""What a fit of points says, as plain values: the content of ``result.json`` and of what the command prints as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import as_record
from fg_orient.rectification.distances import PairDistances
from fg_orient.rectification.fit import Observations
from fg_orient.rectification.outliers import PointTests, Pruning, check_tests, point_tests
from fg_orient.rectification.points import PointFit
from fg_orient.rectification.remarks import findings_on

Array = npt.NDArray[np.float64]

SCHEMA: Final = 1


def record_of(
    found: PointFit, *, pruning: Pruning | None = None, distances: PairDistances | None = None
) -> dict[str, Any]:
    """Give the record of a fit.

    Parameters
    ----------
    found : PointFit
    pruning : Pruning, optional
        If points were left out.
    distances : PairDistances, optional
        Of the control points, image in metres minus map.
    """
    fit, tests = found.fit, point_tests(found.fit)
    checks = None if found.check is None else check_tests(fit, found.check, found.check_residuals)
    t, axes = fit.transformation, fit.transformation.target_names
    return {
        "schema": SCHEMA,
        "model": t.model.name, "title": t.model.title, "degree": t.model.degree or None,
        "direction": found.direction, "crs": t.crs or None, "unit": found.unit, "axes": list(axes),
        "n_control": len(fit.points), "n_check": len(found.check_residuals), "n_unknowns": t.model.n_unknowns,
        "redundancy": fit.redundancy, "weighted": bool((fit.points.sigma != 1.0).any()),
        "m0": fit.m0, "rmse": _named(axes, fit.rmse), "check_rmse": _named(axes, found.check_rmse),
        "condition": fit.condition, "iterations": len(fit.log),
        "coefficients": _coefficients(found), "cofactors": fit.cofactors, "points": _rows(found, tests, checks),
        "pruning": None if pruning is None else {"dropped": list(pruning.dropped), "rmse": list(pruning.history)},
        "pair_distances": None if distances is None else {
            "standard_deviation_m": distances.standard_deviation, "mean_m": distances.mean,
            "pairs": len(distances.differences),
            "of_point_m": dict(zip(fit.points.ids, distances.of_point.tolist(), strict=True)),
        },
        **as_record(findings_on(found, tests, checks, pruning)),
    }  # fmt: skip


def _named(axes: Sequence[str], values: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((*axes, "radial"), values, strict=True))


def _coefficients(found: PointFit) -> list[dict[str, Any]]:
    """Normalised coefficients with standard deviations, and those of the coordinates themselves where there are any."""
    t = found.fit.transformation
    sigma = found.fit.m0 * np.sqrt(np.diag(found.fit.cofactors))
    plain = t.plain_coefficients() or {}
    return [
        {"name": name, "normalised": float(value), "sigma": float(s), "plain": plain.get(name)}
        for name, value, s in zip(t.model.names, t.coefficients, sigma, strict=True)
    ]


def _rows(found: PointFit, tests: PointTests, checks: PointTests | None) -> list[dict[str, Any]]:
    """One row per point: target coordinates as given, residuals, tests; check points have no redundancy."""
    redundancy = found.fit.redundancy_numbers.mean(axis=1).tolist()
    rows = _tested(found, "control", found.fit.points, found.fit.residuals, redundancy, tests)
    if found.check is not None and checks is not None:
        rows += _tested(found, "check", found.check, found.check_residuals, [None] * len(found.check), checks)
    return rows


def _tested(
    found: PointFit, role: str, points: Observations, residuals: Array, redundancy: Sequence[float | None],
    tests: PointTests,
) -> list[dict[str, Any]]:  # fmt: skip
    unit = found.unit
    first, second = found.fit.transformation.target_names
    return [
        {
            "id": name, "role": role, **_plain(first, second, unit, points.target[k], residuals[k]),
            "redundancy": redundancy[k], "F": float(tests.statistic[k]), "F_limit": float(tests.critical[k]),
            "suspicious": bool(tests.suspicious[k]),
            f"error_{first}_{unit}": float(tests.error[k, 0]), f"error_{second}_{unit}": float(tests.error[k, 1]),
        }
        for k, name in enumerate(points.ids)
    ]  # fmt: skip


def _plain(first: str, second: str, unit: str, given: Array, residual: Array) -> dict[str, Any]:
    return {
        f"{first}_{unit}": float(given[0]), f"{second}_{unit}": float(given[1]),
        f"residual_{first}_{unit}": float(residual[0]), f"residual_{second}_{unit}": float(residual[1]),
        f"residual_{unit}": float(np.hypot(*residual)),
    }  # fmt: skip
