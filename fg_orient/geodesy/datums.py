"""Horizontal shifts by which coordinates of other datums differ if they are taken for WGS84 ones."""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np

from fg_orient.geodesy import (
    area_of_use,
    enu_from_ecef,
    geodetic_to_ecef,
    offline_pyproj,
    operation_to_ecef,
    spatial_crs,
)
from fg_orient.model.errors import InputError

#: Geographic reference systems that older maps and control points have.
DATUMS: Final = {
    "ED50": "EPSG:4230", "NAD27": "EPSG:4267", "Pulkovo 1942": "EPSG:4284", "DHDN": "EPSG:4314",
    "MGI": "EPSG:4312", "NTF": "EPSG:4275", "OSGB36": "EPSG:4277", "Tokyo": "EPSG:4301", "SAD69": "EPSG:4618",
    "S-JTSK": "EPSG:4156", "Monte Mario": "EPSG:4265", "Indian 1975": "EPSG:4240", "Arc 1950": "EPSG:4209",
    "Cape": "EPSG:4222", "AGD66": "EPSG:4202", "Beijing 1954": "EPSG:4214",
}  # fmt: skip
#: Plate fixed system with its area, geocentric codes of ITRF and of it, epochs of ITRF, and the accuracy in m.
ETRS89: Final = ("EPSG:4258", "EPSG:7789", "EPSG:7930", (1995.0, 2000.0, 2005.0, 2010.0, 2015.0, 2020.0, 2025.0), 0.05)
#: Accuracy in m of an operation that states none.
UNSTATED_M: Final = 10.0


class DatumShift(NamedTuple):
    """A datum, and East and North (m) of its coordinates from the WGS84 ones of the same place."""

    name: str
    east_m: float
    north_m: float
    accuracy_m: float


@cache
def known_shifts(lon_deg: float, lat_deg: float) -> tuple[DatumShift, ...]:
    """Shifts of the datums in use at a place, from the operations that PROJ has without further grids.

    Parameters
    ----------
    lon_deg, lat_deg : float
    """
    lonlat = np.array([[lon_deg, lat_deg]])
    place, axes = geodetic_to_ecef(lon_deg, lat_deg, 0.0)[0], enu_from_ecef(lon_deg, lat_deg)[0]
    out = []
    for name, crs in DATUMS.items():
        if not _is_used(crs, lon_deg, lat_deg):
            continue
        try:
            transformer, operation = operation_to_ecef(crs, spatial_crs(crs), lonlat)
        except InputError:  # it needs a grid
            continue
        true = np.array(transformer.transform(lon_deg, lat_deg, 0.0))
        east, north, _ = axes @ (place - true)
        stated = operation.accuracy_m
        out.append(DatumShift(name, float(east), float(north), UNSTATED_M if np.isnan(stated) else stated))
    area, itrf, etrf, epochs, accuracy = ETRS89
    if _is_used(area, lon_deg, lat_deg):
        turn = offline_pyproj().Transformer.from_crs(itrf, etrf)
        for epoch in epochs:
            east, north, _ = axes @ (np.array(turn.transform(*place, epoch)[:3]) - place)
            out.append(DatumShift(f"ETRS89 for ITRF at epoch {epoch:.0f}", float(east), float(north), accuracy))
    return tuple(out)


def _is_used(crs: str, lon_deg: float, lat_deg: float) -> bool:
    """Whether the area of use of a CRS contains a place."""
    area = area_of_use(crs)
    if area is None:
        return False
    west, south, east, north = area
    inside = west <= lon_deg <= east if west <= east else lon_deg >= west or lon_deg <= east
    return inside and south <= lat_deg <= north
