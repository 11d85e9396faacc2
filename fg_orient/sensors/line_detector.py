"""Camera of a line-scan state: a straight detector line with radial distortion, fitted to the look angles of samples.

The line is at ``(x, y) = (d, y0 + b d)`` pixels of the focal plane, d = +-(sample - s0); its ideal coordinates are
``(x, y) (1 - k0 - k1 r^2 - k2 r^4)``, and the line of sight is ``R (x, y, focal)`` in body axes turned to the ground
(x right of flight, y backward, z down). Look angles that are linear in the sample need neither distortion nor R.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.sensors.focal_plane import Distortion

#: Residual, px, below which a straight line without distortion is exact: rounding of the tangents.
EXACT_PX: Final = 1e-7
#: Start values of the distance of the line from the axis and of its sample, in half lines.
_STARTS: Final = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0))
#: Samples to which the camera is fitted, and at which it is compared.
FITTED: Final = 201
#: Evaluations of the camera for each start.
MOST: Final = 1500
COMPARED: Final = 6007


@dataclass(frozen=True)
class LineDetector:
    """See the module.

    Parameters
    ----------
    rotation : (3, 3) array
        R, turned body axes from camera axes.
    focal_px, origin_sample, sign, slope, offset_px : float
        Focal length, s0, the sign of d, b and y0.
    radial : (3,) tuple
        k0, k1, k2 for r in pixels.
    largest_px : (2,) tuple
        Largest differences of the look angles along lines and samples.
    """

    rotation: Array
    focal_px: float
    origin_sample: float
    sign: float
    slope: float
    offset_px: float
    radial: tuple[float, float, float]
    largest_px: tuple[float, float] = (0.0, 0.0)

    def directions(self, sample: Array) -> Array:
        """Lines of sight (n, 3) in turned body axes, z component 1."""
        d = self.sign * (sample - self.origin_sample)
        measured = np.stack([d, self.offset_px + self.slope * d], axis=1)
        ideal = Distortion("radial", self.radial).ideal(measured)
        u = np.column_stack([ideal, np.full(len(d), self.focal_px)]) @ self.rotation.T
        return np.asarray(u / u[:, 2:])

    def compared(self, sample: Array, tangents: Array) -> LineDetector:
        """Camera with its largest differences from tangents (n, 2) at samples (n,)."""
        apart = np.abs(self.directions(sample)[:, :2] - tangents).max(axis=0) * self.focal_px
        return LineDetector(
            self.rotation, self.focal_px, self.origin_sample, self.sign, self.slope, self.offset_px, self.radial,
            (float(apart[1]), float(apart[0])),
        )  # fmt: skip


def fit_detector(sample: Array, tangents: Array) -> LineDetector:
    """Camera whose directions at samples (n,) are nearest to tangents (n, 2): x right of flight, y backward."""
    step = np.polyfit(sample, tangents[:, 0], 1)
    sign, focal = float(np.sign(step[0])), float(1.0 / abs(step[0]))
    origin = float(-step[1] / step[0])
    slope, offset = np.polyfit(sign * (sample - origin), tangents[:, 1] * focal, 1)
    plain = LineDetector(np.eye(3), focal, origin, sign, float(slope), float(offset), (0.0, 0.0, 0.0))
    plain = plain.compared(sample, tangents)
    return plain if max(plain.largest_px) < EXACT_PX else _bent(sample, tangents, sign, focal)


def _bent(sample: Array, tangents: Array, sign: float, focal: float) -> LineDetector:
    """Camera with rotation and radial distortion, the best of several starts."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    half = 0.5 * (sample[-1] - sample[0])
    middle, axis = 0.5 * (sample[0] + sample[-1]), tangents.mean(axis=0)
    rows = np.linspace(0, len(sample) - 1, min(FITTED, len(sample))).astype(np.intp)
    at, seen = sample[rows], tangents[rows]
    turn = Rotation.from_rotvec([-np.arctan(axis[1]), np.arctan(axis[0]), 0.0])

    def camera(x: Array) -> LineDetector:
        """Camera of unknowns of size about 1."""
        rotation = (turn * Rotation.from_rotvec(x[:3])).as_matrix()
        radial = float(x[6]), float(x[7]) / half**2, float(x[8]) / half**4
        return LineDetector(rotation, focal, middle + half * x[3], sign, float(x[5]), half * float(x[4]), radial)

    def misfit(x: Array) -> Array:
        return np.asarray(((camera(x).directions(at)[:, :2] - seen) * focal).ravel())

    fits = [least_squares(misfit, [0.0, 0.0, 0.0, s, y, 0.0, 0.0, 0.0, 0.0], method="lm", xtol=1e-15, ftol=1e-15,
                          max_nfev=MOST) for y, s in _STARTS]  # fmt: skip
    return camera(min(fits, key=lambda fit: float(fit.cost)).x).compared(sample, tangents)
