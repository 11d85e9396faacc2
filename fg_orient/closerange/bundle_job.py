"""Work of the command ``closerange bundle``: read tables, photos and constraints, adjust, make the record."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import files, job
from fg_orient.closerange.accuracy import compare_points
from fg_orient.closerange.bundle import Adjustment, BundlePhoto, BundleResult, adjust_bundle
from fg_orient.closerange.bundle_block import CENTRE, TURNS
from fg_orient.closerange.bundle_checks import NAMED
from fg_orient.closerange.corrections import NAMES, camera_of, parameters_of, profile
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.options import BundleOptions
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.closerange.resection import resect
from fg_orient.formats.closerange import read_photos
from fg_orient.formats.constraints import read_constraints
from fg_orient.model.constraint import Constraint, foreign_members, place_of
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.quality.camera import ImageCofactors, inseparable
from fg_orient.quality.reliability import ALPHA, CHECKABLE, POWER, noncentrality
from fg_orient.quality.significance import camera_significance
from fg_orient.report.tables import correlations

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Called at each stage of the work with its name and the number of image points (0 if unknown).
Stage = Callable[[str, int], None]
Known = Mapping[str, tuple[Array, Array]]

#: Limit of listed correlations; number of listed correlations and of weak directions.
HIGH: Final = 0.9
LISTED: Final = 40
#: Fields of an iteration.
HISTORY: Final = ("iteration", "chi2", "chi2_after", "ratio", "step", "accepted")
_WEAK: Final = 5
#: Unknowns of a direction that are named, at most.
_FEW: Final = 4


def run_bundle(
    path: Path, photos: Path, options: BundleOptions, *, control: Path | None = None, start: Path | None = None,
    constraints: Path | None = None, stations: Path | None = None, check: Path | None = None,
    output: job.Output = job.NONE, callback: Callback | None = None, stage: Stage | None = None,
) -> job.Record:  # fmt: skip
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
            backend=options.backend,
        )  # fmt: skip
    oriented = [] if result.beyond else result.oriented()
    parts = zip(oriented, result.interiors, result.rotations, strict=bool(oriented))
    texts = [files.photo_text(*part) for part in parts]
    given_check = {name: at for name, (at, _) in withheld.items()}
    record = {"weights": table.weights} | bundle_record(result, table, known, which, of, seen, given_check, doubts)
    beside = (photos, control, check, start, constraints, stations)
    return job.finished(record, path, table, output, texts, beside)


def _sigmas(
    control: Path | None, sigma_m: float, known: Mapping[str, tuple[Array, Array]], constraints: Path | None,
    stated: Sequence[Constraint], stations: Path | None, seen: Mapping[str, files.Station],
) -> Iterator[tuple[str, str, float]]:  # fmt: skip
    """Sigmas in m or rad: file, place and value of control points, constraints with their observations, stations."""
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
    """Coordinates and sigmas of the control points by id."""
    if path is None:
        return {}
    table = files.read_ground_points(path, sigma_m)
    assert table.sigma is not None  # else there is no default
    return {name: (at, sigma) for name, at, sigma in zip(table.ids, table.ground, table.sigma, strict=True)}


def _approximate(
    path: Path, table: files.Observed, known: Known, seen: Mapping[str, files.Station], begun: Iterable[str]
) -> tuple[list[tuple[PhotoInterior, Array, Array]], Array, list[Finding]]:
    """Interior, rotation and centre of each photo; points (n, 3); warnings.

    An observed attitude is its own approximate value; other photos come from the file, else from a resection. Points
    without given coordinates are intersected.
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


# --- record ----------------------------------------------------------------------------------------


