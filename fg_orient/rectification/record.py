"""What a fit of points says, as plain values: the content of ``result.json`` and of ``--json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.special import fdtrc

from fg_orient.rectification.distances import PairDistances
from fg_orient.rectification.outliers import PointTests, Pruning, point_tests
from fg_orient.rectification.points import PointFit

Array = npt.NDArray[np.float64]

SCHEMA: Final = 1
#: Condition number of the scaled design beyond which the points hardly determine a transformation.
WEAK_CONDITION: Final = 1e4
#: Redundancy number below which an error of a point hardly shows in its own residual.
HARDLY_CHECKED: Final = 0.1
#: Probability below which check points are worse than the control points say.
WORSE: Final = 0.001


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
    t, axes = fit.transformation, fit.transformation.target_names
    return {
        "schema": SCHEMA,
        "model": t.model.name, "title": t.model.title, "degree": t.model.degree or None,
        "direction": found.direction, "crs": t.crs or None, "unit": found.unit, "axes": list(axes),
        "n_control": len(fit.points), "n_check": len(found.check_residuals), "n_unknowns": t.model.n_unknowns,
        "redundancy": fit.redundancy, "weighted": bool((fit.points.sigma != 1.0).any()),
        "m0": fit.m0, "rmse": _named(axes, fit.rmse), "check_rmse": _named(axes, found.check_rmse),
        "condition": fit.condition, "iterations": len(fit.log),
        "coefficients": _coefficients(found), "cofactors": fit.cofactors, "points": _rows(found, tests),
        "pruning": None if pruning is None else {"dropped": list(pruning.dropped), "rmse": list(pruning.history)},
        "pair_distances": None if distances is None else {
            "standard_deviation_m": distances.standard_deviation, "mean_m": distances.mean,
            "pairs": len(distances.differences),
            "of_point_m": dict(zip(fit.points.ids, distances.of_point.tolist(), strict=True)),
        },
        "warnings": warnings_of(found, tests, pruning),
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


def _rows(found: PointFit, tests: PointTests) -> list[dict[str, Any]]:
    """One row per point: target coordinates as given, residuals, and the tests of control points."""
    fit, unit = found.fit, found.unit
    first, second = fit.transformation.target_names
    redundancy, rows = fit.redundancy_numbers, list[dict[str, Any]]()
    for k, name in enumerate(fit.points.ids):
        rows.append({
            "id": name, "role": "control",
            **_plain(first, second, unit, fit.points.target[k], fit.residuals[k]),
            "redundancy": float(redundancy[k].mean()), "F": float(tests.statistic[k]),
            "F_limit": float(tests.critical[k]), "suspicious": bool(tests.suspicious[k]),
            f"error_{first}_{unit}": float(tests.error[k, 0]), f"error_{second}_{unit}": float(tests.error[k, 1]),
        })  # fmt: skip
    nothing = {"redundancy": None, "F": None, "F_limit": None, "suspicious": None,
               f"error_{first}_{unit}": None, f"error_{second}_{unit}": None}  # fmt: skip
    if found.check is not None:
        rows += [
            {"id": name, "role": "check", **_plain(first, second, unit, given, residual), **nothing}
            for name, given, residual in zip(found.check.ids, found.check.target, found.check_residuals, strict=True)
        ]
    return rows


def _plain(first: str, second: str, unit: str, given: Array, residual: Array) -> dict[str, Any]:
    return {
        f"{first}_{unit}": float(given[0]), f"{second}_{unit}": float(given[1]),
        f"residual_{first}_{unit}": float(residual[0]), f"residual_{second}_{unit}": float(residual[1]),
        f"residual_{unit}": float(np.hypot(*residual)),
    }  # fmt: skip


def warnings_of(found: PointFit, tests: PointTests, pruning: Pruning | None) -> list[str]:
    """Say in sentences what a reader of the figures must know."""
    fit, out = found.fit, list[str]()
    for k in np.flatnonzero(tests.suspicious):
        error = ", ".join(f"{value:+.2f}" for value in tests.error[k])
        out.append(f"point {fit.points.ids[k]}: gross error of about {error} {found.unit}; F = "
                   f"{tests.statistic[k]:.1f}, limit {tests.critical[k]:.1f}")  # fmt: skip
    weak = [name for name, r in zip(fit.points.ids, fit.redundancy_numbers.mean(axis=1), strict=True)
            if r < HARDLY_CHECKED]  # fmt: skip
    if weak:
        out.append(f"hardly checked by the others (redundancy below {HARDLY_CHECKED}): {', '.join(weak)}")
    if fit.condition > WEAK_CONDITION:
        out.append(f"the points hardly determine the transformation (condition {fit.condition:.2g})")
    if pruning is not None and pruning.dropped:
        out.append("points were left out until the RMSE was small: it is no measure of accuracy any more")
    if found.check is None:
        out.append("no check points: residuals of control points are smaller than errors elsewhere")
    else:
        out += _worse(found)
    return out


def _worse(found: PointFit) -> list[str]:
    """F test of the check points' squares, with the variance of the prediction, against m0."""
    fit, check = found.fit, found.check
    assert check is not None
    variance = (fit.m0 * check.sigma) ** 2 + fit.prediction_sigma(check.source[:, : fit.model.dimension]) ** 2
    n = 2 * len(check)
    statistic = float(np.sum(found.check_residuals**2 / variance)) / n
    if fdtrc(n, fit.redundancy, statistic) >= WORSE:
        return []
    ratio = np.sqrt(statistic)
    return [f"check points are {ratio:.1f} times worse than control points predict: too high a degree, or gross errors"]
