"""Read tables of ground points and of image observations; the coordinates of check points are sealed.

The reader checks every cell of every point. However, the coordinates of check points do
not leave this module until :meth:`fg_orient.model.block.WithheldCoordinates.open` reads
the file again.

Our own tables contain ids, roles, standard deviations, and coordinates in any EPSG CRS. There are three roles:

- **control** points are observed points of the adjustment; they are constant if all their sigma columns contain the
  word ``fixed``;
- **check** points have coordinates that are used for comparison only;
- **tie** points have no known coordinates.

A record of observations contains line and sample with their standard deviations, px. (0,
0) is the centre of the first pixel. An image of n lines extends from -0.5 to n - 0.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import Faults, sigma_remarks
from fg_orient.formats.heights import ZeroLevel, on_found_grid, without_vertical
from fg_orient.formats.scenes import Scene, check_positions, exchanged_pixels
from fg_orient.formats.tables import Row, Table, read_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import (
    BODY_FIXED,
    COORDINATE_COLUMNS,
    Kind,
    Operation,
    crs_kind,
    is_of_body,
    to_ecef_with_operation,
)
from fg_orient.model.arrays import having_role
from fg_orient.model.block import Coordinates, GroundPoints, GroundSystem, ImagePoints, WithheldCoordinates
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import LARGEST, SMALLEST, Role

SIGMA_COLUMNS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_SIGMA_XYZ: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
FIXED: Final = "fixed"


#: Entries of a project file that messages name instead of options.
ENTRIES: Final = {name: f"{name} under [points]" for name in ("geoid", "undulation_m", "both_heights")}


def _layouts(first: Kind, incomplete: bool) -> list[tuple[str, ...]]:
    kinds: list[Kind] = sorted(COORDINATE_COLUMNS, key=lambda kind: kind != first)
    usual: list[tuple[str, ...]] = [("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS) for kind in kinds]
    # if several layouts have the same columns, the first one is used, because it lacks the fewest
    # columns
    if incomplete:
        lacking = (("role", *SIGMA_COLUMNS), SIGMA_COLUMNS, ("role",), ())
        usual = [tuple(name for name in layout if name not in out) for out in lacking for layout in usual]
    return [*usual, ("id", "role", *COORDINATE_COLUMNS["geocentric"], *_SIGMA_XYZ)]


def parse_points(path: Path, crs: str, faults: Faults, *, incomplete: bool = False) -> Survey | None:
    """Read a table of ground points, including the coordinates of check points; see :func:`read_points`.

    An ``incomplete`` table may lack roles, heights and standard deviations. Missing
    values are then nan, and points with coordinates are control points.
    """
    kind = crs_kind(crs)
    table = read_table(path, _layouts(kind, incomplete), faults)
    if table is None or not _columns_fit(table, kind, faults):
        return None
    if incomplete:
        table = table.completed("role", *SIGMA_COLUMNS)
    ids = tuple(table.cells["id"])
    table.refuse([not name for name in ids], "points.id_missing", "id")
    table.refuse_repeated([name or k for k, name in enumerate(ids)], "points.id_twice", "id")
    known: dict[str, Role] = {str(role): role for role in Role}
    filled = {name: ~table.where(name, "") for name in (*COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS)}
    located = np.any([filled[name] for name in COORDINATE_COLUMNS[kind]], axis=0)
    roles = tuple(map(known.get, table.cells["role"]))
    if incomplete:
        table_roles = zip(table.cells["role"], roles, located.tolist(), strict=True)
        roles = tuple(role if name else (Role.CONTROL if has else Role.TIE) for name, role, has in table_roles)
    table.refuse(having_role(roles, None), "points.role", "role", value=lambda row: repr(row.cells["role"]))
    tie = having_role(roles, Role.TIE)
    measured = ~(tie | having_role(roles, None))
    wrong = np.zeros(len(table), bool)
    for name, is_filled in filled.items():
        table.refuse(is_filled & tie & ~wrong, "points.tie_coordinates", name)
        wrong |= is_filled
    given = _coordinates(table, kind, measured, located, incomplete)
    stated = np.any([filled[name] for name in SIGMA_COLUMNS], axis=0) | (not incomplete)
    sigma, fixed = _sigmas(table, having_role(roles, Role.CHECK), measured & stated)
    table.report(faults)
    known_roles = tuple(role or Role.TIE for role in roles)
    if is_of_body(crs):
        from fg_orient.geodesy.bodies import points_on  # imported here, because it compiles kernels

        crs, given = BODY_FIXED, points_on(crs, given)
    return Survey(crs, ids, known_roles, given, sigma, fixed, lines=table.lines, unit=table.unit)


def _columns_fit(table: Table, kind: Kind, faults: Faults) -> bool:
    """Return whether the columns belong to this kind of CRS; if not, note the fault."""
    wanted = COORDINATE_COLUMNS[kind]
    if not set(wanted) <= set(table.columns):
        present = ", ".join(name for name in table.columns if name not in ("id", "role", *SIGMA_COLUMNS))
        faults.add("points.crs_columns", place="header", value=present, kind=kind, columns=", ".join(wanted))
        return False
    if _SIGMA_XYZ[0] in table.columns:
        faults.add("points.sigma_axes", place="header", value=", ".join(_SIGMA_XYZ))
        return False
    return True


def _coordinates(table: Table, kind: Kind, measured: Mask, filled: Mask, incomplete: bool) -> Array:
    """Read the coordinates (n, 3) of points with known coordinates.

    Refused values, and heights that an incomplete table does not contain, are nan.
    """
    columns = COORDINATE_COLUMNS[kind]
    flat = measured & filled & table.where(columns[2], "") & (incomplete and kind != "geocentric")
    empty = {"value": _id, "role": lambda row: row.cells["role"]}
    table.refuse(measured & ~filled, "points.no_coordinates", columns[0], **empty)
    values = table.numbers(*columns, rows=measured & filled & ~flat)
    values[flat, :2] = table.numbers(*columns[:2], rows=flat)[flat]
    if kind == "geographic":
        whole = np.isfinite(values[:, :2]).all(axis=1)
        lon, lat = np.abs(values[:, :2].T)
        beyond, swapped = whole & (lat > 90.0), (lon <= 90.0) & (lat <= 180.0)
        table.refuse(beyond & swapped, "points.swapped_range", "lat_deg")
        table.refuse(beyond & ~swapped, "points.latitude", "lat_deg")
        table.refuse(whole & ~beyond & (lon > 180.0), "points.longitude", "lon_deg")
        values[beyond | (whole & (lon > 180.0))] = np.nan
    large = np.abs(values) > LARGEST  # the squares of such numbers can overflow
    for name, column in zip(columns, large.T, strict=True):
        table.refuse(column & (name not in ("lon_deg", "lat_deg")), "points.too_large", name, limit=LARGEST)
    values[large.any(axis=1)] = np.nan
    return values


def _sigmas(table: Table, check: Mask, measured: Mask) -> tuple[Array, Mask]:
    """Read the standard deviations East, North, Up (n, 3), m, and a mask (n,) of the fixed points.

    Refused values are nan.
    """
    words = np.array([table.where(name, FIXED) & measured for name in SIGMA_COLUMNS])
    some, fixed = np.asarray(words.any(axis=0)), np.asarray(words.all(axis=0))
    missing = words.argmin(axis=0)  # the first column without the word "fixed"
    for j, name in enumerate(SIGMA_COLUMNS):
        wrong = some & ~fixed & (missing == j)
        value = lambda row, name=name: row.cells[name] or "an empty cell"  # noqa: E731
        table.refuse(wrong, "points.fixed_partly", name, value=value)
    table.refuse(fixed & check, "points.fixed_check", SIGMA_COLUMNS[0], value=_id)
    values = table.numbers(*SIGMA_COLUMNS, rows=measured & ~some)
    for name, column in zip(SIGMA_COLUMNS, values.T, strict=True):
        table.refuse((column < SMALLEST) | (column > LARGEST), "points.sigma_not_positive", name)
    values[~(values > 0.0)] = np.nan
    return values, fixed


def _id(row: Row) -> str:
    return row.cells["id"]


def located(
    survey: Survey, faults: Faults, names: Mapping[str, str] | None = None
) -> tuple[Coordinates, Operation | None]:
    """Transform the coordinates of a survey to ECEF; messages show ``names`` instead of options.

    Returns
    -------
    Coordinates
        (n, 3) m; nan for points without coordinates.
    Operation or None
        Operation of the transformation; only control points decide which one it is.
    """
    ecef, operation = np.full_like(survey.coordinates, np.nan), None
    rows = np.flatnonzero(np.isfinite(survey.coordinates).all(axis=1))
    if survey.crs == BODY_FIXED:
        ecef[rows] = survey.coordinates[rows]
    elif len(rows):
        try:
            ecef[rows], operation = to_ecef_with_operation(
                survey.crs, *survey.coordinates[rows].T, labels=[survey.place(k) for k in rows.tolist()],
                deciding=having_role(survey.roles, Role.CONTROL)[rows],
            )  # fmt: skip
        except InputError as error:
            faults.take(*(replace(p, file=faults.file, names=names or {}) for p in error.problems))
    return Coordinates(ecef, survey.sigma_enu_m, survey.fixed), operation


#: After one of these faults, the list of ids may differ from the list that the user intended.
LOSES_IDS: Final = {
    "table.no_records",
    "table.cell_count",
    "table.quotes",
    "table.long_line",
    "points.id_twice",
    "points.id_missing",
}
#: A standard deviation outside this range (0.01 mm to 10 km) probably has a wrong unit.
PLAUSIBLE_SIGMA_M: Final = (1e-5, 1e4)
#: Function that reads the points of a file, including check points. It notes errors and
#: returns None if the file cannot be used.
Parse = Callable[[Faults], Survey | None]


@dataclass(frozen=True)
class PointFile:
    """Ground points that were read from a file, without the coordinates of check points.

    Parameters
    ----------
    path, system, sha256 : Path, GroundSystem, str
            The file, the reference system of its coordinates, and its hash.
    points : GroundPoints
        All points in the order of the file.
    operation : Operation or None
        Operation that transformed the coordinates to ECEF; None if no point has coordinates.
    remarks : tuple of Finding
        Warnings that require no correction.
    opened : callable
        Function that reads the file again and returns the coordinates of the points with given ids.
    """

    path: Path
    system: GroundSystem
    sha256: str
    points: GroundPoints
    operation: Operation | None
    remarks: tuple[Finding, ...]
    opened: Callable[[tuple[str, ...]], Coordinates]

    def withheld(self, ids: Sequence[str]) -> WithheldCoordinates:
        """Return the sealed coordinates of these check points."""
        return WithheldCoordinates(tuple(ids), partial(self.opened, tuple(ids)))


def read_points(
    path: Path, crs: str, faults: Faults, scenes: Sequence[Scene] = (), level: ZeroLevel | None = None
) -> PointFile | None:
    """Read a table of ground points.

    Parameters
    ----------
    path : Path
        Table with the columns ``id, role``, three coordinates and three standard deviations.
    crs : str
        EPSG code of the coordinates, "body-fixed", or a code of the IAU, whose coordinates become body-fixed.
    faults : Faults
        Collects all faults of the file.
    scenes : sequence of Scene
        Footprints of the images; points that are far from all images are refused.
    level : ZeroLevel, optional
        Zero level of the heights; it replaces the vertical part of the CRS.

    Returns
    -------
    PointFile or None
        None if the table cannot be used at all. If only cells have faults, ids and roles are
        correct, and other files can be checked with them.

    Raises
    ------
    InputError
        The CRS cannot be used.
    """
    where = path.absolute()  # the working directory may change before check points are opened
    return point_file(path, (where,), lambda noted: parse_points(where, crs, noted), faults, scenes, level)


def no_points(path: Path, ties: tuple[str, ...] = ()) -> PointFile:
    """Return the points of a project without a point table: the tie points that its observations (``path``) name."""

    def nothing(names: tuple[str, ...]) -> Coordinates:
        none = np.full((len(names), 3), np.nan)
        return Coordinates(none, none, np.zeros(len(names), bool))

    points = GroundPoints(ties, (Role.TIE,) * len(ties), nothing(ties))
    return PointFile(path, GroundSystem(), "", points, None, (), nothing)


def point_file(
    path: Path,
    files: tuple[Path, ...],
    parse: Parse,
    faults: Faults,
    scenes: Sequence[Scene] = (),
    level: ZeroLevel | None = None,
) -> PointFile | None:
    """Read the points of a file of any format and seal the coordinates of its check points.

    ``parse`` reads the ``files`` (absolute paths) now. It reads them again when the seal is
    opened. For ``level`` see :func:`read_points`.
    """  # fmt: skip
    given = parse(faults)
    survey = _ellipsoidal(given, level, faults)
    if given is None or survey is None:
        return None
    digest = sha256_of(*files)
    coordinates, operation = located(survey, faults, ENTRIES)
    check_positions(scenes, survey.crs, survey.coordinates, coordinates.ecef_m, survey.place, faults)

    def opened(wanted: tuple[str, ...]) -> Coordinates:
        noted = Faults(str(files[0]))
        again = _ellipsoidal(parse(noted), level, noted)
        if again is None or noted or sha256_of(*files) != digest:
            raise InputError.of("points.changed", file=files[0], place="check points")
        row = {name: k for k, name in enumerate(again.ids)}
        return located(again, noted)[0].take(np.array([row[name] for name in wanted], np.intp))

    control = having_role(survey.roles, Role.CONTROL)
    known = coordinates.only(control)
    if survey.starts is not None:
        starts = located(replace(survey, coordinates=survey.starts), faults)[0].ecef_m
        ties = having_role(survey.roles, Role.TIE)[:, None]
        known = Coordinates(np.where(ties, starts, known.ecef_m), known.sigma_enu_m, known.fixed)
    points = GroundPoints(survey.ids, survey.roles, known)
    remarks = _remarks(str(path), survey, operation)
    return PointFile(path, (level or ZeroLevel()).system(given.crs), digest, points, operation, remarks, opened)


def _ellipsoidal(survey: Survey | None, level: ZeroLevel | None, faults: Faults) -> Survey | None:
    """Convert the heights to ellipsoidal heights if PROJ does not contain their zero level.

    If this fails, note the faults and return None.
    """
    if survey is None:
        return None
    try:
        return level.applied(without_vertical(survey)) if level else on_found_grid(survey)
    except InputError as error:
        faults.take(*(replace(p, names=ENTRIES) for p in error.problems))
        return None


def _remarks(file: str, survey: Survey, operation: Operation | None) -> tuple[Finding, ...]:
    sigma = survey.sigma_enu_m
    remarks = [*survey.notes, *sigma_remarks("remark.sigma_ground", file, sigma, PLAUSIBLE_SIGMA_M, survey.place)]
    if operation is not None and operation.missing_grids:
        accuracy = "an unknown accuracy" if np.isnan(operation.accuracy_m) else f"{operation.accuracy_m:g} m"
        fields = {"accuracy": accuracy, "grids": ", ".join(operation.missing_grids)}
        remarks.append(finding("remark.grid_missing", file=file, place="crs", value=operation.crs, **fields))
    return tuple(remarks)


# --- image observations -----------------------------------------------------------------------------

#: Columns of a table of observations.
COLUMNS: Final = ("image", "id", "line", "sample", "sigma_line_px", "sigma_sample_px")
#: A standard deviation of an image point outside this range, px, probably has a wrong unit.
PLAUSIBLE_SIGMA_PX: Final = (1e-4, 1e3)


@dataclass(frozen=True)
class ObservationFile:
    """Image observations that were read from a file, with its SHA-256, remarks, and the ids of its points."""

    path: Path
    sha256: str
    observations: ImagePoints
    remarks: tuple[Finding, ...]
    ids: tuple[str, ...] = ()


def read_observations(
    path: Path,
    sizes: Mapping[str, tuple[int, int] | None] | None,
    point_ids: Sequence[str] | None,
    faults: Faults,
    *,
    ties: bool = False,
    incomplete: bool = False,
) -> ObservationFile | None:
    """Read a table of image observations.

    Parameters
    ----------
    path : Path
        Table with the columns ``image, id, line, sample, sigma_line_px, sigma_sample_px``.
    sizes : mapping of str to (n_lines, n_samples) or None, or None
        Sizes of the images in the order of the block. If a size is None, the range of its
        pixels is not checked. None instead of the mapping: the images are unknown.
    point_ids : sequence of str or None
        Ids of the ground points. None: they are unknown and are not checked.
    faults : Faults
        Collects all faults of the file.
    ties : bool
        There is no table of ground points. All points are tie points in the order of the file.
    incomplete : bool
        Standard deviations may be missing; they are then nan.

    Returns
    -------
    ObservationFile or None
        None if the file has a fault; ``faults`` then contains the reasons.
    """  # fmt: skip
    table = read_table(path, [COLUMNS[:4], COLUMNS] if incomplete else [COLUMNS], faults)
    if table is None:
        return None
    table = table.completed(*COLUMNS[4:])
    if ties:
        point_ids = tuple(dict.fromkeys(table.cells["id"]))
    image = table.positions("image", None if sizes is None else list(sizes), "observations.image_unknown")
    point = table.positions("id", point_ids, "observations.point_unknown")
    keys = image * (int(point.max(initial=0)) + 1) + point
    pair = {"value": lambda row: f"{row.cells['id']} in {row.cells['image']}"}
    table.refuse_repeated(keys, "observations.twice", "id", **pair)
    bare = np.all([table.where(name, "") for name in COLUMNS[4:]], axis=0) if incomplete else np.zeros(len(table), bool)
    values = table.numbers(*COLUMNS[2:], rows=~bare if incomplete else None)
    if bare.any():
        values[bare, :2] = table.numbers(*COLUMNS[2:4], rows=bare)[bare]
    size = np.array([n or (np.inf, np.inf) for n in (sizes or {"": None}).values()], float)
    sizes_of = np.append(size, [[np.inf, np.inf]], axis=0)[np.minimum(image, len(size))]
    exchanged, beyond = exchanged_pixels(image, values[:, :2], sizes_of)
    if beyond.any():
        names = list(dict.fromkeys(table.cells["image"][k] for k in np.flatnonzero(exchanged).tolist()))
        faults.add(
            "observations.exchanged", place=table.row(int(np.argmax(beyond))).place(), images=names,
            outside=int(beyond.sum()), total=int(exchanged.sum()),
        )  # fmt: skip
    last = sizes_of - 0.5
    for j, axis in enumerate(("line", "sample")):
        outside = np.isfinite(last[:, j]) & ((values[:, j] < -0.5) | (values[:, j] > last[:, j])) & ~exchanged
        fields = {"image": lambda row: row.cells["image"], "axis": axis, "last": last[:, j]}
        table.refuse(outside, "observations.outside", axis, **fields)
        sigma = values[:, 2 + j]
        table.refuse((sigma < SMALLEST) | (sigma > LARGEST), "observations.sigma_not_positive", COLUMNS[4 + j])
    table.report(faults)
    if faults or sizes is None or point_ids is None:
        return None
    remarks = sigma_remarks(
        "remark.sigma_image", faults.file, values[:, 2:], PLAUSIBLE_SIGMA_PX, lambda k: table.row(k).place()
    )
    ids = tuple(point_ids) if ties else ()
    return ObservationFile(path, sha256_of(path), ImagePoints(image, point, *values.T), remarks, ids)
