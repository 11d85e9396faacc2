"""Read navigation tables: positions and attitudes observed on board for each frame image.

See docs/gnss-ins.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.tables import read_numbers
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import COORDINATE_COLUMNS, crs_kind, to_ecef
from fg_orient.sensors.navigation import TOP_FORWARD, Fix, Mounting, body_attitude

if TYPE_CHECKING:
    from fg_orient.formats.schema import NavigationEntry

POSITION_SIGMAS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
ANGLES: Final = ("roll_deg", "pitch_deg", "heading_deg")
ANGLE_SIGMAS: Final = ("sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg")


def read_navigation(path: Path, crs: str) -> tuple[tuple[Fix, ...], str]:
    """Read a navigation table. Its positions are in ``crs``; attitudes are optional.

    Returns
    -------
    tuple of Fix
    str
        Hash of the file (SHA-256).

    Raises
    ------
    InputError
        The table has faults; all are listed.
    """
    place = COORDINATE_COLUMNS[crs_kind(crs)]
    position = ("image", "strip", "time_s", *place, *POSITION_SIGMAS)
    layouts = [position, (*position, *ANGLES, *ANGLE_SIGMAS)]
    values, table = read_numbers(path, layouts, ("image", "strip"))
    for name, column in zip(layouts[-1][2:], values.T, strict=False):
        if name.startswith("sigma_"):
            table.refuse(column <= 0.0, "navigation.sigma", name)
    table.require_valid()
    ecef = to_ecef(crs, *values[:, 1:4].T)
    ids = zip(table.cells["image"], table.cells["strip"], strict=True)
    return tuple(_fix(i, s, v, at) for (i, s), v, at in zip(ids, values, ecef, strict=True)), sha256_of(path)


def _fix(image: str, strip: str, values: Array, ecef_m: Array) -> Fix:
    """Read one record: time, position and its standard deviations; also the angles if the table has them."""
    if len(values) == 7:
        return Fix(image, strip, float(values[0]), ecef_m, values[4:7])
    (roll, pitch, heading), sigmas = np.radians(values[7:10]).tolist(), np.radians(values[10:13])
    attitude = body_attitude(roll, pitch, heading, ecef_m)
    return Fix(image, strip, float(values[0]), ecef_m, values[4:7], attitude, sigmas)


def mounting_of(entry: NavigationEntry) -> Mounting:
    """Return the mounting of the receiver and inertial unit from the table ``[navigation]`` of a project."""

    def rad(degrees: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if degrees is None:
            return None
        roll, pitch, heading = np.radians(degrees).tolist()
        return roll, pitch, heading

    matrix = TOP_FORWARD if entry.camera_from_body is None else np.array(entry.camera_from_body)
    return Mounting(
        np.array(entry.lever_m), matrix, entry.shift_sigma_m, entry.drift_sigma_m, rad(entry.attitude_shift_sigma_deg),
        rad(entry.attitude_drift_sigma_deg), entry.lever_sigma_m, rad(entry.boresight_sigma_deg),
    )  # fmt: skip
