"""Run the commands of close range: read a table, compute, make the record, write the folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.closerange import files
from fg_orient.closerange.assessment import assessed, tests_of
from fg_orient.closerange.dlt import RECOVERED, DltFit, fit_dlt
from fg_orient.closerange.files import Observed
from fg_orient.closerange.fitting import Fit, plain_rms
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.options import DltOptions, ImageOptions, SurfaceOptions
from fg_orient.closerange.photo import aerial_from_rotation, photo_text
from fg_orient.closerange.report import CONTENTS, RECORD_FILE, REPORT_FILE, render
from fg_orient.closerange.report_words import photo_rows
from fg_orient.closerange.resection import Resection, doubted_readings, resect
from fg_orient.closerange.surface import Kind
from fg_orient.closerange.surface_fit import Priors, fit_surface
from fg_orient.formats.atomic import outputs, require_free, require_free_files, staged_folder, write_text, writing
from fg_orient.formats.closerange import read_photos
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.model.installation import stamp
from fg_orient.result.manifest import with_manifest, write_manifest
from fg_orient.result.plain import dumps, plain, rows_of, write_records

Record = dict[str, Any]
T = TypeVar("T")
#: Record of a photo, its fit, and its table for the photo file.
Oriented = tuple[Record, DltFit | Resection, str]

SCHEMA: Final = 1


@dataclass(frozen=True)
class Output:
    """Outputs of a command: result folder, or single HTML report; also the command line for the record."""

    out: Path | None = None
    report: Path | None = None
    overwrite: bool = False
    command: Sequence[str] = ()

    def require_possible(self) -> None:
        """Refuse outputs that exist and must not be replaced, and a report in a missing folder.

        Call before computing.
        """
        if self.out is not None:
            require_free(self.out, overwrite=self.overwrite, contents=CONTENTS)
        if self.report is None:
            return
        require_free_files(self.report, overwrite=self.overwrite and not self.report.is_dir(), option="report")
        if not self.report.parent.is_dir():
            raise InputError.of("output.unwritable", file=self.report, option="report", value="no such folder")


#: Output that consists of the record only.
NONE: Final = Output()


def run_dlt(path: Path, options: DltOptions, output: Output = NONE) -> Record:
    """Fit a DLT to each photo of a table of control points (:func:`fg_orient.closerange.files.read_control`).

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.dlt.fit_dlt`.
    """

    def one(name: str, ids: list[str], ground: Array, image: Array, sigma: Array | None) -> Oriented:
        fit = fit_dlt(ground, image, sigma=sigma, distortion=options.distortion, name=name, iterate=not options.direct)
        little = fit.redundancy == 1 and sigma is None
        doubts = [fit.doubt, finding("closerange.little_redundancy") if little else None]
        r, s = fit.recovered, fit.recovered.sigma or dict.fromkeys(RECOVERED, np.nan)
        interior = {
            "principal": r.principal,
            "sigma_principal": [s["x0"], s["y0"]],
            "cx": r.cx,
            "sigma_cx": s["cx"],
            "cy": r.cy,
            "sigma_cy": s["cy"],
            "skew_rad": r.skew,
            "sigma_skew_rad": s["skew"],
            "y_axis": r.y_axis,
        }
        sd = [s[name] for name in RECOVERED]
        record = {
            "photo": name,
            **_fit_facts(fit, doubts),
            "parameters": parameters(fit.names, fit.values, fit.sigma),
            "origin_m": fit.photo.origin_m,
            "interior": interior,
            "exterior": exterior_record(r.rotation, r.centre_m, sd[8:], sd[5:8]),
        }
        return record, fit, photo_text(fit.photo)

    return _each_photo("dlt", path, options.sigma, output, one)


def run_resect(path: Path, camera: Path, options: ImageOptions, output: Output = NONE) -> Record:
    """Orient each photo of a table of control points by its camera.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.resection.resect`; a photo without a camera.
    """
    cameras = files.interiors(read_photos(camera))

    def one(name: str, ids: list[str], ground: Array, image: Array, sigma: Array | None) -> Oriented:
        interior = of_name(cameras, name, camera)
        pose = resect(interior, ground, image, sigma=1.0 if sigma is None else sigma, name=name)
        sd = np.full(6, np.nan) if pose.sigma is None else pose.sigma
        exterior = exterior_record(pose.rotation, pose.centre_m, sd[:3], sd[3:])
        found = [*doubted_readings([("", interior, ground, image, ids)]), *pose.second_pose()]
        record = {"photo": name, **_fit_facts(pose, found), "exterior": exterior}
        return record, pose, photo_text(pose.photo, interior, pose.rotation)

    return _each_photo("resection", path, options.sigma, output, one, [camera])


def run_intersect(path: Path, photos: Path, options: ImageOptions, output: Output = NONE) -> Record:
    """Intersect the points of a table by oriented photos.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.intersection.intersect_photos`; a photo that the file does not contain.
    """
    output.require_possible()
    table, known = files.read_image_points(path, options.sigma), files.oriented_photos(read_photos(photos))
    names, ids, which, of = table.numbered()
    with one_blas_thread():
        result = intersect_photos(
            [of_name(known, n, photos) for n in names], which, of, table.image, sigma=table.image_sigma, ids=ids
        )
    rays = np.bincount(of)
    misfit = np.sqrt(np.bincount(of, np.sum(result.residuals**2, axis=1)) / rays)
    sigma = {} if table.sigma is None else {"sigma_{}": table.sigma}
    record = {
        "kind": "intersection",
        "weights": table.weights,
        "m0": result.m0,
        "redundancy": result.redundancy,
        "iterations": result.iterations,
        "points": rows_of(
            {
                "id": ids,
                **point_columns(result.points_m, result.sigma_m, result.cofactors, result.m0),
                "rays": rays,
                "misfit": misfit,
            }
        ),
        "residuals": rows_of(
            {"photo": table.photos, "id": table.ids, "{}": table.image, "residual_{}": result.residuals, **sigma}
        ),
        "stations": [{"photo": n, "exterior": {"centre_m": known[n].origin_m}} for n in names if n in known],
        **as_record(no_redundancy(result.m0)),
    }
    return finished(record, path, table, output, beside=[photos])


def run_surface(
    path: Path, kind: Kind, options: SurfaceOptions, *, priors: Priors | None = None, output: Output = NONE
) -> Record:
    """Fit a surface to the points of a table.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.surface_fit.fit_surface`; priors for points without sigma.
    """
    output.require_possible()
    table, axis, method = files.read_ground_points(path, options.sigma_m), options.axis, options.method
    sigma = table.sigma
    require_absolute(path, table, [("", f"<prior> {name}", value[1]) for name, value in (priors or {}).items()])
    with one_blas_thread():
        fit = fit_surface(table.ground, kind, axis=axis, sigma_m=sigma, method=method, priors=priors)
    ratio = {}
    if sigma is not None and method == "geometric":
        ratio["distance_over_sigma"] = np.linalg.norm(fit.deviations_m / sigma, axis=1)
    free = {"redundancy": fit.redundancy_numbers[: len(table.ids)]} if method == "geometric" else {}
    record: Record = {
        "kind": "surface",
        "weights": table.weights,
        "surface": fit.surface.as_dict(),
        "method": method,
        "axis": axis if kind == "spheroid" else None,
        "m0": fit.m0,
        "redundancy": fit.redundancy,
        "condition": fit.condition,
        "iterations": fit.iterations,
        "rms_m": fit.rms_m,
        "rms_deviation_m": plain_rms(fit.deviations_m),
        "parameters": parameters(fit.names, fit.values, fit.sigma),
        "points": rows_of(
            {
                "id": table.ids,
                "{}_m": table.ground,
                "deviation_{}_m": fit.deviations_m,
                "distance_m": fit.distances_m,
                **free,
                **ratio,
            }
        ),
        **as_record(no_redundancy(fit.m0)),
    }
    return finished(record, path, table, output)


# --- common parts ----------------------------------------------------------------------------------


def require_absolute(path: Path, table: Observed, beside: Iterable[tuple[str, str, float]]) -> None:
    """Refuse other observations (file, place, sigma in m or rad) if the coordinates have relative weights."""
    if table.sigma is None:
        for file, place, value in beside:
            raise InputError.of("closerange.relative", file=file, place=place, value=value, points=path.name)


def _each_photo(
    kind: str,
    path: Path,
    sigma: float | None,
    output: Output,
    one: Callable[[str, list[str], Array, Array, Array | None], Oriented],
    beside: Sequence[Path] = (),
) -> Record:
    """Return the record of the photos in a table of control points, in its order; each photo has its points' residuals.

    Residuals are computed minus measured. Errors name the photo.

    ``one`` needs the name, the ids, the ground (n, 3) and image coordinates (n, 2) of the control points, and their
    sigmas (n, 2).
    """
    output.require_possible()
    table, texts, photos = files.read_control(path, sigma), list[str](), list[Record]()
    with one_blas_thread():
        for name in dict.fromkeys(table.photos):
            mine = np.flatnonzero(np.array(table.photos, dtype=object) == name)
            used = mine[~table.check[mine]]
            try:
                spread = None if table.sigma is None else table.sigma[used]
                record, fit, text = one(
                    name, [table.ids[k] for k in used], table.ground[used], table.image[used], spread
                )
            except InputError as error:
                of = f"photo {name}, " if name else ""
                raise InputError(*(replace(p, place=f"{of}{p.place}".rstrip(", ")) for p in error.problems)) from None
            residual, check = fit.photo.project(table.ground[mine]) - table.image[mine], table.check[mine]
            free = np.full((len(mine), 2), np.nan)
            free[~check] = fit.redundancy_numbers.reshape(-1, 2)
            sigmas = {} if table.sigma is None else {"sigma_{}": table.sigma[mine]}
            points = rows_of(
                {
                    "id": [table.ids[k] for k in mine],
                    "role": np.where(check, "check", "control"),
                    "residual_{}": residual,
                    "redundancy_{}": free,
                    "{}": table.image[mine],
                    "{}_m": table.ground[mine],
                    **sigmas,
                }
            )
            rms = {"rms": plain_rms(residual[~check]), "check_rms": plain_rms(residual[check])}
            photos.append(record | rms | {"points": points})
            texts.append(text)
    return finished({"kind": kind, "weights": table.weights, "photos": photos}, path, table, output, texts, beside)


def of_name(known: Mapping[str, T], name: str, path: Path) -> T:
    """Return the photo of this name; without a name, return the only photo of the file."""
    if not name and len(known) == 1:
        return next(iter(known.values()))
    if name not in known:
        raise InputError.of(
            "closerange.no_photo", file=path, place="photos", value=name or "no name", known=", ".join(known)
        )
    return known[name]


def no_redundancy(m0: float | None) -> list[Finding]:
    """Return the warning that standard deviations are undefined, if there is no redundancy."""
    return [] if m0 is not None else [finding("closerange.no_redundancy")]


def _fit_facts(fit: Fit, doubts: Sequence[Finding | None]) -> Record:
    return {
        "m0": fit.m0,
        "redundancy": fit.redundancy,
        "condition": fit.condition,
        "iterations": fit.iterations,
        **as_record([*no_redundancy(fit.m0), *filter(None, doubts)]),
    }


def exterior_record(rotation: Array, centre: Array, turns: Any, sigma: Any) -> Record:
    """Return the orientation of a photo, standard deviations of rotations (3,) and centre (3,), and aerial angles."""
    omega, phi, kappa = np.degrees(aerial_from_rotation(rotation))
    return {
        "centre_m": centre,
        "sigma_centre_m": sigma,
        "rotation": rotation,
        "sigma_turns_rad": turns,
        "omega_deg": omega,
        "phi_deg": phi,
        "kappa_deg": kappa,
    }


def parameters(names: Sequence[str], values: Array, sigma: Array | None) -> list[Record]:
    """Return the values (k,) with their standard deviations, which are None without redundancy."""
    return rows_of({"name": names, "value": values, "sigma": [None] * len(names) if sigma is None else sigma})


def point_columns(points_m: Array, sigma_m: Array | None, cofactors: Array, m0: float | None) -> Record:
    """Return the columns of points (n, 3), standard deviations (n, 3), m, and covariances, m²; nan without redundancy.

    ``cofactors`` (n, 3, 3), m².
    """
    sigma = np.full_like(points_m, np.nan) if sigma_m is None else sigma_m
    covariance = (np.nan if m0 is None else m0**2) * cofactors
    pairs = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    mixed = {f"cov_{name}_m2": covariance[:, i, j] for name, (i, j) in pairs.items()}
    return {"{}_m": points_m, "sigma_{}_m": sigma, **mixed}


def finished(
    record: Record,
    path: Path,
    table: Observed,
    output: Output,
    photos: Sequence[str] = (),
    beside: Iterable[Path | None] = (),
) -> Record:
    """Convert a record to plain values, add its provenance, and write folder and report.

    ``photos``: tables of ``photos.toml``; ``beside``: inputs in addition to the points of ``path``.
    """
    inputs, out, report = [one for one in beside if one is not None], output.out, output.report
    record = plain(
        {
            "schema": SCHEMA,
            **record,
            "input": {"file": path.name, "sha256": table.sha256},
            **stamp(output.command),
            "report": {"inputs": [{"file": one.name, "sha256": sha256_of(one)} for one in inputs]},
        }
    )
    by_adjustment = record["kind"] == "bundle" and record["weights"] == "absolute"
    record = plain(assessed(record, () if by_adjustment else tests_of(record)))
    page = "" if out is None and report is None else render(record)
    if out is not None:
        with staged_folder(out, overwrite=output.overwrite, contents=CONTENTS) as folder, writing(out):
            kept = with_manifest(record)
            (folder / RECORD_FILE).write_text(dumps(kept, indent=1) + "\n", encoding="utf-8")
            (folder / REPORT_FILE).write_text(page, encoding="utf-8")
            write_records(folder / "points.csv", record.get("points") or photo_rows(record))
            if photos:
                (folder / "photos.toml").write_text("schema = 1\n\n" + "\n".join(photos), encoding="utf-8")
            write_manifest(folder, kept, CONTENTS)
    if report is not None:
        with outputs(report, overwrite=output.overwrite and not report.is_dir(), option="report"):
            write_text(report, page)
    return record | {"out": None if out is None else str(out), "page": None if report is None else str(report)}
