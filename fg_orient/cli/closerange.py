"""Commands of close-range photogrammetry: ``closerange dlt``, ``resect``, ``bundle`` and others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fg_orient.cli.command import ImageSize, Overwrite, Several, argument, command, command_line, image_sizes, option
from fg_orient.cli.output import (
    answer,
    answer_with_status,
    number,
    say,
    show_components,
    table,
    tell,
    tell_findings,
)
from fg_orient.cli.progress import progress
from fg_orient.closerange.options import COMMON, DEFAULTS, BundleOptions, DltOptions, ImageOptions, SurfaceOptions
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError, finding
from fg_orient.model.options import Options

app = typer.Typer(help="Close range: DLT, resection, intersection, bundle, surfaces of the second degree.")

Control = Annotated[
    Path, argument("POINTS", "CSV: id,x,y,x_m,y_m,z_m; optional: photo, role (control, check), sigma_x, sigma_y.")
]
Measured = Annotated[Path, argument("POINTS", "CSV: id,photo,x,y; optional: sigma_x, sigma_y.")]
Photos = Annotated[Path, argument("PHOTOS", 'TOML file with one table "photos" per photo.')]
Out = Annotated[Path | None, option("Folder of the results, with report.html.", "DIR")]
Report = Annotated[Path | None, option("Write the report only, as one self-contained page.", "FILE.html")]


def _output(**given: Any) -> Any:
    """Combine the output options of a command."""
    from fg_orient.closerange.job import Output

    return Output(**given, command=command_line())


#: These output options replace the parameter ``output`` of a command.
OUTPUT = {"output": Several({"out": (Out, None), "report": (Report, None), "overwrite": (Overwrite, False)}, _output)}


@app.command("dlt")
@command(DltOptions, several=OUTPUT)
def dlt(points: Control, options: Mapping[str, Any], output: Any) -> None:
    """Orient photos of unknown cameras by a direct linear transformation."""
    from fg_orient.closerange.job import run_dlt

    record = run_dlt(points, DltOptions(**options), output=output)
    answer_with_status(record, _show, record, _show_photos)


@app.command("resect")
@command(ImageOptions, several=OUTPUT)
def resect(points: Control, camera: Photos, options: Mapping[str, Any], output: Any) -> None:
    """Orient photos of known cameras by control points."""
    from fg_orient.closerange.job import run_resect

    record = run_resect(points, camera, ImageOptions(**options), output=output)
    answer_with_status(record, _show, record, _show_photos)


@app.command("intersect")
@command(ImageOptions, several=OUTPUT)
def intersect(points: Measured, photos: Photos, options: Mapping[str, Any], output: Any) -> None:
    """Intersect points of oriented photos."""
    from fg_orient.closerange.job import run_intersect

    record = run_intersect(points, photos, ImageOptions(**options), output=output)
    answer_with_status(record, _show, record, _show_points)


@app.command("relative")
@command(ImageOptions)
def relative(
    points: Measured,
    photos: Photos,
    options: Mapping[str, Any],
    out: Annotated[Path | None, option("Points of the model.", "CSV")] = None,
    photos_out: Annotated[Path | None, option("Both photos, oriented in the model.", "TOML")] = None,
    report: Report = None,
    overwrite: Overwrite = False,
) -> None:
    """Orient two photos relative to each other without control points."""
    from fg_orient.closerange.orient_job import run_relative

    output = _output(report=report, overwrite=overwrite)
    record = run_relative(points, photos, ImageOptions(**options), out=out, photos=photos_out, output=output)
    answer_with_status(record, _show_orientation, record, "base", "")


@app.command("absolute")
@command(SurfaceOptions, only=("sigma_m",))
def absolute(
    model: Annotated[Path, argument("MODEL", "CSV: id,x,y,z, in any unit, as relative writes it.")],
    control: Annotated[Path, argument("CONTROL", "CSV: id,x_m,y_m,z_m; optional: sigma_x_m,sigma_y_m,sigma_z_m.")],
    options: Mapping[str, Any],
    out: Annotated[Path | None, option("All points of the model on the ground.", "CSV")] = None,
    report: Report = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a model to three control points or more: rotation, scale and shift."""
    from fg_orient.closerange.orient_job import run_absolute

    output = _output(report=report, overwrite=overwrite)
    record = run_absolute(model, control, **options, out=out, output=output)
    answer_with_status(record, _show_orientation, record, "shift", " m")


