"""Mistakes that a transformation between image and map hides in its fit: a mirror image, and relief.

An exchange of two columns makes a mirror image, which an affine or polynomial transformation fits without larger
residuals. A plane transformation of hilly ground has residuals that follow the heights.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.distributions import f_tail
from fg_orient.model.errors import Finding, finding
from fg_orient.rectification.fit import STEP, TransformationFit

#: Residuals follow the heights if the probability of their correlation without relief is below this.
LEVEL: Final = 0.001
#: Smallest sine of the angle between the images of the two axes at which their order is determined.
LEAST_SINE: Final = 0.1
#: Heights contain no information if they differ from a linear function of the other columns by less than this share.
LEAST_REST: Final = 1e-6


def mistakes_in(fit: TransformationFit, heights: Array | None) -> list[Finding]:
    """Return findings on a mirror image, and on residuals of a plane transformation that follow the heights.

    Parameters
    ----------
    fit : TransformationFit
    heights : (n,) array or None
        Heights of the control points, m; None if they are unknown or part of the model.
    """
    out = []
    if handedness(fit) < 0.0:
        out.append(finding("rectify.mirrored"))
    if heights is not None:
        statistic, after = relief(fit, heights)
        if statistic > 0.0 and f_tail(2, fit.redundancy - 2, statistic) < LEVEL:
            out.append(finding("rectify.relief", before=fit.m0, after=after))
    return out


def handedness(fit: TransformationFit) -> float:
    """Return 1 if image and map have the same orientation at the centre of the points, -1 if one is mirrored.

    The result is 0 if the points do not determine this, and for Helmert's transformation, which cannot mirror. Lines
    run down and samples to the right; eastings run to the right and northings up.
    """
    if fit.model.shared_scale or any(reach.is_unknown for reach in fit.reaches[: fit.model.dimension - 1]):
        return 0.0
    source = fit.points.source[:, : fit.model.dimension]
    centre, step = source.mean(axis=0), STEP * np.eye(source.shape[1])[:2] * np.ptp(source, axis=0).max()
    ends = fit.transformation.apply(np.concatenate([centre + step, centre - step]))
    along, across = ends[:2] - ends[2:]
    size = float(np.linalg.norm(along) * np.linalg.norm(across))
    sine = float(along[0] * across[1] - along[1] * across[0]) / size if size > 0.0 else 0.0
    right = -1.0 if fit.model.dimension == 2 else 1.0  # (sample, line) is left-handed, (line, sample) right-handed
    return float(np.sign(right * sine)) if abs(sine) > LEAST_SINE else 0.0


def relief(fit: TransformationFit, heights: Array) -> tuple[float, float]:
    """Return the F statistic of a term of the height in both coordinates, and m0 with these terms.

    The fit is linearised. The statistic is 0 if redundancy or heights do not allow the test.
    """
    if fit.redundancy <= 2:
        return 0.0, fit.m0
    columns = np.einsum("n,nc,cd->ncd", heights - heights.mean(), 1.0 / fit.points.sigma, np.eye(2)).reshape(-1, 2)
    base = np.linalg.qr(fit.design)[0]
    rest = columns - base @ (base.T @ columns)
    if not (np.linalg.norm(rest, axis=0) > LEAST_REST * np.linalg.norm(columns, axis=0)).all():
        return 0.0, fit.m0
    explained = float(np.sum((np.linalg.qr(rest)[0].T @ fit.whitened.ravel()) ** 2))
    left, freedom = max(fit.weighted_squares - explained, 0.0), fit.redundancy - 2
    if left <= 0.0:
        return 0.0, fit.m0
    return 0.5 * explained / (left / freedom), float(np.sqrt(left / freedom))
