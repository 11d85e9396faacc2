"""Assessment of a close-range result: findings that follow from tests of m0 and of residuals, and the status.

The tests need only the record of a result. A bundle with given standard deviations is assessed by its adjustment
instead (``fg_orient.quality.verdict``, ``doubts``), which has the joint cofactors of all residuals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from fg_orient.closerange.report_words import length, significant
from fg_orient.model.distributions import chi_square_limit, f_quantile, normal_quantile, sidak
from fg_orient.model.errors import Finding, by_severity, finding, findings_of, judged
from fg_orient.quality.reliability import CHECKABLE
from fg_orient.quality.verdict import sigma0_interval

#: Level of the test of m0, and of the search for the worst of all residuals.
LEVEL: Final = 0.001
#: Smaller residuals are rounding errors of exact data, in metres or image units; they are not tested.
ROUNDING: Final = 1e-9
#: Maximum number of suspicious observations that are named.
SUSPECTS: Final = 3
#: A direction is reported if its standard deviation, in units of one image point, is above this. Above 1000 it is
#: refused.
WEAK: Final = 100.0
#: Codes of findings on m0.
M0: Final = ("closerange.m0_large", "closerange.m0_small", "verdict.sigma0", "solution.sigmas_large")
#: Kinds of results without image coordinates.
_GROUND: Final = ("surface", "absolute")


class Residual(NamedTuple):
    """Residual that is tested alone.

    Parameters
    ----------
    size : float
        Metres, or unit of the image coordinates.
    ratio : float
        Root of its quadratic form divided by its degrees of freedom; of one residual: its size divided by the given
        standard deviation (1 without one) and by the root of its redundancy number.
    freedom : int
        Degrees of freedom.
    place, words : str
        Observation; name and value of the residual.
    """

    size: float
    ratio: float
    freedom: int
    place: str
    words: str


class LargeResidual(NamedTuple):
    """Residual that chance does not explain: its ratio to its standard deviation, place, words, name of the divisor."""

    times: float
    place: str
    words: str
    divisor: str


def assessed(record: dict[str, Any], tests: Sequence[Finding]) -> dict[str, Any]:
    """Return a record with its status and all findings, the most serious first, also those of its photos.

    Parameters
    ----------
    record : dict
        Record of a result, with the findings that were made during the computation.
    tests : sequence of Finding
        Findings that follow from tests: :func:`tests_of`, or the findings of the adjustment.
    """
    photos = [one for one in record.get("photos", []) if isinstance(one, Mapping)]
    own = [replace(one, place=_of_photo(photo, one.place)) for photo in photos for one in findings_of(photo)]
    found = [*findings_of(record), *own, *tests, *weak_directions(record)]
    return record | judged(by_severity(found))


def _of_photo(photo: Mapping[str, Any], place: str = "") -> str:
    name = f"photo {photo['photo']}" if photo.get("photo") else ""
    return ", ".join(filter(None, (name, place)))


def tests_of(record: Mapping[str, Any]) -> list[Finding]:
    """Return the findings of the tests that need only the record: too large residuals first, then m0."""
    return [*_of_residuals(record), *of_m0(record)]


def of_m0(record: Mapping[str, Any]) -> list[Finding]:
    """Return the findings on m0 of the adjustment, or of each photo, if chance does not explain its difference from 1.

    A large m0 is a doubt, as in every adjustment. A small m0 means that the standard deviations are too large; this
    makes the result look worse than it is.
    """
    parts = [record] if "m0" in record else record["photos"]
    return [one for part in parts for one in _of_m0({**record, **part}, "m0" not in record)]


def _of_m0(part: Mapping[str, Any], of_photo: bool) -> Iterator[Finding]:
    if not is_tested(part):
        return
    place = _of_photo(part) if of_photo else ""
    low, high = sigma0_interval(part["redundancy"])
    if part["m0"] > high:
        axis = None if part["kind"] in _GROUND else "y_axis"
        yield finding("closerange.m0_large", place=place, size=part["m0"], low=low, limit=high, axis=axis)
    elif part["m0"] < low:
        yield finding("closerange.m0_small", place=place, size=part["m0"], limit=low, high=high)


def is_tested(part: Mapping[str, Any]) -> bool:
    """Return whether m0 is a test of the model: standard deviations were given, and there is redundancy."""
    estimated = part.get("loss", "none") != "none" or part.get("variance_components")
    return part["m0"] is not None and part["weights"] == "absolute" and not estimated


def weak_directions(record: Mapping[str, Any]) -> list[Finding]:
    """Return the warnings on unknowns of a bundle that are hardly determined."""
    return [
        finding(
            "closerange.weak_direction (warning): hardly determined: {words} (standard deviation {times:.2g} times as "
            "large as from one image point) -> add observations that determine it, or omit one of these unknowns",
            words=one["words"], times=1.0 / one["value"],
        )
        for one in record.get("directions", {}).get("weakest", []) if one["value"] < 1.0 / WEAK
    ]  # fmt: skip


def suspects(record: Mapping[str, Any]) -> list[tuple[float, str]]:
    """Return observations of a bundle whose residuals are too large for the largest of all by chance, worst first.

    Residuals are divided by their standard deviation, and by m0 if it is above 1, because a common factor does not make
    a single observation suspicious.
    """
    rows = [
        (abs(r[f"w_{a}"]), f"{a} of point {r['id']} in photo {r['photo']}")
        for r in record.get("residuals", [])
        for a in "xy"
        if r.get(f"w_{a}") is not None and abs(r[f"residual_{a}"]) > ROUNDING
    ]
    rows += [(abs(o["w"]), o["what"]) for o in record.get("observations", []) if o["w"] is not None]
    if not rows:
        return []
    common = max(record["m0"] or 1.0, 1.0) if record["weights"] == "absolute" else 1.0
    limit = float(-normal_quantile(0.5 * sidak(LEVEL, len(rows))))
    return sorted(((w / common, words) for w, words in rows if w / common > limit), key=lambda row: -row[0])


def _of_residuals(record: Mapping[str, Any]) -> list[Finding]:
    """Return the doubts on the most suspicious observations; the others are counted."""
    scaled = record["weights"] == "absolute" and (record.get("m0") or 1.0) > 1.0
    own = "its own standard deviation and m0" if scaled else "its own standard deviation"
    large = [LargeResidual(w, place, "its residual", own) for w, place in suspects(record)]
    groups, absolute = _groups(record), record["weights"] == "absolute"  # all kinds of results except the bundle
    tests = (outlying(part, rows, LEVEL / len(groups), absolute=absolute) for part, rows in groups)
    large += sorted((one for test in tests for one in test), key=lambda one: -one.times)
    more = len(large) - SUSPECTS
    return [
        finding("closerange.large_residual", place=place, size=w, what=what, over=over,
                more=more if more > 0 and k == 0 else None)
        for k, (w, place, what, over) in enumerate(large[:SUSPECTS])
    ]  # fmt: skip


def _groups(record: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], list[Residual]]]:
    """Return the record and the residuals of each adjustment, except of surfaces that were not fitted by distances."""
    kind = record["kind"]
    if kind == "surface":
        return [(record, _distances(record))] if record["method"] == "geometric" else []
    if kind == "intersection":
        return [(record, _misfits(record))]
    if kind == "relative":
        return [(record, _coplanarity(record))]
    if kind == "absolute":
        rows = [_residual(c, a, f"{a.upper()} of control point {c['id']}", length, "_m")
                for c in record["control"] for a in "xyz"]  # fmt: skip
        return [(record, rows)]
    photos = record["photos"] if kind in ("dlt", "resection") else []
    return [
        (
            photo,
            [
                _residual(r, a, f"{a} of point {r['id']} in photo {photo['photo'] or '-'}", significant)
                for r in photo["points"] for a in "xy" if r.get("role") != "check"
            ],
        )
        for photo in photos
    ]  # fmt: skip


def _residual(row: Mapping[str, Any], axis: str, place: str, words: Callable[[float], str], unit: str = "") -> Residual:
    value = row[f"residual_{axis}{unit}"]
    size = abs(value)
    free = _free(row.get(f"redundancy_{axis}"))
    ratio = size / row.get(f"sigma_{axis}{unit}", 1.0) / math.sqrt(free)
    return Residual(size, ratio, 1, place, f"its residual, {words(value)},")


def _free(redundancy_number: float | None) -> float:
    """Return the divisor of a squared residual: its redundancy number; infinite if the others do not check it.

    Records of versions before 0.3 have no redundancy numbers; 1 makes the test of their residuals too weak.
    """
    number = 1.0 if redundancy_number is None else redundancy_number
    return number if number >= CHECKABLE else math.inf


def _distances(record: Mapping[str, Any]) -> list[Residual]:
    """Return the normal distances of the points from a surface."""
    out = []
    for p in record["points"]:
        size = abs(p["distance_m"])
        ratio = p.get("distance_over_sigma", size) / math.sqrt(_free(p.get("redundancy")))
        out.append(Residual(size, ratio, 1, f"point {p['id']}", f"its normal distance, {length(size)},"))
    return out


def _coplanarity(record: Mapping[str, Any]) -> list[Residual]:
    """Return the distances of the pairs of image points from coplanarity, in sigmas (1 without given ones)."""
    unit, out = " sigmas" if record["weights"] == "absolute" else "", []
    for p in record["points"]:
        size = abs(p["distance"])
        words = f"the distance of its rays from coplanarity, {significant(size)}{unit},"
        out.append(Residual(size, size / math.sqrt(_free(p.get("redundancy"))), 1, f"point {p['id']}", words))
    return out


def _misfits(record: Mapping[str, Any]) -> list[Residual]:
    """Return the length of the residuals of each point's rays, divided by the root of their redundancy."""
    squares: dict[str, float] = {}
    for r in record["residuals"]:
        own = sum((r[f"residual_{a}"] / r.get(f"sigma_{a}", 1.0)) ** 2 for a in "xy")
        squares[r["id"]] = squares.get(r["id"], 0.0) + own
    out = []
    for p in record["points"]:
        free, words = 2 * p["rays"] - 3, f"the misfit of its rays, {significant(p['misfit'])},"
        out.append(Residual(p["misfit"], math.sqrt(squares[p["id"]] / free), free, f"point {p['id']}", words))
    return out


