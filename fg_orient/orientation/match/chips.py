"""Control points measured by chips: small georeferenced rasters about points of known position.

The chip of a point is a raster with map coordinates, such as a part of an orthoimage, named by the point's
id. It is compared (normalised cross correlation) with the image at all positions that the prior sigmas allow.
For the comparison, the image is resampled to the pixels of the chip by the sensor model. Least-squares
matching with an affine map refines the best position.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import ndimage

from factors.arrays import Array
from fg_orient.formats.exchange.convert import read_survey
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.gdal import opened, rasterio_of
from fg_orient.formats.rasters import ENDS, Grey, Raster
from fg_orient.formats.registry import Settings, format_of
from fg_orient.geodesy import ecef_to_geodetic, from_geographic, geodetic_to_ecef, to_ecef, to_geographic
from fg_orient.kernels.matching import AFFINE, FIT, fit_window
from fg_orient.model.block import Options
from fg_orient.model.distributions import MAD
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.limits import within_memory
from fg_orient.orientation.match.blocks import WIDER, spline_of
from fg_orient.orientation.match.epipolar import prior_covariance
from fg_orient.orientation.match.features import cv2_of
from fg_orient.orientation.match.options import MatchOptions

#: Largest half width of the wider window of a chip, and smallest half width of a window, chip pixels.
HALF: Final = 14
LEAST_HALF: Final = 7
#: Radius of the search in prior standard deviations, and its maximum, px.
PRIOR_SIGMAS: Final = 3.0
REACH_PX: Final = 300.0
#: Smallest accepted correlation. Largest correlation of another position, relative to the best one, and its
#: smallest distance from it, chip pixels.
CORRELATION: Final = 0.5
SECOND: Final = 0.9
SECOND_PX: Final = 4
#: Largest ratio of the pixel sizes of chip and image.
SCALE: Final = 2.5
#: A displacement is wrong if it differs from the median of its image by more than this number of robust
#: standard deviations. The second number is the smallest standard deviation used, px.
LIMIT: Final = 4.0
LEAST_PX: Final = 1.0
#: Minimum number of control points of an image for which the scatter of displacements is used.
FEWEST: Final = 8


@dataclass(frozen=True)
class Mark:
    """A control point in an image.

    Parameters
    ----------
    point, image : int
    pixel : (2,) array
    variance : (2,) array
        Variances of least-squares matching, px^2.
    moved_px : (2,) array
        Pixel minus the pixel of the sensor model.
    wider_px, wider_variance : (2,) arrays
        Pixel by the wider window minus ``pixel``, and the variance of this difference.
    """

    point: int
    image: int
    pixel: Array
    variance: Array
    moved_px: Array
    wider_px: Array
    wider_variance: Array


@dataclass(frozen=True, eq=False)
class Control:
    """Control points with chips.

    Parameters
    ----------
    survey : Survey
        Ids, coordinates and standard deviations of n points.
    ecef_m : (n, 3) array
        Geocentric positions, m.
    chips : n paths
        Raster with the chip of each point.
    """

    survey: Survey
    ecef_m: Array
    chips: tuple[Path, ...]


def read_control(path: Path) -> Control:
    """Read control points of a vector file or table, and find their chips.

    The chip of the point ID is ``ID.tif`` (or another raster) beside the file, or in the folder with the file's name
    without its suffix.

    Raises
    ------
    InputError
        The file cannot be read, a point has no position or no sigma, or no chip.
    """
    survey, _ = read_survey((path,), format_of(path, place="<control>"), Settings())
    folders, faults, chips = (path.with_suffix(""), path.parent), [], []
    for k, name in enumerate(survey.ids):
        found = [
            f / f"{name}{end}"
            for f in folders
            for end in ENDS
            if Path(name).name == name and (f / f"{name}{end}").is_file()
        ]
        complete = survey.located[k] and np.isfinite([survey.coordinates[k], survey.sigma_enu_m[k]]).all()
        if not complete or not found:
            missing = f"chip {name}.tif" if complete else "coordinates with height and sigmas"
            faults.append(finding("match.no_chip", file=path, place=f"point {name}", missing=missing))
        chips.append(found[0] if found else path)
    if faults:
        raise InputError(*faults)
    return Control(survey, to_ecef(survey.crs, *survey.coordinates.T), tuple(chips))


def measure(
    control: Control, images: tuple[Any, ...], rasters: tuple[Raster, ...], options: Options, chosen: MatchOptions
) -> tuple[list[Mark], list[Finding]]:
    """Measure all control points in all images that show them.

    Parameters
    ----------
    control : Control
    images : tuple of images
        Images of the project.
    rasters : tuple of Raster
        Pixels of each image.
    options : Options
        Prior sigmas of the orientation, which limit the search.
    chosen : MatchOptions

    Returns
    -------
    marks : list of Mark
        Sorted by point and image.
    findings : list of Finding
        Points that no image shows clearly, and displacements that contradict the other chips of an image.
    """
    marks, findings = [], []
    for k, name in enumerate(control.survey.ids):
        found = [
            m
            for i in range(len(images))
            for m in _measured(control, k, i, images[i].sensor, rasters[i], options, chosen)
        ]
        marks += found
        if not found:
            findings.append(finding("match.chip_lost", place=f"point {name}"))
    kept = []
    for i in range(len(images)):
        own = [m for m in marks if m.image == i]
        moved = np.array([m.moved_px for m in own]).reshape(-1, 2)
        middle = np.median(moved, axis=0) if len(own) else np.zeros(2)
        away = np.linalg.norm(moved - middle, axis=1)
        spread = max(MAD * float(np.median(away)) if len(own) else 0.0, LEAST_PX)
        for mark, distance in zip(own, away.tolist(), strict=True):
            if len(own) > 2 and distance > LIMIT * spread:
                findings.append(
                    finding(
                        "match.chip_apart",
                        place=f"point {control.survey.ids[mark.point]}",
                        value=f"image {images[i].id}",
                        distance=distance,
                    )
                )
            else:
                kept.append(mark)
    return sorted(kept, key=lambda m: (m.point, m.image)), findings


def sigmas_of(marks: list[Mark], factor: float) -> Array:
    """Return the standard deviations (m, 2) px of the image points of control points.

    The variance has two parts: the noise, with the factor of the pairs, and the relief in the windows, from the
    differences to the wider windows (:func:`fg_orient.orientation.match.tracks.relief_variance`). If the displacements
    of an image scatter more about an affine trend, the additional variance is added: it includes errors of the chips'
    own positions.

    Parameters
    ----------
    marks : list of Mark
        m measured points.
    factor : float
        Estimated factor of the standard deviations of least-squares matching.

    Returns
    -------
    (m, 2) array
        Standard deviations of line and sample, px.
    """
    if not marks:
        return np.empty((0, 2))
    variance, wider = (np.array([getattr(m, n) for m in marks]) for n in ("variance", "wider_variance"))
    apart = np.array([m.wider_px for m in marks])
    relief = np.mean(apart**2 - factor**2 * np.maximum(variance - wider, 0.0), axis=0)
    out = factor**2 * variance + np.maximum(relief, 0.0)
    image = np.array([m.image for m in marks])
    for k in np.unique(image):
        own = np.flatnonzero(image == k)
        if len(own) >= FEWEST:
            pixel = np.array([marks[n].pixel for n in own])
            terms = np.column_stack([np.ones(len(own)), (pixel - pixel.mean(axis=0)) / (np.ptp(pixel, axis=0) + 1.0)])
            moved = np.array([marks[n].moved_px for n in own])
            residual = moved - terms @ np.linalg.lstsq(terms, moved, rcond=None)[0]
            scatter = (residual**2).sum(axis=0) / (len(own) - terms.shape[1])
            out[own] += np.maximum(scatter - out[own].mean(axis=0), 0.0)
    return np.asarray(np.sqrt(out))


def _measured(
    control: Control, k: int, i: int, sensor: Any, raster: Raster, options: Options, chosen: MatchOptions
) -> list[Mark]:
    """Return the mark of point k in image i, if the image shows it and the chip is found."""
    lon, lat, height = (float(v[0]) for v in ecef_to_geodetic(control.ecef_m[k : k + 1]))
    expected = np.stack(sensor.project(control.ecef_m[k : k + 1]), axis=1)[0]
    place = raster.place
    at = expected - [place.line, place.sample]
    if not (np.isfinite(at).all() and (at >= 0).all() and (at < [place.rows, place.columns]).all()):
        return []
    chip, centre, to_lon_lat = _chip(control.chips[k], lon, lat)
    whole = np.rint(centre)

    def pixels(row: Array, column: Array) -> Array:
        """Return the raster pixels (n, 2) of pixels of the chip, on level ground."""
        at_lon, at_lat = to_lon_lat(row, column)
        ground = geodetic_to_ecef(at_lon, at_lat, np.full(len(row), height))
        return np.stack(sensor.project(ground), axis=1) - [place.line, place.sample]

    step = np.array([4.0, -4.0, 0.0, 0.0]), np.array([0.0, 0.0, 4.0, -4.0])
    p = pixels(whole[0] + step[0], whole[1] + step[1])
    matrix = np.stack([p[0] - p[1], p[2] - p[3]], axis=1) / 8.0
    scale = float(np.sqrt(abs(np.linalg.det(matrix))))
    half = min(HALF, int(min(*whole, *(np.array(chip.shape) - 1 - whole))))
    if half < LEAST_HALF or not 1.0 / SCALE <= scale <= SCALE:
        return []
    inside = np.clip(expected, [sensor.first_line, sensor.first_sample], [sensor.last_line, sensor.last_sample])
    prior = prior_covariance(sensor, options, inside[0], inside[1], height)
    sigma = float(np.sqrt(np.linalg.eigvalsh(prior)[-1]))
    radius = int(np.ceil(min(PRIOR_SIGMAS * sigma, REACH_PX) / scale)) + 3
    border = int(np.ceil((half + radius) * np.abs(matrix).sum(axis=1).max())) + 8
    start = pixels(whole[:1], whole[1:])[0]
    first = np.floor(start).astype(int) - border
    grey = raster.window(first[0], first[1], 2 * border + 1, 2 * border + 1)
    begin = start - first
    window = chip[int(whole[0]) - half : int(whole[0]) + half + 1, int(whole[1]) - half : int(whole[1]) + half + 1]
    offset = _best_place(window, grey, begin, matrix, radius)
    if offset is None:
        return []
    guess, spline, fits = np.hstack([begin + matrix @ offset, matrix.ravel()]), spline_of(grey), []
    for width in (half, round(half / WIDER)):
        out = np.zeros(FIT.size)
        if not fit_window(chip, spline, whole, guess, np.array([0.0, 1.0]), AFFINE, width, 0.5 * width, 25, 3.0, out):
            return []
        if out[FIT.correlation] < chosen.correlation:
            return []
        pixel = out[FIT.place] + out[FIT.affine].reshape(2, 2) @ (centre - whole) + first + [place.line, place.sample]
        fits.append((pixel, out[[FIT.line_line, FIT.sample_sample]]))
    (wide, wide_variance), (pixel, variance) = fits
    return [Mark(k, i, pixel, variance, pixel - expected, wide - pixel, wide_variance)]


def _chip(path: Path, lon: float, lat: float) -> tuple[Grey, Array, Any]:
    """Return the chip, the point's row and column, and a function that converts pixels to longitude and latitude."""
    rasterio = rasterio_of(path, "match.no_rasterio")
    try:
        with opened(rasterio, path) as source:
            if source.crs is None:
                raise InputError.of("match.chip_crs", file=path)
            within_memory(8.0 * source.height * source.width, path.stat().st_size, file=path, place="chip")
            grey = source.read(1, out_dtype="float32", masked=True).filled(np.nan)
            crs, t = str(source.crs.to_wkt()), source.transform
    except rasterio.errors.RasterioError as error:
        raise InputError.of("ortho.image", file=path, value=error) from None
    x, y = from_geographic(crs, np.array([lon]), np.array([lat]))
    back = ~t
    centre = np.array([back.d * x[0] + back.e * y[0] + back.f - 0.5, back.a * x[0] + back.b * y[0] + back.c - 0.5])

    def to_lon_lat(row: Array, column: Array) -> tuple[Array, Array]:
        r, c = row + 0.5, column + 0.5
        return to_geographic(crs, t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)

    return np.ascontiguousarray(grey), centre, to_lon_lat


