"""Comparison of the heights of points with a reference elevation model.

Differences are point minus model. In addition to mean and standard deviation there are measures that are
robust against blunders and vegetation: median, NMAD = 1.4826 median|d - median| and quantiles of |d| (Höhle,
Höhle 2009). The differences caused by a horizontal shift of the points depend on slope and aspect (Nuth, Kääb
2011): ``d = U - s_E E - s_N N`` with the slopes s of the model. The shift is estimated by least squares. In
each step the model is read again at the shifted positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from factors.geometry import ellipsoid
from fg_orient.geodesy import enu_from_ecef
from fg_orient.model.block import Block
from fg_orient.model.distributions import MAD, t_quantile
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.surface import RasterDem

#: Half the distance over which slopes are computed.
SLOPE_M: Final = 15.0
#: Differences farther from the median than this multiple of the NMAD are not used for the shift.
REACH: Final = 3.0
MAX_STEPS, STEP_M = 30, 1e-3
#: After this number of steps the selection of points is kept. Otherwise points near the limit would change in
#: every step.
CHOOSING_STEPS: Final = 8
LEAST_POINTS: Final = 10
#: East, North and Up are not separable if the condition number of the scaled slopes and the constant exceeds this.
CONDITION: Final = 1e3
CONFIDENCE: Final = 0.95


@dataclass(frozen=True)
class Shift:
    """Shift of the points relative to the model; the points minus this shift have no systematic differences.

    Parameters
    ----------
    enu_m, sigma_m : (3,) arrays
        Shift East, North, Up and its standard deviations, from the scatter of the differences.
    n : int
        Number of points used.
    limit : float
        A component is significant if |shift| / sigma exceeds this limit (Student, 95 %).
    rmse_before_m, rmse_after_m : float
        RMSE of the differences of these points.
    """

    enu_m: Array
    sigma_m: Array
    n: int
    limit: float
    rmse_before_m: float
    rmse_after_m: float

    @property
    def significant(self) -> Mask:
        """Components (3,) that differ significantly from zero."""
        return np.asarray(np.abs(self.enu_m) > self.limit * self.sigma_m)


@dataclass(frozen=True)
class DemComparison:
    """Result of :func:`compare_dem`.

    Parameters
    ----------
    difference_m : (n,) array
        Point minus model, for points inside the model.
    n_outside : int
        Number of points for which the model has no height.
    shift : Shift or None
        Shift; None if it is not determined, for the reason in ``unavailable``.
    """

    difference_m: Array
    n_outside: int
    shift: Shift | None
    unavailable: Finding | None = None

    def statistics(self) -> dict[str, float | int]:
        """Return the statistics with the keys of the record; statistics that need more points are absent."""
        d = self.difference_m
        out: dict[str, float | int] = {"n": len(d), "n_outside": self.n_outside}
        if not len(d):
            return out
        out |= {
            "mean_m": float(d.mean()),
            "rmse_m": float(np.sqrt(np.mean(d**2))),
            "max_m": float(np.abs(d).max()),
            "median_m": float(np.median(d)),
        }
        if len(d) > 1:
            out |= {"sd_m": float(d.std(ddof=1)), "nmad_m": nmad(d)}
            out |= {f"q{name}_m": float(np.quantile(np.abs(d), q)) for name, q in (("68_3", 0.683), ("95", 0.95))}
        return out

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the record."""
        s, axes = self.shift, ("east", "north", "up")
        shift = (
            None
            if s is None
            else {
                **{f"{a}_m": float(v) for a, v in zip(axes, s.enu_m, strict=True)},
                **{f"sigma_{a}_m": float(v) for a, v in zip(axes, s.sigma_m, strict=True)},
                "significant": [a for a, yes in zip(axes, s.significant, strict=True) if yes],
                "n": s.n,
                "rmse_before_m": s.rmse_before_m,
                "rmse_after_m": s.rmse_after_m,
            }
        )
        return {**self.statistics(), "shift": shift, **as_record([self.unavailable] if self.unavailable else [])}


def nmad(values: Array) -> float:
    """Return the normalised median absolute deviation, a standard deviation that is robust against a few blunders."""
    return MAD * float(np.median(np.abs(values - np.median(values))))


def compare_dem(ground_m: Array, dem: HeightSurface) -> DemComparison:
    """Compare points (n, 3), ECEF m, with an elevation model of ellipsoidal heights.

    Rows that are not finite are ignored. InputError: all points are outside the model.
    """
    ground = np.ascontiguousarray(ground_m[np.isfinite(ground_m).all(axis=1)])
    difference = _differences(ground, dem)
    over = np.isfinite(difference)
    if not over.any():
        raise InputError.of("accuracy.dem_outside", file=dem.path, value=f"{len(ground)} points")
    shift, unavailable = _shift(ground[over], dem)
    return DemComparison(difference[over], int((~over).sum()), shift, unavailable)


