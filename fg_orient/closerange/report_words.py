"""Texts of the close-range report: assessment, problems, lengths."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from fg_orient.model.distributions import chi_square_interval, chi_square_limit, f_quantile, normal_quantile, sidak
from fg_orient.model.errors import sentences
from fg_orient.report.words import check_point_words, number

#: A residual: its size; its size divided by the given standard deviation (without one, the
#: size again); redundancy; description.
Residual = tuple[float, float, int, str]

#: Level of the test of m0, and of the search for the worst of all residuals.
LEVEL: Final = 0.001
#: Smaller residuals are rounding errors of exact data, in metres or image units; they are not tested.
ROUNDING: Final = 1e-9
#: Maximum number of suspicious observations that the first page names.
SUSPECTS: Final = 3
#: A direction is reported if its standard deviation, in units of one image point, is above
#: this. Above 1000 it is refused.
WEAK: Final = 100.0
#: Units of length and their factors from m.
LENGTHS: Final = (("km", 1e-3), ("m", 1.0), ("mm", 1e3), ("µm", 1e6))
KINDS: Final = {
    "bundle": "Bundle adjustment", "dlt": "Direct linear transformation", "resection": "Resection",
    "intersection": "Intersection", "surface": "Surface",
}  # fmt: skip


def significant(value: float | None, digits: int = 3) -> str:
    """Return the number with some significant digits, without an exponent if that is short; a dash for None."""
    if value is None or not math.isfinite(value):
        return "–"
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    decimals = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(decimals, 0)}f}".replace("-", "−")


def length(metres: float) -> str:
    """Return the length in m, mm or µm."""
    unit, factor = next((one for one in LENGTHS[1:] if abs(metres) * one[1] >= 0.1), LENGTHS[-1])
    return f"{significant(metres * factor)} {unit}" if metres else "0 m"


def round_length(metres: float) -> str:
    """Return the round length of a scale bar."""
    unit, factor = next((one for one in LENGTHS if metres * one[1] >= 1.0), LENGTHS[-1])
    return f"{metres * factor:g} {unit}"


def unit_of(metres: list[float]) -> tuple[str, float]:
    """Return the unit of a column of lengths, and its factor from m: mm where the largest is below 0.2 m."""
    largest = max((abs(v) for v in metres if v is not None and math.isfinite(v)), default=0.0)
    return ("m", 1.0) if largest >= 0.2 else ("mm", 1e3)


def photo_rows(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the image points of photos that were oriented one by one, with the name of their photo."""
    return [{"photo": photo["photo"]} | row for photo in record.get("photos", []) for row in photo["points"]]


def m0_words(record: dict[str, Any]) -> tuple[str, str]:
    """Return the kind (good, warn) and a sentence on m0: its comparison with 1, or its unit if no sigmas were given."""
    m0, f = record["m0"], record["redundancy"]
    if m0 is None:
        return "warn", "Without redundancy nothing was checked: there are no standard deviations."
    if record.get("loss", "none") != "none":
        return "good", f"With the loss {record['loss']} the weighted residuals are no test of the model."
    if record.get("variance_components"):
        return "good", "The standard deviations were estimated from the residuals: m0 is no test of the model."
    if record["weights"] == "relative":
        unit = "metres" if record["kind"] in ("surface", "absolute") else "the unit of the image coordinates"
        return "good", f"m0, the standard deviation of one observation, is {significant(m0)}, in {unit}."
    low, high = (math.sqrt(v / f) for v in chi_square_interval(f, LEVEL))
    between, size = f"chance leaves it between {number(low, 2)} and {number(high, 2)}", significant(m0, 3)
    if m0 > high:
        axis = (
            ""
            if record["kind"] in ("surface", "absolute")
            else ", or y of the image coordinates points the other way (y_axis)"
        )
        text = f"The residuals are {size} times as large as the given standard deviations (m0; {between})"
        return "warn", f"{text}: these are too small, or the model lacks something, or there are gross errors{axis}."
    if m0 < low:
        return "warn", f"m0 is {size}, and {between}: the given standard deviations are too large."
    return "good", f"The observations fit the model within their standard deviations: m0 is {size}, {between}."


