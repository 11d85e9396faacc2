"""Tests of the matches of each pair, sigmas, even distribution, and joining of matches to tie points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.formats.rasters import Place
from fg_orient.orientation.match.blocks import Counts, Matches, spread, variance_along
from fg_orient.orientation.match.coarse import Coarse
from fg_orient.orientation.match.consistency import Calibration, calibrate, fits_neighbours, trend_of
from fg_orient.orientation.match.options import MatchOptions

#: Limit of a y-parallax, in its calibrated standard deviations.
LIMIT: Final = 4.0
#: Smallest standard deviation of an image coordinate, px, because no measurement in images is more accurate.
LEAST_SIGMA_PX: Final = 0.01
#: Expected difference between neighbours along the curve after least-squares matching, px.
RELIEF_PX: Final = 1.0
#: Minimum number of matches of a pair.
FEWEST: Final = 20


@dataclass(frozen=True, eq=False)
class PairResult:
    """Accepted matches of a pair with their sigmas.

    Parameters
    ----------
    a, b : int
        Images.
    matches : Matches
        n accepted matches.
    variance_b, variance_a : (n, 2) arrays
        Variances of line and sample in each image, px^2.
    residual_px, variance_parallax : (n,) arrays
        Y-parallax minus its trend, and the variance of the y-parallax.
    record : dict
        Numbers for the report.
    """

    a: int
    b: int
    matches: Matches
    variance_b: Array
    variance_a: Array
    residual_px: Array
    variance_parallax: Array
    record: dict[str, Any]


def variance_across(matches: Matches) -> Array:
    """Return the variances (n,) of the y-parallaxes by least-squares matching, px^2."""
    across = np.stack([-matches.direction[:, 1], matches.direction[:, 0]], axis=1)
    return variance_along(matches.covariance, across)


def relief_variance(matches: Matches, factor: float) -> float:
    """Estimate the variance px^2 along the curves caused by relief in the windows, from differences to wider windows.

    The noise of a difference has the variance of the narrow window minus the variance of the wide window, as for any
    estimate minus a more efficient estimate (Hausman 1978).

    Parameters
    ----------
    matches : Matches
    factor : float
        Estimated factor of the standard deviations of least-squares matching.

    Returns
    -------
    float
        Variance, px^2; 0 if the differences are not larger than their noise.
    """
    noise = factor**2 * (variance_along(matches.covariance, matches.direction) - matches.wider_variance)
    excess = matches.wider_px**2 - np.maximum(noise, 0.0)
    limit = np.quantile(matches.wider_px**2, 0.995) if len(excess) else 0.0
    return max(float(np.mean(excess[matches.wider_px**2 <= limit])), 0.0)


def accept(
    a: int,
    b: int,
    matches: Matches,
    counts: Counts,
    coarse: Coarse,
    prior_sigma_px: float,
    matrix: Array,
    options: MatchOptions,
) -> PairResult | None:
    """Test the matches of a pair together; None if too few remain.

    Parameters
    ----------
    a, b : int
        Images.
    matches : Matches
    counts : Counts
    coarse : Coarse
    prior_sigma_px : float
        Prior standard deviation of the y-parallax.
    matrix : (2, 2) array
        Derivatives of a pixel of b by the pixel of a.
    options : MatchOptions
    """
    # features near the common border of two blocks may be rounded to the same pixel
    matches = matches.take(np.sort(np.unique(matches.pixel_a, axis=0, return_index=True)[1]))
    width = coarse.width_px()
    if len(matches.t) < FEWEST:
        return None
    along = matches.t * matches.half_px
    local = fits_neighbours(matches.pixel_a, along, RELIEF_PX)
    used = np.flatnonzero(local)
    trend = trend_of(matches.pixel_a[used], matches.parallax_px[used], width)
    if trend is None:
        return None
    residual = matches.parallax_px - trend.at(matches.pixel_a)
    formal = variance_across(matches)
    calibration = calibrate(residual[used], formal[used])
    sigma = np.sqrt(calibration.variance(formal))
    within = np.abs(residual) <= LIMIT * sigma
    good = np.flatnonzero(local & within)
    if len(good) < FEWEST:
        return None
    kept, sigma_y = matches.take(good), sigma[good]
    relief = relief_variance(kept, calibration.factor)
    ll, ls, ss = kept.covariance.T
    noise = calibration.factor**2 * np.array([[ll, ls], [ls, ss]]) + calibration.floor_px**2 * np.eye(2)[:, :, None]
    # each of two images gets one half of the variance of their difference
    full = 0.5 * (noise + relief * np.einsum("ni,nj->ijn", kept.direction, kept.direction))
    back = np.linalg.inv(matrix)
    in_a = np.einsum("ij,jkn,ik->ni", back, full, back)
    variance = np.stack([full[0, 0], full[1, 1]], axis=1)
    record = _record(matches, residual, sigma, local, within, coarse, calibration, relief, counts, prior_sigma_px, good)
    least = LEAST_SIGMA_PX**2
    return PairResult(
        a, b, kept, np.maximum(variance, least), np.maximum(in_a, least), residual[good], sigma_y**2, record
    )


def _record(
    matches: Matches,
    residual: Array,
    sigma: Array,
    local: Mask,
    within: Mask,
    coarse: Coarse,
    calibration: Calibration,
    relief: float,
    counts: Counts,
    prior_sigma_px: float,
    good: Index,
) -> dict[str, Any]:
    """Return the numbers of a pair; wrong matches are predicted from the matches in the band beyond the limit."""
    raw, width = matches.parallax_px[good], coarse.width_px()
    limit = LIMIT * sigma
    outside = int((local & ~within & (np.abs(residual) <= width)).sum())
    share = float(np.mean(np.minimum(limit / np.maximum(width - limit, 1e-6), 1.0)))
    return {
        "candidates_coarse": coarse.candidates,
        "matches_coarse": len(coarse.t),
        "reduction": coarse.factor,
        "band_prior_px": 3.0 * prior_sigma_px,
        "band_px": width,
        "y_parallax_prior_sigma_px": prior_sigma_px,
        "y_parallax_before_mean_px": float(raw.mean()),
        "y_parallax_before_rms_px": _rms(raw),
        "y_parallax_after_rms_px": _rms(residual[good]),
        "candidates": counts.candidates,
        "fit_neighbours": counts.neighbours,
        "least_squares": counts.fitted,
        "backward": counts.backward,
        "local_heights": int(local.sum()),
        "accepted": len(good),
        "beyond_limit": outside,
        "predicted_wrong": outside * share,
        "predicted_wrong_share": outside * share / max(len(good), 1),
        "sigma_factor": calibration.factor,
        "sigma_floor_px": calibration.floor_px,
        "sigma_relief_px": relief**0.5,
        "sigma_formal_rms_px": calibration.formal_rms_px,
        "nees_y_parallax": float(np.mean((residual[good] / sigma[good]) ** 2)),
        "correlation_median": float(np.median(matches.correlation[good])),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


# --- points --------------------------------------------------------------------------------------


class TiePoints(NamedTuple):
    """Image points of tie points.

    Parameters
    ----------
    image, point : (m,) int arrays
        Image and tie point of each image point.
    pixel, sigma_px : (m, 2) arrays
        Line and sample, and their standard deviations.
    """

    image: Index
    point: Index
    pixel: Array
    sigma_px: Array

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0


def tie_points(results: list[PairResult], places: tuple[Place, ...], options: MatchOptions) -> TiePoints:
    """Join the points of all pairs: the same pixel of a first image is one point in all images, evenly distributed.

    A cell of an image has at most ``points_per_cell`` points with each other image; points with most rays come first.

    Parameters
    ----------
    results : list of PairResult
        Accepted matches of all pairs.
    places : tuple of Place
        Position and size of the raster of each image.
    options : MatchOptions
        Options for cells and for points in each cell.

    Returns
    -------
    TiePoints
        Empty if there are no matches.
    """
    image, point, pixel, sigma, number = [], [], [], [], 0
    for a in sorted({r.a for r in results}):
        own = [r for r in results if r.a == a]
        keys, row = np.unique(np.concatenate([r.matches.pixel_a for r in own]), axis=0, return_inverse=True)
        row = row.ravel()
        which = np.repeat(np.arange(len(own)), [len(r.matches.t) for r in own])
        chosen = _chosen(keys, row, which, len(own), np.concatenate([r.matches.strength for r in own]),
                         places[a], options)  # fmt: skip
        new = np.full(len(keys), -1)
        new[chosen] = np.arange(len(chosen)) + number
        number += len(chosen)
        taken = new[row] >= 0
        count = np.bincount(row[taken], minlength=len(keys))[chosen]
        in_a = np.concatenate([r.variance_a for r in own])
        mean = np.stack([np.bincount(row[taken], in_a[taken, j], len(keys))[chosen] / count for j in (0, 1)], axis=1)
        image += [np.full(len(chosen), a), np.concatenate([np.full(len(r.matches.t), r.b) for r in own])[taken]]
        point += [new[chosen], new[row[taken]]]
        pixel += [keys[chosen], np.concatenate([r.matches.pixel_b for r in own])[taken]]
        sigma += [np.sqrt(mean), np.sqrt(np.concatenate([r.variance_b for r in own])[taken])]
    if not image:
        return TiePoints(np.empty(0, np.intp), np.empty(0, np.intp), np.empty((0, 2)), np.empty((0, 2)))
    numbers, of_image = np.concatenate(point), np.concatenate(image)
    order = np.lexsort((of_image, numbers))
    out = TiePoints(of_image[order], numbers[order], np.concatenate(pixel)[order], np.concatenate(sigma)[order])
    return out if options.sigma_px is None else out._replace(sigma_px=np.full_like(out.sigma_px, options.sigma_px))


def _chosen(
    keys: Array, row: Index, which: Index, n_pairs: int, strength: Array, place: Place, options: MatchOptions
) -> Index:
    """Return the rows of the pixels that become points."""
    rays = np.bincount(row, minlength=len(keys))
    best = np.zeros(len(keys))
    np.maximum.at(best, row, strength)
    seen = np.zeros((len(keys), n_pairs), bool)
    seen[row, which] = True
    size = np.array([place.rows, place.columns]) / options.cells
    cell = np.floor((keys - [place.line, place.sample]) / size).astype(int)
    number = cell[:, 0] * options.cells + cell[:, 1]
    order = np.argsort(number, kind="stable")
    kept = []
    for rows in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        quota = np.full(n_pairs, options.points_per_cell)
        rank = 1e3 * rays[rows] + best[rows] / max(float(best[rows].max()), 1e-12)
        for k in spread(keys[rows], rank, options.distance_px, len(rows)).tolist():
            if (quota[seen[rows[k]]] > 0).any():
                quota[seen[rows[k]]] -= 1
                kept.append(int(rows[k]))
    return np.array(sorted(kept), np.intp)