def _show_orientation(record: dict[str, Any], name: str, unit: str) -> None:
    outer, used = record["exterior"], record.get("control", record["points"])
    say(f"{len(used)} points, redundancy {record['redundancy']}, m0 {_m0(record)}, condition {record['condition']:.3g}")
    rows = [("scale", f"{record['scale']:.8g}", _short(record["sigma_scale"]))] if "scale" in record else []
    rows += [(f"{name} {axis}{unit}", f"{value:.6f}", _short(sigma)) for axis, value, sigma in
             zip("XYZ", outer["centre_m"], outer["sigma_centre_m"], strict=True)]  # fmt: skip
    rows += [(f"{angle}, deg", f"{outer[f'{angle}_deg']:.6f}", "") for angle in ("omega", "phi", "kappa")]
    rows += [(f"rotation about {axis}, deg", "", _short(sigma and math.degrees(sigma))) for axis, sigma in
             zip("XYZ", outer["sigma_turns_rad"], strict=True)]  # fmt: skip
    table("", ("", "value", "sigma"), rows)
    if "control" in record:
        table("residuals, m", ("id", "X", "Y", "Z"),
              [(c["id"], *(f"{c[f'residual_{axis}_m']:.4f}" for axis in "xyz")) for c in used])  # fmt: skip
    if record["left_out"]:
        tell("note", f"not in both: {', '.join(record['left_out'])}")
    _relative_note(record)
    for written in filter(None, (record["out"], record["photos_out"])):
        say(f"written: {written}")
    if record["page"]:
        say(f"report: {record['page']}")


@app.command("bundle")
@command(Options, BundleOptions, only=(*declared(BundleOptions), *COMMON), defaults=DEFAULTS, several=OUTPUT)
def bundle(
    points: Measured,
    photos: Photos,
    options: Mapping[str, Any],
    output: Any,
    control: Annotated[Path | None, option("id,x_m,y_m,z_m; optional: sigma_x_m,sigma_y_m,sigma_z_m.", "CSV")] = None,
    check: Annotated[
        Path | None, option("id,x_m,y_m,z_m of check points, which are not used in the adjustment.", "CSV")
    ] = None,
    start: Annotated[
        Path | None, option("id,x_m,y_m,z_m: approximate values of new points; others are intersected.", "CSV")
    ] = None,
    constraints: Annotated[
        Path | None, option('TOML file with one table "constraints" per constraint.', "TOML")
    ] = None,
    stations: Annotated[
        Path | None,
        option(
            "Observed projection centres: photo,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m; optional: attitudes "
            "(docs/closerange.md).",
            "CSV",
        ),
    ] = None,
) -> None:
    """Adjust photos and points together: self-calibration, control points, constraints, search for gross errors."""
    from fg_orient.closerange.bundle_job import run_bundle

    common = {name: value for name, value in options.items() if name in COMMON}
    own = BundleOptions(**{name: value for name, value in options.items() if name not in COMMON})
    with progress() as watch:
        record = run_bundle(
            points, photos, own, control=control, start=start, constraints=constraints,
            stations=stations, check=check, output=output, callback=watch.iteration, stage=watch.stage, **common,
        )  # fmt: skip
    answer_with_status(record, _show, record, _show_bundle)


