"""Ground points of a file, with the coordinates of check points sealed.

Reading checks every cell of every point, but the coordinates of check points do not leave this
module until :meth:`fg_orient.model.block.WithheldCoordinates.open` reads the file again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Mask
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import Faults, sigma_remarks
from fg_orient.formats.point_table import located, parse_points
from fg_orient.formats.scenes import Scene, check_positions
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import Operation
from fg_orient.model.block import Coordinates, GroundPoints, WithheldCoordinates
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

#: Faults after which the list of ids differs from the one that the user meant.
LOSES_IDS: Final = {"table.cell_count", "table.quotes", "table.long_line", "points.id_twice", "points.id_missing"}
#: Standard deviations outside this range are more likely a wrong unit than a survey: 0.01 mm, 10 km.
PLAUSIBLE_SIGMA_M: Final = (1e-5, 1e4)
#: Reads the points of a file, check points included; None, with the faults noted, if it is unusable.
Parse = Callable[[Faults], Survey | None]


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
    opened : callable
        Reads the file again and gives the coordinates of the points with these ids.
    """

    path: Path
    crs: str
    sha256: str
    points: GroundPoints
    operation: Operation | None
    remarks: tuple[Finding, ...]
    opened: Callable[[tuple[str, ...]], Coordinates]

    def withheld(self, ids: Sequence[str]) -> WithheldCoordinates:
        """Seal the coordinates of these check points until they are opened."""
        wanted = tuple(ids)
        return WithheldCoordinates(wanted, lambda: self.opened(wanted))


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
    return point_file(path, (where,), lambda noted: parse_points(where, crs, noted), faults, scenes)


def point_file(
    path: Path, files: tuple[Path, ...], parse: Parse, faults: Faults, scenes: Sequence[Scene] = ()
) -> PointFile | None:
    """Points of a file of any format, those of check points sealed.

    ``parse`` reads the ``files`` (absolute paths) now, and again to open the seal.
    """
    survey = parse(faults)
    if survey is None:
        return None
    digest = sha256_of(*files)
    coordinates, operation = located(survey, faults)
    check_positions(scenes, survey.crs, survey.coordinates, coordinates.ecef_m, survey.lines, faults)

    def opened(wanted: tuple[str, ...]) -> Coordinates:
        noted = Faults(str(files[0]))
        again = parse(noted)
        if again is None or noted or sha256_of(*files) != digest:
            raise InputError.of("points.changed", file=files[0], place="check points")
        row = {name: k for k, name in enumerate(again.ids)}
        return _take(located(again, noted)[0], np.array([row[name] for name in wanted], int))

    control = np.array([role is Role.CONTROL for role in survey.roles], bool)
    points = GroundPoints(survey.ids, survey.roles, _mask(coordinates, control))
    remarks = _remarks(str(path), survey, operation)
    return PointFile(path, survey.crs, digest, points, operation, remarks, opened)


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


def _remarks(file: str, survey: Survey, operation: Operation | None) -> tuple[Finding, ...]:
    sigma, lines = survey.sigma_enu_m, survey.lines
    remarks = [*sigma_remarks("remark.sigma_ground", file, sigma, PLAUSIBLE_SIGMA_M, lambda k: f"line {lines[k]}")]
    if operation is not None and operation.missing_grids:
        accuracy = "an unknown accuracy" if np.isnan(operation.accuracy_m) else f"{operation.accuracy_m:g} m"
        grids = ", ".join(operation.missing_grids)
        remarks.append(
            finding("remark.grid_missing", file=file, place="crs", value=operation.crs, accuracy=accuracy, grids=grids)
        )
    return tuple(remarks)
