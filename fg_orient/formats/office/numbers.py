"""Convert cells to numbers: decimal comma or point, groups of thousands, degrees with minutes and seconds."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.formats.office.workbook import Cell


class Style(NamedTuple):
    """Decimal sign, and whether the other sign, blanks or apostrophes may group thousands."""

    decimal: str = "."
    grouped: bool = False


#: A style is possible if it reads at least this share of the cells that the best style reads as numbers.
NEARLY_ALL: Final = 0.9
USUAL: Final = Style()
#: Styles that together accept every text that is a number in any table.
ANY: Final = (Style(".", True), Style(",", True))
_PLAIN: Final = {
    # possessive: otherwise a text of thousands of digits would be divided in all possible ways
    ".": re.compile(r"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?(?:[0-9]++(?:,[0-9]*+)?|,[0-9]++)(?:[eE][+-]?[0-9]+)?"),
}
_GROUPED: Final = {
    ".": re.compile(r"[+-]?[0-9]{1,3}(?:(?P<mark>[ ,'’])[0-9]{3})(?:(?P=mark)[0-9]{3})*(?:\.[0-9]*)?"),
    ",": re.compile(r"[+-]?[0-9]{1,3}(?:(?P<mark>[ .'’])[0-9]{3})(?:(?P=mark)[0-9]{3})*(?:,[0-9]*)?"),
}
_ANGLE: Final = re.compile(
    r"""(?P<before>[NSEWKGDB])?\s*(?P<sign>[+-])?\s*(?P<d>[0-9]{1,3})\s*[°ºd:\s-]\s*(?P<m>[0-9]{1,2})\s*['′’m:\s-]\s*
    (?P<s>[0-9]{1,2}(?:[.,][0-9]+)?)\s*(?:"|″|”|''|′′|s)?\s*(?P<after>[NSEWKGDB])?""", re.VERBOSE,
)  # fmt: skip
_DEGREES: Final = re.compile(
    r"(?P<before>[NSEWKGDB])?\s*(?P<number>[+-]?[0-9]+(?:[.,][0-9]+)?)\s*[°º]?\s*(?P<after>[NSEWKGDB])?"
)
#: Longer cells are no angles, characters.
_LONGEST: Final = 60
#: Letters of the hemispheres in English, German, French and Spanish, and in Turkish (Kuzey, Güney, Doğu, Batı).
_SOUTH_OR_WEST: Final = "SWGB"


def bare(cell: str) -> str:
    """Return a cell without outer blanks.

    Unusual minus signs and blanks are replaced by usual ones.
    """
    return cell.replace("\u2212", "-").replace("\u00a0", " ").replace("\u202f", " ").strip()


def value_of(cell: Cell, style: Style) -> float:
    """Read the number of a cell in this style; nan if it is not a number."""
    if not isinstance(cell, str):
        return float(cell) if math.isfinite(cell) else math.nan
    text = bare(cell)
    if not _PLAIN[style.decimal].fullmatch(text):
        if not (style.grouped and _GROUPED[style.decimal].fullmatch(text)):
            return math.nan
        text = re.sub("[ ,'’]" if style.decimal == "." else "[ .'’]", "", text)
    value = float(text.replace(",", "."))
    return value if math.isfinite(value) else math.nan


def angle_of(cell: Cell) -> float:
    """Read an angle and return degrees; nan for other cells.

    An angle has minutes and seconds, a degree sign or a hemisphere.
    """
    if not isinstance(cell, str):
        return math.nan
    text = bare(cell)
    if len(text) > _LONGEST:
        return math.nan
    found = _ANGLE.fullmatch(text)
    if found:
        minutes, seconds = int(found["m"]), float(found["s"].replace(",", "."))
        if minutes >= 60 or seconds >= 60.0 or (found["before"] and found["after"]):
            return math.nan
        value = int(found["d"]) + minutes / 60.0 + seconds / 3600.0
        letter = found["before"] or found["after"] or ""
        if letter and found["sign"]:
            return math.nan
        return -value if found["sign"] == "-" or (letter and letter in _SOUTH_OR_WEST) else value
    found = _DEGREES.fullmatch(text)
    letter = (found["before"] or found["after"] or "") if found else ""
    if not found or not (letter or "°" in text or "º" in text) or (found["before"] and found["after"]):
        return math.nan
    value = float(found["number"].replace(",", "."))
    if letter and found["number"][0] in "+-":
        return math.nan
    return -value if letter and letter in _SOUTH_OR_WEST else value


def is_number(cell: Cell) -> bool:
    """Return whether a cell is an angle, or a number in any style."""
    if not isinstance(cell, str):
        return True
    return any(np.isfinite([*(value_of(cell, style) for style in ANY), angle_of(cell)]))


def angles(cells: Sequence[Cell]) -> Array | None:
    """Return degrees (n,) if the cells are angles or blank; None if most cells are not angles."""
    values = np.array([angle_of(cell) for cell in cells])
    filled = np.array([cell != "" for cell in cells], bool)
    return values if filled.any() and np.isfinite(values[filled]).mean() > 0.5 else None


def values(cells: Sequence[Cell], style: Style) -> Array:
    """Return the numbers (n,) of cells; nan if a cell is not a number."""
    return np.array([value_of(cell, style) for cell in cells], float)


def possible_styles(columns: Sequence[Sequence[Cell]]) -> tuple[Style, ...]:
    """Return the styles in which nearly all cells of these columns are numbers.

    If all styles give the same numbers, only one is returned. Groups of thousands are not
    used if a number above 999 has no group.

    Parameters
    ----------
    columns : sequence of sequences of cells
        Columns with numbers.

    Returns
    -------
    tuple of Style
        One or two styles: decimal point and decimal comma.
    """
    texts = [cell for cells in columns for cell in cells if isinstance(cell, str) and cell != ""]
    found: dict[Style, Array] = {}
    for decimal in (".", ","):
        plain = np.array([value_of(cell, Style(decimal)) for cell in texts])
        style = Style(decimal, not (np.abs(plain[np.isfinite(plain)]) >= 1000.0).any())
        found[style] = np.array([value_of(cell, style) for cell in texts])
    most = max((int(np.isfinite(read).sum()) for read in found.values()), default=0)
    kept = {style: read for style, read in found.items() if np.isfinite(read).sum() >= NEARLY_ALL * most}
    if len(kept) == 2:
        one, other = kept.values()
        both = np.isfinite(one) & np.isfinite(other)
        if np.array_equal(one[both], other[both]):
            return (max(kept, key=lambda style: int(np.isfinite(kept[style]).sum())),)
    return tuple(kept)


def unpacked(values: Array, form: str) -> Array:
    """Convert numbers in a packed form or in another unit to degrees.

    Parameters
    ----------
    values : (n,) array
    form : str
        "deg", "gon", "rad", "dms" (dddmmss.s) or "d.mmss".

    Returns
    -------
    (n,) array
        Degrees; nan if a number is impossible in this form.
    """
    if form == "deg":
        return values
    if form == "gon":
        return values * 0.9
    if form == "rad":
        return np.degrees(values)
    whole = np.round(np.abs(values) * (1.0 if form == "dms" else 1e4), 9)
    d, rest = np.divmod(whole, 1e4)
    m, s = np.divmod(rest, 100.0)
    out = np.sign(values) * (d + m / 60.0 + s / 3600.0)
    return np.where((m < 60.0) & (s < 60.0), out, np.nan)
