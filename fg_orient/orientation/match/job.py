"""Measurement of tie points in the images of a project: pairs, coarse level, cells, tests, tables and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors._preparation import working_clock
from factors.arrays import Array
from fg_orient.adjustment.parts.execution import Execution, opened
from fg_orient.formats.atomic import Contents, alone, require_free, staged_folder, together, writing
from fg_orient.formats.heights import ZeroLevel
from fg_orient.formats.project import ProjectImages, read_images
from fg_orient.formats.rasters import Place, missing, place_of, raster_beside
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.errors import Finding, InputError, as_record, finding, findings_of
from fg_orient.model.names import Progress
from fg_orient.orientation.match import kept
from fg_orient.orientation.match.blocks import Counts, Matches, joined
from fg_orient.orientation.match.chips import Control, coordinates_in, measure, read_control, sigmas_of
from fg_orient.orientation.match.coarse import Coarse
from fg_orient.orientation.match.epipolar import Pair, height_range, inside
from fg_orient.orientation.match.features import cv2_of
from fg_orient.orientation.match.options import MatchOptions
from fg_orient.orientation.match.record import record_of, write_report
from fg_orient.orientation.match.tables import NEW_POINTS, ControlRows, require_tables, table_files, write_tables
from fg_orient.orientation.match.tasks import Setup, cell_task, cell_windows, coarse_task, work_of
from fg_orient.orientation.match.tracks import LEAST_SIGMA_PX, PairResult, accept, tie_points
from fg_orient.sensors.dem import RasterDem, range_below

#: Contents of the folder of the report.
CONTENTS: Final = Contents("match.json", ("match.json", "report.html"))
#: Smallest share of the first image of a pair that the second image must show.
OVERLAP: Final = 0.01
#: Number of points along each side of an image that are projected into another image to find the overlap.
SIDE: Final = 9


def match_project(
    project: str | Path,
    out: str | Path | None = None,
    *,
    options: MatchOptions | None = None,
    dem: str | Path | None = None,
    vertical_crs: str = "",
    workers: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    control: str | Path | None = None,
    progress: Progress | None = None,
    command: Sequence[str] = (),
    warn: Callable[[Finding], None] | None = None,
) -> dict[str, Any]:
    """Measure tie points in the pixels of a project's images and add them to its tables.

    Parameters
    ----------
    project : path
        Project file; it may have no tables yet.
    out : path, optional
        Folder of the quality report; default ``match`` beside the project file.
    options : MatchOptions, optional
    dem : path, optional
        Elevation model that restricts the search.
    vertical_crs : str
        See :class:`fg_orient.sensors.surface.RasterDem`.
    workers : int
        Processes; the result does not depend on it.
    overwrite : bool
        Replace the matched points and the report of an earlier run.
    resume : bool
        Continue a run that was interrupted.
    control : path, optional
        Table or vector file of points of known position to measure by chips
        (:func:`fg_orient.orientation.match.chips.read_control`).
    progress : callable, optional
        Function that receives the number of finished tasks, the number of all tasks, and a text.
    command : sequence of str
        Words of the command line, for the record.
    warn : callable, optional
        Called with warnings of the elevation model.

    Returns
    -------
    dict
        Record of the run, as in ``match.json``.

    Raises
    ------
    InputError
        Another run matches this project; fewer than two images, images without pixels, without georeference or without
        common ground, tables that cannot be extended, pairs that do not match.
    """
    path, chosen = Path(project), options or MatchOptions()
    target = path.parent / "match" if out is None else Path(out)
    begin = working_clock()
    with alone(path):  # another run would change tables and finished parts
        read = read_images(path)
        tables = table_files(path, read)
        require_free(target, overwrite=overwrite, contents=CONTENTS)
        require_tables(path, read, overwrite=overwrite)
        cv2_of()
        places = _places(path, read)
        known = None if control is None else read_control(Path(control))
        if known is not None:
            _coordinates(known, read, path)  # its errors are reported before the work begins
        surface = None if dem is None else RasterDem(dem, vertical_crs=vertical_crs, warn=warn)
        low, high = _heights(read, chosen, surface)
        setup = Setup(str(path), places, low, high, chosen, "" if dem is None else str(dem), vertical_crs)
        pairs = overlapping(read, places, low, high)
        if not pairs:
            raise InputError.of("match.no_overlap", file=path, low=low, high=high)
        store = kept.Store(path, setup, resume=resume)
        with opened(Execution(workers=workers)) as pool:
            coarse = store.each(pool, coarse_task, [(setup, a, b) for a, b in pairs], "pairs", progress)
            found = _match_cells(pool, store, setup, pairs, [c for c, _ in coarse], progress)
        results, failed = _accepted(read, setup, pairs, coarse, found)
        if not results:
            reasons = "; ".join(f"{a} and {b}: {why}" for a, b, why in failed)
            raise InputError.of("match.none", file=path, reason=reasons)
        ties = tie_points(results, places, chosen)
        record = record_of(read, setup, results, failed, ties, working_clock() - begin, command)
        rows = None
        if known is not None:
            rows, found_chips = _control_rows(known, setup, path, read, results)
            record |= as_record([*findings_of(record), *found_chips])
            counts = {"points": len(known.chips), "measured": len(rows.ids), "image_points": len(rows.image)}
            record["control"] = counts
        with (
            alone(*tables[1:]), together(*tables),
            staged_folder(target, overwrite=overwrite, contents=CONTENTS) as folder, writing(target),
        ):  # fmt: skip
            write_report(folder, record, results, ties, setup)
            record["files"] = write_tables(path, read, ties, rows)
        record["out"] = str(target)
        store.remove()
        return record


def _places(path: Path, read: ProjectImages) -> tuple[Place, ...]:
    """Return the rasters of the images; all input errors are raised as one error."""
    if len(read.images) < 2:
        raise InputError.of("match.one_image", file=path, place="images", value=len(read.images))
    faults, places = [], []
    for image, entry in zip(read.images, read.entries, strict=True):
        metadata = path.parent / entry.metadata
        if not image.sensor.georeferenced:
            faults.append(finding("match.local", file=path, place=f"image {image.id}"))
            continue
        raster = path.parent / entry.pixels if entry.pixels is not None else raster_beside(metadata)
        if raster is None or not raster.is_file():
            faults.append(missing(image.id, str(path), metadata if raster is None else raster))
            continue
        try:
            places.append(place_of(raster, entry.pixels_origin, image.id, str(path)))
        except InputError as error:
            faults += error.problems
    if faults:
        raise InputError(*faults)
    return tuple(places)


def _coordinates(known: Control, read: ProjectImages, path: Path) -> Array:
    """Return the coordinates of control points in the CRS of the project's table of points."""
    level = ZeroLevel.of(read.points, path.parent)
    return coordinates_in(known, "heights above a geoid" if level else read.points.crs or NEW_POINTS["crs"], path)


