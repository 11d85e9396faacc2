"""Commands ``rpc check``, ``rpc convert``, ``rpc refine`` and ``rpc fit`` for rational function models (RPC)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.command import Extrapolate, Light, Overwrite, Result, Sensors, argument, command, open_dem, option
from fg_orient.cli.output import answer, end_if, is_doubtful, number, say, table, tell, tell_findings, verdict
from fg_orient.cli.progress import progress_bar
from fg_orient.model.declaration import declared
from fg_orient.model.errors import Finding, InputError, finding, judged
from fg_orient.rpc.options import FileOptions, FitOptions, RefineOptions

if TYPE_CHECKING:
    from fg_orient.rpc.files import RpcFile

app = typer.Typer(
    help="Check, convert, refine and fit rational function models (RPC). Pixels: (0, 0) = centre of the first one."
)

File = Annotated[Path, argument("FILE", "RPC file of any known format.")]
Heights = Annotated[
    tuple[float, float] | None, option("Range of heights, m above the ellipsoid.", "LOW HIGH", flag="--heights")
]
To = Annotated[
    str | None,
    option(
        "rpc-txt, rpb, dimap, ossim-geom, geotiff-tags or vrt; default: by the name of --out.", "FORMAT", flag="--to"
    ),
]
FIGURES = ("mean", "rms", "max")


def _opened(file: Path, options: Mapping[str, Any]) -> RpcFile:
    """Read an RPC file with the given ``FileOptions``."""
    from fg_orient.rpc.files import open_rpc

    return open_rpc(file, **{name: options[name] for name in declared(FileOptions) if name in options})


@app.command("check")
@command(FileOptions)
def check(
    file: File,
    options: Mapping[str, Any],
    heights: Heights = None,
    dem: Annotated[Path | None, option("Use the heights of this DEM (ellipsoidal, a raster that GDAL reads).")] = None,
    points: Annotated[
        Path | None, option("CSV of points: id,line,sample,lon_deg,lat_deg,height_m (pixels, degrees, m).")
    ] = None,
    against: Annotated[Path | None, option("RPC file or metadata (DIMAP) to compare with.", "OTHER")] = None,
) -> None:
    """Check an RPC: its file, denominators and two directions; compare it with points and another model.

    Residuals are projected minus observed, pixels. The exit code is 4 if the RPC is not trustworthy.
    """
    if heights is not None and dem is not None:
        raise InputError.of("options.two_ways", option="heights, dem")
    from fg_orient.rpc.check import check_rpc, heights_below
    from fg_orient.rpc.points import read_measured

    model, measured = _opened(file, options), None if points is None else read_measured(points)
    if dem is not None:
        heights = heights_below(model, open_dem(dem))
    _end(check_rpc(model, heights_m=heights, points=measured, against=against), _show_check)


@app.command("convert")
@command(FileOptions)
def convert(
    file: Annotated[
        Path, argument("FILE|RESULT", "RPC file of any known format, or result folder of adjust with corrected RPC.")
    ],
    out: Annotated[
        Path,
        option("File to write; with --for or RESULT: a folder; with geotiff-tags: an image.", show_default=False),
    ],
    options: Mapping[str, Any],
    to: To = None,
    program: Annotated[
        str, option("Write the files of this program: gdal, qgis, otb, asp, cars or s2p.", "PROGRAM", flag="--for")
    ] = "",
    image: Annotated[
        list[str] | None,
        option(
            "Raster of the image, for the names of the files, vrt and copies with tags; may be repeated.", "[ID=]FILE"
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write an RPC in another format or for another program, read it back and compare.

    Tags go into an existing GeoTIFF, so they need --overwrite, or into a copy of --image;
    pixels are not changed.
    """
    from fg_orient.rpc.files import describe, disagreement, target_of, write_as
    from fg_orient.rpc.handover import hand_over, model_of, models_of

    if program and to is not None:
        raise InputError.of("options.two_ways", option="for, to")
    source = None if file.is_dir() else _opened(file, options)
    if source is not None and not program:
        target, raster = target_of(to, out), Path(image[-1].rpartition("=")[2]) if image else None
        written = write_as(source.model, out, target, overwrite=overwrite, image=raster)
        status = judged((*source.model.notes, *disagreement([written])))
        _end({**status, "source": describe(source), "out": written}, _show_convert)
        return
    models, notes = models_of(file) if source is None else (model_of(file, source.model), source.model.notes)
    if not program and to is None:
        raise InputError.of("handover.no_target", file=file)
    target = "" if program else target_of(to, out)
    images = _images(image or [], list(models))
    files, remarks = hand_over(models, out, program, target=target, images=images, overwrite=overwrite)
    status = judged((*notes, *remarks, *disagreement(files)))
    record = {**status, "source": str(file), "program": program, "files": files}
    _end(record, _show_handover)


