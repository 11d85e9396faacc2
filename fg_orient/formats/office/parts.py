"""Ground points and image points of tables: which columns they are, and which readings of them are possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Decisions
from fg_orient.formats.office.layout import Table
from fg_orient.formats.office.numbers import unpacked
from fg_orient.formats.office.words import ANGLES, LENGTHS, plain
from fg_orient.model.errors import InputError

Kind = Literal["geographic", "projected", "geocentric"]
#: Distances from the centre of the Earth of points near its surface, m.
_RADIUS: Final = (6.33e6, 6.40e6)
#: Heights of points, m.
_HEIGHTS: Final = (-600.0, 9000.0)
#: Columns without a usual name that are tried in all orders.
_TRIED: Final = 5
#: Factors of heights and coordinates whose unit no header names.
_HEIGHT_UNITS: Final = {"m": 1.0, "ft": 0.3048}
_LENGTH_UNITS: Final = {"m": 1.0, "km": 1000.0}


@dataclass(frozen=True, eq=False)
class Triple:
    """Coordinates of one reading of a table.

    Parameters
    ----------
    kind : str
        "geographic", "projected" or "geocentric".
    columns : tuple of int
        Columns of east (longitude, x), north (latitude, y) and height (z); the last may be -1.
    coordinates : (n, 3) array
        Degrees or m.
    named : bool
        The headers name the axes in this order.
    units : str
        Units of horizontal coordinates and height, as the option ``units`` has them.
    """

    kind: Kind
    columns: tuple[int, int, int]
    coordinates: Array
    named: bool
    units: str

    def words(self, table: Table) -> str:
        """Columns as the option ``columns`` has them."""
        keys = {"geographic": ("lon", "lat", "H"), "projected": ("E", "N", "H"), "geocentric": ("X", "Y", "Z")}[
            self.kind
        ]
        return ",".join(f"{key}={table.headers[k]}" for key, k in zip(keys, self.columns, strict=True) if k >= 0)


@dataclass(frozen=True, eq=False)
class ImagePart:
    """Columns of image points: a pair of columns for each image, or one pair and a column of images.

    Parameters
    ----------
    table : Table
    id : int
    image : int
        Column of images; -1: the images are named by ``groups``.
    pairs : list of (int, int)
        Columns of line and sample.
    groups : list of str
        Words that name the image of each pair; "" if none do.
    named : bool
        The headers tell line from sample.
    """

    table: Table
    id: int
    image: int
    pairs: list[tuple[int, int]]
    groups: list[str]
    named: bool


def id_column(table: Table) -> int:
    """Column of the points' ids; without a usual name the first one, of points that occur once the first unique one."""
    named = table.one("id")
    if named is not None:
        return named
    free = [k for k, one in enumerate(table.names) if not one.key]
    if not table.having("image") and not table.having("line"):
        free = [k for k in free if _are_ids(table, k)]
    if not free:
        raise InputError.of("office.no_ids", file=table.file, place=table.sheet.name, option="columns",
                            value=", ".join(table.headers))  # fmt: skip
    return free[0]


def _are_ids(table: Table, column: int) -> bool:
    """Whether the cells of a column are unique, and text or whole numbers."""
    cells = table.texts(column)
    whole = all(not isinstance(c, float) or c.is_integer() for c in table.columns[column])
    return whole and "" not in cells and len(set(cells)) == len(cells)


def ground_triples(table: Table, units: dict[str, str]) -> list[Triple]:
    """Readings of a table as ground points; empty if it has none."""
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
                assert there is not None  # one of both
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
    """Readings of three columns: geographic or projected, in every unit that is not stated and possible."""
    out = []
    heights = _heights(table, columns[2], units)
    for kind, horizontal, unit in _horizontals(table, columns[:2], units):
        key = "lon" if kind == "geographic" else "E"
        for h, h_unit in heights:
            both = ",".join([f"{key}={unit}"] * bool(unit) + [f"H={h_unit}"] * bool(h_unit))
            out.append(Triple(kind, columns, np.column_stack([horizontal, h]), named, both))
    return out


def _heights(table: Table, column: int, units: dict[str, str]) -> list[tuple[Array, str]]:
    """Heights (n,) in m for each possible unit; nan without a column."""
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
    """Horizontal coordinates (n, 2), east or longitude first, for each kind and unit that is possible."""
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


