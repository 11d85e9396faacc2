"""Reader of IERS C04 files: the series 08, 14 and 20, as the IERS gives them out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.earth_rotation import EarthOrientation

_ARC_SECOND: Final = np.pi / 180.0 / 3600.0
_RECORD: Final = re.compile(r"^\s*\d{4}\s+\d{1,2}\s+\d{1,2}\s")
#: Largest pole coordinate (arc seconds) and UT1 - UTC (s) that can be right.
_LIMITS: Final = (1.0, 1.0, 1.0)


def read_earth_orientation(path: str | Path) -> EarthOrientation:
    """Read a C04 file, or a part of one with at least two days.

    Celestial pole offsets that refer to the equinox (columns dPsi, dEps, against IAU 1980) are left out, with a note:
    against IAU 2006/2000A they are below 1 mas, 3 cm on the ground.

    Raises
    ------
    InputError
        The file cannot be read, holds no such records, has gaps, or a value that cannot be right.
    """
    try:
        text = Path(path).read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError.of("earth.unreadable", file=path, value=error.strerror) from None
    lines = text.replace("\r\n", "\n").split("\n")
    found = [(n, line.split()) for n, line in enumerate(lines, 1) if _RECORD.match(line)]
    if len(found) < 2:
        raise InputError.of("earth.no_records", file=path, value=f"{len(found)} records")
    # year, month, day (, hour), MJD, x, y, UT1 - UTC; then LOD, dX, dY, or since C04 20 dX, dY at once
    hours = _number(path, *found[0], 3) < 100.0
    columns = (4, 5, 6, 7, 8, 9) if hours else (3, 4, 5, 6, 8, 9)
    table = np.array([[_number(path, n, words, k) for k in columns] for n, words in found])
    gaps = np.flatnonzero(np.abs(np.diff(table[:, 0]) - 1.0) > 1e-9)
    if len(gaps):
        raise InputError.of("earth.gap", file=path, place=f"line {found[gaps[0] + 1][0]}", value=table[gaps[0] + 1, 0])
    bad = np.flatnonzero((np.abs(table[:, 1:4]) > _LIMITS).any(axis=1))
    if len(bad):
        raise InputError.of("earth.value", file=path, place=f"line {found[bad[0]][0]}", value=table[bad[0], 1:4])
    offset, notes = table[:, 4:6] * _ARC_SECOND, tuple[Finding, ...]()
    if "dpsi" in text[:5000].lower():
        offset, notes = 0.0 * offset, (finding("image.pole_offsets"),)
    return EarthOrientation(str(path), table[:, 0], table[:, 1:3] * _ARC_SECOND, table[:, 3], offset, notes)


def _number(path: str | Path, line: int, words: list[str], k: int) -> float:
    try:
        value = float(words[k])
    except (IndexError, ValueError):
        value = np.nan
    if not np.isfinite(value):
        raise InputError.of("earth.record", file=path, place=f"line {line}", value=" ".join(words)[:60])
    return value
