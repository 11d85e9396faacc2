"""What the commands do: read a table, compute, give the record, write the folder."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.closerange.axes import aerial_from_rotation
from fg_orient.closerange.dlt import DltFit, fit_dlt
from fg_orient.closerange.files import (
    GROUND,
    Observed,
    interiors,
    oriented_photos,
    photo_text,
    read_control,
    read_ground_points,
    read_image_points,
)
from fg_orient.closerange.fitting import plain_rms
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.photo import Photo
from fg_orient.closerange.report import RECORD_FILE, REPORT_FILE
from fg_orient.closerange.report_html import render
from fg_orient.closerange.report_words import doubts
from fg_orient.closerange.resection import Resection, resect
from fg_orient.closerange.surface import Kind
from fg_orient.closerange.surface_fit import Method, Priors, fit_surface
from fg_orient.formats.atomic import Contents, require_free, staged_folder, write_text, writing
from fg_orient.formats.closerange import read_photos
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.model.installation import versions
from fg_orient.result.plain import dumps
from fg_orient.result.provenance import sha256_of

Array = npt.NDArray[np.float64]
Record = dict[str, Any]
T = TypeVar("T")

SCHEMA: Final = 1
CONTENTS: Final = Contents(
    RECORD_FILE,
    (
        RECORD_FILE,
        "points.csv",
        "photos.toml",
        REPORT_FILE,
        "figures/*.svg",
        "figures/*.pdf",
        "figures/captions.md",
    ),
)  # fmt: skip


def run_dlt(
    path: Path, *, distortion: Sequence[str] = (), sigma: float | None = None, iterate: bool = True,
    out: Path | None = None, report: Path | None = None, overwrite: bool = False, command: Sequence[str] = (),
) -> Record:  # fmt: skip
    """Fit a DLT to each photo of a table of control points.

    Parameters
    ----------
    path : Path
        See :func:`fg_orient.closerange.files.read_control`.
    distortion : sequence of str
        Unknown coefficients.
    sigma : float, optional
        Of image coordinates, where the table has none; without it they all have weight 1, and m0 is their sigma.
    iterate : bool
        False: the direct linear solution.
    out, report, overwrite, command
        Folder of the results; a single HTML report; replace them; words of the command line, for the record.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.dlt.fit_dlt`.
    """
    table, texts = _begin(path, read_control, out, report, overwrite), list[str]()

    def one(name: str, rows: Array, weights: Array) -> Record:
        used = rows[~table.check[rows]]
        stated = None if table.sigma is None and sigma is None else weights[~table.check[rows]]
        found = fit_dlt(table.ground[used], table.image[used], sigma=stated, distortion=distortion, name=name,
                        iterate=iterate)  # fmt: skip
        texts.append(photo_text(found.photo))
        little = found.redundancy == 1 and stated is None
        told = [found.doubt, finding("closerange.little_redundancy") if little else None]
        return _dlt_record(found, told) | _photo_points(table, rows, found.photo, sigma)

    photos = _each_photo(table, sigma, one)
    return finished(
        {"kind": "dlt", **unit_of_weights(table, sigma), "photos": photos}, path, table, out, overwrite, command, texts,
        report,
    )  # fmt: skip


def _dlt_record(found: DltFit, told: Sequence[Finding | None]) -> Record:
    r, sd = found.recovered, found.sigma
    s = r.sigma or dict.fromkeys(("x0", "y0", "cx", "cy", "skew", "X0", "Y0", "Z0", "turn_x", "turn_y", "turn_z"))
    return {
        "photo": found.photo.name, **_fit_facts(found, told),
        "parameters": [
            {"name": n, "value": v, "sigma": None if sd is None else float(sd[k])}
            for k, (n, v) in enumerate(zip(found.names, found.values.tolist(), strict=True))
        ],
        "origin_m": found.photo.origin_m.tolist(),
        "interior": {
            "principal": r.principal.tolist(), "sigma_principal": [s["x0"], s["y0"]], "cx": r.cx, "sigma_cx": s["cx"],
            "cy": r.cy, "sigma_cy": s["cy"], "skew_rad": r.skew, "sigma_skew_rad": s["skew"], "y_axis": r.y_axis,
        },
        "exterior": exterior_record(r.rotation, r.centre_m, [s["turn_x"], s["turn_y"], s["turn_z"]],
                              [s["X0"], s["Y0"], s["Z0"]]),
    }  # fmt: skip


def run_resect(
    path: Path, camera: Path, *, sigma: float | None = None, out: Path | None = None, overwrite: bool = False,
    report: Path | None = None, command: Sequence[str] = (),
) -> Record:  # fmt: skip
    """Orient each photo of a table of control points by its camera.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.resection.resect`; a photo without a camera.
    """
    table, texts = _begin(path, read_control, out, report, overwrite), list[str]()
    cameras = interiors(read_photos(camera))

    def one(name: str, rows: Array, weights: Array) -> Record:
        interior, used = of_name(cameras, name, camera), rows[~table.check[rows]]
        found = resect(interior, table.ground[used], table.image[used], sigma=weights[~table.check[rows]], name=name)
        texts.append(photo_text(found.photo, interior, found.rotation))
        return _resection_record(found) | _photo_points(table, rows, found.photo, sigma)

    photos = _each_photo(table, sigma, one)
    return finished({"kind": "resection", **unit_of_weights(table, sigma), "photos": photos}, path, table, out,
                    overwrite, command, texts, report, [camera])  # fmt: skip


def _resection_record(found: Resection) -> Record:
    sd = found.sigma
    turns, centre = ([None] * 3, [None] * 3) if sd is None else (sd[:3].tolist(), sd[3:].tolist())
    facts = _fit_facts(found, [None if found.rival is None else found.rival.finding()])
    return {"photo": found.photo.name, **facts,
            "exterior": exterior_record(found.rotation, found.centre_m, turns, centre)}  # fmt: skip


def run_intersect(
    path: Path, photos: Path, *, sigma: float | None = None, out: Path | None = None, overwrite: bool = False,
    report: Path | None = None, command: Sequence[str] = (),
) -> Record:  # fmt: skip
    """Intersect the points of a table by oriented photos.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.intersection.intersect_photos`; a photo that the file does not have.
    """
    table = _begin(path, read_image_points, out, report, overwrite)
    known = oriented_photos(read_photos(photos))
    names, ids = list(dict.fromkeys(table.photos)), list(dict.fromkeys(table.ids))
    which, of = [names.index(name) for name in table.photos], [ids.index(name) for name in table.ids]
    weights = weights_of(table, sigma)
    with one_blas_thread():
        found = intersect_photos([of_name(known, n, photos) for n in names], which, of, table.image, sigma=weights,
                                 ids=ids)  # fmt: skip
    rms, sd = [np.linalg.norm(found.residuals[np.array(of) == k]) for k in range(len(ids))], found.sigma_m
    points = [
        {"id": name, **xyz(found.points_m[k]), **xyz(None if sd is None else sd[k], "sigma_"),
         **covariances(found.cofactors[k], found.m0), "rays": of.count(k),
         "misfit": float(rms[k] / np.sqrt(of.count(k)))}
        for k, name in enumerate(ids)
    ]  # fmt: skip
    seen = zip(table.photos, table.ids, table.image.tolist(), found.residuals.tolist(), strict=True)
    given = _given_sigmas(table, sigma) or [{}] * len(table)
    residuals = [{"photo": p, "id": i, "x": x, "y": y, "residual_x": vx, "residual_y": vy, **s}
                 for (p, i, (x, y), (vx, vy)), s in zip(seen, given, strict=True)]  # fmt: skip
    centres = [{"photo": n, "exterior": {"centre_m": known[n].origin_m.tolist()}} for n in names if n in known]
    record = {
        "kind": "intersection", **unit_of_weights(table, sigma), "m0": found.m0, "redundancy": found.redundancy,
        "iterations": found.iterations, "points": points, "residuals": residuals, "stations": centres,
        **as_record(no_redundancy(found.m0)),
    }  # fmt: skip
    return finished(record, path, table, out, overwrite, command, (), report, [photos])


def run_surface(
    path: Path, kind: Kind, *, axis: str = "y", method: Method = "geometric", sigma_m: float | None = None,
    priors: Priors | None = None, out: Path | None = None, report: Path | None = None, overwrite: bool = False,
    command: Sequence[str] = (),
) -> Record:  # fmt: skip
    """Fit a surface to the points of a table.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.surface_fit.fit_surface`; priors where the points have no sigma.
    """
    table = _begin(path, read_ground_points, out, report, overwrite)
    require_absolute(
        path, table, sigma_m, [("", f"<prior> {name}", value[1]) for name, value in (priors or {}).items()]
    )
    weights = sigma_m if table.sigma is None else table.sigma
    with one_blas_thread():
        found = fit_surface(table.ground, kind, axis=axis, sigma_m=weights, method=method, priors=priors)
    sd = found.sigma
    ratio = None if weights is None or method != "geometric" else np.linalg.norm(found.deviations_m / weights, axis=1)
    record: Record = {
        "kind": "surface", **unit_of_weights(table, sigma_m), "surface": found.surface.as_dict(), "method": method,
        "axis": axis if kind == "spheroid" else None, "m0": found.m0, "redundancy": found.redundancy,
        "condition": found.condition, "iterations": found.iterations, "rms_m": found.rms_m,
        "rms_deviation_m": plain_rms(found.deviations_m),
        "parameters": [
            {"name": name, "value": value, "sigma": None if sd is None else float(sd[k])}
            for k, (name, value) in enumerate(zip(found.names, found.values.tolist(), strict=True))
        ],
        "points": [
            {"id": name, **xyz(table.ground[k]), **xyz(found.deviations_m[k], "deviation_"),
             "distance_m": float(found.distances_m[k]),
             **({} if ratio is None else {"distance_over_sigma": float(ratio[k])})}
            for k, name in enumerate(table.ids)
        ],
        **as_record(no_redundancy(found.m0)),
    }  # fmt: skip
    return finished(record, path, table, out, overwrite, command, (), report)


# --- what they share -------------------------------------------------------------------------------


def require_outputs(out: Path | None, report: Path | None, overwrite: bool) -> None:
    """Refuse outputs that may not be written, before anything is computed.

    Raises
    ------
    InputError
        One exists and may not be replaced, or the report cannot stand there.
    """
    if out is not None:
        require_free(out, overwrite=overwrite, contents=CONTENTS)
    if report is None:
        return
    if report.is_dir() or (report.exists() and not overwrite):
        raise InputError.of("output.exists", file=report, option="report")
    if not report.parent.is_dir():
        raise InputError.of("output.unwritable", file=report, option="report", value="no such folder")


def _begin(
    path: Path, read: Callable[[Path], Observed], out: Path | None, report: Path | None, overwrite: bool
) -> Observed:
    require_outputs(out, report, overwrite)
    return read(path)


def weights_of(table: Observed, sigma: float | None) -> Array:
    """Sigmas (n, 2) of the image coordinates: the table's, or one for all; 1 where nothing tells their size."""
    return np.full((len(table), 2), 1.0 if sigma is None else sigma) if table.sigma is None else table.sigma


