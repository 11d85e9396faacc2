"""Content of ``closerange.json`` for a bundle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.extended_collinearity import NAMES
from fg_orient.closerange.accuracy import compare_points
from fg_orient.closerange.bundle import Adjustment, BundleResult
from fg_orient.closerange.bundle_network import camera_of
from fg_orient.closerange.bundle_quality import Quality
from fg_orient.closerange.corrections import profile
from fg_orient.closerange.files import Observed, Station, observed_record
from fg_orient.closerange.job import Record, covariances, exterior_record, no_redundancy, xyz
from fg_orient.model.errors import Finding, as_record, finding
from fg_orient.quality.reliability import ALPHA, CHECKABLE, POWER, noncentrality

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Known = Mapping[str, tuple[Array, Array]]

#: Correlations above this are listed; how many of them, and of weak directions.
HIGH: Final = 0.9
LISTED: Final = 40
_WEAK: Final = 5


def bundle_record(
    result: BundleResult, table: Observed, known: Known, which: Index, of: Index, seen: Mapping[str, Station],
    check: Mapping[str, Array], started: Sequence[Finding] = (),
) -> Record:  # fmt: skip
    """Record of a bundle.

    Parameters
    ----------
    result : BundleResult
    table : Observed
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
    quality = result.quality
    unit = (result.m0 or 1.0) if table.sigma is None else 1.0
    return {
        "kind": "bundle", "backend": result.backend, "m0": result.m0, "redundancy": result.redundancy,
        "iterations": result.iterations, "unknowns": len(result.labels), "photos": _photos(result, which, seen),
        "cameras": [{"camera": c.name, "parameters": _numbers(c)} for c in result.cameras],
        "figures": [{"figure": f.name, "numbers": _numbers(f)} for f in result.figures],
        "points": _points(result, known, of, check), "residuals": _residuals(result, table, unit),
        "distortion": _distortion(result, table, which), "observations": _others(quality, unit),
        "check": _check(result, check), "reliability": _reliability(quality),
        "correlations": _correlations(quality), "directions": _directions(quality),
        "history": [{name: _finite(getattr(i, name)) for name in ("iteration", "chi2", "chi2_after", "ratio", "step")}
                    | {"iteration": i.iteration, "accepted": i.accepted} for i in quality.history],
        **as_record([*_findings(result, known, seen, check), *started]),
    }  # fmt: skip


def _numbers(one: Adjustment, names: Sequence[str] | None = None) -> list[Record]:
    """Values with standard deviations."""
    return [{"name": n, "value": one[n][0], "sigma": one[n][1]} for n in (names or one.names)]


def _photos(result: BundleResult, which: Index, seen: Mapping[str, Station]) -> list[Record]:
    photos = []
    for k, (one, rotation, centre) in enumerate(zip(result.photos, result.rotations, result.centres_m, strict=True)):
        sigma = [one[n][1] for n in ("X0", "Y0", "Z0")]
        turns = [one[n][1] for n in ("turn_x", "turn_y", "turn_z")]
        own = [n for n in one.names if n in NAMES]
        roots = np.sqrt(result.quality.angles_deg[k].diagonal())
        angles = [None] * 3 if result.m0 is None else (result.m0 * roots).tolist()
        inner = result.interiors[k]
        photos.append({
            "photo": one.name, "parameters": _numbers(one, own) if own else [], "interior": None, "points": [],
            "exterior": exterior_record(rotation, centre, turns, sigma) | {"sigma_angles_deg": angles},
            "camera": {"focal": inner.focal, "principal": inner.principal.tolist(),
                       "corrections": inner.corrections.tolist(), "y_axis": inner.y_axis},
            "observed": observed_record(seen.get(one.name), centre),
            "rms": np.sqrt(np.mean(result.residuals[which == k] ** 2, axis=0)).tolist(),
        })  # fmt: skip
    return photos


def _distortion(result: BundleResult, table: Observed, which: Index) -> list[Record]:
    """Corrections along the radius of each camera: common ones, of each photo, or fixed ones that are not 0."""
    labels, out = result.quality.labels, list[Record]()
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
        covariance = m0**2 * result.quality.orientation[np.ix_(rows, rows)]
        reach = np.linalg.norm(table.image[np.isin(which, members)] - inner.principal, axis=1)
        curve = profile(camera, float(reach.max(initial=1e-9)), list(where), covariance)
        if any(curve["radial"]) or any(curve["across"]) or any(curve["sigma"]):
            out.append({"photos": [result.photos[k].name for k in members], "determined": list(where), **curve})
    return out


def _points(result: BundleResult, known: Known, of: Index, check: Mapping[str, Array]) -> list[Record]:
    n = len(result.ids)
    rays = np.bincount(of, minlength=n)
    misfit = np.sqrt(np.bincount(of, np.sum(result.residuals**2, axis=1), n) / np.maximum(rays, 1))
    out = []
    for k, name in enumerate(result.ids):
        given = known[name][0] if name in known else check.get(name)
        role = "control" if name in known else "new" if given is None else "check"
        out.append({
            "id": name, "role": role, **xyz(result.points_m[k]),
            **xyz(None if result.sigma_m is None else result.sigma_m[k], "sigma_"),
            **covariances(result.quality.points[k], result.m0),
            **xyz(None if given is None else result.points_m[k] - given, "difference_"), "rays": int(rays[k]),
            "misfit": float(misfit[k]) if rays[k] else None,
        })  # fmt: skip
    return out