@app.command("import")
@command()
def import_(
    export: Annotated[list[Path], argument("EXPORT", "File or folder of the project, or all files of its format.")],
    out: Annotated[Path, option("Folder of the tables.", "DIR")],
    source: Annotated[
        str, option("Format of EXPORT, with cameras and poses.", "FORMAT", flag="--from")
    ] = "photomodeler",
    control: Annotated[Path | None, option("Control points: id, name, X, Y, Z; optional: sigmas.", "FILE")] = None,
    stations: Annotated[Path | None, option("Observed projection centres: photo, X, Y, Z, sigma.", "FILE")] = None,
    sigma_image: Annotated[float | None, option("Sigma of image coordinates, pixels.", "PX")] = None,
    image_size: ImageSize = None,
    overwrite: Overwrite = False,
) -> None:
    """Write the tables of the bundle from a project of another program (PhotoModeler)."""
    from fg_orient.closerange.fitting import require_sigmas
    from fg_orient.closerange.importing import run_import

    if sigma_image is not None:
        require_sigmas(sigma_image, "<sigma_image>")
    record = run_import(*export, source=source, control=control, stations=stations, sigma_image_px=sigma_image,
                        image_sizes=image_sizes(image_size), out=out, overwrite=overwrite)  # fmt: skip
    answer(record, _show_imported)


def _show_imported(record: dict[str, Any]) -> None:
    say(f"{record['photos']} photos, {record['points']} points, {record['image_points']} image points "
        f"({record['unit']}), {record['control']} control points, {record['stations']} stations")  # fmt: skip
    if any(record["shift_m"]):
        moved = ", ".join(f"{v:.4f}" for v in record["shift_m"])
        say(f"shifted by {moved} m into the system of the control points")
    tell_findings(record)
    say(f"written: {record['out']}")


