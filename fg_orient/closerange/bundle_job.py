"""Work of the command ``closerange bundle``: read tables, photos and constraints, adjust, make the record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.loop import Callback
from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.bundle_record import bundle_record
from fg_orient.closerange.constraints import Constraint
from fg_orient.closerange.corrections import parameters_of
from fg_orient.closerange.files import (
    Observed,
    Station,
    interiors,
    photo_text,
    read_ground_points,
    read_image_points,
    read_stations,
)
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.job import (
    NONE,
    Output,
    Record,
    finished,
    of_name,
    require_absolute,
)
from fg_orient.closerange.options import BundleOptions
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.closerange.resection import resect
from fg_orient.formats.closerange import ConstraintEntry, read_constraints, read_photos
from fg_orient.model.errors import Finding, InputError, finding

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Called at each stage of the work with its name and the number of image points (0 if unknown).
Stage = Callable[[str, int], None]


def run_bundle(
    path: Path, photos: Path, options: BundleOptions, *, control: Path | None = None, start: Path | None = None,
    constraints: Path | None = None, stations: Path | None = None, check: Path | None = None, output: Output = NONE,
    callback: Callback | None = None, stage: Stage | None = None,
) -> Record:  # fmt: skip
    """Adjust the photos and points of a table.

    Parameters
    ----------
    path, photos : Path
        Image points; photo file. A photo without orientation is resected from its points with known coordinates.
    options : BundleOptions
    control, check, start : Path, optional
        Tables of points in space: control points; check points, whose coordinates are not used in the adjustment; new
        points with approximate coordinates (other new points are intersected).
    constraints, stations : Path, optional
        Constraint file; table of observed projection centres and attitudes.
    output : Output, optional
    callback, stage : callable, optional
        Called with an ``IterationRecord`` after each iteration; see ``Stage``.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.bundle.adjust_bundle`; sigmas of control points or constraints where image
        coordinates have none.
    """
    output.require_possible()
    report_progress = stage or (lambda name, count: None)
    report_progress("reading", 0)
    table, sigma_control_m = read_image_points(path, options.sigma), options.sigma_control_m
    own, common = parameters_of(options.unknown, "<unknown>"), parameters_of(options.shared, "<shared>")
    known, begun = _control(control, sigma_control_m), _control(start, 0.0)
    places = begun | known
    names, ids = list(dict.fromkeys(table.photos)), list(dict.fromkeys((*table.ids, *begun)))
    which = np.array([names.index(name) for name in table.photos], np.intp)
    of = np.array([ids.index(name) for name in table.ids], np.intp)
    seen, withheld = read_stations(stations) if stations else {}, _control(check, 0.0)
    both = [name for name in withheld if name in known]
    if both:
        raise InputError.of("closerange.check_and_control", file=check, place=f"point {both[0]}")
    entries = read_constraints(constraints) if constraints else ()
    stated = [Constraint(e.kind, e.members, e.value_m, e.sigma, e.observed, e.axis,
                         np.eye(3) if e.offset is None else np.array(e.offset)) for e in entries]  # fmt: skip
    require_absolute(path, table, _sigmas(control, sigma_control_m, known, constraints, entries, stations, seen))
    report_progress("start values", len(table.ids))
    with one_blas_thread():
        starts, doubts = _starts(photos, names, table, which, of, ids, places, seen)
        given = [
            BundlePhoto(name, *start, own, "all", common, sigma_centre_m=station.sigma_m if station else None,
                        sigma_turn_rad=station.sigma_turns_rad if station else None,
                        observed_centre_m=station.centre_m if station else None)
            for name, start, station in zip(names, starts, map(seen.get, names), strict=True)
        ]  # fmt: skip
        begin = _points(starts, names, table, which, of, ids, places)
        report_progress("iterations", len(table.ids))
        result = adjust_bundle(
            given, ids, begin, which, of, table.image, sigma=table.image_sigma,
            control={i: known[i] for i in ids if i in known}, constraints=stated, callback=callback,
            backend=options.backend,
        )  # fmt: skip
    oriented = [] if result.beyond else result.oriented()
    parts = zip(oriented, result.interiors, result.rotations, strict=bool(oriented))
    texts = [photo_text(*part) for part in parts]
    checks = {name: at for name, (at, _) in withheld.items()}
    record = {"weights": table.weights} | bundle_record(result, table, known, which, of, seen, checks, doubts)
    beside = (photos, control, check, start, constraints, stations)
    return finished(record, path, table, output, texts, beside)


def _sigmas(
    control: Path | None, sigma_m: float, known: Mapping[str, tuple[Array, Array]], constraints: Path | None,
    entries: Sequence[ConstraintEntry], stations: Path | None, seen: Mapping[str, Station],
) -> Iterator[tuple[str, str, float]]:  # fmt: skip
    """Sigmas in m or rad: file, place and value of control points, constraints with their observations, stations."""
    for name, (_, sigma) in known.items():
        if sigma.any():
            own = (str(control), f"control {name}")
            yield *(("", "<sigma_control>") if (sigma == sigma_m).all() else own), float(sigma.max())
    for k, entry in enumerate(entries, start=1):
        stated = {"": entry.sigma} | {f"observed.{name}": value for name, (_, value) in entry.observed.items()}
        for place, one in stated.items():
            if one is not None:
                yield str(constraints), f"constraints[{k}].{place or 'sigma'}", one
    for name, station in seen.items():
        yield str(stations), f"photo {name}", float(station.sigma_m.max())


def _control(path: Path | None, sigma_m: float) -> dict[str, tuple[Array, Array]]:
    """Coordinates and sigmas of the control points by id."""
    if path is None:
        return {}
    table = read_ground_points(path, sigma_m)
    assert table.sigma is not None  # else there is no default
    return {name: (at, sigma) for name, at, sigma in zip(table.ids, table.ground, table.sigma, strict=True)}


Start = tuple[PhotoInterior, Array, Array]


def _starts(
    path: Path, names: Sequence[str], table: Observed, which: Index, of: Index, ids: Sequence[str],
    known: Mapping[str, tuple[Array, Array]], seen: Mapping[str, Station],
) -> tuple[list[Start], list[Finding]]:  # fmt: skip
    """PhotoInterior, rotation and centre of each photo, and warnings.

    An observed attitude is its own approximate value; the others come from the file, else from a resection.
    """
    file = read_photos(path)
    cameras, out, doubts = interiors(file), list[Start](), list[Finding]()
    for k, name in enumerate(names):
        entry, interior = of_name(file.entries, name, path), of_name(cameras, name, path)
        turn = seen[name].rotation if name in seen else None
        if entry.rotation is not None and entry.centre_m is not None:
            out.append((interior, np.array(entry.rotation) if turn is None else turn, np.array(entry.centre_m)))
            continue
        if turn is not None:
            out.append((interior, turn, seen[name].centre_m))
            continue
        rows = [a for a in np.flatnonzero(which == k) if ids[of[a]] in known]
        if len(rows) < 4:
            raise InputError.of("closerange.not_oriented", file=path, place=name)
        ground = np.array([known[ids[of[a]]][0] for a in rows])
        pose = resect(interior, ground, table.image[rows], sigma=table.image_sigma[rows], name=name)
        out.append((interior, pose.rotation, pose.photo.origin_m))
        doubts += pose.second_pose(f"the bundle begins with a resection of photo {name}")
    return out, doubts


def _points(
    starts: Sequence[Start], names: Sequence[str], table: Observed, which: Index, of: Index, ids: Sequence[str],
    known: Mapping[str, tuple[Array, Array]],
) -> Array:  # fmt: skip
    """Start coordinates (n, 3): as given, else by intersection."""
    out = np.array([known[i][0] if i in known else np.full(3, np.nan) for i in ids])
    rays, free = np.bincount(of, minlength=len(ids)), np.isnan(out[:, 0])
    lost = [name for name, is_free, n in zip(ids, free, rays, strict=True) if is_free and n < 2]
    if lost:
        raise InputError(*(finding("closerange.no_place", place=f"point {name}") for name in lost))
    rows = np.flatnonzero(free[of])
    if len(rows):
        number = np.cumsum(free) - 1
        photos = [Photo.of(n, *start) for n, start in zip(names, starts, strict=True)]
        result = intersect_photos(photos, which[rows], number[of[rows]], table.image[rows],
                                  ids=[i for i, f in zip(ids, free, strict=True) if f])  # fmt: skip
        out[free] = result.points_m
    return out
