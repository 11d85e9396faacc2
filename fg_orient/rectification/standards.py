"""Accuracy standards of maps and images: compliance, and the largest admissible scale.

- NMAS (US National Map Accuracy Standards 1947): at most 10 % of the tested points may have an error above 1/50 inch at
  1:20 000 and smaller scales, or above 1/30 inch at larger scales.
- CMAS: radius of the 90 % circle, 2.1460 times the mean RMSE of both axes (FGDC 1998, appendix 3-D).
- NSSDA (FGDC-STD-007.3-1998): radius of the 95 % circle.
- ASPRS 1990: the RMSE of each axis is at most 0.25 mm at map scale; classes 2 and 3 allow twice and three times this.
- ASPRS 2014 (edition 1): classes by the RMSE of each axis.
- ASPRS 2023 (edition 2): classes by the radial RMSE including the error of the check points; at least 30 points.

EMAS (ASCE 1983) is not included, because no source of its limits was available.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import number, positive
from fg_orient.rectification.fit import plain_rmse
from fg_orient.rectification.options import AccuracyOptions

INCH_M: Final = 0.0254
#: Limit of NMAS in the map, m, for scales of 1:20 000 and smaller.
NMAS_SMALL_M: Final = INCH_M / 50.0
#: Limit of NMAS in the map, m, for larger scales.
NMAS_LARGE_M: Final = INCH_M / 30.0
NMAS_LIMIT_SCALE: Final = 20_000.0
#: Share of points that may lie beyond the limit of NMAS.
NMAS_SHARE: Final = 0.1
#: Factors from the standard deviation of each axis of a circular normal distribution to the radius of 90 % and of 95 %.
CMAS_FACTOR: Final = 2.1460
NSSDA_FACTOR: Final = 2.4477
ASPRS_1990_M: Final = 0.25e-3
#: NSSDA's formula for a circle is valid if the ratio of the RMSE of both axes is at least this.
CIRCULAR_RATIO: Final = 0.6
#: Minimum numbers of check points.
NSSDA_POINTS: Final = 20
ASPRS_2023_POINTS: Final = 30
#: Quantity that each standard compares, in words.
MEASURES: Final = {
    "NMAS": "largest error of the better 90 %", "CMAS": "radius of 90 % by the RMSE",
    "NSSDA": "radius of 95 % by the RMSE", "ASPRS-1990": "larger RMSE of an axis, class 1",
    "ASPRS-2014": "larger RMSE of an axis", "ASPRS-2023": "radial RMSE with that of the check points",
}  # fmt: skip


@dataclass(frozen=True)
class StandardCompliance:
    """Compliance with a standard.

    Parameters
    ----------
    standard : str
        Name of the standard.
    measure : str
        Compared quantity in words.
    value_m, limit_m : float
        Compared value and its limit; nan without a given scale or class.
    passed : bool or None
        None without a given scale or class, or if the standard has no limit.
    largest_scale : float
        Denominator of the largest scale that would pass; nan for standards without
        scales, and for errors of 0, which pass at every scale.
    remarks : tuple of str
        Doubts, and further requirements of the standard.
    """

    standard: str
    measure: str
    value_m: float
    limit_m: float
    passed: bool | None
    largest_scale: float
    remarks: tuple[str, ...] = ()


def nmas_limit_m(scale: float) -> float:
    """Return the limit of NMAS on the ground at 1:scale, m; InputError if the scale is not above 0.

    Parameters
    ----------
    scale : float
        Denominator of the map scale.
    """
    positive("scale", scale, "denominator")
    return scale * (NMAS_SMALL_M if scale >= NMAS_LIMIT_SCALE else NMAS_LARGE_M)


def effective_resolution_m(scale: float) -> float:
    """Return the effective resolution, half a millimetre at map scale (İpbüker 1994, summary), m."""
    return 0.5e-3 * positive("scale", scale, "denominator")


def cmas_m(rmse_x_m: float, rmse_y_m: float) -> float:
    """Return the radius of 90 %: 2.1460 (RMSE_x + RMSE_y)/2, m.

    Raise InputError if an RMSE is below 0 or not finite.
    """
    return CMAS_FACTOR * 0.5 * sum(number("RMSE", v, "m", least=0.0) for v in (rmse_x_m, rmse_y_m))


def nssda_m(rmse_x_m: float, rmse_y_m: float) -> float:
    """Return the radius of 95 %: 2.4477 (RMSE_x + RMSE_y)/2, m; InputError if an RMSE is below 0 or not finite.

    Parameters
    ----------
    rmse_x_m, rmse_y_m : float
        RMSE of each axis at the check points, m.
    """
    return NSSDA_FACTOR * 0.5 * sum(number("RMSE", v, "m", least=0.0) for v in (rmse_x_m, rmse_y_m))


def _largest_nmas_scale(limit_at_90_m: float) -> tuple[float, str]:
    """Return the denominator of the largest scale at which an error meets NMAS, and smaller scales that fail."""
    if limit_at_90_m == 0.0:
        return np.nan, ""
    large, small = limit_at_90_m / NMAS_LARGE_M, limit_at_90_m / NMAS_SMALL_M
    if large >= NMAS_LIMIT_SCALE:
        return small, ""
    gap = f"not from 1:20000 to 1:{small:.0f}, where the limit is 1/50 inch" if small > NMAS_LIMIT_SCALE else ""
    return large, gap


def check_accuracy(differences_m: npt.ArrayLike, **options: Any) -> tuple[StandardCompliance, ...]:
    """Assess tested points by the standards.

    Parameters
    ----------
    differences_m : (n, 2) array_like
        Measured minus true, east and north, of well-defined points that were not used to make the map.
    **options
        Fields of :class:`fg_orient.rectification.options.AccuracyOptions`.

    Raises
    ------
    InputError
        The differences or options are invalid.
    """
    d = np.atleast_2d(np.asarray(differences_m, float))
    if d.ndim != 2 or d.shape[1:] != (2,) or not len(d) or not np.isfinite(d).all():
        raise InputError.of("rectify.differences", value=f"shape {d.shape}")
    chosen, (x, y, _), n = AccuracyOptions(**options), plain_rmse(d), len(d)
    own = chosen.check_point_rmse_m

    def few(least: int) -> tuple[str, ...]:
        return (f"{n} points; the standard asks for {least}",) if n < least else ()

    errors, beyond = np.sort(np.hypot(*d.T)), int(np.floor(NMAS_SHARE * n + 1e-9))
    unequal = f"RMSEs {x:.3g} and {y:.3g} m: too different for a circle"
    circle = () if min(x, y) >= CIRCULAR_RATIO * max(x, y) else (unequal,)
    exact = ("the error of the check points is taken as 0",) if own == 0.0 else ()
    no_limit = "reported, not passed: the standard has no limit"
    values: dict[str, tuple[float, tuple[str, ...]]] = {
        "NMAS": (float(errors[n - 1 - beyond]), (f"{beyond} of {n} points may lie beyond the limit",)),
        "CMAS": (cmas_m(x, y), circle),
        "NSSDA": (nssda_m(x, y), (no_limit, *circle, *few(NSSDA_POINTS))),
        "ASPRS-1990": (max(x, y), ()),
        "ASPRS-2014": (max(x, y), few(NSSDA_POINTS)),
        "ASPRS-2023": (float(np.sqrt(x * x + y * y + own * own)), (*few(ASPRS_2023_POINTS), *exact)),
    }
    return tuple(_compliance(name, *value, chosen) for name, value in values.items() if name in chosen.standards)


def _compliance(name: str, value: float, remarks: tuple[str, ...], options: AccuracyOptions) -> StandardCompliance:
    """Compare a value with the limit of its standard."""
    scale, limit, largest, tolerance = options.scale, np.nan, np.nan, 0.0
    if name in ("NMAS", "CMAS"):
        largest, gap = _largest_nmas_scale(value)
        limit = np.nan if scale is None else nmas_limit_m(scale)
        remarks = (*remarks, *((gap,) if gap else ()))
    elif name == "ASPRS-1990":
        largest, tolerance = value / ASPRS_1990_M if value > 0.0 else np.nan, 1e-12
        if scale is not None:
            limit = scale * ASPRS_1990_M
            rank = int(np.ceil(value / limit - tolerance))
            remarks = (f"class {rank} is met",) if rank in (2, 3) else ()
            remarks += ("written for 1:20000 and larger scales",) if scale > NMAS_LIMIT_SCALE else ()
    elif name != "NSSDA":
        limit = np.nan if options.class_m is None else options.class_m
        remarks = (_smallest_class(value), *remarks)
    passed = None if np.isnan(limit) else bool(value <= limit * (1.0 + tolerance))
    return StandardCompliance(name, MEASURES[name], value, limit, passed, largest, remarks)


def _smallest_class(value_m: float) -> str:
    """Return the smallest class that is met, with four digits.

    The class is rounded up, because a smaller class is not met.
    """
    text = f"{100.0 * value_m:.4g}"
    text = text if float(text) >= 100.0 * value_m else f"{100.05 * value_m:.4g}"
    return f"{text} cm is the smallest class that is met"