def image_part(table: Table, images: Sequence[str]) -> ImagePart | None:
    """Columns of image points of a table; None if it has none."""
    image = table.one("image")
    lines, samples = table.having("line"), table.having("sample")
    named = bool(lines)
    if not lines and not samples:
        x, y = table.having("x"), table.having("y")
        if (
            not x
            or len(x) != len(y)
            or (image is None and len(x) == 1 and not (table.names[x[0]].rest or _about(table, images)))
        ):
            return _unnamed(table, images)
        lines, samples, named = y, x, True
    if len(lines) != len(samples):
        raise InputError.of("office.pairs", file=table.file, place=table.sheet.name, option="columns",
                            value=", ".join(table.headers[k] for k in (*lines, *samples)))  # fmt: skip
    rests = [[table.names[k].rest for k in own] for own in (lines, samples)]
    if len(lines) > 1:
        if sorted(rests[0]) != sorted(rests[1]) or len(set(rests[0])) < len(lines):
            raise InputError.of("office.pairs", file=table.file, place=table.sheet.name, option="columns",
                                value=", ".join(table.headers[k] for k in (*lines, *samples)))  # fmt: skip
        samples = [samples[rests[1].index(rest)] for rest in rests[0]]
    groups = rests[0] if len(lines) > 1 else [rests[0][0] or _about(table, images)]
    return ImagePart(
        table,
        id_column(table),
        -1 if image is None else image,
        list(zip(lines, samples, strict=True)),
        groups,
        named,
    )


def _about(table: Table, images: Sequence[str]) -> str:
    """Words of the sheet, the text above the header or the file that name an image."""
    for text in (table.sheet.name, table.titles, table.sheet.path.stem):
        if text and match_image(text, images):
            return text
    return ""


def match_image(text: str, images: Sequence[str]) -> str:
    """Image whose name a text has, or that has the text in its name; "" unless it is exactly one."""
    if text in images:
        return text
    own = plain(text.replace(".", " ").replace("_", " ").replace("-", " "))
    bare = {name: plain(name.replace(".", " ").replace("_", " ").replace("-", " ")) for name in images}
    for test in (
        lambda a, b: a == b,
        lambda a, b: bool(a) and f" {a} " in f" {b} ",
        lambda a, b: bool(b) and f" {b} " in f" {a} ",
        lambda a, b: bool(set(a.split()) & _own_words(b, list(bare.values()))),
    ):
        found = [name for name, b in bare.items() if own and test(own, b)]
        if len(found) == 1:
            return found[0]
    return ""


def _own_words(name: str, names: Sequence[str]) -> set[str]:
    """Words of a name that no other name has."""
    others = [set(n.split()) for n in names if n != name]
    return set(name.split()) - set().union(*others)


def _unnamed(table: Table, images: Sequence[str]) -> ImagePart | None:
    """Image points of a table without usual names: a column of images, or a sheet named after one."""
    image = table.one("image")
    if image is None:
        for k in range(len(table.headers)):
            cells = set(table.texts(k))
            if not table.names[k].key and 0 < len(cells) <= len(images) and all(match_image(c, images) for c in cells):
                image = k
                break
    about = "" if image is not None else _about(table, images)
    if image is None and not about:
        return None
    named = table.one("id")
    free = [k for k in range(len(table.headers)) if k != image and not table.names[k].key]
    ids = named if named is not None else (free[0] if free else -1)
    numeric = [k for k in table.numeric if k not in (ids, image) and not table.names[k].key]
    if ids < 0 or len(numeric) != 2:
        return None
    return ImagePart(table, ids, -1 if image is None else image, [(numeric[0], numeric[1])], [about], False)


def note_numbers(table: Table, triple: Triple, rows: Array, decisions: Decisions) -> None:
    """Raise InputError for cells of the coordinates that are no numbers; wholly blank records are tie points."""
    faults = Faults(table.file)
    for axis, column in enumerate(triple.columns):
        if column >= 0:
            values = np.where(rows, triple.coordinates[:, axis], 0.0)
            table.require_numbers(column, values, faults)
    faults.raise_if_any()
