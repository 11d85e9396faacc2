"""Find the columns of a table that may be coordinates of ground points, and their possible order and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Decisions
from fg_orient.formats.office.numbers import unpacked
from fg_orient.formats.office.table import Table, id_column
from fg_orient.formats.office.words import ANGLES, LENGTHS
from fg_orient.model.errors import InputError

Kind = Literal["geographic", "projected", "geocentric"]
#: Range of distances from the centre of the Earth for points near its surface, m.
_RADIUS: Final = (6.33e6, 6.40e6)
#: Range of plausible heights of points, m.
_HEIGHTS: Final = (-600.0, 9000.0)
#: Maximum number of columns without usual names that are tried in all orders.
_TRIED: Final = 5
#: Possible units and factors of heights and coordinates if no header names the unit.
_HEIGHT_UNITS: Final = {"m": 1.0, "ft": 0.3048}
_LENGTH_UNITS: Final = {"m": 1.0, "km": 1000.0}


@dataclass(frozen=True, eq=False)
class Triple:
    """Three columns of a table, interpreted as coordinates.

    Parameters
    ----------
    kind : str
        "geographic", "projected" or "geocentric".
    columns : tuple of int
        Columns of east (longitude, x), north (latitude, y) and height (z). The last one
        is -1 if there is no height.
    coordinates : (n, 3) array
        Coordinates, degrees or m.
    named : bool
        Whether the headers name the axes in this order.
    units : str
        Units of horizontal coordinates and height in the form of the option ``units``.
    """

    kind: Kind
    columns: tuple[int, int, int]
    coordinates: Array
    named: bool
    units: str

    def words(self, table: Table) -> str:
        """Return the columns in the form of the option ``columns``."""
        keys = {"geographic": ("lon", "lat", "H"), "projected": ("E", "N", "H"), "geocentric": ("X", "Y", "Z")}[
            self.kind
        ]
        return ",".join(f"{key}={table.headers[k]}" for key, k in zip(keys, self.columns, strict=True) if k >= 0)


def ground_triples(table: Table, units: dict[str, str]) -> list[Triple]:
    """List all interpretations of a table as ground points.

    The list is empty if it has no ground points.
    """
    keyed = {key: table.one(key) for key in ("lon", "lat", "E", "N", "H", "X", "Y", "Z")}
    height = keyed["H"] if keyed["H"] is not None else -1
    orders: list[tuple[tuple[int, int, int], bool]] = []
    if keyed["X"] is not None and keyed["Y"] is not None and keyed["Z"] is not None:
        triple = (keyed["X"], keyed["Y"], keyed["Z"])
        return _geocentric(table, triple) or _refuse_geocentric(table)
    for east, north in (("lon", "lat"), ("E", "N")):
        e, n = keyed[east], keyed[north]
        if e is not None and n is not None:
            fixed = {e, n} <= table.stated
            orders += [((e, n, height), True)] + ([] if fixed else [((n, e, height), False)])
            break
        if (e is None) != (n is None) and not table.having("line"):
            there, missing = (e, north) if n is None else (n, east)
            free = [k for k in table.numeric if not table.names[k].key]
            if not free and table.one("x") is None:
                assert there is not None  # one of the two exists
                raise InputError.of(
                    "office.half", file=table.file, place=table.headers[there], option="columns", key=missing
                )
    x, y = table.having("x"), table.having("y")
    if not orders and len(x) == len(y) == 1 and table.one("image") is None:
        if height >= 0:
            found = _geocentric(table, (x[0], y[0], height))
            if found:
                return found
        orders += [((x[0], y[0], height), False), ((y[0], x[0], height), False)]
    if not orders and not table.having("line") and not x and not y and table.one("image") is None:
        free = [k for k in table.numeric if not table.names[k].key and k != _id_or_none(table)][:_TRIED]
        if height >= 0 and len(free) >= 2:
            orders += [((*two, height), False) for two in permutations(free, 2)]
        elif len(free) >= 3:
            found = [t for three in permutations(free, 3) for t in _geocentric(table, three)]
            if found:
                return found
            orders += [(three, False) for three in permutations(free, 3)]
    return [t for order, named in orders for t in _triples(table, order, named, units)]


def _id_or_none(table: Table) -> int:
    try:
        return id_column(table)
    except InputError:
        return -1


def _geocentric(table: Table, columns: tuple[int, int, int]) -> list[Triple]:
    unit = {table.names[k].unit for k in columns} & set(LENGTHS)
    scale = LENGTHS[unit.pop()] if len(unit) == 1 else 1.0
    xyz = np.stack([table.numbers(k) for k in columns], axis=1) * scale
    radius = (
        np.median(np.linalg.norm(xyz[np.isfinite(xyz).all(axis=1)], axis=1))
        if np.isfinite(xyz).all(axis=1).any()
        else 0.0
    )
    if not _RADIUS[0] < radius < _RADIUS[1]:
        return []
    named = [table.names[k].key for k in columns] in (["x", "y", "H"], ["X", "Y", "Z"])
    return [Triple("geocentric", columns, xyz, named, "E=m,H=m")]


def _refuse_geocentric(table: Table) -> list[Triple]:
    raise InputError.of("office.not_geocentric", file=table.file, option="columns")


def _triples(table: Table, columns: tuple[int, int, int], named: bool, units: dict[str, str]) -> list[Triple]:
    """Return the interpretations of three columns: geographic or projected, in every possible unit."""
    out = []
    heights = _heights(table, columns[2], units)
    for kind, horizontal, unit in _horizontals(table, columns[:2], units):
        key = "lon" if kind == "geographic" else "E"
        for h, h_unit in heights:
            both = ",".join([f"{key}={unit}"] * bool(unit) + [f"H={h_unit}"] * bool(h_unit))
            out.append(Triple(kind, columns, np.column_stack([horizontal, h]), named, both))
    return out


def _heights(table: Table, column: int, units: dict[str, str]) -> list[tuple[Array, str]]:
    """Return the heights (n,), m, for each possible unit; nan if there is no column of heights."""
    if column < 0:
        return [(np.full(len(table), np.nan), "")]
    values, unit = table.numbers(column), units.get("H") or table.names[column].unit
    stated = {unit: LENGTHS[unit]} if unit in LENGTHS else _HEIGHT_UNITS
    known = values[np.isfinite(values)]
    good = [(values * f, name) for name, f in stated.items() if _within(known * f, _HEIGHTS)]
    return good or ([(values * f, name) for name, f in stated.items()][:1] if unit in LENGTHS else [])


def _within(values: Array, limits: tuple[float, float]) -> bool:
    return bool(len(values)) and limits[0] <= float(np.median(values)) <= limits[1]


def _horizontals(table: Table, columns: Sequence[int], units: dict[str, str]) -> list[tuple[Kind, Array, str]]:
    """Return horizontal coordinates (n, 2), east or longitude first, for each possible kind and unit."""
    angles = [table.angles(k) for k in columns]
    known = [a for a in angles if a is not None]
    if known:
        return [("geographic", np.column_stack(known), "")] if len(known) == 2 else []
    values = np.column_stack([table.numbers(k) for k in columns])
    keys = {table.names[k].key for k in columns}
    named = {units.get(key, "") for key in ("E", "N", "lon", "lat")} | {table.names[k].unit for k in columns}
    named -= {""}
    lengths = {unit for unit in named if unit in LENGTHS}
    forms = {ANGLES[unit] for unit in named if unit in ANGLES}
    out: list[tuple[Kind, Array, str]] = []
    if not lengths and not keys & {"x", "y"}:
        for form in sorted(forms) or (("deg", "gon", "rad", "dms", "d.mmss")):
            degrees = unpacked(values, form)
            whole = degrees[np.isfinite(degrees).all(axis=1)]
            if len(whole) >= 0.5 * len(values) and (np.abs(whole) <= (180.0, 90.0)).all():
                out.append(("geographic", degrees, form))
    if not forms and not keys & {"lon", "lat"}:
        stated = {unit: LENGTHS[unit] for unit in sorted(lengths)} or _LENGTH_UNITS
        out += [("projected", values * factor, unit) for unit, factor in stated.items()]
    return out


def note_numbers(table: Table, triple: Triple, rows: Array, decisions: Decisions) -> None:
    """Raise InputError if cells of coordinates are not numbers.

    Records with blank coordinates are tie points.
    """
    faults = Faults(table.file)
    for axis, column in enumerate(triple.columns):
        if column >= 0:
            values = np.where(rows, triple.coordinates[:, axis], 0.0)
            table.require_numbers(column, values, faults)
    faults.raise_if_any()