def _images(words: list[str], names: list[str]) -> dict[str, Path]:
    """Read texts ``ID=FILE`` and return rasters by image id; for a single image, ``FILE`` is sufficient."""
    pairs = [word.partition("=") for word in words]
    if len(names) == 1:
        pairs = [(name, "=", path) if path else (names[0], "=", name) for name, _, path in pairs]
    for name, _, path in pairs:
        if not path:
            raise InputError.of("handover.image_words", option="image", value=name)
    return {name: Path(path) for name, _, path in pairs}


@app.command("refine")
@command(RefineOptions, FileOptions)
def refine(
    file: File,
    points: Annotated[
        Path,
        option(
            "CSV: id,line,sample,lon_deg,lat_deg,height_m; optional: role (control, check), "
            "sigma_line_px,sigma_sample_px.",
            show_default=False,
        ),
    ],
    options: Mapping[str, Any],
    out: Annotated[Path | None, option("Write the corrected RPC.")] = None,
    to: To = None,
    overwrite: Overwrite = False,
) -> None:
    """Remove the bias of an RPC with control points; test check points and name gross errors.

    For a shift, the corrected RPC is exact. Otherwise it is fitted again, and its error is stated. The
    exit code is 4 if the points do not fit the model.
    """
    from fg_orient.formats.atomic import require_free_files
    from fg_orient.rpc.files import corrected, describe, target_of, write_as
    from fg_orient.rpc.points import read_measured
    from fg_orient.rpc.refine import refine as refined

    target = None if out is None else target_of(to, out)
    require_free_files(out, overwrite=overwrite)
    source = _opened(file, options)
    chosen = RefineOptions(**{name: options[name] for name in declared(RefineOptions) if name in options})
    record = refined(source.model, read_measured(points), chosen.compensation, extrapolate=chosen.extrapolate)
    record |= {"source": describe(source), "out": None}
    if out is not None and target is not None:
        new = corrected(source.model, record["values_px"])
        record["out"] = write_as(new.model, out, target, overwrite=overwrite)
        record["out"] |= {"exact": new.exact, "errors": new.errors}
    _end(record, _show_refine)