def _control_rows(
    known: Control, setup: Setup, path: Path, read: ProjectImages, results: list[PairResult]
) -> tuple[ControlRows, list[Finding]]:
    """Measure control points. Their noise has the median factor of the pairs, because they have no y-parallax."""
    work = work_of(setup)
    marks, findings = measure(known, work.images, work.rasters, work.options, setup.options)
    factor = float(np.median([r.record["sigma_factor"] for r in results]))
    used = sorted({m.point for m in marks})
    rows = ControlRows(
        [known.survey.ids[k] for k in used], _coordinates(known, read, path)[used],
        known.survey.sigma_enu_m[used], np.array([m.image for m in marks], np.intp),
        np.array([used.index(m.point) for m in marks], np.intp), np.array([m.pixel for m in marks]).reshape(-1, 2),
        np.maximum(sigmas_of(marks, factor), LEAST_SIGMA_PX),
    )  # fmt: skip
    return rows, findings


def _heights(read: ProjectImages, options: MatchOptions, dem: RasterDem | None) -> tuple[float, float]:
    """Return the lowest and highest height of the ground: given, from the DEM, or from the sensor models."""
    low, high = options.lowest_m, options.highest_m
    if dem is not None:
        sensors = [image.sensor for image in read.images]

        def outline(height_m: float) -> tuple[Array, Array]:
            ground = np.concatenate([one.locate(*one.corners(), height_m=height_m) for one in sensors])
            return ecef_to_geodetic(ground)[:2]

        lowest, highest = range_below(dem, outline, float(np.median([one.mean_height_m for one in sensors])))
        margin = 3.0 * options.dem_sigma_m
        if np.isfinite(lowest):
            low, high = lowest - margin if low is None else low, highest + margin if high is None else high
    low, high = height_range(tuple(i.sensor for i in read.images), low, high)
    if not low < high:
        raise InputError.of(
            "options.value",
            option="lowest_m, highest_m",
            value=f"{low:g}, {high:g}",
            expected="a lowest height below the highest one",
        )
    return low, high