def outlying(
    part: Mapping[str, Any], residuals: list[Residual], level: float, *, absolute: bool
) -> list[LargeResidual]:
    """Return residuals that are too large for the largest of one adjustment by chance, worst first.

    A residual is divided by its standard deviation, from the given one or, if this is larger or none is given, from the
    one that the other residuals show: externally studentised (Cook and Weisberg 1982, section 2.2.1). Without one
    observation, the sum of squares decreases by its quadratic form. Points of an intersection are independent: each is
    tested as a whole. No observation is excluded.

    Parameters
    ----------
    part : mapping
        ``m0`` and ``redundancy`` of the adjustment.
    residuals : list of Residual
    level : float
        Probability of any such residual among good ones.
    absolute : bool
        True if standard deviations were given.
    """
    if not residuals or part["m0"] is None:
        return []
    ratio, own = (np.array([getattr(row, name) for row in residuals], float) for name in ("ratio", "freedom"))
    chance, f = sidak(level, len(ratio)), part["redundancy"] - own
    squares = part["m0"] ** 2 * part["redundancy"] - ratio**2 * own
    others = np.sqrt(np.maximum(squares, 0.0) / np.maximum(f, 1.0))
    out = []
    for (size, w, n, place, what), scatter, left in zip(residuals, others.tolist(), f.tolist(), strict=True):
        given = absolute and scatter <= 1.0
        times = w if given else w / scatter if scatter > 0.0 else math.inf
        limit = chi_square_limit(n, chance) / n if given else f_quantile(n, max(left, 1.0), 1.0 - chance)
        if left >= 1.0 and size > ROUNDING and times**2 > float(limit):
            over = "its standard deviation" if given else "the standard deviation that the others show"
            out.append(LargeResidual(times, place, what, over))
    return sorted(out, key=lambda one: -one.times)
