"""Control points of a rational function model, and the +-1 normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.cameras.rfm_project import RANGE
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Coordinates of a point in the order of offsets and scales.
COORDINATES = ("line", "sample", "longitude", "latitude", "height")


@dataclass(frozen=True)
class ControlPoints:
    """Ground points with their places in the image.

    Parameters
    ----------
    line, sample : (n,) array
        Pixels.
    ground : (n, 3) array
        Longitude, latitude (degrees), ellipsoidal height (m).

    Raises
    ------
    InputError
        Sizes that do not fit, no points, or values that are not finite.
    """

    line: Array
    sample: Array
    ground: Array

    def __post_init__(self) -> None:
        n = len(self.line)
        fits = self.line.shape == self.sample.shape == (n,) and self.ground.shape == (n, 3) and n > 0
        if not fits or not np.isfinite(self.columns).all():
            raise InputError.of("rfm.points", place="control points", value=f"{n} lines, ground {self.ground.shape}")

    def __len__(self) -> int:
        return len(self.line)

    @property
    def columns(self) -> Array:
        """Line, sample, longitude, latitude, height: (n, 5)."""
        return np.column_stack([self.line, self.sample, self.ground])

    def take(self, index: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> ControlPoints:
        """Some of the points, or all of them in another order."""
        return ControlPoints(self.line[index], self.sample[index], self.ground[index])


@dataclass(frozen=True)
class Scaling:
    """Normalised coordinate = (coordinate - offset)/scale.

    Parameters
    ----------
    offsets, scales : (5,) array
        Line, sample (pixels), longitude, latitude (degrees), height (m).
    """

    offsets: Array
    scales: Array

    @classmethod
    def of(cls, points: ControlPoints, *, normalise: bool = True) -> Scaling:
        """Scaling that brings each coordinate to [-1, 1], T(3.51), or that leaves everything as it is.

        Raises
        ------
        InputError
            All points have the same value of a coordinate.
        """
        if not normalise:
            return cls(np.zeros(5), np.ones(5))
        low, high = points.columns.min(axis=0), points.columns.max(axis=0)
        flat = np.flatnonzero(~(high > low))
        if len(flat):
            raise InputError.of("rfm.flat", place=COORDINATES[flat[0]], value=low[flat[0]])
        return cls(0.5 * (high + low), 0.5 * (high - low))

    def ground(self, ground: Array) -> Array:
        """Normalised longitude, latitude, height (n, 3)."""
        return _normalised(ground, self.offsets[RANGE.ground], self.scales[RANGE.ground])

    def image(self, line: Array, sample: Array) -> Array:
        """Normalised line and sample (n, 2)."""
        return _normalised(np.column_stack([line, sample]), self.offsets[RANGE.image], self.scales[RANGE.image])


def _normalised(values: Array, offsets: Array, scales: Array) -> Array:
    return np.asarray((values - offsets) / scales)