def _assessed(record: dict[str, Any]) -> list[tuple[float | None, str, str]]:
    """Return m0 of the adjustment or of each photo, kind (good, warn) and text of its sentence."""
    parts = [record] if "m0" in record else record["photos"]
    names = [f"{part['photo'] or 'photo'}: " if len(parts) > 1 else "" for part in parts]
    texts = [m0_words(record | part) for part in parts]
    return [(part["m0"], kind, name + text) for part, name, (kind, text) in zip(parts, names, texts, strict=True)]


def doubts(record: dict[str, Any]) -> list[str]:
    """Return the doubts in addition to the warnings: an m0 that chance does not explain, too large residuals."""
    return [text for m0, kind, text in _assessed(record) if kind == "warn" and m0 is not None] + _look_at(record)


def verdict(record: dict[str, Any], problems: list[str]) -> dict[str, Any]:
    """Return the assessment of the result: ``kind`` (good, warn), ``title``, ``text``."""
    done = "Fitted" if record["kind"] in ("surface", "dlt") else "Adjusted"
    facts = _assessed(record)
    kind, title = "good", "nothing stands out"
    if problems or any(kind == "warn" for _, kind, _ in facts):
        kind, title = "warn", "unchecked" if any(m0 is None for m0, _, _ in facts) else "with doubts"
    texts = [text for _, _, text in facts][:4]
    return {"kind": kind, "title": f"{done}, {title}", "text": [*texts, *accuracy_words(record)]}


def accuracy_words(record: dict[str, Any]) -> list[str]:
    """Return the accuracy of the result at check points, else by its standard deviations."""
    if record["kind"] == "surface":
        worst = max(record["points"], key=lambda p: abs(p["distance_m"]))
        return [
            f"Normal distances: root mean square {length(record['rms_m'])}, largest "
            f"{length(worst['distance_m'])} at point {worst['id']}."
        ]
    if record.get("check"):
        along = ", ".join(f"{length(v / 1e3)} {axis}" for v, axis in zip(record["check"]["rms_mm"], "XYZ", strict=True))
        return [check_point_words(record["check"]["n"], along)]
    new = [p for p in record.get("points", []) if p.get("role", "new") != "control" and p.get("sigma_x_m") is not None]
    if not new:
        return []
    rms = [math.sqrt(float(np.mean([p[f"sigma_{a}_m"] ** 2 for p in new]))) for a in "xyz"]
    text = ", ".join(f"{length(v)} {axis}" for v, axis in zip(rms, "XYZ", strict=True))
    return [
        f"Mean standard deviations of {len(new)} new points: {text}. "
        "There are no check points: the accuracy is not verified."
    ]


def suspects(record: dict[str, Any]) -> list[tuple[float, str]]:
    """Return observations whose residuals are too large for the largest of all by chance, worst first.

    Residuals are divided by their standard deviation, and by m0 if it is above 1, because a common factor does not make
    a single observation suspicious.
    """
    rows = [
        (abs(r[f"w_{a}"]), f"{a} of point {r['id']} in photo {r['photo']}")
        for r in record.get("residuals", [])
        for a in "xy"
        if r.get(f"w_{a}") is not None
    ]
    rows += [(abs(o["w"]), o["what"]) for o in record.get("observations", []) if o["w"] is not None]
    if not rows:
        return []
    common = max(record["m0"] or 1.0, 1.0) if record["weights"] == "absolute" else 1.0
    limit = float(-normal_quantile(0.5 * sidak(LEVEL, len(rows))))
    return sorted(((w / common, words) for w, words in rows if w / common > limit), key=lambda row: -row[0])


def _look_at(record: dict[str, Any]) -> list[str]:
    """Return the sentences on the most suspicious observations."""
    large = suspects(record)
    scaled = record["weights"] == "absolute" and (record.get("m0") or 1.0) > 1.0
    own = "its own standard deviation and m0" if scaled else "its own standard deviation"
    out = [f"look at {words}: its residual is {number(w, 1)} times {own}" for w, words in large[:SUSPECTS]]
    if len(large) > SUSPECTS:
        out.append(f"{len(large) - SUSPECTS} more observations to look at are listed with the residuals")
    # residuals without redundancy numbers: all kinds of results except the bundle
    groups, absolute = _groups(record), record["weights"] == "absolute"
    others = [one for f, rows in groups for one in outlying(f, rows, LEVEL / len(groups), absolute=absolute)]
    others.sort(key=lambda one: -one[0])
    more = [f"{len(others) - SUSPECTS} more residuals stand out like these"] if len(others) > SUSPECTS else []
    return [*out, *(text for _, text in others[:SUSPECTS]), *more]


