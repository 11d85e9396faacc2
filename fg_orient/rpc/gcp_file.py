"""Reads control points of a scene: rows of id, line, sample, latitude, longitude (degrees), height (m)."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.model.errors import InputError
from fg_orient.rpc.rfm_points import ControlPoints

_COLUMNS: Final = 6
#: The control points of the SPOT-6 scene of Terlemezoğlu 2019 in the folder of real data.
SPOT6_FOLDER: Final = "geoetrim-pleiades"
SPOT6_FILE: Final = "SPOT6_201805150822087_GCP_WGS84_blh.gcp"


def read_gcp(path: Path) -> ControlPoints:
    """Read a file of control points.

    Parameters
    ----------
    path : Path
        Rows of six words between blanks; empty rows are skipped.

    Raises
    ------
    InputError
        The file cannot be read, or a row holds something else; its line is named.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise InputError.of("rfm.data", file=path, value=reason) from None
    rows = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        try:
            row = [float(word) for word in words[1:]]
        except ValueError:
            row = []
        good = len(words) == _COLUMNS and len(row) == _COLUMNS - 1 and np.isfinite(row).all()
        if not good or abs(row[2]) > 90.0 or abs(row[3]) > 360.0:
            raise InputError.of("rfm.data", file=path, place=f"line {number}", value=line.strip())
        rows.append(row)
    if not rows:
        raise InputError.of("rfm.data", file=path, value="no rows")
    table = np.array(rows)
    return ControlPoints(table[:, 0], table[:, 1], table[:, [3, 2, 4]])


def find_spot6(where: Path) -> Path:
    """Path of the SPOT-6 points: the file itself, or inside a folder of real data.

    Raises
    ------
    InputError
        It is not there.
    """
    candidates = (where, where / SPOT6_FILE, where / SPOT6_FOLDER / SPOT6_FILE)
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        raise InputError.of("rfm.data", file=where, value=f"no {SPOT6_FILE}")
    return found
