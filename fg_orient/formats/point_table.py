"""Tables of ground points: ids, roles, coordinates in any EPSG CRS, standard deviations.

Roles: **control** points enter the adjustment as observed (or, with the word ``fixed`` in all
sigma columns, constant) points; the coordinates of **check** points are for comparison only;
**tie** points have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import Faults
from fg_orient.formats.table_files import read_table
from fg_orient.formats.tables import Row, Table
from fg_orient.geodesy import COORDINATE_COLUMNS, Kind, Operation, crs_kind, to_ecef_with_operation
from fg_orient.model.block import Coordinates
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

SIGMA_COLUMNS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_SIGMA_XYZ: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
FIXED: Final = "fixed"


def _layouts(first: Kind) -> list[tuple[str, ...]]:
    kinds: list[Kind] = sorted(COORDINATE_COLUMNS, key=lambda kind: kind != first)
    usual = [("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS) for kind in kinds]
    return [*usual, ("id", "role", *COORDINATE_COLUMNS["geocentric"], *_SIGMA_XYZ)]


def parse_points(path: Path, crs: str, faults: Faults) -> Survey | None:
    """Read a table of ground points, check points included; see :func:`read_points`."""
    kind = crs_kind(crs)
    table = read_table(path, _layouts(kind), faults)
    if table is None or not _columns_fit(table, kind, faults):
        return None
    ids = tuple(table.cells["id"])
    table.refuse([not name for name in ids], "points.id_missing", "id")
    table.refuse_repeated([name or k for k, name in enumerate(ids)], "points.id_twice", "id")
    known: dict[str, Role] = {str(role): role for role in Role}
    roles = tuple(map(known.get, table.cells["role"]))
    table.refuse(_are(roles, None), "points.role", "role", value=lambda row: repr(row.cells["role"]))
    tie = _are(roles, Role.TIE)
    measured = ~(tie | _are(roles, None))
    filled = {name: ~table.where(name, "") for name in (*COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS)}
    wrong = np.zeros(len(table), bool)
    for name, is_filled in filled.items():
        table.refuse(is_filled & tie & ~wrong, "points.tie_coordinates", name)
        wrong |= is_filled
    given = _coordinates(table, kind, measured, np.any([filled[n] for n in COORDINATE_COLUMNS[kind]], axis=0))
    sigma, fixed = _sigmas(table, _are(roles, Role.CHECK), measured)
    table.report(faults)
    known_roles = tuple(role or Role.TIE for role in roles)
    return Survey(crs, ids, known_roles, given, sigma, fixed, lines=table.lines)


def _are(roles: Sequence[Role | None], wanted: Role | None) -> Mask:
    """Points (n,) that have a role."""
    return np.fromiter((role is wanted for role in roles), bool, len(roles))


def _columns_fit(table: Table, kind: Kind, faults: Faults) -> bool:
    """False, with the fault noted, if the columns belong to another kind of CRS."""
    wanted = COORDINATE_COLUMNS[kind]
    if not set(wanted) <= set(table.columns):
        present = ", ".join(name for name in table.columns if name not in ("id", "role", *SIGMA_COLUMNS))
        faults.add("points.crs_columns", place="header", value=present, kind=kind, columns=", ".join(wanted))
        return False
    if _SIGMA_XYZ[0] in table.columns:
        faults.add("points.sigma_axes", place="header", value=", ".join(_SIGMA_XYZ))
        return False
    return True


def _coordinates(table: Table, kind: Kind, measured: Mask, filled: Mask) -> Array:
    """Coordinates (n, 3) of measured points; nan where refused."""
    columns = COORDINATE_COLUMNS[kind]
    empty = {"value": _id, "role": lambda row: row.cells["role"]}
    table.refuse(measured & ~filled, "points.no_coordinates", columns[0], **empty)
    values = table.numbers(*columns, rows=measured & filled)
    if kind == "geographic":
        whole = np.isfinite(values).all(axis=1)
        lon, lat = np.abs(values[:, :2].T)
        beyond, swapped = whole & (lat > 90.0), (lon <= 90.0) & (lat <= 180.0)
        table.refuse(beyond & swapped, "points.swapped_range", "lat_deg")
        table.refuse(beyond & ~swapped, "points.latitude", "lat_deg")
        table.refuse(whole & ~beyond & (lon > 180.0), "points.longitude", "lon_deg")
        values[beyond | (whole & (lon > 180.0))] = np.nan
    return values


def _sigmas(table: Table, check: Mask, measured: Mask) -> tuple[Array, Mask]:
    """Sigmas East, North, Up (n, 3) of measured points, nan where refused; and points held fixed (n,)."""
    words = np.array([table.where(name, FIXED) & measured for name in SIGMA_COLUMNS])
    some, fixed = np.asarray(words.any(axis=0)), np.asarray(words.all(axis=0))
    missing = words.argmin(axis=0)  # the first column without the word
    for j, name in enumerate(SIGMA_COLUMNS):
        wrong = some & ~fixed & (missing == j)
        value = lambda row, name=name: row.cells[name] or "an empty cell"  # noqa: E731
        table.refuse(wrong, "points.fixed_partly", name, value=value)
    table.refuse(fixed & check, "points.fixed_check", SIGMA_COLUMNS[0], value=_id)
    values = table.numbers(*SIGMA_COLUMNS, rows=measured & ~some)
    for name, column in zip(SIGMA_COLUMNS, values.T, strict=True):
        table.refuse(column <= 0.0, "points.sigma_not_positive", name)
    values[~(values > 0.0)] = np.nan
    return values, fixed


def _id(row: Row) -> str:
    return row.cells["id"]


def located(survey: Survey, faults: Faults) -> tuple[Coordinates, Operation | None]:
    """Coordinates of a survey in ECEF.

    Returns
    -------
    Coordinates
        (n, 3) m; nan for points without coordinates.
    Operation or None
        Only control points decide on it.
    """
    ecef, operation = np.full_like(survey.coordinates, np.nan), None
    rows = np.flatnonzero(np.isfinite(survey.coordinates).all(axis=1))
    if len(rows):
        try:
            ecef[rows], operation = to_ecef_with_operation(
                survey.crs, *survey.coordinates[rows].T, labels=[f"line {k}" for k in survey.lines[rows]],
                deciding=_are(survey.roles, Role.CONTROL)[rows],
            )  # fmt: skip
        except InputError as error:
            faults.take(*(replace(p, file=faults.file) for p in error.problems))
    return Coordinates(ecef, survey.sigma_enu_m, survey.fixed), operation
