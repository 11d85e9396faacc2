"""Observed camera stations of a bundle: projection centres, if wanted attitudes, with standard deviations.

They come from a receiver, a total station or an inertial unit, in the coordinate system of the control points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.axes import rotation_from_aerial
from fg_orient.closerange.files import GROUND, SIGMA_GROUND
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.formats.tables import Faults, Row, number, read_table

Array = npt.NDArray[np.float64]

ANGLES: Final = ("omega_deg", "phi_deg", "kappa_deg")
SIGMA_TURNS: Final = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
#: A turn known worse than this is not observed.
_LARGEST_TURN_DEG: Final = 180.0


@dataclass(frozen=True, eq=False)
class Station:
    """What was observed of the orientation of a photo.

    Parameters
    ----------
    centre_m, sigma_m : (3,) arrays
        Projection centre and its standard deviations, m.
    rotation : (3, 3) array or None
        Camera axes from ground axes.
    sigma_turns_rad : (3,) array or None
        Of turns about the camera's axes X right, Y down, Z along the view.
    """

    centre_m: Array
    sigma_m: Array
    rotation: Array | None = None
    sigma_turns_rad: Array | None = None


def read_stations(path: Path) -> dict[str, Station]:
    """Read a table of stations by photo.

    Parameters
    ----------
    path : Path
        CSV: photo, x_m, y_m, z_m, sigma_x_m, sigma_y_m, sigma_z_m; if wanted omega_deg, phi_deg, kappa_deg,
        sigma_x_deg, sigma_y_deg, sigma_z_deg.

    Raises
    ------
    InputError
        All faults of the table.
    """
    faults = Faults(str(path))
    place = ("photo", *GROUND, *SIGMA_GROUND)
    table = read_table(path, [place, (*place, *ANGLES, *SIGMA_TURNS)], faults)
    faults.raise_if_any()
    assert table is not None  # else there is a fault
    out: dict[str, Station] = {}
    for row in table.rows:
        name = row.cells["photo"]
        if name in out or not name:
            faults.add("closerange.station_twice" if name else "table.cell_empty", place=row.place("photo"), value=name)
        out[name] = _station(row, ANGLES[0] in table.columns, faults)
    faults.raise_if_any()
    return out


def _station(row: Row, turned: bool, faults: Faults) -> Station:
    """One row; what is wrong with it is noted."""
    centre, sigma = _numbers(row, GROUND, faults), _sigmas(row, SIGMA_GROUND, LARGEST, faults)
    for name, value in zip(GROUND, centre, strict=True):
        if abs(value) > LARGEST:
            faults.add("closerange.range", place=row.place(name), value=value, limit=LARGEST)
    if not turned:
        return Station(centre, sigma)
    omega, phi, kappa = np.radians(_numbers(row, ANGLES, faults)).tolist()
    turns = np.radians(_sigmas(row, SIGMA_TURNS, _LARGEST_TURN_DEG, faults))
    return Station(centre, sigma, rotation_from_aerial(omega, phi, kappa), turns)


def _numbers(row: Row, names: Iterable[str], faults: Faults) -> Array:
    return np.array([number(row, name, faults) for name in names])


def _sigmas(row: Row, names: tuple[str, ...], limit: float, faults: Faults) -> Array:
    values = _numbers(row, names, faults)
    for name, value in zip(names, values.tolist(), strict=True):
        if not (np.isnan(value) or SMALLEST <= value <= limit):
            faults.add("closerange.sigma_range", place=row.place(name), value=value, least=SMALLEST, limit=limit)
    return values


def station_sigmas(path: Path | None, stations: Mapping[str, Station]) -> list[tuple[str, str, float]]:
    """File, place and size of the standard deviations, for those who must not meet relative weights."""
    return [(str(path), f"photo {name}", float(s.sigma_m.max())) for name, s in stations.items()]


def observed_record(station: Station | None, centre_m: Array) -> dict[str, Any] | None:
    """What a record says of an observed centre: value, sigma, adjusted minus observed, m; None without one."""
    if station is None:
        return None
    return {"centre_m": station.centre_m.tolist(), "sigma_m": station.sigma_m.tolist(),
            "residual_m": (centre_m - station.centre_m).tolist()}  # fmt: skip
