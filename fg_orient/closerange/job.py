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
from fg_orient.closerange.dlt import RECOVERED, DltFit, fit_dlt
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
from fg_orient.closerange.photo import Photo, aerial_from_rotation
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
    """Outputs of a command.

    Parameters
    ----------
    out, report : Path, optional
        Folder of the results; a single HTML report.
    overwrite : bool
        Replace existing outputs.
    command : sequence of str
        Words of the command line, for the record.
    """

    out: Path | None = None
    report: Path | None = None
    overwrite: bool = False
    command: Sequence[str] = ()

    def require_possible(self) -> None:
        """Refuse outputs that may not be written, before anything is computed.

        Raises
        ------
        InputError
            An output exists and may not be replaced, or the report has no folder.
        """
        if self.out is not None:
            require_free(self.out, overwrite=self.overwrite, contents=CONTENTS)
        if self.report is None:
            return
        if self.report.is_dir() or (self.report.exists() and not self.overwrite):
            raise InputError.of("output.exists", file=self.report, option="report")
        if not self.report.parent.is_dir():
            raise InputError.of("output.unwritable", file=self.report, option="report", value="no such folder")


#: No output but the record.
NONE: Final = Output()


def run_dlt(
    path: Path, *, distortion: Sequence[str] = (), sigma: float | None = None, iterate: bool = True,
    output: Output = NONE,
) -> Record:  # fmt: skip
    """Fit a DLT to each photo of a table of control points.

    Parameters
    ----------
    path : Path
        See :func:`fg_orient.closerange.files.read_control`.
    distortion : sequence of str
        Unknown coefficients.
    sigma : float, optional
        Of image coordinates without a sigma in the table; by default all have weight 1, and m0 is their sigma.
    iterate : bool
        False: the direct linear solution.
    output : Output, optional

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.dlt.fit_dlt`.
    """
    output.require_possible()
    table, texts = read_control(path), list[str]()

    def one(name: str, rows: Array, weights: Array) -> Record:
        used = rows[~table.check[rows]]
        stated = None if table.sigma is None and sigma is None else weights[~table.check[rows]]
        fitted = fit_dlt(table.ground[used], table.image[used], sigma=stated, distortion=distortion, name=name,
                         iterate=iterate)  # fmt: skip
        texts.append(photo_text(fitted.photo))
        little = fitted.redundancy == 1 and stated is None
        doubts = [fitted.doubt, finding("closerange.little_redundancy") if little else None]
        return _dlt_record(fitted, doubts) | _photo_points(table, rows, fitted.photo, sigma)

    record = {"kind": "dlt", **unit_of_weights(table, sigma), "photos": _each_photo(table, sigma, one)}
    return finished(record, path, table, output, texts)


def _dlt_record(fitted: DltFit, doubts: Sequence[Finding | None]) -> Record:
    r, s = fitted.recovered, fitted.recovered.sigma or dict.fromkeys(RECOVERED)
    return {
        "photo": fitted.photo.name, **_fit_facts(fitted, doubts),
        "parameters": _parameters(fitted.names, fitted.values, fitted.sigma),
        "origin_m": fitted.photo.origin_m.tolist(),
        "interior": {
            "principal": r.principal.tolist(), "sigma_principal": [s["x0"], s["y0"]], "cx": r.cx, "sigma_cx": s["cx"],
            "cy": r.cy, "sigma_cy": s["cy"], "skew_rad": r.skew, "sigma_skew_rad": s["skew"], "y_axis": r.y_axis,
        },
        "exterior": exterior_record(r.rotation, r.centre_m, [s["turn_x"], s["turn_y"], s["turn_z"]],
                              [s["X0"], s["Y0"], s["Z0"]]),
    }  # fmt: skip


def _parameters(names: Sequence[str], values: Array, sigma: Array | None) -> list[Record]:
    """Values with standard deviations."""
    deviations = [None] * len(names) if sigma is None else sigma.tolist()
    return [{"name": n, "value": v, "sigma": s} for n, v, s in zip(names, values.tolist(), deviations, strict=True)]


def run_resect(path: Path, camera: Path, *, sigma: float | None = None, output: Output = NONE) -> Record:
    """Orient each photo of a table of control points by its camera.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.resection.resect`; a photo without a camera.
    """
    output.require_possible()
    table, texts, cameras = read_control(path), list[str](), interiors(read_photos(camera))

    def one(name: str, rows: Array, weights: Array) -> Record:
        interior, used = of_name(cameras, name, camera), rows[~table.check[rows]]
        pose = resect(interior, table.ground[used], table.image[used], sigma=weights[~table.check[rows]], name=name)
        texts.append(photo_text(pose.photo, interior, pose.rotation))
        sd: list[Any] = [None] * 6 if pose.sigma is None else pose.sigma.tolist()
        exterior = exterior_record(pose.rotation, pose.centre_m, sd[:3], sd[3:])
        facts = {"photo": name, **_fit_facts(pose, pose.second_pose()), "exterior": exterior}
        return facts | _photo_points(table, rows, pose.photo, sigma)

    record = {"kind": "resection", **unit_of_weights(table, sigma), "photos": _each_photo(table, sigma, one)}
    return finished(record, path, table, output, texts, [camera])