@app.command("compare-report")
@command()
def compare_report(
    result: Annotated[Path, argument("RESULT", "Folder of a result of close range.")],
    values: Annotated[Path, argument("VALUES", "CSV: name,value of a published report; optional: sigma, digits.")],
    report: Report = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare the values of a published report with a result, digit by digit."""
    from fg_orient.closerange.compare_report import run_comparison
    from fg_orient.closerange.job import Output

    output = Output(report=report, overwrite=overwrite, command=command_line())
    answer(run_comparison(result, values, output), _show_comparison)


def _show_comparison(record: dict[str, Any]) -> None:
    from fg_orient.closerange.compare_report import summary

    rows = [(r["name"], r["published"], "-" if r["value"] is None else f"{r['value']:.8g}", r["verdict"],
             r["sigma_verdict"] or "") for r in record["values"]]  # fmt: skip
    table("", ("", "published", "result", "value", "sigma"), rows)
    words = summary(record)
    for text in (words["title"], *words["text"]):
        say(text)
    if record["page"]:
        say(f"report: {record['page']}")


@app.command("surface")
@command(SurfaceOptions, several=OUTPUT)
def surface(
    points: Annotated[Path, argument("POINTS", "CSV: id,x_m,y_m,z_m; optional: sigma_x_m,sigma_y_m,sigma_z_m.")],
    kind: Annotated[Literal["sphere", "spheroid", "ellipsoid", "quadric"], option("Kind of surface.")],
    options: Mapping[str, Any],
    output: Any,
    prior: Annotated[list[str] | None, option("Observed parameter, m; repeatable.", "NAME=VALUE:SIGMA")] = None,
) -> None:
    """Fit a sphere, spheroid, ellipsoid or quadric to points."""
    from fg_orient.closerange.job import run_surface

    record = run_surface(points, kind, SurfaceOptions(**options), priors=_priors(prior or []), output=output)
    answer_with_status(record, _show, record, _show_surface)


def _priors(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Read priors from texts NAME=VALUE:SIGMA."""
    out = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        value, colon, sigma = rest.partition(":")
        try:
            if not (equals and colon):
                raise ValueError
            out[name.strip()] = float(value), float(sigma)
        except ValueError:
            raise InputError.of("closerange.prior_text", option="prior", value=text) from None
    return out


def _show(record: dict[str, Any], show: Callable[[dict[str, Any]], None]) -> None:
    """Print a result by ``show``, then its files."""
    show(record)
    _relative_note(record)
    if record["out"]:
        say(f"written: {record['out']}")
    page = record["page"] or (record["out"] and str(Path(record["out"]) / "report.html"))
    if page:
        say(f"report: {page}")


def _relative_note(record: dict[str, Any]) -> None:
    if record["weights"] == "relative":
        tell("note", finding("closerange.relative_weights (note): no standard deviations were given: weights are "
                             "relative, and m0 is the sigma of an observation"))  # fmt: skip


def _m0(record: dict[str, Any]) -> str:
    return "-" if record["m0"] is None else f"{record['m0']:.4g}"


def _show_photos(record: dict[str, Any]) -> None:
    for photo in record["photos"]:
        say(f"photo {photo['photo'] or '-'}: {len(photo['points'])} points, redundancy {photo['redundancy']}, "
            f"m0 {_m0(photo)}, condition {photo['condition']:.3g}")  # fmt: skip
        inner, outer = photo.get("interior"), photo["exterior"]
        rows = _numbers(photo.get("parameters", []))
        if inner:
            rows += [(f"principal {axis}", f"{v:.4f}", _short(s)) for axis, v, s in
                     zip("xy", inner["principal"], inner["sigma_principal"], strict=True)]  # fmt: skip
            rows += [(name, f"{inner[name]:.4f}", _short(inner[f"sigma_{name}"])) for name in ("cx", "cy")]
        rows += _centre(outer)
        rows += [(f"{name}, deg", f"{outer[f'{name}_deg']:.5f}", "") for name in ("omega", "phi", "kappa")]
        table("", ("", "value", "sigma"), rows)


def _numbers(parameters: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Return name, value and standard deviation of parameters as rows."""
    return [(p["name"], f"{p['value']:.8g}", _short(p["sigma"])) for p in parameters]


def _centre(exterior: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return name, value and standard deviation of a projection centre's coordinates as rows."""
    numbers = zip("XYZ", exterior["centre_m"], exterior["sigma_centre_m"], strict=True)
    return [(f"centre {axis}, m", f"{v:.4f}", _short(s)) for axis, v, s in numbers]


def _show_bundle(record: dict[str, Any]) -> None:
    say(f"{len(record['photos'])} photos, {len(record['points'])} points, {record['unknowns']} unknowns, redundancy "
        f"{record['redundancy']}, m0 {_m0(record)}")  # fmt: skip
    parts = [(p["photo"], p["parameters"]) for p in record["photos"]]
    parts += [(c["camera"], c["parameters"]) for c in record["cameras"]]
    parts += [(f["figure"], f["numbers"]) for f in record["figures"]]
    rows = [(name, *row) for name, numbers in parts for row in _numbers(numbers)]
    rows += [(p["photo"], *row) for p in record["photos"] for row in _centre(p["exterior"])]
    table("", ("of", "", "value", "sigma"), rows)
    show_components(record)
    _point_table(record)
    if record["check"] is not None:
        along = ", ".join(f"{v:.3f}" for v in record["check"]["rms_mm"])
        say(f"{record['check']['n']} check points: rms along X, Y, Z {along} mm")


def _show_points(record: dict[str, Any]) -> None:
    say(f"{len(record['points'])} points, redundancy {record['redundancy']}, m0 {_m0(record)}")
    _point_table(record)


def _point_table(record: dict[str, Any]) -> None:
    names = ("x_m", "y_m", "z_m")
    rows = [(p["id"], *(number(p[n], 4) for n in names), *(_short(p[f"sigma_{n}"]) for n in names), p["rays"])
            for p in record["points"]]  # fmt: skip
    table("", ("id", "X", "Y", "Z", "sX", "sY", "sZ", "rays"), rows)


def _show_surface(record: dict[str, Any]) -> None:
    say(f"{record['surface']['shape']}: {len(record['points'])} points, redundancy {record['redundancy']}, "
        f"m0 {_m0(record)}, condition {record['condition']:.3g}")  # fmt: skip
    table(
        "", ("", "value", "sigma"), [(p["name"], f"{p['value']:.6f}", _short(p["sigma"])) for p in record["parameters"]]
    )
    worst = max(record["points"], key=lambda p: abs(p["distance_m"]))
    along = ", ".join(f"{1e3 * v:.2f}" for v in record["rms_deviation_m"])
    say(f"normal distances: rms {1e3 * record['rms_m']:.2f} mm, largest {1e3 * worst['distance_m']:.2f} mm at "
        f"{worst['id']}; rms along X, Y, Z {along} mm")  # fmt: skip
    tell_findings(record)


def _short(value: Any) -> str:
    return "-" if value is None else f"{value:.2g}"
