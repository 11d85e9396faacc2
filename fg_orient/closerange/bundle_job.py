"""Run the command ``closerange bundle``: read tables, photos and constraints, then adjust."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.robust import NONE
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import files, job
from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.bundle_record import bundle_record
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.options import BundleOptions
from fg_orient.closerange.photo import Photo, PhotoInterior, parameters_of, photo_text
from fg_orient.closerange.resection import resect
from fg_orient.formats.closerange import read_photos
from fg_orient.formats.schema import read_constraints
from fg_orient.model.constraint import Constraint, foreign_members, place_of
from fg_orient.model.errors import Finding, InputError, finding

#: Function that is called at each stage of the work with its name and the number of image points (0 if unknown).
Stage = Callable[[str, int], None]
Known = Mapping[str, tuple[Array, Array]]


def run_bundle(
    path: Path, photos: Path, options: BundleOptions, *, control: Path | None = None, start: Path | None = None,
    constraints: Path | None = None, stations: Path | None = None, check: Path | None = None,
    output: job.Output = job.NONE, callback: Callback | None = None, stage: Stage | None = None, **more: Any,
) -> job.Record:  # fmt: skip
    """Adjust the photos and points of a table.

    Parameters
    ----------
    path, photos : Path
        Image points; photo file. A photo without orientation is resected from its points
        with known coordinates.
    options : BundleOptions
    control, check, start : Path, optional
        Tables of points in space: control points; check points, whose coordinates are not
        used in the adjustment; new points with approximate coordinates (other new points
        are intersected).
    constraints, stations : Path, optional
        Constraint file; table of observed projection centres and attitudes.
    output : Output, optional
    callback, stage : callable, optional
        Functions: the first receives an ``IterationRecord`` after each iteration; for the second see ``Stage``.
    **more
        See :func:`fg_orient.closerange.bundle.adjust_bundle`.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.bundle.adjust_bundle`. Also: control points or
        constraints have sigmas, or options need sigmas, but image coordinates have none.
    """
    output.require_possible()
    report_progress = stage or (lambda name, count: None)
    report_progress("reading", 0)
    table, sigma_control_m = files.read_image_points(path, options.sigma), options.sigma_control_m
    own, common = parameters_of(options.unknown, "<unknown>"), parameters_of(options.shared, "<shared>")
    known, begun = _control(control, sigma_control_m), _control(start, 0.0)
    places = begun | known
    names, ids, which, of = table.numbered(begun)
    seen, withheld = files.read_stations(stations) if stations else {}, _control(check, 0.0)
    both = [name for name in withheld if name in known]
    if both:
        raise InputError.of("closerange.check_and_control", file=check, place=f"point {both[0]}")
    stated = read_constraints(constraints) if constraints else ()
    foreign = foreign_members(stated, ids, names, str(constraints))
    if foreign:
        raise InputError(*foreign)
    job.require_absolute(path, table, _sigmas(control, sigma_control_m, known, constraints, stated, stations, seen))
    if table.sigma is None:
        _require_scale(path, more)
    report_progress("start values", len(table.ids))
    with one_blas_thread():
        starts, begin, doubts = _approximate(photos, table, places, seen, begun)
        given = [
            BundlePhoto(name, *start, own, "all", common, sigma_centre_m=station.sigma_m if station else None,
                        sigma_turn_rad=station.sigma_turns_rad if station else None,
                        observed_centre_m=station.centre_m if station else None)
            for name, start, station in zip(names, starts, map(seen.get, names), strict=True)
        ]  # fmt: skip
        report_progress("iterations", len(table.ids))
        result = adjust_bundle(
            given, ids, begin, which, of, table.image, sigma=table.image_sigma,
            control={i: known[i] for i in ids if i in known}, constraints=stated, callback=callback,
            backend=options.backend, **more,
        )  # fmt: skip
    oriented = [] if result.beyond else result.oriented()
    parts = zip(oriented, result.interiors, result.rotations, strict=bool(oriented))
    texts = [photo_text(*part) for part in parts]
    record = {"weights": table.weights} | bundle_record(result, table, known, which, of, seen, withheld, doubts)
    beside = (photos, control, check, start, constraints, stations)
    return job.finished(record, path, table, output, texts, beside)


def _require_scale(path: Path, given: Mapping[str, Any]) -> None:
    """Refuse options that need standard deviations of the image points."""
    impossible = {
        "loss": given.get("loss", NONE) != NONE,
        "outlier_test": given.get("outlier_test") == "baarda",
        "variance_components": bool(given.get("variance_components")),
    }
    for name in (name for name, found in impossible.items() if found):
        value = given[name] if isinstance(given[name], str) else ", ".join(given[name])
        raise InputError.of("closerange.needs_sigma", option=name, value=value, points=path.name)


def _sigmas(
    control: Path | None, sigma_m: float, known: Mapping[str, tuple[Array, Array]], constraints: Path | None,
    stated: Sequence[Constraint], stations: Path | None, seen: Mapping[str, files.Station],
) -> Iterator[tuple[str, str, float]]:  # fmt: skip
    """Yield sigmas in m or rad of control points, constraints with their observations, stations: file, place, value."""
    for name, (_, sigma) in known.items():
        if sigma.any():
            own = (str(control), f"control {name}")
            yield *(("", "<sigma_control>") if (sigma == sigma_m).all() else own), float(sigma.max())
    for k, c in enumerate(stated):
        sigmas = {"sigma": c.sigma} | {f"observed.{name}": value for name, (_, value) in c.observed.items()}
        for place, one in sigmas.items():
            if one is not None:
                yield str(constraints), f"{place_of(k)}.{place}", one
    for name, station in seen.items():
        yield str(stations), f"photo {name}", float(station.sigma_m.max())


def _control(path: Path | None, sigma_m: float) -> dict[str, tuple[Array, Array]]:
    """Return the coordinates and sigmas of the control points by id."""
    if path is None:
        return {}
    table = files.read_ground_points(path, sigma_m)
    assert table.sigma is not None  # there is a default only if the table has sigmas
    return {name: (at, sigma) for name, at, sigma in zip(table.ids, table.ground, table.sigma, strict=True)}


def _approximate(
    path: Path, table: files.Observed, known: Known, seen: Mapping[str, files.Station], begun: Iterable[str]
) -> tuple[list[tuple[PhotoInterior, Array, Array]], Array, list[Finding]]:
    """Return interior, rotation and centre of each photo; points (n, 3); warnings.

    The approximate value of an observed attitude is the observation. Other photos come
    from the file, else from a resection. Points without given coordinates are
    intersected.
    """
    names, ids, which, of = table.numbered(begun)
    file = read_photos(path)
    cameras, starts, doubts = files.interiors(file), list[tuple[PhotoInterior, Array, Array]](), list[Finding]()
    for k, name in enumerate(names):
        entry, interior = job.of_name(file.entries, name, path), job.of_name(cameras, name, path)
        turn = seen[name].rotation if name in seen else None
        if entry.rotation is not None and entry.centre_m is not None:
            starts.append((interior, np.array(entry.rotation) if turn is None else turn, np.array(entry.centre_m)))
            continue
        if turn is not None:
            starts.append((interior, turn, seen[name].centre_m))
            continue
        rows = [a for a in np.flatnonzero(which == k) if table.ids[a] in known]
        if len(rows) < 4:
            raise InputError.of("closerange.not_oriented", file=path, place=name)
        ground = np.array([known[table.ids[a]][0] for a in rows])
        pose = resect(interior, ground, table.image[rows], sigma=table.image_sigma[rows], name=name)
        starts.append((interior, pose.rotation, pose.photo.origin_m))
        doubts += pose.second_pose(f"the bundle begins with a resection of photo {name}")
    points = np.array([known[i][0] if i in known else np.full(3, np.nan) for i in ids])
    rays, free = np.bincount(of, minlength=len(ids)), np.isnan(points[:, 0])
    lost = [ids[j] for j in np.flatnonzero(free & (rays < 2))]
    if lost:
        raise InputError(*(finding("closerange.no_place", place=f"point {name}") for name in lost))
    seen_new = free[of]
    if seen_new.any():
        photos = [Photo.of(name, *start) for name, start in zip(names, starts, strict=True)]
        new, number = np.unique(of[seen_new], return_inverse=True)
        points[new] = intersect_photos(photos, which[seen_new], number, table.image[seen_new],
                                       ids=[ids[j] for j in new]).points_m  # fmt: skip
    return starts, points, doubts