def _best_place(window: Grey, grey: Grey, begin: Array, matrix: Array, radius: int) -> Array | None:
    """Return the displacement (2,) in chip pixels with the largest correlation.

    None if no displacement is clearly best.
    """
    half = len(window) // 2 + radius
    u = np.arange(-half, half + 1.0)
    offsets = np.stack([a.ravel() for a in np.meshgrid(u, u, indexing="ij")])
    filled = np.nan_to_num(grey, nan=float(np.nanmedian(grey)) if np.isfinite(grey).any() else 0.0)
    resampled = ndimage.map_coordinates(filled, begin[:, None] + matrix @ offsets, order=1, mode="nearest")
    cv2 = cv2_of()
    if not np.isfinite(window).all():
        return None
    score = cv2.matchTemplate(resampled.reshape(len(u), len(u)).astype(np.float32), window, cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    best = float(score[row, column])
    rest = score.copy()
    rest[max(row - SECOND_PX, 0) : row + SECOND_PX + 1, max(column - SECOND_PX, 0) : column + SECOND_PX + 1] = -1.0
    if not (best >= CORRELATION and float(rest.max()) <= SECOND * best):
        return None
    return np.array([row - radius, column - radius], float)


def coordinates_in(control: Control, crs: str, file: Path) -> Array:
    """Return the coordinates (n, 3) of all points in the CRS of a project.

    Raises
    ------
    InputError
        The CRS is neither the CRS of the points nor EPSG:4979.
    """
    if crs == control.survey.crs:
        return control.survey.coordinates
    if crs == "EPSG:4979":
        return np.stack(ecef_to_geodetic(control.ecef_m), axis=1)
    raise InputError.of("match.control_crs", file=file, place="points.crs", value=crs, crs=control.survey.crs)