def run_intersect(path: Path, photos: Path, *, sigma: float | None = None, output: Output = NONE) -> Record:
    """Intersect the points of a table by oriented photos.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.intersection.intersect_photos`; a photo that the file does not contain.
    """
    output.require_possible()
    table, known = read_image_points(path), oriented_photos(read_photos(photos))
    names, ids = list(dict.fromkeys(table.photos)), list(dict.fromkeys(table.ids))
    which, of = [names.index(name) for name in table.photos], [ids.index(name) for name in table.ids]
    weights = weights_of(table, sigma)
    with one_blas_thread():
        result = intersect_photos([of_name(known, n, photos) for n in names], which, of, table.image, sigma=weights,
                                 ids=ids)  # fmt: skip
    rms, sd = [np.linalg.norm(result.residuals[np.array(of) == k]) for k in range(len(ids))], result.sigma_m
    points = [
        {"id": name, **xyz(result.points_m[k]), **xyz(None if sd is None else sd[k], "sigma_"),
         **covariances(result.cofactors[k], result.m0), "rays": of.count(k),
         "misfit": float(rms[k] / np.sqrt(of.count(k)))}
        for k, name in enumerate(ids)
    ]  # fmt: skip
    seen = zip(table.photos, table.ids, table.image.tolist(), result.residuals.tolist(), strict=True)
    given = _given_sigmas(table, sigma) or [{}] * len(table)
    residuals = [{"photo": p, "id": i, "x": x, "y": y, "residual_x": vx, "residual_y": vy, **s}
                 for (p, i, (x, y), (vx, vy)), s in zip(seen, given, strict=True)]  # fmt: skip
    centres = [{"photo": n, "exterior": {"centre_m": known[n].origin_m.tolist()}} for n in names if n in known]
    record = {
        "kind": "intersection", **unit_of_weights(table, sigma), "m0": result.m0, "redundancy": result.redundancy,
        "iterations": result.iterations, "points": points, "residuals": residuals, "stations": centres,
        **as_record(no_redundancy(result.m0)),
    }  # fmt: skip
    return finished(record, path, table, output, beside=[photos])


def run_surface(
    path: Path, kind: Kind, *, axis: str = "y", method: Method = "geometric", sigma_m: float | None = None,
    priors: Priors | None = None, output: Output = NONE,
) -> Record:  # fmt: skip
    """Fit a surface to the points of a table.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.closerange.surface_fit.fit_surface`; priors for points without sigma.
    """
    output.require_possible()
    table = read_ground_points(path)
    require_absolute(
        path, table, sigma_m, [("", f"<prior> {name}", value[1]) for name, value in (priors or {}).items()]
    )
    weights = sigma_m if table.sigma is None else table.sigma
    with one_blas_thread():
        fit = fit_surface(table.ground, kind, axis=axis, sigma_m=weights, method=method, priors=priors)
    ratio = None if weights is None or method != "geometric" else np.linalg.norm(fit.deviations_m / weights, axis=1)
    record: Record = {
        "kind": "surface", **unit_of_weights(table, sigma_m), "surface": fit.surface.as_dict(), "method": method,
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


def weights_of(table: Observed, sigma: float | None) -> Array:
    """Sigmas (n, 2) of the image coordinates: of the table, or one for all; 1 if unknown."""
    return np.full((len(table), 2), 1.0 if sigma is None else sigma) if table.sigma is None else table.sigma


def unit_of_weights(table: Observed, sigma: float | None) -> Record:
    """Weights of given sigmas (m0 is a ratio), or relative weights (m0 is a sigma)."""
    return {"weights": "relative" if table.sigma is None and sigma is None else "absolute"}


def require_absolute(
    path: Path, table: Observed, sigma: float | None, beside: Iterable[tuple[str, str, float]]
) -> None:
    """Refuse sigmas in metres or radians together with relative weights of coordinates.

    Parameters
    ----------
    beside : iterable of (file, place, sigma)
        Other observations with a sigma.

    Raises
    ------
    InputError
        Names the first one.
    """
    if table.sigma is None and sigma is None:
        for file, place, value in beside:
            raise InputError.of("closerange.relative", file=file, place=place, value=value, points=path.name)


def _each_photo(table: Observed, sigma: float | None, one: Callable[[str, Any, Array], Record]) -> list[Record]:
    """Records of the photos in the order of the table; errors name the photo."""
    weights, out = weights_of(table, sigma), []
    with one_blas_thread():
        for name in dict.fromkeys(table.photos):
            rows = np.flatnonzero(np.array(table.photos, dtype=object) == name)
            try:
                out.append(one(name, rows, weights[rows]))
            except InputError as error:
                of = f"photo {name}, " if name else ""
                raise InputError(*(replace(p, place=f"{of}{p.place}".rstrip(", ")) for p in error.problems)) from None
    return out


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


def _fit_facts(fit: DltFit | Resection, doubts: Sequence[Finding | None]) -> Record:
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
    """Given standard deviations of the image coordinates; an empty list for equal weights."""
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
    record: Record, path: Path, table: Observed, output: Output, photos: Sequence[str] = (),
    beside: Iterable[Path | None] = (),
) -> Record:  # fmt: skip
    """Add the provenance to a record, and write folder and report.

    Parameters
    ----------
    record : dict
    path : Path
        File of the points.
    table : Observed
        Its points.
    output : Output
    photos : sequence of str
        Tables of ``photos.toml``.
    beside : iterable of Path or None
        Other inputs.
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
            rows = record.get("points") or [
                {"photo": p["photo"]} | row for p in record["photos"] for row in p["points"]
            ]
            write_rows(folder / "points.csv", rows)
            if photos:
                (folder / "photos.toml").write_text("schema = 1\n\n" + "\n".join(photos), encoding="utf-8")
    if report is not None:
        write_text(report, page)
    return record | {"out": None if out is None else str(out), "page": None if report is None else str(report)}