def bundle_record(
    result: BundleResult, table: files.Observed, known: Known, which: Index, of: Index,
    seen: Mapping[str, files.Station], check: Mapping[str, Array], started: Sequence[Finding],
) -> job.Record:  # fmt: skip
    """Record of a bundle.

    Parameters
    ----------
    result : BundleResult
    table : files.Observed
        Image points. With relative weights m0 replaces the sigmas in tests.
    known, check : mappings
        Coordinates and sigmas of control points; coordinates of check points.
    which, of : (m,) int arrays
        Photo and point of each image point.
    seen : mapping
        Observed stations by photo.
    started : sequence of Finding
        Warnings on the start values.
    """
    unit = (result.m0 or 1.0) if table.sigma is None else 1.0
    r, free = result.redundancy_numbers, result.others_redundancy
    w, _ = _tested(result.others_whitened, unit, free)
    return {
        "kind": "bundle", "backend": result.backend, "m0": result.m0, "redundancy": result.redundancy,
        "iterations": result.iterations, "unknowns": len(result.labels), "photos": _photos(result, which, seen),
        "cameras": [{"camera": c.name, "parameters": _numbers(c)} for c in result.cameras],
        "figures": [{"figure": f.name, "numbers": _numbers(f)} for f in result.figures],
        "points": _points(result, known, of, check), "residuals": _residuals(result, table, unit),
        "distortion": _distortion(result, table, which),
        "observations": job.rows({"what": result.others, "redundancy": free, "w": w}),
        "check": _check(result, check), "reliability": {
            "redundancy_of_images": r.sum(), "mean": r.mean(), "least": r.min(), "alpha": ALPHA, "power": POWER,
            "limit_of_checkable": CHECKABLE, "n_not_checkable": (r < CHECKABLE).any(axis=1).sum(),
        },
        "significance": _significance(result),
        "correlations": _correlations(result), "directions": directions(result),
        "history": [{name: getattr(i, name) for name in HISTORY} for i in result.history],
        **as_record([*_findings(result, known, seen, check), *started]),
    }  # fmt: skip


def _numbers(one: Adjustment, *names: str) -> list[job.Record]:
    """Some values, by default all, with standard deviations."""
    return [{"name": n, "value": one[n][0], "sigma": one[n][1]} for n in (names or one.names)]


def _photos(result: BundleResult, which: Index, seen: Mapping[str, files.Station]) -> list[job.Record]:
    photos, m0 = [], np.nan if result.m0 is None else result.m0
    for k, (one, rotation, centre) in enumerate(zip(result.photos, result.rotations, result.centres_m, strict=True)):
        sigma, turns = ([one[n][1] for n in names] for names in (CENTRE, TURNS))
        own = [n for n in one.names if n in NAMES]
        angles = m0 * np.sqrt(result.angle_cofactors[k].diagonal())
        inner, station = result.interiors[k], seen.get(one.name)
        observed = None if station is None else {
            "centre_m": station.centre_m, "sigma_m": station.sigma_m, "residual_m": centre - station.centre_m,
        }  # fmt: skip
        photos.append({
            "photo": one.name, "parameters": _numbers(one, *own) if own else [], "interior": None, "points": [],
            "exterior": job.exterior_record(rotation, centre, turns, sigma) | {"sigma_angles_deg": angles},
            "camera": {"focal": inner.focal, "principal": inner.principal, "corrections": inner.corrections,
                       "y_axis": inner.y_axis},
            "observed": observed,
            "rms": np.sqrt(np.mean(result.residuals[which == k] ** 2, axis=0)),
        })  # fmt: skip
    return photos


def _distortion(result: BundleResult, table: files.Observed, which: Index) -> list[job.Record]:
    """Corrections along the radius of each camera: common ones, of each photo, or fixed ones that are not 0."""
    labels, out = result.orientation_labels, list[job.Record]()
    m0 = result.m0 or 0.0
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, photo in enumerate(result.photos):
        own = [n for n in photo.names if n in NAMES]
        inner = result.interiors[k]
        same = ("photo", photo.name) if own else (inner.focal, *inner.principal, *inner.corrections)
        groups.setdefault(same, []).append(k)
    for members in groups.values():
        photo, inner = result.photos[members[0]], result.interiors[members[0]]
        camera = camera_of(inner)
        parts = [*((f"camera {c.name}", c) for c in result.cameras), (f"photo {photo.name}", photo)]
        where = {n: (f"{of} {n}", p[n][0]) for of, p in parts for n in p.names if n in NAMES}
        for name, (_, value) in where.items():
            camera[NAMES.index(name)] = value
        rows = [labels.index(label) for label, _ in where.values()]
        covariance = m0**2 * result.orientation[np.ix_(rows, rows)]
        reach = np.linalg.norm(table.image[np.isin(which, members)] - inner.principal, axis=1)
        curve = profile(camera, float(reach.max(initial=1e-9)), list(where), covariance)
        if any(curve["radial"]) or any(curve["across"]) or any(curve["sigma"]):
            out.append({"photos": [result.photos[k].name for k in members], "determined": list(where), **curve})
    return out


