"""Camera of a line-scan state: a straight detector line with distortion, fitted to the look angles of samples.

The line is at ``(x, y) = (d, y0 + b d)`` pixels of the focal plane, d = +-(sample - s0).
The distortion converts these to ideal coordinates. The line of sight is ``R (x, y, focal)`` in body
axes that are rotated towards the ground (x right of flight, y backward, z down). Look angles that are
linear in the sample need neither distortion nor R. For other look angles, the better of two distortions
is used:

* radial distortion, ``ideal = (x, y) (1 - k0 - k1 r^2 - k2 r^4)``: degree 5, with one set of coefficients;
* transverse distortion: d and y0 are polynomials of degree 3 in the ideal x, so each direction has its own degree 3.
  Its error falls with the fourth power of the width of a band of columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array
from fg_orient.sensors.focal_plane import Distortion

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

#: A straight line without distortion counts as exact if its residual is below this, px. The tangents are rounded.
EXACT_PX: Final = 1e-7
#: Start values: distance of the line from the axis, and sample of the axis; the unit is half the length of the line.
_STARTS: Final = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0))
#: Residual, px, below which the transverse distortion is used and no radial distortion is fitted.
GOOD_PX: Final = 1e-6
#: Number of samples to which the camera is fitted; ``COMPARED`` is the number at which it is compared.
FITTED: Final = 201
#: Maximum number of evaluations for each start value.
MOST: Final = 1500
COMPARED: Final = 6007
_NONE: Final = Distortion()


@dataclass(frozen=True)
class LineDetector:
    """Straight detector line with radial distortion; see the module.

    Parameters
    ----------
    rotation : (3, 3) array
        Matrix R, which rotates camera axes to the rotated body axes.
    focal_px, origin_sample, sign, slope, offset_px : float
        Focal length, s0, sign of d, b and y0.
    distortion : Distortion
        In pixels.
    largest_px : (2,) tuple
        Largest differences of the look angles along lines and along samples, px.
    """

    rotation: Array
    focal_px: float
    origin_sample: float
    sign: float
    slope: float
    offset_px: float
    distortion: Distortion = _NONE
    largest_px: tuple[float, float] = (0.0, 0.0)

    def directions(self, sample: Array) -> Array:
        """Return lines of sight (n, 3) in rotated body axes; their z component is 1."""
        d = self.sign * (sample - self.origin_sample)
        measured = np.stack([d, self.offset_px + self.slope * d], axis=1)
        ideal = self.distortion.ideal(measured)
        u = np.column_stack([ideal, np.full(len(d), self.focal_px)]) @ self.rotation.T
        return np.asarray(u / u[:, 2:])

    def compared(self, sample: Array, tangents: Array) -> LineDetector:
        """Return the camera with its largest differences from tangents (n, 2) at samples (n,)."""
        apart = np.abs(self.directions(sample)[:, :2] - tangents).max(axis=0) * self.focal_px
        return replace(self, largest_px=(float(apart[1]), float(apart[0])))


def fit_detector(sample: Array, tangents: Array, *, band: bool = False) -> LineDetector:
    """Return the camera whose directions at samples (n,) are nearest to tangents (n, 2): x right of flight, y backward.

    ``band`` is true if the samples are part of a line. Only transverse distortion is then
    fitted: the search for radial distortion takes seconds and found nothing better for
    bands of SPOT 5.
    """
    step = np.polyfit(sample, tangents[:, 0], 1)
    sign, focal = float(np.sign(step[0])), float(1.0 / abs(step[0]))
    origin = float(-step[1] / step[0])
    slope, offset = np.polyfit(sign * (sample - origin), tangents[:, 1] * focal, 1)
    plain = LineDetector(np.eye(3), focal, origin, sign, float(slope), float(offset)).compared(sample, tangents)
    if max(plain.largest_px) < EXACT_PX:
        return plain
    cubic = _transverse(sample, tangents, sign, focal)
    if band or max(cubic.largest_px) < GOOD_PX:
        return cubic
    return min(cubic, _radial(sample, tangents, sign, focal), key=lambda one: max(one.largest_px))


def _axis(tangents: Array) -> Rotation:
    """Return the rotation of a camera whose axis is the mean line of sight."""
    from scipy.spatial.transform import Rotation

    mean = tangents.mean(axis=0)
    return Rotation.from_rotvec([-np.arctan(mean[1]), np.arctan(mean[0]), 0.0])


def _transverse(sample: Array, tangents: Array, sign: float, focal: float) -> LineDetector:
    """Fit a camera with transverse distortion by least squares in Chebyshev polynomials of the ideal x."""
    rotation = _axis(tangents).as_matrix()
    u = np.column_stack([tangents, np.ones(len(tangents))]) @ rotation
    x, y = (focal * u[:, :2] / u[:, 2:]).T
    middle = 0.5 * (sample[0] + sample[-1])
    c = np.zeros((2, 10))
    for row, values in zip(c, (sign * (sample - middle), y), strict=True):
        fit = np.polynomial.Chebyshev.fit(x, values, 3).convert(kind=np.polynomial.Polynomial)
        row[[0, 1, 3, 6]] = np.pad(fit.coef, (0, 4 - len(fit.coef)))
    c[1] *= -1.0  # on the line, y of the detector is 0: y minus its polynomial
    c[1, 2] += 1.0
    found = LineDetector(rotation, focal, middle, sign, 0.0, 0.0, Distortion("transverse", tuple(c.ravel().tolist())))
    return found.compared(sample, tangents)


def _radial(sample: Array, tangents: Array, sign: float, focal: float) -> LineDetector:
    """Fit the camera with rotation and radial distortion from several start values.

    Return the best one.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    half, middle, turn = 0.5 * (sample[-1] - sample[0]), 0.5 * (sample[0] + sample[-1]), _axis(tangents)
    rows = np.linspace(0, len(sample) - 1, min(FITTED, len(sample))).astype(np.intp)
    at, seen = sample[rows], tangents[rows]

    def camera(x: Array) -> LineDetector:
        """Make a camera from scaled unknowns, whose size is about 1."""
        rotation = (turn * Rotation.from_rotvec(x[:3])).as_matrix()
        radial = Distortion("radial", (float(x[6]), float(x[7]) / half**2, float(x[8]) / half**4))
        return LineDetector(rotation, focal, middle + half * x[3], sign, float(x[5]), half * float(x[4]), radial)

    def misfit(x: Array) -> Array:
        return np.asarray(((camera(x).directions(at)[:, :2] - seen) * focal).ravel())

    fits = [least_squares(misfit, [0.0, 0.0, 0.0, s, y, 0.0, 0.0, 0.0, 0.0], method="lm", xtol=1e-15, ftol=1e-15,
                          max_nfev=MOST) for y, s in _STARTS]  # fmt: skip
    return camera(min(fits, key=lambda fit: float(fit.cost)).x).compared(sample, tangents)