def unit_of_weights(table: Observed, sigma: float | None) -> Record:
    """Whether weights are those of given sigmas (m0 is a ratio), or only relative (m0 is a sigma)."""
    return {"weights": "relative" if table.sigma is None and sigma is None else "absolute"}


def require_absolute(
    path: Path, table: Observed, sigma: float | None, beside: Iterable[tuple[str, str, float]]
) -> None:
    """Refuse sigmas in metres or radians beside coordinates whose weights are only relative.

    Parameters
    ----------
    beside : iterable of (file, place, sigma)
        What has a sigma of its own.

    Raises
    ------
    InputError
        Names the first one: all of them weigh nothing definite.
    """
    if table.sigma is None and sigma is None:
        for file, place, value in beside:
            raise InputError.of("closerange.relative", file=file, place=place, value=value, points=path.name)


def _each_photo(table: Observed, sigma: float | None, one: Callable[[str, Any, Array], Record]) -> list[Record]:
    """Records of the photos in the order of the table; faults name the photo."""
    weights, out = weights_of(table, sigma), []
    with one_blas_thread():
        for name in dict.fromkeys(table.photos):
            rows = np.flatnonzero(np.array(table.photos, dtype=object) == name)
            try:
                out.append(one(name, rows, weights[rows]))
            except InputError as error:
                raise _in_photo(error, name) from None
    return out


