"""Read points with image and map coordinates from a CSV file.

The columns are id, line, sample (pixels), easting_m and northing_m. They may be lon_deg
and lat_deg instead; a projection is then required. Optional columns are height_m, role
(control or check), and standard deviations: sigma_easting_m and sigma_northing_m, or
sigma_line_px and sigma_sample_px.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.formats.tables import Table, require_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import crs_kind, from_geographic
from fg_orient.model.arrays import wrong
from fg_orient.model.errors import InputError
from fg_orient.rectification.fit import Observations, TransformationFit, fit, plain_rmse, require_redundancy
from fg_orient.rectification.outliers import Pruning, Rule, prune
from fg_orient.rectification.transformation import TransformationModel
from fg_orient.rpc.points import PointTable, ids_and_checks, positive_numbers

Direction = Literal["image-to-map", "map-to-image"]

DIRECTIONS: Final[tuple[Direction, ...]] = ("image-to-map", "map-to-image")
IMAGE: Final = ("line", "sample")
MAP: Final = ("easting_m", "northing_m")
GEOGRAPHIC: Final = ("lon_deg", "lat_deg")
SIGMA_MAP: Final = ("sigma_easting_m", "sigma_northing_m")
SIGMA_IMAGE: Final = ("sigma_line_px", "sigma_sample_px")


@dataclass(frozen=True)
class MapPoints(PointTable):
    """Image points with their map coordinates: easting, northing (m), and height (m) if the file has it.

    Parameters
    ----------
    sigma_map : (n, 2) array or None
        Standard deviations of easting and northing, m.
    sigma_image : (n, 2) array or None
        Standard deviations of line and sample, pixels.
    crs : str
        Coordinate system of the ground coordinates; "" if it is not known.
    sha256 : str
        SHA-256 of the file.
    """

    sigma_map: Array | None
    sigma_image: Array | None
    crs: str
    sha256: str


def read_map_points(path: Path, crs: str = "") -> MapPoints:
    """Read a table of points.

    Parameters
    ----------
    path : Path
    crs : str
        Projected coordinate system of the map; needed if the table has longitudes and latitudes (WGS84).

    Raises
    ------
    InputError
        The file has errors, which are all listed; or the coordinate system is unknown,
        not projected, or missing.
    """
    if crs and crs_kind(crs) != "projected":
        raise InputError.of("rectify.crs_not_projected", option="crs", value=crs)
    table = require_table(path, _layouts())
    geographic = GEOGRAPHIC[0] in table.columns
    if geographic and not crs:
        raise InputError.of("rectify.no_crs", file=path, option="crs")
    heights = ("height_m",) if "height_m" in table.columns else ()
    image = table.numbers(*IMAGE)
    ground = table.numbers(*(GEOGRAPHIC if geographic else MAP), *heights)
    sigmas = [
        positive_numbers(table, names) if names[0] in table.columns else None for names in (SIGMA_MAP, SIGMA_IMAGE)
    ]
    ids, check = ids_and_checks(table)
    table.require_valid()
    if geographic:
        ground[:, :2] = _projected(path, crs, table, ground)
    return MapPoints(ids, check, image, ground, sigmas[0], sigmas[1], crs, sha256_of(path))


def _layouts() -> list[tuple[str, ...]]:
    """Return all allowed sets of columns."""
    parts = product((MAP, GEOGRAPHIC), ((), ("height_m",)), ((), ("role",)), ((), SIGMA_MAP, SIGMA_IMAGE))
    return [("id", *IMAGE, *plane, *height, *role, *sigma) for plane, height, role, sigma in parts]


def _projected(path: Path, crs: str, table: Table, ground: Array) -> Array:
    """Return easting and northing (n, 2) of WGS84 longitudes and latitudes."""
    plane = np.column_stack(from_geographic(crs, ground[:, 0], ground[:, 1]))
    bad = ~np.isfinite(plane).all(axis=1)
    if bad.any():
        row = table.row(int(np.argmax(bad)))
        raise InputError.of("rectify.outside", file=path, place=row.place(), value=row.cells["id"])
    return plane


def require_direction(model: TransformationModel, direction: str | None) -> Direction:
    """Return the direction of a fit, by default image to map.

    Spatial models allow only map to image.
    """
    usual: Direction = DIRECTIONS[0] if model.dimension == 2 else DIRECTIONS[1]
    for known in DIRECTIONS:
        if direction == known and (model.dimension == 2 or known == usual):
            return known
    if direction is None:
        return usual
    raise InputError.of("rectify.direction", place=f"<direction> with {model.name}", value=direction)


def observations(points: MapPoints, model: TransformationModel, direction: Direction) -> Observations:
    """Return the source and target of a fit.

    Image coordinates of plane models are (sample, line) = (x, y), of spatial models (line, sample).

    Raises
    ------
    InputError
        Heights are missing, or sigmas are given for the source instead of the target.
    """
    given, other = points.sigma_map, points.sigma_image
    if direction == DIRECTIONS[1]:
        given, other = other, given
    if given is None and other is not None:
        columns = SIGMA_MAP if direction == DIRECTIONS[0] else SIGMA_IMAGE
        raise InputError.of("rectify.sigmas", place="sigmas", direction=direction, columns=" and ".join(columns))
    if model.dimension == 3:
        if points.ground.shape[1] < 3:
            raise InputError.of("rectify.heights", place=model.title)
        return Observations.of(points.ground, points.image, given, points.ids)
    image, plane = points.image[:, ::-1], points.ground[:, :2]
    if direction == DIRECTIONS[0]:
        return Observations.of(image, plane, given, points.ids)
    return Observations.of(plane, image, None if given is None else given[:, ::-1], points.ids)


@dataclass(frozen=True)
class PointFit:
    """Fitted transformation between image and map, with its check points.

    Parameters
    ----------
    fit : TransformationFit
        Fit of the control points.
    direction : str
    check : Observations or None
        Check points.
    check_residuals : (n, 2) array
        Computed minus given, in the unit of the target.
    pruning : Pruning or None
        Record of the pruning, if points were left out until an RMSE was reached.
    heights : (n,) array or None
        Heights of the control points, m, if they are known and the transformation does not contain them.
    """

    fit: TransformationFit
    direction: Direction
    check: Observations | None
    check_residuals: Array
    pruning: Pruning | None = None
    heights: Array | None = None

    @property
    def unit(self) -> str:
        """Unit of the target: "m" or "px"."""
        return "m" if self.direction == DIRECTIONS[0] else "px"

    @property
    def check_rmse(self) -> tuple[float, float, float]:
        """Plain RMSE at the check points of both axes and radial; nan without any."""
        return plain_rmse(self.check_residuals)


def fit_points(
    points: MapPoints,
    model: TransformationModel,
    direction: str | None = None,
    *,
    prune_to: float | None = None,
    prune_by: Rule = "residual",
) -> PointFit:
    """Adjust a transformation between image and map, and compare it with the check points.

    Parameters
    ----------
    points : MapPoints
    model : TransformationModel
    direction : str, optional
        "image-to-map" or "map-to-image", see :func:`require_direction`.
    prune_to, prune_by
        Radial RMSE to reach, and rule: see :func:`fg_orient.rectification.outliers.prune`. Default: no pruning.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.rectification.fit.fit`.
    """
    if not isinstance(points, MapPoints):
        raise wrong("points", type(points).__name__, "MapPoints, for instance those of read_map_points")
    way = require_direction(model, direction)
    every = observations(points, model, way)
    require_redundancy(model, int(np.count_nonzero(~points.check)))
    ground, image = ("easting", "northing"), ("sample", "line")
    names: tuple[tuple[str, ...], tuple[str, ...]] = (image, ground) if way == DIRECTIONS[0] else (ground, image)
    if model.dimension == 3:
        names = ((*ground, "height"), image[::-1])
    control = every.take(~points.check)
    fitted = fit(control, model, source_names=names[0], target_names=names[1], crs=points.crs)
    pruning = None if prune_to is None else prune(fitted, prune_to, rule=prune_by)
    fitted = fitted if pruning is None else pruning.fit
    heights = None
    if model.dimension == 2 and points.ground.shape[1] == 3:
        height_of = dict(zip(points.ids, points.ground[:, 2].tolist(), strict=True))
        heights = np.array([height_of[name] for name in fitted.points.ids])
    if not points.check.any():
        return PointFit(fitted, way, None, np.zeros((0, 2)), pruning, heights)
    check = every.take(points.check)
    computed = fitted.transformation.apply(check.source[:, : model.dimension])
    return PointFit(fitted, way, check, computed - check.target, pruning, heights)