@app.command("fit")
@command(FitOptions)
def fit(
    source: Annotated[
        Path,
        argument(
            "POINTS.csv|IMAGE",
            "CSV of control points (columns as in rpc refine), or metadata of a rigorous model (DIMAP).",
        ),
    ],
    options: Mapping[str, Any],
    heights: Heights = None,
    grid: Annotated[
        tuple[int, int, int] | None,
        option("Lines, samples and heights of the grid for IMAGE; default 20 20 5.", "L S H"),
    ] = None,
    extrapolate_attitude: Extrapolate = 0.0,
    light: Light = "",
    result: Result = None,
    out: Annotated[Path | None, option("Write the RPC.")] = None,
    to: To = None,
    force: Annotated[bool, option("Write an RPC that is not trustworthy.", flag="--force")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit an RPC to control points, or to a rigorous model over --heights.

    Errors are stated in pixels of the image at points that were not used in the fit. The
    exit code is 4 if a denominator is near zero or the points do not determine the
    coefficients. In these cases the RPC is written only with --force.
    """
    from fg_orient.formats.atomic import require_free_files
    from fg_orient.formats.table_write import is_binary
    from fg_orient.rpc.files import target_of

    if out is not None:
        target_of(to, out)
    require_free_files(out, overwrite=overwrite)
    of_form = {name: value for name, value in options.items() if name in ("degree", "denominators", "seed")}
    is_points = source.suffix.lower() == ".csv" or is_binary(source)
    chosen = FitOptions(**(options if is_points else of_form))
    if is_points:
        _refuse(source, {"heights": heights, "grid": grid, "result": result}, "control points")
        if out is not None and not chosen.normalise:
            raise InputError.of("rpc.unscaled", file=out, option="no_normalise")
        from fg_orient.rpc.fitting import fit_points
        from fg_orient.rpc.points import read_measured

        with progress_bar("fitting") as progress:
            model, record = fit_points(read_measured(source), chosen, progress)
    else:
        names = {"normalise": "no_normalise"}
        foreign = {names.get(name, name): value for name, value in options.items() if name not in of_form}
        _refuse(source, foreign, "a sensor")
        sensor = Sensors("auto", extrapolate_attitude, light, result).read(source)
        if heights is None:
            raise InputError.of("rpc.no_heights", file=source, option="heights")
        from fg_orient.rpc.fitting import fit_image
        from fg_orient.rpc.virtual_grid import SHAPE

        with progress_bar("fitting"):
            model, record = fit_image(sensor, heights, chosen, grid or SHAPE)
    record |= {"file": str(source), "out": None}
    refused = None
    if out is not None and is_doubtful(record) and not force:
        refused = finding("rpc.not_written (warning): the RPC is not trustworthy and is not written -> correct the "
                          "causes above, or write it with <force>", file=out)  # fmt: skip
    elif out is not None:
        from fg_orient.rpc.files import write_as

        record["out"] = write_as(model, out, target_of(to, out), overwrite=overwrite)
    _end(record, _show_fit, refused)


def _refuse(source: Path, options: Mapping[str, object], what: str) -> None:
    """Refuse options that have no meaning for this source."""
    for name, value in options.items():
        if value is not None:
            raise InputError.of("rpc.foreign_option", file=source, option=name, source=what)


# --- results -------------------------------------------------------------------------------------


def _end(record: dict[str, Any], show: Callable[[dict[str, Any]], None], last: Finding | None = None) -> None:
    """Print a record, then a last warning, and end the command with its exit code."""
    answer(record, _show, record, show)
    if last is not None:
        tell("warning", last)
    end_if(is_doubtful(record))


def _show(record: dict[str, Any], show: Callable[[dict[str, Any]], None]) -> None:
    tell_findings(record)
    show(record)
    verdict(record["status"].replace("_", " "), good=not is_doubtful(record))


def _statistics(title: str, rows: list[tuple[str, Mapping[str, Any] | None]]) -> None:
    """Print statistics of residuals, px."""
    cells = [
        (name, *(f"{number(s.get(f'{figure}_line_px'))}, {number(s.get(f'{figure}_sample_px'))}" for figure in FIGURES))
        for name, s in rows
        if s is not None
    ]
    if cells:
        table(f"{title}, px (line, sample)", ("", "mean", "RMS", "largest"), cells)


def _counted(name: str, found: Mapping[str, Any] | None) -> str:
    return name if found is None else f"{name} ({found['n']})"


def _show_source(source: Mapping[str, Any]) -> None:
    v = source["validity"]
    ranges = ", ".join(f"{name} {v[key][0]:.7g} .. {v[key][1]:.7g}" for name, key in (
        ("lines", "line_px"), ("samples", "sample_px"), ("longitude", "lon_deg"), ("latitude", "lat_deg"),
        ("height", "height_m")))  # fmt: skip
    say(f"{source['file']}: {source['format']}, its first pixel is ({source['first_pixel']:g}, "
        f"{source['first_pixel']:g})")  # fmt: skip
    say(f"valid: {ranges}{'' if source['validity_stated'] else ' (offset and scale)'}")


def _show_check(record: dict[str, Any]) -> None:
    for text in record["notes"]:
        tell("note", text)
    _show_source(record)
    below = record["denominators"]
    say(f"heights {record['heights_m'][0]:g} .. {record['heights_m'][1]:g} m: smallest denominators "
        f"{number(below['least_line'], 5)} (line), {number(below['least_sample'], 5)} (sample)")  # fmt: skip
    used = ", ".join(f"{name} {value:.3f}" for name, value in record["extrapolation"].items())
    say(f"used part of the model's range: {used}")
    points, other = record["points"], record["against"]
    rows = [("image to ground to image", record["image_to_ground"])]
    if points is not None:
        rows.append((_counted("points", points["statistics"]), points["statistics"]))
    if other is not None:
        rows.append((f"{Path(other['file']).name}", other["statistics"]))
    _statistics("residuals", rows)


def _show_out(out: Mapping[str, Any] | None) -> None:
    if out is None:
        return
    say(f"written: {out['file']} ({out['format']}), its first pixel is ({out['first_pixel']:g}, "
        f"{out['first_pixel']:g}); the written file, read again, agrees within {out['round_trip_line_px']:.2g}, "
        f"{out['round_trip_sample_px']:.2g} px (line, sample)")  # fmt: skip
    if out["not_kept"]:
        say(f"the format cannot contain: {', '.join(out['not_kept'])}")
    if "exact" in out:
        e = out["errors"]
        how = "exact" if out["exact"] else "refitted"
        say(f"the written model is {how}: largest error {e['max_line_px']:.2g}, {e['max_sample_px']:.2g} px at "
            f"{e['n']} independent points")  # fmt: skip


def _show_convert(record: dict[str, Any]) -> None:
    _show_source(record["source"])
    _show_out(record["out"])


def _show_handover(record: dict[str, Any]) -> None:
    for file in record["files"]:
        _show_out(file)
    for use in dict.fromkeys(file["use"] for file in record["files"] if file["use"]):
        say(f"{record['program']}: {use}")


def _show_refine(record: dict[str, Any]) -> None:
    _show_source(record["source"])
    rows = [(term["name"], number(term["px"], 4), number(term["sd_px"], 4)) for term in record["terms"]]
    table(f"compensation {record['compensation']}, px", ("term", "value", "standard deviation"), rows)
    say(f"sigma0 {number(record['sigma0'])}, redundancy {record['redundancy']}, left out as gross errors: "
        f"{', '.join(o['id'] for o in record['outliers']) or 'none'}")  # fmt: skip
    stages = [
        (_counted(f"{role} {stage}", record[role][stage]), record[role][stage])
        for role in ("control", "check") if record[role] is not None for stage in ("before", "after")
    ]  # fmt: skip
    _statistics("residuals", [*stages, ("left out, one by one", record["leave_one_out"])])
    _show_out(record["out"])


def _show_fit(record: dict[str, Any]) -> None:
    say(f"degree {record['degree']}, denominators {record['denominators']}, least "
        f"{number(record['least_denominator_line'], 5)} (line), {number(record['least_denominator_sample'], 5)} "
        "(sample)")  # fmt: skip
    if record["source"] == "points":
        choice = "".join(f", {name} {value}" for name, value in record["choice"].items())
        say(f"{record['method']}{choice}: {record['unknowns']} coefficients, rank {record['rank']}, condition "
            f"{record['condition']:.2g}, redundancy {record['redundancy']:.1f}")  # fmt: skip
        say(f"m0 of the linear form {number(record['m0_linear_px'])} px, of the image {number(record['m0_px'])} px")
        left_out = record["cross_validation"]
        rows = [(_counted("control", record["control"]), record["control"]),
                (_counted("check", record["check"]), record["check"])]  # fmt: skip
        if left_out is not None:
            rows.append((f"left out, {left_out['folds']} folds", left_out["statistics"]))
        _statistics("true image residuals", rows)
    else:
        _statistics("errors", [("at the grid", record["fit"]), ("at independent points", record["check"])])
        back = record["image_to_ground"]
        say(f"image to ground at {back['n']} independent points: RMS {back['rms_east_m']:.3f}, "
            f"{back['rms_north_m']:.3f} m, largest {back['max_east_m']:.3f}, {back['max_north_m']:.3f} m (East, North)"
            )  # fmt: skip
    _show_out(record["out"])
