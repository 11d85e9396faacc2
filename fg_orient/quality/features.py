"""Statistics of control features (lines and splines): number of image points, redundancy and normalised misclosures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fg_orient.adjustment.dense import extra_blocks

if TYPE_CHECKING:
    from fg_orient.orientation.adjusted import AdjustmentResult


def feature_records(solution: AdjustmentResult) -> list[dict[str, Any]]:
    """Return one record for each control feature, in the order of the block.

    The residuals of an image point on a feature (line, sample, and both distances of its ground point from
    the feature) follow from one misclosure. Let v be these whitened residuals and r the sum of their
    redundancy numbers. Then ``w^2 = v^T v / r`` has a chi-square distribution with one degree of freedom, and
    w is the normalised misclosure with the given sigmas.

    Parameters
    ----------
    solution : AdjustmentResult

    Returns
    -------
    list of dict
        Keys: ``feature``; ``n``, number of image points; ``redundancy``, sum of their redundancy numbers; ``rms_w``,
        root mean square of their normalised residuals w; ``largest_w``, and the point and image to which it belongs.
        Numbers are None without redundancy numbers.
    """
    problem, known = solution.problem, solution.residuals
    if not problem.on_features:
        return []
    ids, o, on = problem.block.points.ids, problem.observations, problem.on_features
    row_of = {ids[j]: row for row, j in enumerate(o.point.tolist()) if ids[j] in on}
    by_feature: dict[str, list[tuple[float, float, str, str]]] = {}
    for k, extra in enumerate(problem.block.extra):
        point = getattr(extra, "unknowns", ("",))[0].partition(":")[2]
        if point not in row_of:
            continue
        row, square, free = row_of[point], np.nan, np.nan
        if known is not None:
            v = np.concatenate([known.v_image[row], extra_blocks(problem, extra, solution.state, jacobian=False)[0]])
            square, free = float(v @ v), float(np.trace(known.image[row]) + np.sum(known.extra[k]))
        image = problem.block.images[int(o.image[row])].id
        by_feature.setdefault(on[point][0], []).append((square, free, point, image))
    out = []
    for feature, rows in by_feature.items():
        square, free = np.array([row[:2] for row in rows]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            w = np.sqrt(square / free)
        known_w = bool(np.isfinite(w).any())
        worst = int(np.nanargmax(w)) if known_w else 0
        out.append(
            {
                "feature": feature,
                "n": len(rows),
                "redundancy": float(free.sum()) if known_w else None,
                "rms_w": float(np.sqrt(np.nanmean(w**2))) if known_w else None,
                "largest_w": float(w[worst]) if known_w else None,
                "point": rows[worst][2] if known_w else None,
                "image": rows[worst][3] if known_w else None,
            }
        )
    return out