def _points(result: BundleResult, known: Known, of: Index, check: Mapping[str, Array]) -> list[job.Record]:
    n = len(result.ids)
    rays = np.bincount(of, minlength=n)
    with np.errstate(invalid="ignore"):  # points without rays have no misfit
        misfit = np.sqrt(np.bincount(of, np.sum(result.residuals**2, axis=1), n) / rays)
    given = np.array([known[i][0] if i in known else check.get(i, np.full(3, np.nan)) for i in result.ids])
    role = ["control" if i in known else "check" if i in check else "new" for i in result.ids]
    places = job.point_columns(result.points_m, result.sigma_m, result.point_cofactors, result.m0)
    return job.rows({"id": result.ids, "role": role, **places, "difference_{}_m": result.points_m - given,
                     "rays": rays, "misfit": misfit})  # fmt: skip


def _residuals(result: BundleResult, table: files.Observed, unit: float) -> list[job.Record]:
    """Image points: residuals (computed minus measured, corrected), redundancy numbers, w and detectable errors."""
    sigma = table.image_sigma
    own, detectable = _tested(result.residuals, sigma * unit, result.redundancy_numbers)
    return job.rows({
        "photo": table.photos, "id": table.ids, "{}": table.image, "residual_{}": result.residuals, "sigma_{}": sigma,
        "redundancy_{}": result.redundancy_numbers, "w_{}": own, "mdb_{}": detectable,
    })  # fmt: skip


def _tested(residual: Array, sigma: Array | float, redundancy: Array) -> tuple[Array, Array]:
    """Normalised residuals and minimal detectable biases; nan if the observation is not checked."""
    root = np.sqrt(np.where(redundancy >= CHECKABLE, redundancy, np.nan))
    return residual / (sigma * root), np.sqrt(noncentrality()) * sigma / root


def _check(result: BundleResult, check: Mapping[str, Array]) -> job.Record | None:
    """Statistics of adjusted minus given coordinates of the check points; None without check points."""
    rows = [name for name in check if name in result.ids]
    if not rows:
        return None
    given, ours = np.array([check[name] for name in rows]), result.points_m[[result.ids.index(name) for name in rows]]
    measures = compare_points(given, ours, np.zeros(len(rows), bool)).other
    return {"n": len(rows), "rms_mm": measures.rms_mm[:3], "worst_mm": measures.worst_mm,
            "mean_mm": 1e3 * (ours - given).mean(axis=0)}  # fmt: skip


def _correlations(result: BundleResult) -> job.Record:
    """High correlations of the orientation, largest first; all correlations of each photo and camera as triangles.

    Unknowns that hard conditions fix have none.
    """
    rho, labels = correlations(result.orientation), result.orientation_labels
    first, second = np.nonzero(np.tril(np.abs(np.nan_to_num(rho)) > HIGH, -1))
    order = np.argsort(-np.abs(rho[first, second]), kind="stable")[:LISTED]
    owner = [label.rpartition(" ")[0] for label in labels]
    parts = []
    for name in dict.fromkeys(o for o in owner if o.startswith(("photo ", "camera "))):
        rows = [k for k, o in enumerate(owner) if o == name]
        parts.append({"of": name, "names": [labels[k].rpartition(" ")[2] for k in rows],
                      "triangle": [rho[k, rows[:i]] for i, k in enumerate(rows)]})  # fmt: skip
    return {
        "limit": HIGH, "n": len(first), "parts": parts,
        "largest": [{"a": labels[i], "b": labels[j], "correlation": rho[i, j]}
                    for i, j in zip(first[order], second[order], strict=True)],
    }  # fmt: skip


