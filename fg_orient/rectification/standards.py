"""Accuracy standards of maps and images: compliance, and the largest admissible scale.

NMAS (US National Map Accuracy Standards 1947): at most 10 % of the tested points off by more than 1/50 inch at
1:20 000 and smaller, 1/30 inch at larger scales. CMAS: circle of 90 %, 2.1460 times the mean RMSE of both axes (FGDC
1998, appendix 3-D). NSSDA (FGDC-STD-007.3-1998): circle of 95 %. ASPRS 1990: RMSE of each axis within 0.25 mm at
scale, classes 2 and 3 twice and three times that. ASPRS 2014 (edition 1): classes by the RMSE of each axis. ASPRS 2023
(edition 2): classes by the radial RMSE, the error of the check points included, at least 30 of them. EMAS (ASCE 1983)
is left out, because no source of its limits was available.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import number, positive
from fg_orient.rectification.fit import plain_rmse

Array = npt.NDArray[np.float64]

INCH_M: Final = 0.0254
#: NMAS at map scale: at 1:20 000 and smaller, and at larger scales.
NMAS_SMALL_M: Final = INCH_M / 50.0
NMAS_LARGE_M: Final = INCH_M / 30.0
NMAS_LIMIT_SCALE: Final = 20_000.0
#: Share of points that may lie beyond the limit of NMAS.
NMAS_SHARE: Final = 0.1
#: Radius of 90 % and of 95 % by the standard deviation of each axis of a circular normal distribution.
CMAS_FACTOR: Final = 2.1460
NSSDA_FACTOR: Final = 2.4477
ASPRS_1990_M: Final = 0.25e-3
#: NSSDA's formula for a circle holds from this ratio of the axes' RMSEs on.
CIRCULAR_RATIO: Final = 0.6
#: Least numbers of check points.
NSSDA_POINTS: Final = 20
ASPRS_2023_POINTS: Final = 30
NAMES: Final = ("NMAS", "CMAS", "NSSDA", "ASPRS-1990", "ASPRS-2014", "ASPRS-2023")


@dataclass(frozen=True)
class StandardCompliance:
    """Compliance with a standard.

    Parameters
    ----------
    standard : str
        One of ``NAMES``.
    measure : str
        Compared quantity in words.
    value_m, limit_m : float
        Compared value and its limit; nan without a given scale or class.
    passed : bool or None
        None without a given scale or class, or if the standard has no limit.
    largest_scale : float
        Denominator of the largest scale that would pass; nan for standards without scales, and for errors of 0, which
        pass at every scale.
    remarks : tuple of str
        Doubts, and further demands of the standard.
    """

    standard: str
    measure: str
    value_m: float
    limit_m: float
    passed: bool | None
    largest_scale: float
    remarks: tuple[str, ...] = ()


def nmas_limit_m(scale: float) -> float:
    """Limit of NMAS on the ground at 1:scale, m; InputError if the scale is not above 0."""
    positive("scale", scale, "denominator")
    return scale * (NMAS_SMALL_M if scale >= NMAS_LIMIT_SCALE else NMAS_LARGE_M)


def effective_resolution_m(scale: float) -> float:
    """Half a millimetre at map scale (İpbüker 1994, summary), m; InputError if the scale is not above 0."""
    return 0.5e-3 * positive("scale", scale, "denominator")


def cmas_m(rmse_x_m: float, rmse_y_m: float) -> float:
    """Radius of 90 %: 2.1460 (RMSE_x + RMSE_y)/2, m; InputError if an RMSE is below 0 or not finite."""
    return CMAS_FACTOR * 0.5 * sum(number("RMSE", v, "m", least=0.0) for v in (rmse_x_m, rmse_y_m))


def nssda_m(rmse_x_m: float, rmse_y_m: float) -> float:
    """Radius of 95 %: 2.4477 (RMSE_x + RMSE_y)/2, m; InputError if an RMSE is below 0 or not finite."""
    return NSSDA_FACTOR * 0.5 * sum(number("RMSE", v, "m", least=0.0) for v in (rmse_x_m, rmse_y_m))


def _largest_nmas_scale(limit_at_90_m: float) -> tuple[float, str]:
    """Denominator of the largest scale at which an error is within NMAS, and intermediate scales that fail."""
    if limit_at_90_m == 0.0:
        return np.nan, ""
    large, small = limit_at_90_m / NMAS_LARGE_M, limit_at_90_m / NMAS_SMALL_M
    if large >= NMAS_LIMIT_SCALE:
        return small, ""
    gap = f"not from 1:20000 to 1:{small:.0f}, where the limit is 1/50 inch" if small > NMAS_LIMIT_SCALE else ""
    return large, gap


def check_accuracy(
    differences_m: npt.ArrayLike, *, scale: float | None = None, class_m: float | None = None,
    check_point_rmse_m: float = 0.0, standards: tuple[str, ...] = NAMES,
) -> tuple[StandardCompliance, ...]:  # fmt: skip
    """Assess tested points by the standards.

    Parameters
    ----------
    differences_m : (n, 2) array_like
        Measured minus true, east and north, of well-defined points that were not used to make the map.
    scale : float, optional
        Denominator of the assessed map scale (NMAS, CMAS, ASPRS 1990).
    class_m : float, optional
        Assessed accuracy class (ASPRS 2014, 2023), m.
    check_point_rmse_m : float
        Radial RMSE of the check points' own coordinates (ASPRS 2023), 0 or more.
    standards : tuple of str
        Some of ``NAMES``.

    Raises
    ------
    InputError
        Invalid differences, an unknown standard, a scale or class that is not above 0, an RMSE below 0.
    """
    d = np.atleast_2d(np.asarray(differences_m, float))
    if d.ndim != 2 or d.shape[1:] != (2,) or not len(d) or not np.isfinite(d).all():
        raise InputError.of("rectify.differences", value=f"shape {d.shape}")
    x, y, _ = plain_rmse(d)
    assessed = assess_rmse(x, y, scale=scale, class_m=class_m, check_point_rmse_m=check_point_rmse_m,
                           standards=tuple(name for name in standards if name != "NMAS"), n_points=len(d))  # fmt: skip
    if "NMAS" not in standards:
        return assessed
    return tuple(sorted((_nmas(d, scale), *assessed), key=lambda one: NAMES.index(one.standard)))


def assess_rmse(
    rmse_x_m: float, rmse_y_m: float, *, scale: float | None = None, class_m: float | None = None,
    check_point_rmse_m: float = 0.0, standards: tuple[str, ...] = NAMES[1:], n_points: int | None = None,
) -> tuple[StandardCompliance, ...]:  # fmt: skip
    """Assess the RMSEs alone, without NMAS, which needs the points; CMAS replaces it.

    Parameters and errors as in :func:`check_accuracy`; ``n_points`` only adds remarks.
    """
    for place, value, unit in (("<scale>", scale, "denominator"), ("<class_m>", class_m, "m")):
        if value is not None:
            positive(place, value, unit)
    for place, rmse in (("RMSE", rmse_x_m), ("RMSE", rmse_y_m), ("<check_point_rmse>", check_point_rmse_m)):
        number(place, rmse, "m", least=0.0)
    unknown = [name for name in standards if name not in NAMES[1:]]
    if unknown:
        raise InputError.of("rectify.standard", option="standard", value=unknown[0], known=", ".join(NAMES))
    x, y = rmse_x_m, rmse_y_m
    assess: dict[str, Callable[[], StandardCompliance]] = {
        "CMAS": lambda: _cmas(x, y, scale), "NSSDA": lambda: _nssda(x, y, n_points),
        "ASPRS-1990": lambda: _asprs_1990(x, y, scale), "ASPRS-2014": lambda: _asprs_2014(x, y, class_m, n_points),
        "ASPRS-2023": lambda: _asprs_2023(x, y, class_m, check_point_rmse_m, n_points),
    }  # fmt: skip
    return tuple(assess[name]() for name in standards)


def _few(n_points: int | None, least: int) -> tuple[str, ...]:
    return (f"{n_points} points; the standard asks for {least}",) if n_points is not None and n_points < least else ()


def _nmas(differences: Array, scale: float | None) -> StandardCompliance:
    errors = np.sort(np.hypot(*differences.T))
    beyond = int(np.floor(NMAS_SHARE * len(errors) + 1e-9))
    remark = f"{beyond} of {len(errors)} points may lie beyond the limit"
    value = float(errors[len(errors) - 1 - beyond])
    return _by_nmas_limit("NMAS", "largest error of the better 90 %", value, scale, (remark,))


def _cmas(x: float, y: float, scale: float | None) -> StandardCompliance:
    return _by_nmas_limit("CMAS", "radius of 90 % by the RMSE", cmas_m(x, y), scale, _round(x, y))


def _by_nmas_limit(
    name: str, measure: str, value: float, scale: float | None, remarks: tuple[str, ...]
) -> StandardCompliance:
    largest, gap = _largest_nmas_scale(value)
    limit = np.nan if scale is None else nmas_limit_m(scale)
    passed = None if scale is None else bool(value <= limit)
    return StandardCompliance(name, measure, value, limit, passed, largest, (*remarks, *((gap,) if gap else ())))


def _round(x: float, y: float) -> tuple[str, ...]:
    """Remark on RMSEs too different for a circle."""
    low, high = sorted((x, y))
    return () if low >= CIRCULAR_RATIO * high else (f"RMSEs {x:.3g} and {y:.3g} m: too different for a circle",)


def _nssda(x: float, y: float, n_points: int | None) -> StandardCompliance:
    remarks = ("reported, not passed: the standard has no limit", *_round(x, y), *_few(n_points, NSSDA_POINTS))
    return StandardCompliance("NSSDA", "radius of 95 % by the RMSE", nssda_m(x, y), np.nan, None, np.nan, remarks)


def _asprs_1990(x: float, y: float, scale: float | None) -> StandardCompliance:
    value = max(x, y)
    largest, limit = value / ASPRS_1990_M if value > 0.0 else np.nan, np.nan
    remarks: tuple[str, ...] = ()
    passed = None
    if scale is not None:
        limit = scale * ASPRS_1990_M
        rank = int(np.ceil(value / limit - 1e-12)) if value > 0.0 else 1
        passed = rank <= 1
        if rank in (2, 3):
            remarks = (f"class {rank} is met",)
        if scale > NMAS_LIMIT_SCALE:
            remarks = (*remarks, "written for 1:20000 and larger scales")
    return StandardCompliance("ASPRS-1990", "larger RMSE of an axis, class 1", value, limit, passed, largest, remarks)


def _smallest_class(value_m: float) -> str:
    """Four digits, rounded up: a class below the value is not met."""
    text = f"{100.0 * value_m:.4g}"
    text = text if float(text) >= 100.0 * value_m else f"{100.05 * value_m:.4g}"
    return f"{text} cm is the smallest class that is met"


def _asprs_2014(x: float, y: float, class_m: float | None, n_points: int | None) -> StandardCompliance:
    return _by_class("ASPRS-2014", "larger RMSE of an axis", max(x, y), class_m, _few(n_points, NSSDA_POINTS))


def _asprs_2023(x: float, y: float, class_m: float | None, own_m: float, n_points: int | None) -> StandardCompliance:
    value = float(np.sqrt(x * x + y * y + own_m * own_m))
    remarks = _few(n_points, ASPRS_2023_POINTS)
    if own_m == 0.0:
        remarks = (*remarks, "the error of the check points is taken as 0")
    return _by_class("ASPRS-2023", "radial RMSE with that of the check points", value, class_m, remarks)


def _by_class(
    name: str, measure: str, value: float, class_m: float | None, remarks: tuple[str, ...]
) -> StandardCompliance:
    limit, passed = (np.nan, None) if class_m is None else (class_m, bool(value <= class_m))
    return StandardCompliance(name, measure, value, limit, passed, np.nan, (_smallest_class(value), *remarks))
