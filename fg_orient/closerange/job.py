"""Work of the commands: read a table, compute, make the record, write the folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.closerange.dlt import RECOVERED, fit_dlt
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
from fg_orient.closerange.fitting import Fit, plain_rms
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.options import DltOptions, ImageOptions, SurfaceOptions
from fg_orient.closerange.photo import Photo, aerial_from_rotation
from fg_orient.closerange.report import RECORD_FILE, REPORT_FILE
from fg_orient.closerange.report_html import render
from fg_orient.closerange.report_words import doubts, photo_rows
from fg_orient.closerange.resection import resect
from fg_orient.closerange.surface import Kind
from fg_orient.closerange.surface_fit import Priors, fit_surface
from fg_orient.formats.atomic import Contents, require_free, require_free_files, staged_folder, write_text, writing
from fg_orient.formats.closerange import read_photos
from fg_orient.model.errors import Finding, InputError, as_record, finding
from fg_orient.model.installation import versions
from fg_orient.rectification.folder import write_rows
from fg_orient.result.plain import dumps
from fg_orient.result.provenance import sha256_of

Array = npt.NDArray[np.float64]
Record = dict[str, Any]
T = TypeVar("T")

SCHEMA: Final = 1
CONTENTS: Final = Contents(
    RECORD_FILE,
    (RECORD_FILE, "points.csv", "photos.toml", REPORT_FILE, "figures/*.svg", "figures/*.pdf", "figures/captions.md"),
)


@dataclass(frozen=True)
class Output:
    """Outputs of a command: folder of the results, single HTML report; words of the command line for the record."""

    out: Path | None = None
    report: Path | None = None
    overwrite: bool = False
    command: Sequence[str] = ()

    def require_possible(self) -> None:
        """Refuse outputs that exist and may not be replaced, and a report without folder, before the computation."""
        if self.out is not None:
            require_free(self.out, overwrite=self.overwrite, contents=CONTENTS)
        if self.report is None:
            return
        require_free_files(self.report, overwrite=self.overwrite and not self.report.is_dir(), option="report")
        if not self.report.parent.is_dir():
            raise InputError.of("output.unwritable", file=self.report, option="report", value="no such folder")


#: No output but the record.
NONE: Final = Output()


def run_dlt(path: Path, options: DltOptions, output: Output = NONE) -> Record:
    """Fit a DLT to each photo of a table of control points (:func:`fg_orient.closerange.files.read_control`).

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.dlt.fit_dlt`.
    """

    def one(name: str, ground: Array, image: Array, sigma: Array | None) -> tuple[Record, Photo, str]:
        fit = fit_dlt(ground, image, sigma=sigma, distortion=options.distortion, name=name, iterate=not options.direct)
        little = fit.redundancy == 1 and sigma is None
        doubts = [fit.doubt, finding("closerange.little_redundancy") if little else None]
        r, s = fit.recovered, fit.recovered.sigma or dict.fromkeys(RECOVERED)
        interior = {
            "principal": r.principal.tolist(), "sigma_principal": [s["x0"], s["y0"]], "cx": r.cx, "sigma_cx": s["cx"],
            "cy": r.cy, "sigma_cy": s["cy"], "skew_rad": r.skew, "sigma_skew_rad": s["skew"], "y_axis": r.y_axis,
        }  # fmt: skip
        sd = [s[name] for name in RECOVERED]
        exterior = exterior_record(r.rotation, r.centre_m, sd[8:], sd[5:8])
        record = {
            "photo": name, **_fit_facts(fit, doubts), "parameters": _parameters(fit.names, fit.values, fit.sigma),
            "origin_m": fit.photo.origin_m.tolist(), "interior": interior, "exterior": exterior,
        }  # fmt: skip
        return record, fit.photo, photo_text(fit.photo)

    return _each_photo("dlt", path, options.sigma, output, one)


def _parameters(names: Sequence[str], values: Array, sigma: Array | None) -> list[Record]:
    """Values with standard deviations."""
    deviations = [None] * len(names) if sigma is None else sigma.tolist()
    return [{"name": n, "value": v, "sigma": s} for n, v, s in zip(names, values.tolist(), deviations, strict=True)]


def run_resect(path: Path, camera: Path, options: ImageOptions, output: Output = NONE) -> Record:
    """Orient each photo of a table of control points by its camera.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.resection.resect`; a photo without a camera.
    """
    cameras = interiors(read_photos(camera))

    def one(name: str, ground: Array, image: Array, sigma: Array | None) -> tuple[Record, Photo, str]:
        interior = of_name(cameras, name, camera)
        pose = resect(interior, ground, image, sigma=1.0 if sigma is None else sigma, name=name)
        sd: list[Any] = [None] * 6 if pose.sigma is None else pose.sigma.tolist()
        exterior = exterior_record(pose.rotation, pose.centre_m, sd[:3], sd[3:])
        record = {"photo": name, **_fit_facts(pose, pose.second_pose()), "exterior": exterior}
        return record, pose.photo, photo_text(pose.photo, interior, pose.rotation)

    return _each_photo("resection", path, options.sigma, output, one, [camera])


def run_intersect(path: Path, photos: Path, options: ImageOptions, output: Output = NONE) -> Record:
    """Intersect the points of a table by oriented photos.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.intersection.intersect_photos`; a photo that the file does not contain.
    """
    output.require_possible()
    table, known = read_image_points(path, options.sigma), oriented_photos(read_photos(photos))
    names, ids = list(dict.fromkeys(table.photos)), list(dict.fromkeys(table.ids))
    which, of = [names.index(name) for name in table.photos], [ids.index(name) for name in table.ids]
    with one_blas_thread():
        result = intersect_photos([of_name(known, n, photos) for n in names], which, of, table.image,
                                  sigma=table.image_sigma, ids=ids)  # fmt: skip
    rms, sd = [np.linalg.norm(result.residuals[np.array(of) == k]) for k in range(len(ids))], result.sigma_m
    points = [
        {"id": name, **xyz(result.points_m[k]), **xyz(None if sd is None else sd[k], "sigma_"),
         **covariances(result.cofactors[k], result.m0), "rays": of.count(k),
         "misfit": float(rms[k] / np.sqrt(of.count(k)))}
        for k, name in enumerate(ids)
    ]  # fmt: skip
    residuals = [
        {"photo": table.photos[k], "id": table.ids[k], **_pair("", table.image[k]), **_pair("residual_", v),
         **_given_sigmas(table, k)} for k, v in enumerate(result.residuals)
    ]  # fmt: skip
    centres = [{"photo": n, "exterior": {"centre_m": known[n].origin_m.tolist()}} for n in names if n in known]
    record = {
        "kind": "intersection", "weights": table.weights, "m0": result.m0, "redundancy": result.redundancy,
        "iterations": result.iterations, "points": points, "residuals": residuals, "stations": centres,
        **as_record(no_redundancy(result.m0)),
    }  # fmt: skip
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
    table, axis, method = read_ground_points(path, options.sigma_m), options.axis, options.method
    sigma = table.sigma
    require_absolute(path, table, [("", f"<prior> {name}", value[1]) for name, value in (priors or {}).items()])
    with one_blas_thread():
        fit = fit_surface(table.ground, kind, axis=axis, sigma_m=sigma, method=method, priors=priors)
    ratio = None if sigma is None or method != "geometric" else np.linalg.norm(fit.deviations_m / sigma, axis=1)
    record: Record = {
        "kind": "surface", "weights": table.weights, "surface": fit.surface.as_dict(), "method": method,
        "axis": axis if kind == "spheroid" else None, "m0": fit.m0, "redundancy": fit.redundancy,
        "condition": fit.condition, "iterations": fit.iterations, "rms_m": fit.rms_m,
        "rms_deviation_m": plain_rms(fit.deviations_m),
        "parameters": _parameters(fit.names, fit.values, fit.sigma),
        "points": [
            {"id": name, **xyz(table.ground[k]), **xyz(fit.deviations_m[k], "deviation_"),
             "distance_m": float(fit.distances_m[k]),
             **({} if ratio is None else {"distance_over_sigma": float(ratio[k])})}
            for k, name in enumerate(table.ids)
        ],
        **as_record(no_redundancy(fit.m0)),
    }  # fmt: skip
    return finished(record, path, table, output)


# --- common parts ----------------------------------------------------------------------------------


def require_absolute(path: Path, table: Observed, beside: Iterable[tuple[str, str, float]]) -> None:
    """Refuse other observations (file, place, sigma in m or rad) if the coordinates have relative weights."""
    if table.sigma is None:
        for file, place, value in beside:
            raise InputError.of("closerange.relative", file=file, place=place, value=value, points=path.name)


def _each_photo(
    kind: str, path: Path, sigma: float | None, output: Output,
    one: Callable[[str, Array, Array, Array | None], tuple[Record, Photo, str]], beside: Sequence[Path] = (),
) -> Record:  # fmt: skip
    """Record of the photos of a table of control points, in its order; errors name the photo.

    ``one`` gives record, photo and its table for a photo file from its name, the ground (n, 3) and image coordinates
    (n, 2) of the control points and their sigmas (n, 2).
    """
    output.require_possible()
    table, texts, photos = read_control(path, sigma), list[str](), list[Record]()
    with one_blas_thread():
        for name in dict.fromkeys(table.photos):
            rows = np.flatnonzero(np.array(table.photos, dtype=object) == name)
            used = rows[~table.check[rows]]
            try:
                record, photo, text = one(name, table.ground[used], table.image[used],
                                          None if table.sigma is None else table.sigma[used])  # fmt: skip
            except InputError as error:
                of = f"photo {name}, " if name else ""
                raise InputError(*(replace(p, place=f"{of}{p.place}".rstrip(", ")) for p in error.problems)) from None
            photos.append(record | _photo_points(table, rows, photo))
            texts.append(text)
    return finished({"kind": kind, "weights": table.weights, "photos": photos}, path, table, output, texts, beside)


def of_name(known: Mapping[str, T], name: str, path: Path) -> T:
    """Photo of a file; its only one if the table has no names."""
    if not name and len(known) == 1:
        return next(iter(known.values()))
    if name not in known:
        raise InputError.of("closerange.no_photo", file=path, place="photos", value=name or "no name",
                            known=", ".join(known))  # fmt: skip
    return known[name]


def no_redundancy(m0: float | None) -> list[Finding]:
    """Warning that standard deviations are undefined, if there is no redundancy."""
    return [] if m0 is not None else [finding("closerange.no_redundancy")]


def _fit_facts(fit: Fit, doubts: Sequence[Finding | None]) -> Record:
    return {
        "m0": fit.m0, "redundancy": fit.redundancy, "condition": fit.condition, "iterations": fit.iterations,
        **as_record([*no_redundancy(fit.m0), *filter(None, doubts)]),
    }  # fmt: skip


def exterior_record(rotation: Array, centre: Array, turns: Sequence[Any], sigma: Sequence[Any]) -> Record:
    """Orientation of a photo with standard deviations and aerial angles."""
    omega, phi, kappa = (float(np.degrees(angle)) for angle in aerial_from_rotation(rotation))
    return {
        "centre_m": centre.tolist(), "sigma_centre_m": list(sigma), "rotation": rotation.tolist(),
        "sigma_turns_rad": list(turns), "omega_deg": omega, "phi_deg": phi, "kappa_deg": kappa,
    }  # fmt: skip


def _photo_points(table: Observed, rows: npt.NDArray[np.intp], photo: Photo) -> Record:
    """Residuals of all points of a photo, computed minus measured, and their RMS by role."""
    residual, check = photo.project(table.ground[rows]) - table.image[rows], table.check[rows]
    points = [
        {"id": table.ids[k], "role": "check" if table.check[k] else "control", **_pair("residual_", v),
         **_pair("", table.image[k]), **xyz(table.ground[k]), **_given_sigmas(table, k)}
        for k, v in zip(rows.tolist(), residual, strict=True)
    ]  # fmt: skip
    return {"rms": plain_rms(residual[~check]), "check_rms": plain_rms(residual[check]), "points": points}


def _pair(prefix: str, values: Array) -> Record:
    """Two numbers of an image point."""
    return {f"{prefix}{axis}": value for axis, value in zip("xy", values.tolist(), strict=True)}


def _given_sigmas(table: Observed, row: int) -> Record:
    """Given standard deviations of an image point; empty for relative weights."""
    return {} if table.sigma is None else _pair("sigma_", table.sigma[row])


def xyz(values: Array | None, prefix: str = "") -> Record:
    """Three numbers by the names of the columns."""
    numbers: Sequence[Any] = [None] * 3 if values is None else values.tolist()
    return {f"{prefix}{name}": value for name, value in zip(GROUND, numbers, strict=True)}


def covariances(cofactors: Array, m0: float | None) -> Record:
    """Covariances of a point's coordinates, m²; None without redundancy."""
    places = {"cov_xy_m2": (0, 1), "cov_xz_m2": (0, 2), "cov_yz_m2": (1, 2)}
    return {name: None if m0 is None else float(m0**2 * cofactors[at]) for name, at in places.items()}


def finished(
    record: Record, path: Path, table: Observed, output: Output, photos: Sequence[str] = (),
    beside: Iterable[Path | None] = (),
) -> Record:  # fmt: skip
    """Add the provenance to a record, and write folder and report.

    ``photos``: tables of ``photos.toml``; ``beside``: inputs in addition to the points of ``path``.
    """
    files, out, report = [one for one in beside if one is not None], output.out, output.report
    record = {"schema": SCHEMA, **record, "input": {"file": path.name, "sha256": table.sha256}, "versions": versions(),
              "command": [Path(word).name if Path(word).is_absolute() else word for word in output.command],
              "date_time_utc": datetime.now(UTC).isoformat(timespec="seconds"),
              "report": {"inputs": [{"file": one.name, "sha256": sha256_of(one)} for one in files]}}  # fmt: skip
    record["doubts"] = doubts(record)
    page = "" if out is None and report is None else render(record)
    if out is not None:
        with staged_folder(out, overwrite=output.overwrite, contents=CONTENTS) as folder, writing(out):
            (folder / RECORD_FILE).write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
            (folder / REPORT_FILE).write_text(page, encoding="utf-8")
            write_rows(folder / "points.csv", record.get("points") or photo_rows(record))
            if photos:
                (folder / "photos.toml").write_text("schema = 1\n\n" + "\n".join(photos), encoding="utf-8")
    if report is not None:
        write_text(report, page)
    return record | {"out": None if out is None else str(out), "page": None if report is None else str(report)}
