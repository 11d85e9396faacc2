"""Read roles and standard deviations of points from tables of unknown form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.formats.exchange.survey import UNKNOWN
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Choice, Decisions, Question
from fg_orient.formats.office.table import Table, id_column
from fg_orient.formats.office.words import LENGTHS, role_of
from fg_orient.formats.points import FIXED
from fg_orient.model.arrays import having_role
from fg_orient.model.names import Role

#: Usual range of standard deviations of surveys, m. A value without unit is read as m if it is below the upper limit.
_SURVEYED_M: Final = (5e-4, 1.0)
_SURELY_M: Final = 0.5


def pixel_sigmas(table: Table) -> Array:
    """Read standard deviations (n, 2), px, of line and sample; missing values are nan."""
    both = table.one("spx")
    columns = [both, both] if both is not None else [table.one("sline"), table.one("ssample")]
    faults = Faults(table.file)
    out = [np.full(len(table), np.nan) if k is None else _positive(table, k, 1.0, faults) for k in columns]
    faults.raise_if_any()
    return np.column_stack(out)


def _positive(table: Table, column: int, factor: float, faults: Faults) -> Array:
    """Read the standard deviations (n,) of a column.

    An empty cell or the word "fixed" gives nan.
    """
    cells = table.columns[column]
    values = table.numbers(column) * factor
    open_ = np.array([isinstance(c, str) and c.lower() in ("", FIXED) for c in cells], bool)
    table.require_numbers(column, np.where(open_, 0.0, values), faults)
    for k in np.flatnonzero(values <= 0.0).tolist():
        faults.add("points.sigma_not_positive", place=table.place(k, column), value=cells[k])
    return np.where(open_, np.nan, values)


def roles_and_sigmas(
    tables: Sequence[Table],
    row: Mapping[str, int],
    coordinates: Array,
    units: Mapping[str, str],
    role_column: str,
    decisions: Decisions,
) -> tuple[list[Role], Array, Mask]:
    """Read roles and standard deviations of the ground points.

    Parameters
    ----------
    tables : sequence of Table
        Tables of ground points.
    row : mapping of str to int
        Row of each of the n ground points.
    coordinates : (n, 3) array
        Coordinates of the points. Points without coordinates are tie points.
    units : mapping of str to str
        Units that the user has stated.
    role_column : str
        Header of the column of roles; "none" to ignore such columns.
    decisions : Decisions
        Collects the assumptions.

    Returns
    -------
    roles : list of Role
    sigmas : (n, 3) array
        Standard deviations East, North, Up, m; missing values are nan.
    fixed : (n,) bool array
        Mask of the points without uncertainty.
    """
    known = np.asarray(np.isfinite(coordinates[:, :2]).all(axis=1))
    roles = [Role.CONTROL if yes else Role.TIE for yes in known]
    sigma, fixed = np.full((len(row), 3), np.nan), np.zeros(len(row), bool)
    stated = False
    for table in tables:
        at = np.array([row[name] for name in table.texts(id_column(table))], np.intp)
        column = None if role_column == "none" else table.one("role")
        if column is not None:
            stated = True
            _take_roles(table, column, at, roles, known, decisions)
        own, held = _ground_sigmas(table, units, decisions)
        sigma[at] = np.where(np.isfinite(own), own, sigma[at])
        fixed[at] |= held
    if tables and not stated:
        decisions.note("roles", "all points with coordinates are control", "no column names roles", "role_column")
    tie = having_role(roles, Role.TIE)
    return roles, np.where(tie[:, None], UNKNOWN, sigma), fixed & ~tie


def _take_roles(table: Table, column: int, at: Index, roles: list[Role], known: Mask, decisions: Decisions) -> None:
    faults, words = Faults(table.file), dict[str, list[Role]]()
    for k, (cell, n) in enumerate(zip(table.texts(column), at.tolist(), strict=True)):
        role = role_of(cell) if cell else (Role.CONTROL if known[n] else Role.TIE)
        if role is None:
            faults.add("office.role", place=table.place(k, column), value=repr(cell), option="")
        elif role is not Role.TIE and not known[n]:
            faults.add("points.no_coordinates", place=table.place(k, column), value=cell, role=cell)
        else:
            words.setdefault(cell or "a blank cell", []).append(role)
            roles[n] = role
    faults.raise_if_any()
    listed = ", ".join(f"{word} = {own[0]} ({len(own)})" for word, own in words.items())
    decisions.note(f"roles of {table.sheet.title}", listed, f"by column {table.headers[column]}", "role_column")


def _ground_sigmas(table: Table, units: Mapping[str, str], decisions: Decisions) -> tuple[Array, Mask]:
    """Read standard deviations East, North, Up (n, 3), m, of a table, and a mask of fixed points (n,).

    Missing values are nan.
    """
    plane = table.one("sEN")
    own = [table.one(key) for key in ("sE", "sN", "sH")]
    x, y = table.one("sx"), table.one("sy")
    columns = [own[0], own[1], own[2]]
    if plane is not None:
        columns[:2] = [plane, plane]
    elif own[0] is None and own[1] is None and x is not None and y is not None:
        columns[:2] = [x, y]
    faults, out = Faults(table.file), []
    fixed = np.zeros(len(table), bool)
    for column in columns:
        if column is None:
            out.append(np.full(len(table), np.nan))
            continue
        fixed |= np.array([isinstance(c, str) and c.lower() == FIXED for c in table.columns[column]], bool)
        unit = units.get(table.names[column].key) or table.names[column].unit
        plain = _positive(table, column, 1.0, faults)
        faults.raise_if_any()
        out.append(plain * _sigma_factor(table, column, unit, plain, decisions))
    return np.column_stack(out), fixed


def _sigma_factor(table: Table, column: int, unit: str, values: Array, decisions: Decisions) -> float:
    if unit in LENGTHS:
        return LENGTHS[unit]
    known = values[np.isfinite(values)]
    if not len(known):
        return 1.0
    middle = float(np.median(known))
    names = [name for name in ("m", "cm", "mm") if _SURVEYED_M[0] <= middle * LENGTHS[name] <= _SURVEYED_M[1]] or ["m"]
    clear = names[0] == "m" and middle < _SURELY_M
    choices = [Choice(f"{table.names[column].key}={name}", f"{middle:g} {name}") for name in names]
    reason = "usual size of the values in m" if clear else "the header names no unit"
    question = Question("units", f"unit of {table.headers[column]}", choices, clear, reason)
    choice = decisions.settle(question, table.file)
    return LENGTHS.get(choice.value.partition("=")[2], 1.0) if choice is not None else 1.0
