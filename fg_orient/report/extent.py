"""What a map shows first: everything, or the points where the footprints are so large that these would be a dot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Points that fill less than this share of the map of all footprints are shown by themselves.
FILLED: Final = 0.4
#: Border about them, a share of the larger side of their extent.
BORDER: Final = 0.12
#: Least extent that is shown, km: a single point has none.
LEAST_KM: Final = 0.1
KM_PER_DEGREE: Final = 111.2


def first_view(points_deg: Array, footprints_deg: Sequence[Array]) -> Array | None:
    """Corners of the first view where it is not that of everything.

    Parameters
    ----------
    points_deg : (n, 2) array
        Longitude and latitude of the points; rows with nan are left out.
    footprints_deg : sequence of (k, 2) array
        Corners of the images.

    Returns
    -------
    (2, 2) array or None
        Lowest and highest longitude and latitude, degrees, border included; None where all is shown: there are no
        points, or they fill enough of the whole.
    """
    located = points_deg[np.isfinite(points_deg).all(axis=1)]
    if not len(located):
        return None
    everything = np.vstack([located, *footprints_deg])
    middle = 0.5 * (located.min(axis=0) + located.max(axis=0))
    km = KM_PER_DEGREE * np.array([max(math.cos(math.radians(float(middle[1]))), 0.01), 1.0])
    size, whole = (float((np.ptp(part, axis=0) * km).max()) for part in (located, everything))
    if size >= FILLED * whole:
        return None
    half = 0.5 * np.maximum(np.ptp(located, axis=0) * km, LEAST_KM) + BORDER * max(size, LEAST_KM)
    return np.stack([middle - half / km, middle + half / km])


def view_of(record: dict[str, Any], points_deg: Array) -> Array | None:
    """First view of the points of a result; see :func:`first_view`."""
    return first_view(points_deg, footprints(record))


def footprints(record: dict[str, Any]) -> list[Array]:
    """Corners (k, 2) of the images of a record, longitude and latitude in degrees; empty ones left out."""
    found = (np.array(image["footprint_lon_lat_deg"], float).reshape(-1, 2) for image in record["images"])
    return [corners for corners in found if len(corners)]