def compare_points(
    block: Block, ground_m: Array, dem: HeightSurface | str | Path, role: str | None = None
) -> DemComparison:
    """Compare all points of a block, or the points of one role, with an elevation model or a raster file.

    Parameters
    ----------
    block : Block
    ground_m : (N, 3) array
        Points of the block, ECEF, m.
    dem : RasterDem or path
        Ellipsoidal heights, m.
    role : str, optional
        "control", "check" or "tie"; default: all points.

    Raises
    ------
    InputError
        Errors of :func:`compare_dem`; a local coordinate system; no points of this role; a raster that cannot be read
        or whose heights are not ellipsoidal.
    """
    if not block.georeferenced:
        raise InputError.of("accuracy.local", place="dem", value=block.name)
    rows = rows_of_role([given.value for given in block.points.roles], role)
    return compare_dem(ground_m[rows], RasterDem(dem) if isinstance(dem, str | Path) else dem)


def rows_of_role(roles: Sequence[str], role: str | None) -> list[int]:
    """Return the rows of the points of a role, of all points for None; InputError if there are no such points."""
    if role is not None and role not in roles:
        raise InputError.of("accuracy.role", place="role", value=role, known=", ".join(sorted(set(roles))))
    return [k for k, given in enumerate(roles) if role in (None, given)]


def _differences(ground: Array, dem: HeightSurface) -> Array:
    """Return height of the points minus height of the model (n,)."""
    lon, lat, height = ellipsoid.geodetic_array(ground).T
    return np.asarray(height - dem.height_m(np.degrees(lon), np.degrees(lat)))


def _axes(ground: Array) -> Array:
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(ground)).T
    return enu_from_ecef(lon, lat)


def _design(ground: Array, axes: Array, dem: HeightSurface) -> Array:
    """Return the derivatives (n, 3) of the difference with respect to a shift East, North, Up."""
    slopes = [
        (_differences(ground + SLOPE_M * axes[:, k], dem) - _differences(ground - SLOPE_M * axes[:, k], dem))
        / (2.0 * SLOPE_M)
        for k in range(2)
    ]
    return np.stack([*slopes, np.ones(len(ground))], axis=1)


def _near(d: Array, known: Mask) -> Mask:
    """Return which differences are known and lie within :data:`REACH` NMAD of their median."""
    if not known.any():
        return known
    reach = max(REACH * nmad(d[known]), STEP_M)
    return np.asarray(known & (np.abs(d - np.median(d[known])) <= reach))


def _shift(ground: Array, dem: HeightSurface) -> tuple[Shift | None, Finding | None]:
    """Estimate the shift by Gauss-Newton.

    Each step excludes blunders by the NMAD. Return None and a reason if this is impossible.
    """
    axes, shift, kept = _axes(ground), np.zeros(3), np.zeros(len(ground), bool)
    for k in range(MAX_STEPS):
        moved = ground - np.einsum("k,nkj->nj", shift, axes)
        d, a = _differences(moved, dem), _design(moved, axes, dem)
        known = np.isfinite(d) & np.isfinite(a).all(axis=1)
        kept = _near(d, known) if k < CHOOSING_STEPS else kept & known
        n = int(kept.sum())
        if n < LEAST_POINTS:
            return None, finding("unavailable.slopes", n=n, least=LEAST_POINTS)
        length = np.linalg.norm(a[kept], axis=0)
        if not length.all() or np.linalg.cond(a[kept] / length) > CONDITION:
            return None, finding("unavailable.aspects")
        step = np.linalg.lstsq(a[kept], d[kept], rcond=None)[0]
        shift = shift + step
        if k >= CHOOSING_STEPS and np.abs(step).max() < STEP_M:
            break
    else:
        return None, finding("unavailable.steps", steps=MAX_STEPS)
    rest = d[kept] - a[kept] @ step
    sigma = np.sqrt(rest @ rest / (n - 3) * np.linalg.inv(a[kept].T @ a[kept]).diagonal())
    before = _differences(ground, dem)[kept]
    return Shift(
        shift,
        sigma,
        n,
        float(t_quantile(n - 3, 0.5 + CONFIDENCE / 2.0)),
        float(np.sqrt(np.mean(before**2))),
        float(np.sqrt(np.mean(rest**2))),
    ), None
