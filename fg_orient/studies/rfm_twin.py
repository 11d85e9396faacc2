"""The twin of the RFM experiments: 99 control points of one image, heights 0-1000 m, 0.5 px of image noise."""

from __future__ import annotations

import numpy as np

from factors.geometry import ellipsoid
from fg_orient.rpc.rfm_points import ControlPoints
from fg_orient.rpc.virtual_grid import LocatingSensor

N_POINTS = 99
HEIGHTS_M = (0.0, 1000.0)
NOISE_PX = 0.5
#: Points keep this distance from the border of the image.
MARGIN_PX = 100.0


def rfm_points(
    sensor: LocatingSensor, seed: int, *, count: int = N_POINTS, noise_px: float = NOISE_PX, stream: int = 0
) -> ControlPoints:
    """Draw control points of a sensor: pixels and heights uniform, noise in line and sample.

    Parameters
    ----------
    sensor : LocatingSensor
    seed : int
    count : int
    noise_px : float
    stream : int
        Another one gives other points of the same seed: check points.
    """
    rng = np.random.default_rng([seed, stream])
    last = np.array([sensor.n_lines, sensor.n_samples]) - 1.0 - MARGIN_PX
    pixels, height = rng.uniform(MARGIN_PX, last, (count, 2)), rng.uniform(*HEIGHTS_M, count)
    geodetic = ellipsoid.geodetic_array(np.ascontiguousarray(sensor.locate(*pixels.T, height_m=height)))
    line, sample = (pixels + noise_px * rng.standard_normal((count, 2))).T
    return ControlPoints(line, sample, np.column_stack([np.degrees(geodetic[:, :2]), height]))