def _in_photo(error: InputError, name: str) -> InputError:
    """Put the name of the photo to a fault."""
    if not name:
        return error
    return InputError(*(replace(p, place=f"photo {name}, {p.place}".rstrip(", ")) for p in error.problems))


def of_name(known: Mapping[str, T], name: str, path: Path) -> T:
    """A photo of a file; the only one if the table names none."""
    if not name and len(known) == 1:
        return next(iter(known.values()))
    if name not in known:
        raise InputError.of("closerange.no_photo", file=path, place="photos", value=name or "no name",
                            known=", ".join(known))  # fmt: skip
    return known[name]


def no_redundancy(m0: float | None) -> list[Finding]:
    """Tell that standard deviations follow from nothing, where it is so."""
    return [] if m0 is not None else [finding("closerange.no_redundancy")]


def _fit_facts(found: DltFit | Resection, told: Sequence[Finding | None]) -> Record:
    return {
        "m0": found.m0, "redundancy": found.redundancy, "condition": found.condition, "iterations": found.iterations,
        **as_record([*no_redundancy(found.m0), *filter(None, told)]),
    }  # fmt: skip


def exterior_record(rotation: Array, centre: Array, turns: Sequence[Any], sigma: Sequence[Any]) -> Record:
    """Orientation of a photo with standard deviations and aerial angles."""
    omega, phi, kappa = (float(np.degrees(angle)) for angle in aerial_from_rotation(rotation))
    return {
        "centre_m": centre.tolist(), "sigma_centre_m": list(sigma), "rotation": rotation.tolist(),
        "sigma_turns_rad": list(turns), "omega_deg": omega, "phi_deg": phi, "kappa_deg": kappa,
    }  # fmt: skip