def overlapping(read: ProjectImages, places: tuple[Place, ...], low_m: float, high_m: float) -> list[tuple[int, int]]:
    """Return the pairs of images with common ground at some height of the range."""
    boxes, pixels = [], []
    for image, place in zip(read.images, places, strict=True):
        s = image.sensor
        ends = (place.line, place.line + place.rows - 1.0), (place.sample, place.sample + place.columns - 1.0)
        line, sample = (a.ravel() for a in np.meshgrid(*(np.linspace(*e, SIDE) for e in ends), indexing="ij"))
        line, sample = np.clip(line, s.first_line, s.last_line), np.clip(sample, s.first_sample, s.last_sample)
        pixels.append((line, sample))
        lon, lat = np.hstack([ecef_to_geodetic(s.locate(line, sample, height_m=h))[:2] for h in (low_m, high_m)])
        boxes.append((lon.min(), lat.min(), lon.max(), lat.max()))
    found = []
    for a, b in combinations(range(len(places)), 2):
        (w, s_, e, n), (w2, s2, e2, n2) = boxes[a], boxes[b]
        if w > e2 or w2 > e or s_ > n2 or s2 > n:
            continue
        pair = Pair(read.images[a].sensor, read.images[b].sensor, low_m, high_m)
        heights = np.linspace(low_m, high_m, 5)
        share = max(float(np.mean(inside(pair.project(*pixels[a], h), places[b]))) for h in heights)
        if share > OVERLAP:
            found.append((a, b))
    return found


def _match_cells(
    pool: Any,
    store: kept.Store,
    setup: Setup,
    pairs: list[tuple[int, int]],
    coarse: list[Coarse],
    progress: Progress | None,
) -> dict[tuple[int, int], tuple[Matches, Counts]]:
    """Return the matches of all pairs that the coarse level connects."""
    arguments = []
    for a in sorted({a for a, _ in pairs}):
        others = tuple(
            (b, c) for (first, b), c in zip(pairs, coarse, strict=True) if first == a and c.trend is not None
        )
        if others:
            arguments += [(setup, a, window, others) for window in cell_windows(setup.places[a], setup.options.cells)]
    out: dict[tuple[int, int], tuple[list[Matches], Counts]] = {}
    for (_, a, _, others), results in zip(
        arguments, store.each(pool, cell_task, arguments, "cells", progress), strict=True
    ):
        for (b, _), (matches, counts) in zip(others, results, strict=True):
            parts, total = out.get((a, b), ([], Counts()))
            out[a, b] = [*parts, matches], total.plus(counts)
    return {key: (joined(parts), counts) for key, (parts, counts) in out.items()}


def _accepted(
    read: ProjectImages,
    setup: Setup,
    pairs: list[tuple[int, int]],
    coarse: list[tuple[Coarse, float]],
    found: dict[tuple[int, int], tuple[Matches, Counts]],
) -> tuple[list[PairResult], list[tuple[str, str, str]]]:
    """Return the results of the pairs, and the pairs without result, with the reason."""
    results, failed = [], []
    for (a, b), (level, sigma) in zip(pairs, coarse, strict=True):
        names = read.images[a].id, read.images[b].id
        if level.trend is None:
            failed.append((*names, level.reason))
            continue
        matches, counts = found[a, b]
        pair = Pair(read.images[a].sensor, read.images[b].sensor, setup.low_m, setup.high_m)
        height = float(pair.height_m(np.array(np.median(level.t))))
        matrix = pair.matrix(*setup.places[a].centre, height)
        result = accept(a, b, matches, counts, level, sigma, matrix, setup.options)
        if result is None:
            failed.append((*names, f"{len(matches.t)} matches do not agree"))
        else:
            results.append(result)
    return results, failed
