"""Make the record of a bundle, which is the content of ``closerange.json`` and of the report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.robust import NONE
from fg_orient.closerange import files, job
from fg_orient.closerange.bundle_block import CENTRE, TURNS
from fg_orient.closerange.bundle_checks import NAMED
from fg_orient.closerange.bundle_result import Adjustment, BundleResult
from fg_orient.closerange.fitting import compare_points
from fg_orient.closerange.photo import NAMES, camera_of, profile
from fg_orient.closerange.resection import doubted_readings
from fg_orient.model.errors import Finding, NoSolutionError, as_record, finding
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.camera import ImageCofactors, inseparable
from fg_orient.quality.doubts import of_check_points, with_accepted
from fg_orient.quality.reliability import ALPHA, CHECKABLE, POWER, noncentrality
from fg_orient.quality.significance import camera_significance
from fg_orient.report.tables import correlations
from fg_orient.result.plain import rows_of
from fg_orient.result.statistics import search_record
from fg_orient.result.summary import robust_record

Known = Mapping[str, tuple[Array, Array]]

#: Codes, or their beginnings, of the findings of the adjustment that concern a close-range bundle.
ASSESSED: Final = ("camera.direction", "verdict.", "solution.sigmas_large")
#: Units of gross errors, in the words of close range.
_UNITS: Final = {"px line, sample": "in y, x", "px line": "in y", "px sample": "in x"}
#: Number of photos whose image coordinates are tested in another reading.
READ: Final = 3
#: Correlations of at least this size are listed.
HIGH: Final = 0.9
#: Maximum number of listed correlations.
LISTED: Final = 40
#: Recorded fields of an iteration.
HISTORY: Final = ("iteration", "chi2", "chi2_after", "ratio", "step", "accepted")
#: Maximum number of listed weak directions.
_WEAK: Final = 5
#: Maximum number of unknowns that are named for a direction.
_FEW: Final = 4


def bundle_record(
    result: BundleResult,
    table: files.Observed,
    known: Known,
    which: Index,
    of: Index,
    seen: Mapping[str, files.Station],
    check: Known,
    started: Sequence[Finding],
) -> job.Record:
    """Return the record of a bundle.

    Parameters
    ----------
    result : BundleResult
    table : files.Observed
        Image points. With relative weights m0 replaces the sigmas in tests.
    known, check : mappings
        Coordinates and sigmas of control points, and of check points.
    which, of : (m,) int arrays
        Photo and point of each image point.
    seen : mapping
        Observed stations by photo.
    started : sequence of Finding
        Warnings on the start values.
    """
    unit = (result.m0 or 1.0) if table.sigma is None else 1.0
    solution, free = result.solution, result.others_redundancy
    r, options = result.redundancy_numbers[~result.rejected], solution.block.options
    w, _ = _tested(result.others_whitened, unit, free)
    if options.loss != NONE:
        w = np.full(len(w), np.nan)
    checked = _check_points(result, check)
    found = [
        *_readings(result, table, known, which, of),
        *_findings(result, table, known, seen, check, checked),
        *started,
    ]
    return {
        "kind": "bundle",
        "backend": result.backend,
        "m0": result.m0,
        "redundancy": result.redundancy,
        "iterations": result.iterations,
        "unknowns": len(result.labels),
        "photos": _photos(result, which, seen),
        "cameras": [{"camera": c.name, "parameters": _numbers(c)} for c in result.cameras],
        "figures": [{"figure": f.name, "numbers": _numbers(f)} for f in result.figures],
        "points": _points(result, known, of, check),
        "residuals": _residuals(result, table, unit),
        "loss": options.loss,
        "robust": robust_record(solution),
        "snooping": search_record(solution),
        "variance_components": None if solution.components is None else solution.components.as_dict(),
        "distortion": _distortion(result, table, which),
        "observations": rows_of({"what": result.others, "redundancy": free, "w": w}),
        "check": _check(checked),
        "reliability": {
            "redundancy_of_images": r.sum(),
            "mean": r.mean(),
            "least": r.min(),
            "alpha": ALPHA,
            "power": POWER,
            "limit_of_checkable": CHECKABLE,
            "n_not_checkable": (r < CHECKABLE).any(axis=1).sum(),
        },
        "significance": _significance(result),
        "correlations": _correlations(result),
        "directions": directions(result),
        "history": [{name: getattr(i, name) for name in HISTORY} for i in result.history],
        **as_record(with_accepted(found, options.accept)),
    }


def _numbers(one: Adjustment, *names: str) -> list[job.Record]:
    """Return values with their standard deviations, by default all values."""
    return [{"name": n, "value": one[n][0], "sigma": one[n][1]} for n in (names or one.names)]


def _photos(result: BundleResult, which: Index, seen: Mapping[str, files.Station]) -> list[job.Record]:
    photos, m0 = [], np.nan if result.m0 is None else result.m0
    for k, (one, rotation, centre) in enumerate(zip(result.photos, result.rotations, result.centres_m, strict=True)):
        sigma, turns = ([one[n][1] for n in names] for names in (CENTRE, TURNS))
        own = [n for n in one.names if n in NAMES]
        angles = m0 * np.sqrt(result.angle_cofactors[k].diagonal())
        inner, station = result.interiors[k], seen.get(one.name)
        observed = (
            None
            if station is None
            else {
                "centre_m": station.centre_m,
                "sigma_m": station.sigma_m,
                "residual_m": centre - station.centre_m,
            }
        )
        photos.append(
            {
                "photo": one.name,
                "parameters": _numbers(one, *own) if own else [],
                "interior": None,
                "points": [],
                "exterior": job.exterior_record(rotation, centre, turns, sigma) | {"sigma_angles_deg": angles},
                "camera": {
                    "focal": inner.focal,
                    "principal": inner.principal,
                    "corrections": inner.corrections,
                    "y_axis": inner.y_axis,
                },
                "observed": observed,
                "rms": np.sqrt(np.mean(result.residuals[(which == k) & ~result.rejected] ** 2, axis=0)),
            }
        )
    return photos


def _distortion(result: BundleResult, table: files.Observed, which: Index) -> list[job.Record]:
    """Return radial corrections: common ones of each camera, own ones of each photo, or fixed ones other than 0."""
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


def _points(result: BundleResult, known: Known, of: Index, check: Known) -> list[job.Record]:
    n, kept = len(result.ids), ~result.rejected
    of = of[kept]
    rays = np.bincount(of, minlength=n)
    with np.errstate(invalid="ignore"):  # points without rays have no residual; the result is then nan
        misfit = np.sqrt(np.bincount(of, np.sum(result.residuals[kept] ** 2, axis=1), n) / rays)
    given = np.array(
        [known[i][0] if i in known else check[i][0] if i in check else np.full(3, np.nan) for i in result.ids]
    )
    role = ["control" if i in known else "check" if i in check else "new" for i in result.ids]
    places = job.point_columns(result.points_m, result.sigma_m, result.point_cofactors, result.m0)
    return rows_of(
        {
            "id": result.ids,
            "role": role,
            **places,
            "difference_{}_m": result.points_m - given,
            "rays": rays,
            "misfit": misfit,
        }
    )


def _residuals(result: BundleResult, table: files.Observed, unit: float) -> list[job.Record]:
    """Return image points with residuals (computed minus corrected), redundancy numbers, w and detectable errors.

    With a loss or a search for gross errors, they have weights; rejected points have the
    weight 0. With a loss, there are no tests.
    """
    sigma, options = result.image_sigma, result.solution.block.options
    own, detectable = _tested(result.residuals, sigma * unit, result.redundancy_numbers)
    robust = options.loss != NONE
    if robust:
        own, detectable = np.full_like(own, np.nan), np.full_like(own, np.nan)
    weights = {"weight": result.weights} if robust or options.snoop else {}
    return rows_of(
        {
            "photo": table.photos,
            "id": table.ids,
            "{}": table.image,
            "residual_{}": result.residuals,
            "sigma_{}": sigma,
            "redundancy_{}": result.redundancy_numbers,
            "w_{}": own,
            "mdb_{}": detectable,
            **weights,
        }
    )


def _tested(residual: Array, sigma: Array | float, redundancy: Array) -> tuple[Array, Array]:
    """Return the normalised residuals and minimal detectable biases; nan if the observation is not checked."""
    root = np.sqrt(np.where(redundancy >= CHECKABLE, redundancy, np.nan))
    return residual / (sigma * root), np.sqrt(noncentrality()) * sigma / root


def _check(checked: PointDifferences) -> job.Record | None:
    """Return the statistics of adjusted minus given coordinates of the check points; None without check points."""
    if not len(checked):
        return None
    measures = compare_points(np.zeros_like(checked.enu_m), checked.enu_m, np.zeros(len(checked), bool)).other
    return {
        "n": len(checked),
        "rms_mm": measures.rms_mm[:3],
        "worst_mm": measures.worst_mm,
        "mean_mm": 1e3 * checked.enu_m.mean(axis=0),
    }


def _correlations(result: BundleResult) -> job.Record:
    """Return high correlations of the orientation, largest first, and all correlations of each photo and camera.

    Unknowns fixed by hard conditions have no correlations.
    """
    rho, labels = correlations(result.orientation), result.orientation_labels
    first, second = np.nonzero(np.tril(np.abs(np.nan_to_num(rho)) > HIGH, -1))
    order = np.argsort(-np.abs(rho[first, second]), kind="stable")[:LISTED]
    owner = [label.rpartition(" ")[0] for label in labels]
    parts = []
    for name in dict.fromkeys(o for o in owner if o.startswith(("photo ", "camera "))):
        rows = [k for k, o in enumerate(owner) if o == name]
        parts.append(
            {
                "of": name,
                "names": [labels[k].rpartition(" ")[2] for k in rows],
                "triangle": [rho[k, rows[:i]] for i, k in enumerate(rows)],
            }
        )
    return {
        "limit": HIGH,
        "n": len(first),
        "parts": parts,
        "largest": [
            {"a": labels[i], "b": labels[j], "correlation": rho[i, j]}
            for i, j in zip(first[order], second[order], strict=True)
        ],
    }


def _significance(result: BundleResult) -> job.Record | None:
    """Test the distortion parameters; None without redundancy, under a loss, or with too many components."""
    solution = result.solution
    if result.m0 is None or solution.weights is not None:
        return None
    try:
        freedom = solution.unknown_freedom
    except NoSolutionError:
        return None
    owners = [*(("camera", c) for c in result.cameras), *(("photo", p) for p in result.photos)]
    values = {f"{of} {one.name} {name}": one[name][0] for of, one in owners for name in one.names if name in NAMES}
    own = [(k, label) for k, label in enumerate(result.orientation_labels) if label in values]
    rows = [k for k, _ in own]
    named = [(label.rpartition(" ")[0], label.rpartition(" ")[2]) for _, label in own]
    x, q = np.array([values[label] for _, label in own]), result.orientation[np.ix_(rows, rows)]
    if freedom is None:
        return camera_significance(named, x, q, result.m0, result.redundancy).as_dict()
    ties, places = solution.problem.ties, np.array(rows, np.intp)
    places = places if ties is None else ties.place[places]
    return camera_significance(named, x, q, 1.0, result.redundancy, lambda at: freedom.together(places[at])).as_dict()


def directions(result: BundleResult) -> job.Record:
    """Return the singular values of the orientation in its units. Name its weakest directions by the main unknowns.

    A direction with the value s has a standard deviation of 1/s units; directions that
    hard conditions fix are counted.
    """
    units = result.orientation_units
    variances, vectors = np.linalg.eigh(result.orientation / np.outer(units, units))
    values = 1.0 / np.sqrt(variances[variances > 0.0][::-1])
    return {
        "singular_values": values,
        "held": len(units) - len(values),
        "weakest": [
            {"value": value, "words": _words(vectors[:, -1 - k], result.orientation_labels)}
            for k, value in enumerate(values[:_WEAK])
        ],
    }


def _words(direction: Array, labels: Sequence[str]) -> str:
    """Return the main unknowns of a direction (o,)."""
    size = np.abs(direction)
    order = [int(k) for k in np.argsort(-size, kind="stable")[:_FEW] if size[k] >= NAMED * size.max()]
    sign = np.sign(direction[order[0]]) or 1.0
    return ", ".join(f"{sign * direction[k]:+.2f} {labels[k]}".replace("-", "−") for k in order)


def _findings(
    result: BundleResult,
    table: files.Observed,
    known: Known,
    seen: Mapping[str, files.Station],
    check: Known,
    checked: PointDifferences,
) -> list[Finding]:
    """Return the findings on the result.

    With relative weights the adjustment assumes 1 as the standard deviation of an image coordinate: then its tests are
    not used, but those of :mod:`fg_orient.closerange.assessment`.
    """
    solution, absolute = result.solution, table.sigma is not None
    of_adjustment = ASSESSED if absolute else ASSESSED[:1]
    out = [of_photos(one) for one in solution.findings if one.code.startswith(of_adjustment)]
    out += of_check_points(checked) if absolute else []
    out += job.no_redundancy(result.m0)
    out += solution.snooping.findings() if solution.snooping is not None else ()
    out += solution.components.findings if solution.components is not None else ()
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


def _readings(result: BundleResult, table: files.Observed, known: Known, which: Index, of: Index) -> list[Finding]:
    """Return the doubts on the reading of the image coordinates, from the photos with the most control points.

    A wrong direction of y concerns all photos of a camera, so a few photos are sufficient.
    """
    names, control = np.array(result.ids, object), np.isin(result.ids, list(known))
    counts = np.bincount(which[control[of]], minlength=len(result.photos))
    tested = []
    for k in np.argsort(-counts, kind="stable")[:READ].tolist():
        rows = np.flatnonzero((which == k) & control[of] & ~result.rejected)
        place = np.array([known[name][0] for name in names[of[rows]]]).reshape(-1, 3)
        tested.append((result.photos[k].name, result.interiors[k], place, table.image[rows], list(names[of[rows]])))
    return doubted_readings(tested)


def of_photos(found: Finding) -> Finding:
    """Return a finding of the adjustment in the words of close range: x and y, in the unit of the image coordinates."""
    data = dict(found.data)
    if "unit" in data:
        data["unit"] = _UNITS.get(data["unit"], data["unit"])
    if found.code.startswith("verdict.sigmas"):
        data["words"] = data["words"].replace(" px", "")
    return replace(found, data=data)


def _check_points(result: BundleResult, check: Known) -> PointDifferences:
    """Return adjusted minus given coordinates of the check points, with the cofactors of the adjusted points."""
    rows = np.array([k for k, name in enumerate(result.ids) if name in check], np.intp)
    names = tuple(result.ids[k] for k in rows)
    given, sigma = (np.array([check[name][k] for name in names]).reshape(-1, 3) for k in (0, 1))
    difference = result.points_m[rows] - given
    return PointDifferences(names, rows, difference, difference, result.point_cofactors[rows], sigma)


def _cofactors(result: BundleResult) -> Iterator[ImageCofactors]:
    """Yield the cofactors of the unknowns of each photo and of its camera."""
    labels = {label: k for k, label in enumerate(result.orientation_labels)}
    for photo, rotation in zip(result.photos, result.rotations, strict=True):
        own = [f"photo {photo.name} {name}" for name in photo.names]
        names = [
            label
            for label in (*own, *(f"camera {c.name} {n}" for c in result.cameras for n in c.names))
            if label in labels
        ]
        short = tuple(label.rpartition(" ")[2] for label in names)
        rows = [labels[label] for label in names]
        along = np.array([rotation[2][CENTRE.index(name)] if name in CENTRE else 0.0 for name in short])
        same = not result.cameras or any(name in NAMES for name in photo.names)
        key = f"photo {photo.name}" if same else f"camera {result.cameras[0].name}"
        yield ImageCofactors(key, short, result.orientation[np.ix_(rows, rows)], along)