def _significance(result: BundleResult) -> job.Record | None:
    """Tests of the distortion parameters; None without redundancy."""
    if result.m0 is None:
        return None
    owners = [*(("camera", c) for c in result.cameras), *(("photo", p) for p in result.photos)]
    values = {f"{of} {one.name} {name}": one[name][0] for of, one in owners for name in one.names if name in NAMES}
    own = [(k, label) for k, label in enumerate(result.orientation_labels) if label in values]
    rows = [k for k, _ in own]
    named = [(label.rpartition(" ")[0], label.rpartition(" ")[2]) for _, label in own]
    x, q = np.array([values[label] for _, label in own]), result.orientation[np.ix_(rows, rows)]
    return camera_significance(named, x, q, result.m0, result.redundancy).as_dict()


def directions(result: BundleResult) -> job.Record:
    """Singular values of the orientation in its units, and its weakest directions by their main unknowns.

    A direction with the value s has a standard deviation of 1/s units; directions that hard conditions fix are counted.
    """
    units = result.orientation_units
    variances, vectors = np.linalg.eigh(result.orientation / np.outer(units, units))
    values = 1.0 / np.sqrt(variances[variances > 0.0][::-1])
    return {
        "singular_values": values, "held": len(units) - len(values),
        "weakest": [{"value": value, "words": _words(vectors[:, -1 - k], result.orientation_labels)}
                    for k, value in enumerate(values[:_WEAK])],
    }  # fmt: skip


def _words(direction: Array, labels: Sequence[str]) -> str:
    """Main unknowns of a direction (o,)."""
    size = np.abs(direction)
    order = [int(k) for k in np.argsort(-size, kind="stable")[:_FEW] if size[k] >= NAMED * size.max()]
    sign = np.sign(direction[order[0]]) or 1.0
    return ", ".join(f"{sign * direction[k]:+.2f} {labels[k]}".replace("-", "−") for k in order)


def _findings(
    result: BundleResult, known: Known, seen: Mapping[str, files.Station], check: Mapping[str, Array]
) -> list[Finding]:  # fmt: skip
    """Warnings on the result."""
    out = job.no_redundancy(result.m0)
    for code, names, measured in (
        ("closerange.unseen_control", known, result.ids),
        ("closerange.unseen_check", check, result.ids),
        ("closerange.unseen_station", seen, [p.name for p in result.photos]),
    ):
        unseen = [name for name in names if name not in set(measured)]
        if unseen:
            out.append(finding(code, names=unseen))
    out += inseparable(_cofactors(result))
    if result.beyond:
        out.append(finding("closerange.no_photo_file", parameters=result.beyond))
    return out


def _cofactors(result: BundleResult) -> Iterator[ImageCofactors]:
    """Cofactors of the unknowns of each photo and of its camera."""
    labels = {label: k for k, label in enumerate(result.orientation_labels)}
    for photo, rotation in zip(result.photos, result.rotations, strict=True):
        own = [f"photo {photo.name} {name}" for name in photo.names]
        names = [label for label in (*own, *(f"camera {c.name} {n}" for c in result.cameras for n in c.names))
                 if label in labels]  # fmt: skip
        short = tuple(label.rpartition(" ")[2] for label in names)
        rows = [labels[label] for label in names]
        along = np.array([rotation[2][CENTRE.index(name)] if name in CENTRE else 0.0 for name in short])
        same = not result.cameras or any(name in NAMES for name in photo.names)
        key = f"photo {photo.name}" if same else f"camera {result.cameras[0].name}"
        yield ImageCofactors(key, short, result.orientation[np.ix_(rows, rows)], along)
