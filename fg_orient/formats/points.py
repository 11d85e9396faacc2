"""Table of ground points: ids, roles, coordinates in any EPSG CRS, standard deviations.

Roles: **control** points enter the adjustment as observed (or, with the word ``fixed`` in all sigma columns, constant)
points; the coordinates of **check** points are for comparison only; **tie** points have none. Reading checks every
cell of every point, but the coordinates of check points do not leave this module until
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
from fg_orient.formats.tables import Faults, Row, Table, read_table, sigma_remarks
from fg_orient.geodesy import COORDINATE_COLUMNS, Kind, Operation, crs_kind, to_ecef_with_operation
from fg_orient.model.block import Coordinates, GroundPoints, WithheldCoordinates
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SIGMA_COLUMNS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_SIGMA_XYZ: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
FIXED: Final = "fixed"
#: Faults after which the list of ids differs from the one that the user meant.
LOSES_IDS: Final = {"table.cell_count", "table.quotes", "table.long_line", "points.id_twice", "points.id_missing"}
#: Standard deviations outside this range are more likely a wrong unit than a survey: 0.01 mm, 10 km.
PLAUSIBLE_SIGMA_M: Final = (1e-5, 1e4)


@dataclass(frozen=True)
class Record:
    """Ground points of a file, check points included; outside ``formats``, their coordinates are sealed.

    Parameters
    ----------
    ids, roles : tuples of length n
    lines : (n,) int array
        Line of each point in its file; 0 if it has no lines.
    given : (n, 3) array
        Coordinates as in the file; nan for points without coordinates.
    coordinates : Coordinates
        Of control and check points.
    operation : Operation or None
        Operation by which they became ECEF.
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


#: Reads the points of a file; None, with the faults noted, if it is unusable.
Parse = Callable[[Faults], Record | None]


@dataclass(frozen=True)
class PointFile:
    """Ground points as read, without the coordinates of check points.

    Parameters
    ----------
    path, crs, sha256 : Path, str, str
        Of the file.
    points : GroundPoints
        All points of the file in its order.
    operation : Operation or None
        Operation by which the coordinates became ECEF; None if no point has coordinates.
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
        Receives all faults of the file.
    scenes : sequence of Scene
        Footprints of the images; points far from all of them are refused.

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
    """Points of a file of any format, those of check points sealed; ``parse`` reads them, now and to open the seal."""
    parsed = parse(faults)
    if parsed is None:
        return None
    check_positions(scenes, parsed.crs, parsed.given, parsed.coordinates.ecef_m, parsed.lines, faults)
    known = _are(parsed.roles, Role.CONTROL)
    points = GroundPoints(parsed.ids, parsed.roles, _mask(parsed.coordinates, known))
    remarks = _remarks(str(path), parsed)
    return PointFile(path, parsed.crs, parsed.sha256, points, parsed.operation, remarks, parse)


def located(points: Record, faults: Faults) -> Record:
    """Points with coordinates in ECEF, from those in their CRS."""
    ecef, operation = _ecef(points.crs, points.given, _are(points.roles, Role.CONTROL), points.lines, faults)
    return replace(points, coordinates=replace(points.coordinates, ecef_m=ecef), operation=operation)


# --- parsing -------------------------------------------------------------------------------------


def _layouts(first: Kind) -> list[tuple[str, ...]]:
    kinds: list[Kind] = sorted(COORDINATE_COLUMNS, key=lambda kind: kind != first)
    usual = [("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS) for kind in kinds]
    return [*usual, ("id", "role", *COORDINATE_COLUMNS["geocentric"], *_SIGMA_XYZ)]


def parse_points(path: Path, crs: str, faults: Faults) -> Record | None:
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
    points = Record(
        ids, tuple(role or Role.TIE for role in roles), table.lines, given, Coordinates(given, sigma, fixed), None,
        table.sha256, crs,
    )  # fmt: skip
    return located(points, faults)


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


def _ecef(
    crs: str, given: Array, control: Mask, lines: npt.NDArray[np.int64], faults: Faults
) -> tuple[Array, Operation | None]:
    """ECEF of rows with coordinates; only control points decide on the operation."""
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


def _mask(coordinates: Coordinates, known: Mask) -> Coordinates:
    shown = known[:, None]
    return Coordinates(
        np.where(shown, coordinates.ecef_m, np.nan),
        np.where(shown, coordinates.sigma_enu_m, np.nan),
        coordinates.fixed & known,
    )


def _take(coordinates: Coordinates, rows: npt.NDArray[np.int_]) -> Coordinates:
    return Coordinates(coordinates.ecef_m[rows], coordinates.sigma_enu_m[rows], coordinates.fixed[rows])


def take_points(points: GroundPoints, rows: npt.NDArray[np.int_]) -> GroundPoints:
    """Selected points."""
    return GroundPoints(
        tuple(points.ids[k] for k in rows), tuple(points.roles[k] for k in rows), _take(points.known, rows)
    )


def _remarks(file: str, parsed: Record) -> tuple[Finding, ...]:
    sigma = parsed.coordinates.sigma_enu_m
    remarks = [
        *sigma_remarks("remark.sigma_ground", file, sigma, PLAUSIBLE_SIGMA_M, lambda k: f"line {parsed.lines[k]}")
    ]
    operation = parsed.operation
    if operation is not None and operation.missing_grids:
        accuracy = "an unknown accuracy" if np.isnan(operation.accuracy_m) else f"{operation.accuracy_m:g} m"
        grids = ", ".join(operation.missing_grids)
        remarks.append(
            finding("remark.grid_missing", file=file, place="crs", value=operation.crs, accuracy=accuracy, grids=grids)
        )
    return tuple(remarks)
