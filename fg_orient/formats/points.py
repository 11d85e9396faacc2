"""Table of ground points: ids, roles, coordinates in any EPSG CRS, standard deviations.

Roles: **control** points enter the adjustment as observed (or, with the word ``fixed`` in
all sigma columns, constant) points; **check** points carry coordinates for comparison
only; **tie** points have none. Reading checks every cell of every point, but the
coordinates of check points do not leave this module until
:meth:`fg_orient.model.block.WithheldCoordinates.open` reads the file again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.scenes import Scene, check_positions
from fg_orient.formats.tables import Faults, Row, Table, number, read_table
from fg_orient.geodesy import COORDINATE_COLUMNS, Kind, Operation, crs_kind, to_ecef_with_operation
from fg_orient.model.block import Coordinates, GroundPoints, WithheldCoordinates
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]

SIGMA_COLUMNS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_SIGMA_XYZ: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
FIXED: Final = "fixed"
#: Faults after which the list of ids is not the one the user meant.
LOSES_IDS: Final = {"table.cell_count", "table.quotes", "table.long_line", "points.id_twice", "points.id_missing"}
#: Standard deviations outside this range are more likely a wrong unit than a survey: 0.01 mm, 10 km.
PLAUSIBLE_SIGMA_M: Final = (1e-5, 1e4)


@dataclass(frozen=True)
class Record:
    """Ground points as a reader gives them, check points included: they leave ``formats`` sealed only.

    Parameters
    ----------
    ids, roles : tuples of length n
    lines : (n,) int array
        Line of each point in its file; 0 where there is none.
    given : (n, 3) array
        Coordinates as in the file, nan where there are none.
    coordinates : Coordinates
        Of control and check points.
    operation : Operation or None
        How they became ECEF.
    sha256, crs : str
        Of the file.
    """

    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    lines: npt.NDArray[np.int64]
    given: Array
    coordinates: Coordinates
    operation: Operation | None
    sha256: str
    crs: str


#: Reads the points of a file; None, with the reasons noted, if it is unusable.
Parse = Callable[[Faults], Record | None]


@dataclass(frozen=True)
class PointFile:
    """Ground points as read, without the coordinates of check points.

    Parameters
    ----------
    path, crs, sha256 : Path, str, str
        Where they come from.
    points : GroundPoints
        All points of the file in its order.
    operation : Operation or None
        How the coordinates became ECEF; None if no point has coordinates.
    remarks : tuple of Finding
        Warnings that require no correction.
    parse : callable
        Reads the file again, for the coordinates of check points.
    """

    path: Path
    crs: str
    sha256: str
    points: GroundPoints
    operation: Operation | None
    remarks: tuple[Finding, ...]
    parse: Parse

    def withheld(self, ids: Sequence[str]) -> WithheldCoordinates:
        """Seal the coordinates of these check points until they are opened."""
        # absolute: the working directory may change before they are opened
        wanted, path, sha256, parse = tuple(ids), self.path.absolute(), self.sha256, self.parse

        def reader() -> Coordinates:
            faults = Faults(str(path))
            again = parse(faults)
            if again is None or faults or again.sha256 != sha256:
                raise InputError.of("points.changed", file=path, place="check points")
            row = {name: k for k, name in enumerate(again.ids)}
            return _take(again.coordinates, np.array([row[name] for name in wanted], int))

        return WithheldCoordinates(wanted, reader)


def read_points(path: Path, crs: str, faults: Faults, scenes: Sequence[Scene] = ()) -> PointFile | None:
    """Read a table of ground points.

    Parameters
    ----------
    path : Path
        CSV file: ``id, role``, three coordinate columns, three sigma columns.
    crs : str
        EPSG code of the coordinates.
    faults : Faults
        Takes everything wrong with the file.
    scenes : sequence of Scene
        Where the images look; points far from all of them are refused.

    Returns
    -------
    PointFile or None
        None if the table as a whole is unusable. With cell faults the ids and roles are
        still right, so that other files can be checked against them.

    Raises
    ------
    InputError
        The CRS is unusable.
    """
    where = path.absolute()  # the working directory may change before check points are opened
    return point_file(path, lambda noted: parse_points(where, crs, noted), faults, scenes)


def point_file(path: Path, parse: Parse, faults: Faults, scenes: Sequence[Scene] = ()) -> PointFile | None:
    """Seal what a reader of any format gives; see :func:`read_points`.

    Parameters
    ----------
    path : Path
        Where the points stand.
    parse : callable
        Reads them, and again for the check points.
    faults, scenes
        See :func:`read_points`.
    """
    parsed = parse(faults)
    if parsed is None:
        return None
    check_positions(scenes, parsed.crs, parsed.given, parsed.coordinates.ecef_m, parsed.lines, faults)
    known = _are(parsed.roles, Role.CONTROL)
    points = GroundPoints(parsed.ids, parsed.roles, _mask(parsed.coordinates, known))
    remarks = _remarks(str(path), parsed)
    return PointFile(path, parsed.crs, parsed.sha256, points, parsed.operation, remarks, parse)


def located(found: Record, faults: Faults) -> Record:
    """Points whose coordinates were left in their CRS, with those in ECEF."""
    ecef, operation = _ecef(found.crs, found.given, _are(found.roles, Role.CONTROL), found.lines, faults)
    return replace(found, coordinates=replace(found.coordinates, ecef_m=ecef), operation=operation)


# --- parsing -------------------------------------------------------------------------------------


def _layouts(first: Kind) -> list[tuple[str, ...]]:
    kinds: list[Kind] = sorted(COORDINATE_COLUMNS, key=lambda kind: kind != first)
    usual = [("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS) for kind in kinds]
    return [*usual, ("id", "role", *COORDINATE_COLUMNS["geocentric"], *_SIGMA_XYZ)]


def parse_points(path: Path, crs: str, faults: Faults) -> Record | None:
    """Read a table of ground points as it stands, check points included; see :func:`read_points`."""
    kind = crs_kind(crs)
    table = read_table(path, _layouts(kind), faults)
    if table is None or not _columns_fit(table, kind, faults):
        return None
    ids = _ids(table, faults)
    roles = _roles(table, faults)
    given, sigma, fixed = _converted(table, roles, kind) or _checked(table, roles, kind, faults)
    control = _are(roles, Role.CONTROL)
    ecef, operation = _ecef(crs, given, control, table.lines, faults)
    coordinates = Coordinates(ecef, sigma, fixed)
    known_roles = tuple(role or Role.TIE for role in roles)
    return Record(ids, known_roles, table.lines, given, coordinates, operation, table.sha256, crs)


def _are(roles: Sequence[Role | None], wanted: Role) -> npt.NDArray[np.bool_]:
    """Tell which points have a role."""
    return np.fromiter((role is wanted for role in roles), bool, len(roles))


def _converted(
    table: Table, roles: Sequence[Role | None], kind: Kind
) -> tuple[Array, Array, npt.NDArray[np.bool_]] | None:
    """Coordinates, sigmas (n, 3) and fixed (n,) of the whole table at once; None if anything is wrong with it."""
    columns = COORDINATE_COLUMNS[kind]
    measured = ~_are(roles, Role.TIE)
    filled = np.zeros(len(table), bool)
    for name in (*columns, *SIGMA_COLUMNS):
        filled |= np.fromiter(map(bool, table.cells[name]), bool, len(table))
    words = [np.fromiter((cell == FIXED for cell in table.cells[name]), bool, len(table)) for name in SIGMA_COLUMNS]
    fixed = np.logical_and.reduce(words)
    rows, weighted = np.flatnonzero(measured), np.flatnonzero(measured & ~fixed)
    coordinates, sigmas = table.numbers(*columns, rows=rows), table.numbers(*SIGMA_COLUMNS, rows=weighted)
    if coordinates is None or sigmas is None or None in roles or (filled & ~measured).any():
        return None
    on_earth = kind != "geographic" or bool((np.abs(coordinates[:, :2]) <= (180.0, 90.0)).all())
    if not (on_earth and (sigmas > 0.0).all() and not (fixed & ~_are(roles, Role.CONTROL)).any()):
        return None
    given, sigma = np.full((len(table), 3), np.nan), np.full((len(table), 3), np.nan)
    given[rows], sigma[weighted] = coordinates, sigmas
    return given, sigma, fixed


def _checked(
    table: Table, roles: Sequence[Role | None], kind: Kind, faults: Faults
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """The same record by record; notes what is wrong."""
    given, sigma = np.full((len(table), 3), np.nan), np.full((len(table), 3), np.nan)
    fixed = np.zeros(len(table), bool)
    for k, (row, role) in enumerate(zip(table.rows, roles, strict=True)):
        if role is Role.TIE:
            _require_empty(row, COORDINATE_COLUMNS[kind], faults)
        elif role is not None:
            given[k] = _coordinates(row, role, kind, faults)
            sigma[k], fixed[k] = _sigmas(row, role, faults)
    return given, sigma, fixed


def _columns_fit(table: Table, kind: Kind, faults: Faults) -> bool:
    wanted = COORDINATE_COLUMNS[kind]
    if not set(wanted) <= set(table.columns):
        found = ", ".join(name for name in table.columns if name not in ("id", "role", *SIGMA_COLUMNS))
        faults.add("points.crs_columns", place="header", value=found, kind=kind, columns=", ".join(wanted))
        return False
    if _SIGMA_XYZ[0] in table.columns:
        faults.add("points.sigma_axes", place="header", value=", ".join(_SIGMA_XYZ))
        return False
    return True


def _ids(table: Table, faults: Faults) -> tuple[str, ...]:
    ids = tuple(table.cells["id"])
    if all(ids) and len(set(ids)) == len(ids):
        return ids
    first: dict[str, int] = {}
    for row in table.rows:
        name = row.cells["id"]
        if not name:
            faults.add("points.id_missing", place=row.place("id"))
        elif name in first:
            faults.add("points.id_twice", place=row.place("id"), value=name, first=first[name])
        else:
            first[name] = row.line
    return ids


def _roles(table: Table, faults: Faults) -> tuple[Role | None, ...]:
    words: dict[str, Role] = {str(role): role for role in Role}
    roles = tuple(map(words.get, table.cells["role"]))
    for k in np.flatnonzero([role is None for role in roles]):
        row = table.row(int(k))
        faults.add("points.role", place=row.place("role"), value=repr(row.cells["role"]))
    return roles


def _require_empty(row: Row, columns: Sequence[str], faults: Faults) -> None:
    for column in (*columns, *SIGMA_COLUMNS):
        if row.cells[column]:
            faults.add("points.tie_coordinates", place=row.place(column), value=row.cells[column])
            return


def _coordinates(row: Row, role: Role, kind: Kind, faults: Faults) -> Array:
    columns = COORDINATE_COLUMNS[kind]
    if not any(row.cells[column] for column in columns):
        faults.add("points.no_coordinates", place=row.place(columns[0]), value=row.cells["id"], role=role)
        return np.full(3, np.nan)
    values = np.array([number(row, column, faults) for column in columns])
    if kind != "geographic" or not np.isfinite(values).all():
        return values
    lon, lat = values[:2]
    if abs(lat) > 90.0:
        swapped = abs(lon) <= 90.0 and abs(lat) <= 180.0
        code = "points.swapped_range" if swapped else "points.latitude"
        faults.add(code, place=row.place("lat_deg"), value=row.cells["lat_deg"])
    elif abs(lon) > 180.0:
        faults.add("points.longitude", place=row.place("lon_deg"), value=row.cells["lon_deg"])
    else:
        return values
    return np.full(3, np.nan)


def _sigmas(row: Row, role: Role, faults: Faults) -> tuple[Array, bool]:
    words = [row.cells[column] == FIXED for column in SIGMA_COLUMNS]
    if any(words):
        if not all(words):
            column = SIGMA_COLUMNS[words.index(False)]
            faults.add("points.fixed_partly", place=row.place(column), value=row.cells[column] or "an empty cell")
        elif role is not Role.CONTROL:
            faults.add("points.fixed_check", place=row.place(SIGMA_COLUMNS[0]), value=row.cells["id"])
        return np.full(3, np.nan), all(words)
    values = np.full(3, np.nan)
    for k, column in enumerate(SIGMA_COLUMNS):
        value = number(row, column, faults)
        if value <= 0.0:
            faults.add("points.sigma_not_positive", place=row.place(column), value=row.cells[column])
        else:
            values[k] = value
    return values, False


def _ecef(
    crs: str, given: Array, control: npt.NDArray[np.bool_], lines: npt.NDArray[np.int64], faults: Faults
) -> tuple[Array, Operation | None]:
    """ECEF of rows with coordinates; control alone decides on the operation: check points decide nothing."""
    ecef = np.full_like(given, np.nan)
    rows = np.flatnonzero(np.isfinite(given).all(axis=1))
    if not len(rows):
        return ecef, None
    try:
        xyz, operation = to_ecef_with_operation(
            crs, *given[rows].T, labels=[f"line {k}" for k in lines[rows]], deciding=control[rows]
        )
    except InputError as error:
        faults.take(*(replace(p, file=faults.file) for p in error.problems))
        return ecef, None
    ecef[rows] = xyz
    return ecef, operation


def _mask(coordinates: Coordinates, known: npt.NDArray[np.bool_]) -> Coordinates:
    shown = known[:, None]
    return Coordinates(
        np.where(shown, coordinates.ecef_m, np.nan),
        np.where(shown, coordinates.sigma_enu_m, np.nan),
        coordinates.fixed & known,
    )


def _take(coordinates: Coordinates, rows: npt.NDArray[np.int_]) -> Coordinates:
    return Coordinates(coordinates.ecef_m[rows], coordinates.sigma_enu_m[rows], coordinates.fixed[rows])


def take_points(points: GroundPoints, rows: npt.NDArray[np.int_]) -> GroundPoints:
    """Give the selected points."""
    return GroundPoints(
        tuple(points.ids[k] for k in rows), tuple(points.roles[k] for k in rows), _take(points.known, rows)
    )


def _remarks(file: str, parsed: Record) -> tuple[Finding, ...]:
    remarks = []
    low, high = PLAUSIBLE_SIGMA_M
    sigma = parsed.coordinates.sigma_enu_m
    odd = np.flatnonzero(((sigma < low) | (sigma > high)).any(axis=1))
    if len(odd):
        place, value = f"line {parsed.lines[odd[0]]}, sigma", " ".join(f"{s:g}" for s in sigma[odd[0]])
        remarks.append(
            finding("remark.sigma_ground", file=file, place=place, value=value, low=low, high=high, count=len(odd))
        )
    operation = parsed.operation
    if operation is not None and operation.missing_grids:
        accuracy = "an unknown accuracy" if np.isnan(operation.accuracy_m) else f"{operation.accuracy_m:g} m"
        grids = ", ".join(operation.missing_grids)
        remarks.append(
            finding("remark.grid_missing", file=file, place="crs", value=operation.crs, accuracy=accuracy, grids=grids)
        )
    return tuple(remarks)