def _photo_points(table: Observed, rows: Array, photo: Photo, sigma: float | None) -> Record:
    """Residuals of all points of a photo, computed minus measured, and their RMS by role."""
    index = np.asarray(rows, np.intp)
    residual = photo.project(table.ground[index]) - table.image[index]
    given = _given_sigmas(table, sigma)
    check = table.check[index]
    points = [
        {"id": table.ids[k], "role": "check" if table.check[k] else "control", "residual_x": float(r[0]),
         "residual_y": float(r[1]), "x": float(table.image[k, 0]), "y": float(table.image[k, 1]),
         **xyz(table.ground[k]), **(given[k] if given else {})}
        for k, r in zip(index.tolist(), residual, strict=True)
    ]  # fmt: skip
    return {"rms": plain_rms(residual[~check]), "check_rms": plain_rms(residual[check]), "points": points}


def _given_sigmas(table: Observed, sigma: float | None) -> list[Record]:
    """Given standard deviations of the image coordinates; none where all have the same weight."""
    if unit_of_weights(table, sigma)["weights"] == "relative":
        return []
    return [{"sigma_x": x, "sigma_y": y} for x, y in weights_of(table, sigma).tolist()]


def xyz(values: Array | None, prefix: str = "") -> Record:
    """Three numbers by the names of the columns."""
    numbers: Sequence[Any] = [None] * 3 if values is None else values.tolist()
    return {f"{prefix}{name}": value for name, value in zip(GROUND, numbers, strict=True)}


def covariances(cofactors: Array, m0: float | None) -> Record:
    """Covariances of a point's coordinates, m²; None without redundancy."""
    places = {"cov_xy_m2": (0, 1), "cov_xz_m2": (0, 2), "cov_yz_m2": (1, 2)}
    return {name: None if m0 is None else float(m0**2 * cofactors[at]) for name, at in places.items()}


def finished(
    record: Record, path: Path, table: Observed, out: Path | None, overwrite: bool, command: Sequence[str],
    photos: Sequence[str] = (), report: Path | None = None, beside: Iterable[Path | None] = (),
) -> Record:  # fmt: skip
    """Add what the record was made from, write folder and report where they are wanted.

    Parameters
    ----------
    record : dict
    path : Path
        Of the points.
    table : Observed
        The points.
    out, overwrite, command, report
        See :func:`run_dlt`.
    photos : sequence of str
        Tables of ``photos.toml``.
    beside : iterable of Path or None
        Other inputs.
    """
    files = [one for one in beside if one is not None]
    record = {"schema": SCHEMA, **record, "input": {"file": path.name, "sha256": table.sha256}, "versions": versions(),
              "command": [Path(word).name if Path(word).is_absolute() else word for word in command],
              "date_time_utc": datetime.now(UTC).isoformat(timespec="seconds"),
              "report": {"inputs": [{"file": one.name, "sha256": sha256_of(one)} for one in files]}}  # fmt: skip
    record["doubts"] = doubts(record)
    page = "" if out is None and report is None else render(record)
    if out is not None:
        with staged_folder(out, overwrite=overwrite, contents=CONTENTS) as folder, writing(out):
            (folder / RECORD_FILE).write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
            (folder / REPORT_FILE).write_text(page, encoding="utf-8")
            _write_points(folder / "points.csv", record)
            if photos:
                (folder / "photos.toml").write_text("schema = 1\n\n" + "\n".join(photos), encoding="utf-8")
    if report is not None:
        write_text(report, page)
    return record | {"out": None if out is None else str(out), "page": None if report is None else str(report)}


def _write_points(path: Path, record: Record) -> None:
    """Write all points as one table; None and nan are empty cells."""
    rows = record.get("points") or [{"photo": p["photo"]} | row for p in record["photos"] for row in p["points"]]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(rows[0])
        writer.writerows(["" if v is None or v != v else v for v in row.values()] for row in rows)
