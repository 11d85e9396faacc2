"""How far control points reach in each direction, seen by what they say of the transformation there.

Points within their noise of a straight line give an adjustment that converges and means nothing beside the line. For
each principal direction of the points in the source system (centred, one scale) the standard deviation of the scale of
the transformation is compared with that along the points: for an affine transformation the ratio is that of the
extents, the condition number of the centred design. No unit and no size of the scene enters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Ratio of standard deviations beyond which a direction is called weak: a strip 20 times longer than wide.
WEAK_RATIO: Final = 20.0
#: Noise by the root mean square width of the points beyond which a weak direction is not determined at all. Of points
#: on a line it is 0.7 in the mean whatever their number, if all noise is that of the source; half of it is left to
#: chance.
NOISE_SHARE: Final = 1.0 / 3.0
#: Component of a direction below which it is not worth a word: 3 degrees.
LEAST_SHARE: Final = 0.05
#: Half the step of differences, by the extent of the points.
STEP: Final = 1e-3


@dataclass(frozen=True)
class Reach:
    """One principal direction of the control points, not the longest.

    Parameters
    ----------
    direction : (k,) array
        Unit vector of the source system.
    ratio : float
        Standard deviation of the scale along it by that along the longest.
    sigma : float
        Standard deviation of the scale along it by the scale along the longest.
    noise : float
        Noise of a point, brought to the source system, by the root mean square extent in this direction.
    """

    direction: Array
    ratio: float
    sigma: float
    noise: float

    @property
    def is_weak(self) -> bool:
        """Tell whether the points are narrow in this direction."""
        return self.ratio > WEAK_RATIO

    @property
    def is_unknown(self) -> bool:
        """Tell whether the points are so narrow that their noise hides how far they reach."""
        return self.is_weak and self.noise > NOISE_SHARE

    def words(self, names: tuple[str, ...]) -> str:
        """Direction in the names of the source coordinates: "line", or "0.71 sample - 0.71 line"."""
        first = self.direction[np.argmax(np.abs(self.direction))]
        parts = [
            (v, name) for v, name in zip(self.direction * np.sign(first), names, strict=True) if abs(v) >= LEAST_SHARE
        ]
        if len(parts) == 1:
            return parts[0][1]
        rest = (f" {'-' if v < 0.0 else '+'} {abs(v):.2f} {name}" for v, name in parts[1:])
        return f"{parts[0][0]:.2f} {parts[0][1]}" + "".join(rest)


def reaches(
    source: Array, value_at: Callable[[Array], Array], rows_at: Callable[[Array], Array], cofactors: Array, m0: float
) -> tuple[Reach, ...]:
    """Judge all principal directions but the longest.

    Parameters
    ----------
    source : (n, k) array
        Control points.
    value_at, rows_at : callable
        Target (m, 2) of places (m, k), and its derivatives (m, 2, u) with respect to the coefficients.
    cofactors : (u, u) array
        Of the coefficients.
    m0 : float
    """
    centre = source.mean(axis=0)
    _, extent, axes = np.linalg.svd(source - centre, full_matrices=False)
    step = STEP * extent[0] / np.sqrt(len(source))
    ends = np.concatenate([centre + step * axes, centre - step * axes])
    values, rows = (np.asarray(f(ends)).reshape(2, len(axes), 2, -1) for f in (value_at, rows_at))
    scale = float(np.linalg.norm((values[0, 0] - values[1, 0]) / (2.0 * step)))
    slopes = (rows[0] - rows[1]) / (2.0 * step)
    sigma = np.sqrt(0.5 * np.einsum("kij,jl,kil->k", slopes, cofactors, slopes))
    share = m0 * sigma[1:] / scale
    noise = np.sqrt(len(source)) * share  # a slope is known to the noise by the extent and the root of the number
    return tuple(map(Reach, axes[1:], (sigma[1:] / sigma[0]).tolist(), share.tolist(), noise.tolist()))
