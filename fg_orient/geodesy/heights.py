"""Heights above a zero level: vertical CRS of PROJ, and geoid files with other names in PROJ's folders.

The undulation of a zero level is its height above the WGS84 ellipsoid.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.geodesy import (
    Kind,
    ecef_to_geodetic,
    grid_folders,
    horizontal_part,
    known_crs,
    longitude_latitude,
    offline_pyproj,
    operation_to_ecef,
    require_finite,
    to_geographic,
)
from fg_orient.geodesy.geoid import GRID_SUFFIXES, GeoidFile
from fg_orient.model.errors import InputError


def vertical_reference(crs: str) -> tuple[str, str]:
    """Return the name of the vertical CRS of heights in ``crs`` (WKT or EPSG code), and the unit of its height axis.

    The name is ``""`` for ellipsoidal heights; the unit is ``""`` if the CRS has no height axis.
    """
    whole = known_crs(crs)
    names = [part.name for part in (whole, *whole.sub_crs_list) if part.is_vertical and not part.is_compound]
    units = [axis.unit_name for axis in whole.axis_info if axis.direction in ("up", "down")]
    return (names[0] if names else ""), (units[0] if units else "")


def with_vertical(crs: str, vertical: str) -> tuple[str, str]:
    """Return the horizontal part of a CRS, and its compound with a vertical CRS ("": its own vertical CRS), as WKT.

    Raises
    ------
    InputError
        A CRS is unknown, or ``vertical`` is not a vertical CRS.
    """
    whole = known_crs(crs)
    flat = horizontal_part(whole)
    if not vertical:
        return str(flat.to_wkt()), str(whole.to_wkt())
    heights = known_crs(vertical)
    if not heights.is_vertical or heights.is_compound:
        raise InputError.of("geodesy.not_vertical", place="vertical crs", value=f"{vertical}, {heights.name}")
    both = offline_pyproj().crs.CompoundCRS(f"{flat.name} + {heights.name}", [flat, heights])
    return str(flat.to_wkt()), str(both.to_wkt())


def undulation_m(crs: str, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
    """Return the height of the zero level of a compound CRS above the WGS84 ellipsoid.

    Parameters
    ----------
    crs : str
    x, y : (N,) array_like
        Easting and northing, or longitude and latitude, in units of the CRS.

    Returns
    -------
    (N,) array
        Height in m.

    Raises
    ------
    InputError
        The geoid grid is missing, or does not cover a point.
    """
    source = known_crs(crs)
    given = np.stack([np.asarray(x, float), np.asarray(y, float), np.zeros(np.shape(x))], axis=1)
    kind: Kind = "projected" if source.sub_crs_list[0].is_projected else "geographic"
    lonlat = longitude_latitude(source.name, source, kind, given, None)
    try:
        transformer = operation_to_ecef(source.name, source, lonlat)[0]
    except InputError as error:
        grid = found_grid(error)
        if grid is None:
            raise
        return grid.undulation_m(*to_geographic(horizontal_part(source).to_wkt(), *given[:, :2].T))
    xyz = np.stack(transformer.transform(*given.T), axis=1)
    require_finite(source.name, xyz, given, None)
    return ecef_to_geodetic(xyz)[2]


def found_grid(error: InputError, folders: Iterable[Path] = ()) -> GeoidFile | None:
    """Return a file of the same geoid, with another name or format, that can replace a missing grid of an operation.

    PROJ's folders and ``folders`` are searched. None if ``error`` has another reason, or there is no such file.
    """
    stems = {_stem(name) for name in str(error.problems[0].data.get("grids", "")).split(", ")}
    for folder in folders or map(Path, grid_folders()):
        for path in sorted(folder.glob("*")) if folder.is_dir() else ():
            if path.suffix.lower() in GRID_SUFFIXES and _stem(path.name) in stems:
                return GeoidFile(path)
    return None


def _stem(name: str) -> str:
    """Return the name of a grid without suffix, country and agency (``us_nga_``), and with "-" instead of "_"."""
    parts = Path(name.lower()).stem.split("_", 2)
    return (parts[2] if len(parts) == 3 and len(parts[0]) == 2 else "_".join(parts)).replace("_", "-")
