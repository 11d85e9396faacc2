"""Record of a fit of points as plain values, and the result folder of ``rectify fit``.

The record is the content of ``result.json`` and of the command's JSON output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import area_of_use, to_geographic
from fg_orient.model.distributions import f_tail, sidak
from fg_orient.model.errors import Finding, by_severity, finding, judged, sentences
from fg_orient.model.names import Status
from fg_orient.quality.doubts import BUDGET
from fg_orient.quality.verdict import sigma0_interval
from fg_orient.rectification.fit import Observations
from fg_orient.rectification.folder import CONTENTS, RECORD_FILE, TRANSFORMATION_FILE
from fg_orient.rectification.mistakes import mistakes_in
from fg_orient.rectification.outliers import PointTests, check_tests, point_tests, rounding_of
from fg_orient.rectification.points import DIRECTIONS, PointFit
from fg_orient.rectification.study import PairDistances
from fg_orient.report.chart import INKS, Chart, large, mapped, round_down
from fg_orient.report.svg import svg
from fg_orient.report.words import printable, scientific
from fg_orient.result.manifest import with_manifest, write_manifest
from fg_orient.result.plain import dumps, write_records

SCHEMA: Final = 1
#: Typical condition number of the scaled design by degree of a polynomial: median of random
#: layouts with three points more than terms. The points hardly determine a transformation
#: above 50 times this value. All other models have one common limit.
TYPICAL_CONDITION: Final = {1: 1.5, 2: 8.0, 3: 25.0, 4: 125.0, 5: 500.0}
WEAK_FACTOR: Final = 50.0
WEAK_CONDITION: Final = 1e4
#: If the redundancy number is below this, an error of a point hardly changes its own residual.
HARDLY_CHECKED: Final = 0.1
#: If the probability is below this, check points are worse than the control points predict.
WORSE: Final = 0.001
#: If the ratio of sigmas is above this, points with the larger sigmas have negligible weight.
NEGLIGIBLE: Final = 1e4
#: Maximum distance from the area of use of a map projection, divided by its width. For UTM, this is half a zone.
FAR: Final = 0.5


def record_of(fitted: PointFit, distances: PairDistances | None = None) -> dict[str, Any]:
    """Return the record of a fit; ``distances`` of control points: image in metres minus map, if compared."""
    fit, tests, check, pruning = fitted.fit, point_tests(fitted.fit), fitted.check, fitted.pruning
    checks = None if check is None else check_tests(fit, check, fitted.check_residuals)
    t, axes = fit.transformation, fit.transformation.target_names
    rows = _rows(fitted, "control", fit.points, fit.residuals, fit.redundancy_numbers.mean(axis=1).tolist(), tests)
    if check is not None and checks is not None:  # redundancy numbers exist only for control points
        rows += _rows(fitted, "check", check, fitted.check_residuals, [None] * len(check), checks)
    return {
        "schema": SCHEMA,
        "model": t.model.name,
        "title": t.model.title,
        "degree": t.model.degree or None,
        "direction": fitted.direction,
        "crs": t.crs or None,
        "unit": fitted.unit,
        "axes": list(axes),
        "n_control": len(fit.points),
        "n_check": len(fitted.check_residuals),
        "n_unknowns": t.model.n_unknowns,
        "redundancy": fit.redundancy,
        "weighted": bool((fit.points.sigma != 1.0).any()),
        "m0": fit.m0,
        "rmse": _named(axes, fit.rmse),
        "check_rmse": _named(axes, fitted.check_rmse),
        "condition": fit.condition,
        "iterations": len(fit.log),
        "coefficients": _coefficients(fitted),
        "cofactors": fit.cofactors,
        "points": rows,
        "pruning": None if pruning is None else {"dropped": list(pruning.dropped), "rmse": list(pruning.history)},
        "pair_distances": None
        if distances is None
        else {
            "standard_deviation_m": distances.standard_deviation,
            "mean_m": distances.mean,
            "pairs": len(distances.differences),
            "of_point_m": dict(zip(fit.points.ids, distances.of_point.tolist(), strict=True)),
        },
        **judged(by_severity(findings_on(fitted, tests, checks))),
    }


def _named(axes: Sequence[str], values: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((*axes, "radial"), values, strict=True))


def _coefficients(fitted: PointFit) -> list[dict[str, Any]]:
    """Return the normalised coefficients with standard deviations, and plain coefficients if there are any."""
    t = fitted.fit.transformation
    sigma = fitted.fit.m0 * np.sqrt(np.diag(fitted.fit.cofactors))
    plain = t.plain_coefficients() or {}
    return [
        {"name": name, "normalised": float(value), "sigma": float(s), "plain": plain.get(name)}
        for name, value, s in zip(t.model.names, t.coefficients, sigma, strict=True)
    ]


def _rows(
    fitted: PointFit,
    role: str,
    points: Observations,
    residuals: Array,
    redundancy: Sequence[float | None],
    tests: PointTests,
) -> list[dict[str, Any]]:
    """Return one row per point: given target coordinates, residuals, tests."""
    names = [f"{axis}_{fitted.unit}" for axis in fitted.fit.transformation.target_names]

    def pair(prefix: str, values: Array) -> dict[str, float]:
        return {f"{prefix}{name}": float(value) for name, value in zip(names, values, strict=True)}

    return [
        {
            "id": name,
            "role": role,
            **pair("", points.target[k]),
            **pair("residual_", residuals[k]),
            f"residual_{fitted.unit}": float(np.hypot(*residuals[k])),
            "redundancy": redundancy[k],
            "F": float(tests.statistic[k]),
            "F_limit": float(tests.critical[k]),
            "suspicious": bool(tests.suspicious[k]),
            **pair("error_", tests.error[k]),
        }
        for k, name in enumerate(points.ids)
    ]


def findings_on(fitted: PointFit, tests: PointTests, checks: PointTests | None) -> list[Finding]:
    """Return the findings on a fit, from the tests of the control points and of the check points, if any."""
    out = mistakes_in(fitted.fit, fitted.heights) + _suspicious("point", fitted.fit.points.ids, tests, fitted.unit)
    out += _layout(fitted) + _sigmas(fitted) + _far_from_zone(fitted)
    if fitted.pruning is not None and fitted.pruning.dropped:
        out.append(finding("rectify.rmse_after_pruning"))
    if fitted.check is None or checks is None:
        return [*out, finding("rectify.no_check")]
    return out + _suspicious("check point", fitted.check.ids, checks, fitted.unit) + _worse(fitted, fitted.check)


def _suspicious(kind: str, ids: tuple[str, ...], tests: PointTests, unit: str) -> list[Finding]:
    """Report each point beyond its limit, with the size of its error.

    The level of a single test makes false alarms among many points. It is a doubt only if the largest of so many
    statistics is so large with the small probability of every doubt (``fg_orient.quality.doubts.BUDGET``).
    """
    level = sidak(BUDGET["gross_error"], max(int(np.count_nonzero(tests.dimension)), 1))
    return [
        finding(
            "rectify.gross_error" if tests.probability[k] <= level else "rectify.suspicious_point",
            kind=kind,
            point=ids[k],
            error=list(tests.error[k]),
            unit=unit,
            statistic=tests.statistic[k],
            limit=tests.critical[k],
        )
        for k in sorted(np.flatnonzero(tests.suspicious).tolist(), key=lambda k: float(tests.probability[k]))
    ]


def _layout(fitted: PointFit) -> list[Finding]:
    """Report points that the other points hardly check, and directions in which the points hardly extend."""
    fit, out = fitted.fit, list[Finding]()
    weak = [
        name for name, r in zip(fit.points.ids, fit.redundancy_numbers.mean(axis=1), strict=True) if r < HARDLY_CHECKED
    ]
    if weak:
        out.append(finding("rectify.hardly_checked", limit=HARDLY_CHECKED, points=weak))
    names, spatial = fit.transformation.source_names, fit.model.dimension == 3
    for reach in fit.reaches:
        # points always extend less in height than in plan, so only undetermined directions are reported
        if reach.is_unknown or (reach.is_weak and not spatial):
            out.append(
                finding(
                    "rectify.little_reach",
                    direction=reach.describe(names),
                    ratio=reach.ratio,
                    percent=100.0 * reach.sigma,
                )
            )
    typical = TYPICAL_CONDITION.get(fit.model.degree, WEAK_CONDITION / WEAK_FACTOR)
    if fit.condition > WEAK_FACTOR * typical and not out[bool(weak) :]:
        out.append(
            finding(
                "rectify.hardly_determined",
                condition=fit.condition,
                typical=typical,
                what="a surface" if spatial else "a curve",
            )
        )
    return out


def _sigmas(fitted: PointFit) -> list[Finding]:
    """Report sigmas that the residuals contradict by orders of magnitude, or that give points negligible weight."""
    sigma, m0, out = fitted.fit.points.sigma, fitted.fit.m0, list[Finding]()
    if not (sigma != 1.0).any():
        return out
    low, high = sigma0_interval(fitted.fit.redundancy) if fitted.fit.redundancy else (0.0, math.inf)
    if m0 > high:
        out.append(finding("rectify.m0_large", size=m0, limit=high))
    elif m0 < low:
        out.append(finding("rectify.m0_small", size=m0, limit=low))
    span = float(sigma.max() / sigma.min())
    if span > NEGLIGIBLE:
        out.append(finding("rectify.sigma_span", span=span))
    return out


def _far_from_zone(fitted: PointFit) -> list[Finding]:
    """Return the points far outside the area of use of the map projection."""
    t, fit = fitted.fit.transformation, fitted.fit
    area = area_of_use(t.crs) if t.crs else None
    if area is None:
        return []
    plane = fit.points.target if fitted.direction == DIRECTIONS[0] else fit.points.source[:, :2]
    west, south, east, north = area
    lon, lat = to_geographic(t.crs, *plane.T)
    width = (east - west) % 360.0 or 360.0
    off = (lon - (west + 0.5 * width) + 180.0) % 360.0 - 180.0  # longitude relative to the middle of the area
    beyond = np.maximum(np.abs(off) / width - 0.5, np.maximum(south - lat, lat - north) / max(north - south, width))
    far = ~(beyond <= FAR)  # written with not, because points outside the domain of the projection are nan
    if not far.any():
        return []
    k = int(np.argmax(np.where(np.isnan(beyond), np.inf, beyond)))
    where = f"longitude {lon[k]:.1f}, latitude {lat[k]:.1f}" if np.isfinite(lon[k] + lat[k]) else "no place on Earth"
    return [
        finding(
            "rectify.far_from_zone",
            n=far.sum(),
            crs=t.crs,
            west=west,
            east=east,
            south=south,
            north=north,
            point=fit.points.ids[k],
            where=where,
        )
    ]


def _worse(fitted: PointFit, check: Observations) -> list[Finding]:
    """Test the squares of the check points against m0 by F, with the variance of the prediction."""
    fit = fitted.fit
    if np.abs(fitted.check_residuals).max() <= rounding_of(check):
        return []
    variance = (fit.m0 * check.sigma) ** 2 + fit.prediction_sigma(check.source[:, : fit.model.dimension]) ** 2
    n = 2 * len(check)
    statistic = float(np.sum(fitted.check_residuals**2 / variance)) / n
    if f_tail(n, fit.redundancy, statistic) >= WORSE:
        return []
    return [finding("rectify.check_worse", ratio=np.sqrt(statistic))]


# --- result folder ----------------------------------------------------------------------------------

#: Length of a large residual (90 % quantile), and maximum length of a residual, as shares of the width.
SHARE: Final = 0.07
MOST: Final = 0.3
#: If there are more points than this, only some are drawn.
MAX_POINTS: Final = 3000
#: Maximum number of suspicious points in the verdict.
NAMED: Final = 3


def write_folder(folder: Path, fitted: PointFit, record: dict[str, Any]) -> None:
    """Fill an empty folder with the results of a fit."""
    transformation = fitted.fit.transformation.as_dict()
    kept = with_manifest({key: value for key, value in record.items() if key != "out"})
    (folder / TRANSFORMATION_FILE).write_text(dumps(transformation, indent=1) + "\n", encoding="utf-8")
    (folder / RECORD_FILE).write_text(dumps(kept, indent=1) + "\n", encoding="utf-8")
    (folder / "residuals.svg").write_text(residual_file(record) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(_report(kept), encoding="utf-8")
    write_records(folder / "points.csv", record["points"])
    write_records(folder / "coefficients.csv", record["coefficients"])
    write_manifest(folder, kept, CONTENTS)


def _report(record: dict[str, Any]) -> str:
    """Return the HTML report, with the shell of all reports."""
    from fg_orient.report.page import environment

    heads = [f"residual {axis}, {record['unit']}" for axis in record["axes"]]
    return (
        environment("fg_orient.rectification")
        .get_template("rectify.html.j2")
        .render(
            r=record,
            figure=residual_chart(record),
            heads=heads,
            verdict=_verdict(record),
            problems=sentences(record),
        )
    )


def _verdict(record: dict[str, Any]) -> dict[str, Any]:
    """Return the assessment of the fit: ``kind`` is "good" or "warn"; ``title`` and ``text`` explain it."""
    unit = "" if record["weighted"] else f" {record['unit']}"
    text = (
        f"{record['n_control']} control points, {record['n_unknowns']} unknowns, redundancy {record['redundancy']}. "
        "m0 is per coordinate and divided by the redundancy; RMSE is divided by the number of points."
    )
    text = f"m0 {scientific(record['m0'])}{unit}; {text}"
    if not sentences(record):
        return {"kind": "good", "title": "Fitted, nothing stands out", "text": text}
    bad = record.get("status") == Status.NOT_TRUSTWORTHY  # results before version 0.3 have no status
    title = "not trustworthy" if bad else "with warnings" if record["redundancy"] else "unchecked"
    suspects = [str(row["id"]) for row in record["points"] if row["suspicious"]]
    named = f"{', '.join(suspects[:NAMED])}{' and others' if len(suspects) > NAMED else ''}"
    first = [f"Suspected gross errors: point {named}. Correct or remove them, the largest first, and fit again."]
    return {"kind": "bad" if bad else "warn", "title": f"Fitted, {title}", "text": [*(first if suspects else []), text]}


def residual_chart(record: dict[str, Any]) -> Chart:
    """Return the points in the target system with their residuals, enlarged.

    Parameters
    ----------
    record : dict
        See :func:`fg_orient.rectification.record.record_of`.

    Returns
    -------
    Chart
        Chart; maps have north up, images have lines downwards.
    """
    (first, second), unit = record["axes"], record["unit"]
    rows = record["points"][:: max(1, math.ceil(len(record["points"]) / MAX_POINTS))]
    across, up = (second, first) if first == "line" else (first, second)
    sign = np.array([1.0, -1.0 if "line" in (first, second) else 1.0])
    names = f"{across}_{unit}", f"{up}_{unit}"
    at = np.array([[row[name] for name in names] for row in rows], float) * sign
    vector = np.array([[row[f"residual_{name}"] for name in names] for row in rows], float) * sign
    per_width = max(large(vector) / SHARE, float(np.linalg.norm(vector, axis=1).max()) / MOST)
    wide = max(float(np.ptp(at, axis=0).max()), 1e-9)
    room = float(np.abs(vector).max()) / per_width * wide if per_width else 0.0
    chart = mapped("residual vectors", np.vstack([at - room, at + room]), margin=28.0, per_width=per_width)
    roles = np.array([row["role"] for row in rows])
    for role in ("control", "check"):
        mine = np.flatnonzero(roles == role)
        if len(mine):
            tips = [
                f"{printable(rows[k]['id'])}: residual {scientific(float(np.linalg.norm(vector[k])))} {unit}"
                for k in mine.tolist()
            ]
            chart.add("dots", role, *at[mine].T, label=role, tips=tips, vectors=vector[mine])
    suspicious = np.array([bool(row["suspicious"]) for row in rows])
    if suspicious.any():
        chart.add("dots", "ring", *at[suspicious].T, label="suspicious")
    wide = float(np.ptp(chart.x.limits))
    bar = round_down(0.2 * wide)
    chart.bars = [(bar / wide, f"{bar:g} {unit}")]
    if per_width:
        size = round_down(0.2 * per_width)
        times = f"{float(f'{wide / per_width:.2g}'):,.0f}"
        chart.bars.append((size / per_width, f"{size:g} {unit} residual, enlarged {times} times"))
    return chart


def residual_file(record: dict[str, Any]) -> str:
    """Return the text of the chart as an SVG file."""
    looks = "".join(
        f".{kind}{{fill:{ink.colour if ink.filled else 'none'};stroke:{ink.colour}}}"
        for kind, ink in INKS.items()
        if kind in ("control", "check", "ring")
    )
    others = "text{font:14px sans-serif}.bar-line{stroke:#566069}.vector,.bar-line{fill:none}"
    head, _, rest = str(svg(residual_chart(record))).partition(">")
    return f'{head} xmlns="http://www.w3.org/2000/svg"><style>{looks}{others}</style>{rest}'