def _groups(record: dict[str, Any]) -> list[tuple[int, list[Residual]]]:
    """Return redundancy and residuals of each adjustment, except of surfaces that were not fitted by distances."""
    if record["kind"] == "surface":
        rows = [
            (
                abs(p["distance_m"]),
                p.get("distance_over_sigma", abs(p["distance_m"])),
                1,
                f"point {p['id']}: its normal distance, {length(p['distance_m'])},",
            )
            for p in record["points"]
        ]
        return [(record["redundancy"], rows)] if record["method"] == "geometric" else []
    if record["kind"] == "intersection":
        squares: dict[str, float] = {}
        for r in record["residuals"]:
            own = sum((r[f"residual_{a}"] / r.get(f"sigma_{a}", 1.0)) ** 2 for a in "xy")
            squares[r["id"]] = squares.get(r["id"], 0.0) + own
        free = {p["id"]: 2 * p["rays"] - 3 for p in record["points"]}
        # the length of the residuals of a point's rays, divided by the root of their redundancy
        rows = [
            (
                p["misfit"],
                math.sqrt(squares[p["id"]] / free[p["id"]]),
                free[p["id"]],
                f"point {p['id']}: the misfit of its rays, {significant(p['misfit'])},",
            )
            for p in record["points"]
        ]
        return [(record["redundancy"], rows)]
    photos = record["photos"] if record["kind"] in ("dlt", "resection") else []
    return [
        (
            photo["redundancy"],
            [
                (
                    abs(r[f"residual_{a}"]),
                    abs(r[f"residual_{a}"]) / r.get(f"sigma_{a}", 1.0),
                    1,
                    f"{a} of point {r['id']} in photo {photo['photo'] or '-'}: its residual, "
                    f"{significant(r[f'residual_{a}'])},",
                )
                for r in photo["points"]
                for a in "xy"
                if r.get("role") != "check"
            ],
        )
        for photo in photos
    ]


def outlying(redundancy: int, residuals: list[Residual], level: float, *, absolute: bool) -> list[tuple[float, str]]:
    """Return the ratios and words of residuals too large for the largest of one adjustment by chance, worst first.

    A residual is divided by its given standard deviation, or by the standard deviation of the other
    residuals if this is larger or none is given: externally studentised (Cook and Weisberg 1982,
    section 2.2.1). The redundancy number is taken as 1, which makes the ratio too small, never too
    large. Points of an intersection are independent: each is tested as a whole. The tests of
    ``fg_orient.quality.hypotheses`` need cofactors, which a record does not contain. No observation is
    excluded.

    Parameters
    ----------
    redundancy : int
    residuals : list of Residual
    level : float
        Probability of any such residual among good ones.
    absolute : bool
        True if standard deviations were given.
    """
    if not residuals:
        return []
    ratio, own = np.array([row[1:3] for row in residuals], float).T
    chance, f = sidak(level, len(ratio)), redundancy - own
    squares = ratio**2 * own
    others = np.sqrt(np.maximum(squares.sum() - squares, 0.0) / np.maximum(f, 1.0))
    out = []
    for (size, w, n, what), scatter, left in zip(residuals, others.tolist(), f.tolist(), strict=True):
        given = absolute and scatter <= 1.0
        times = w if given else w / scatter if scatter > 0.0 else math.inf
        limit = chi_square_limit(n, chance) / n if given else f_quantile(n, max(left, 1.0), 1.0 - chance)
        if left >= 1.0 and size > ROUNDING and times**2 > float(limit):
            over = "its standard deviation" if given else "the standard deviation that the others show"
            out.append((times, f"look at {what} is {number(times, 1)} times {over}"))
    return sorted(out, key=lambda row: -row[0])


def problems(record: dict[str, Any]) -> list[str]:
    """Return the problems of the result, the worst first."""
    out = _look_at(record)
    for one in record.get("directions", {}).get("weakest", []):
        if one["value"] < 1.0 / WEAK:
            times = f"standard deviation {significant(1.0 / one['value'], 2)} times as large as from one image point"
            out.append(f"hardly determined: {one['words']} ({times})")
    photos = record.get("photos", [])
    own = [f"photo {photo['photo'] or '-'}: {text}" for photo in photos for text in sentences(photo)]
    return out + sentences(record) + own