def _residuals(result: BundleResult, table: Observed, unit: float) -> list[Record]:
    """Image points: residuals (computed minus measured, corrected), redundancy numbers, w and detectable errors."""
    sigma = table.image_sigma
    own, detectable = _tested(result.residuals, sigma * unit, result.quality.redundancy)
    columns = {"": table.image, "residual_": result.residuals, "sigma_": sigma,
               "redundancy_": result.quality.redundancy, "w_": own, "mdb_": detectable}  # fmt: skip
    return [
        {"photo": p, "id": i} | {f"{name}{axis}": _finite(values[k, j]) for name, values in columns.items()
                                 for j, axis in enumerate("xy")}
        for k, (p, i) in enumerate(zip(table.photos, table.ids, strict=True))
    ]  # fmt: skip


def _tested(residual: Array, sigma: Array, redundancy: Array) -> tuple[Array, Array]:
    """Normalised residuals and minimal detectable biases; nan if the observation is not checked."""
    root = np.sqrt(np.where(redundancy >= CHECKABLE, redundancy, np.nan))
    return residual / (sigma * root), np.sqrt(noncentrality()) * sigma / root


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _others(quality: Quality, unit: float) -> list[Record]:
    """Observations other than image coordinates: name, redundancy number, normalised residual."""
    own, _ = _tested(quality.others_whitened, np.full(len(quality.others), unit), quality.others_redundancy)
    return [{"what": name, "redundancy": float(r), "w": _finite(w)}
            for name, r, w in zip(quality.others, quality.others_redundancy, own, strict=True)]  # fmt: skip


def _check(result: BundleResult, check: Mapping[str, Array]) -> Record | None:
    """Statistics of adjusted minus given coordinates of the check points; None without check points."""
    rows = [name for name in check if name in result.ids]
    if not rows:
        return None
    given, ours = np.array([check[name] for name in rows]), result.points_m[[result.ids.index(name) for name in rows]]
    measures = compare_points(given, ours, np.zeros(len(rows), bool)).other
    return {"n": len(rows), "rms_mm": measures.rms_mm[:3], "worst_mm": measures.worst_mm,
            "mean_mm": (1e3 * (ours - given).mean(axis=0)).tolist()}  # fmt: skip


def _reliability(quality: Quality) -> Record:
    """Summary of the redundancy numbers."""
    r = quality.redundancy
    return {
        "redundancy_of_images": float(r.sum()), "mean": float(r.mean()), "least": float(r.min()), "alpha": ALPHA,
        "power": POWER, "limit_of_checkable": CHECKABLE, "n_not_checkable": int((r < CHECKABLE).any(axis=1).sum()),
    }  # fmt: skip


def _correlations(quality: Quality) -> Record:
    """High correlations of the orientation, largest first; all correlations of each photo and camera as triangles."""
    rho = quality.correlations()
    first, second = np.nonzero(np.tril(np.abs(np.nan_to_num(rho)) > HIGH, -1))
    order = np.argsort(-np.abs(rho[first, second]), kind="stable")[:LISTED]
    owner = [label.rpartition(" ")[0] for label in quality.labels]
    parts = []
    for name in dict.fromkeys(o for o in owner if o.startswith(("photo ", "camera "))):
        rows = np.flatnonzero(np.array(owner, dtype=object) == name)
        own = rho[np.ix_(rows, rows)]
        parts.append({"of": name, "names": [quality.labels[k].rpartition(" ")[2] for k in rows],
                      "triangle": [[_finite(v) for v in own[i, :i]] for i in range(len(rows))]})  # fmt: skip
    return {
        "limit": HIGH, "n": len(first), "parts": parts,
        "largest": [{"a": quality.labels[first[k]], "b": quality.labels[second[k]],
                     "correlation": float(rho[first[k], second[k]])} for k in order],
    }  # fmt: skip


def _directions(quality: Quality) -> Record:
    """Singular values of the orientation and its weakest directions in words."""
    values, rows = quality.weak_directions()
    finite = values[np.isfinite(values)]
    return {
        "singular_values": finite.tolist(), "held": int(len(values) - len(finite)),
        "weakest": [{"value": float(values[k]), "words": quality.describe(rows[k])}
                    for k in range(min(_WEAK, len(finite)))],
    }  # fmt: skip


def _findings(
    result: BundleResult, known: Known, seen: Mapping[str, Station], check: Mapping[str, Array]
) -> list[Finding]:  # fmt: skip
    """Warnings on the result."""
    out = no_redundancy(result.m0)
    for code, names, measured in (
        ("closerange.unseen_control", known, result.ids),
        ("closerange.unseen_check", check, result.ids),
        ("closerange.unseen_station", seen, [p.name for p in result.photos]),
    ):
        unseen = [name for name in names if name not in set(measured)]
        if unseen:
            out.append(finding(code, names=unseen))
    if result.beyond:
        out.append(finding("closerange.no_photo_file", parameters=result.beyond))
    return out
