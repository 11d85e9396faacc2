"""Commands ``rectify fit``, ``study``, ``check`` and ``ortho``: image to map by points or DEM, map accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from fg_orient.cli.command import Extrapolate, Overwrite, Result, argument, command, command_line, option
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, note, number, say, table, tell, tell_findings
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError
from fg_orient.rectification.options import AccuracyOptions, OrthoOptions, PointOptions, StudyOptions

if TYPE_CHECKING:
    from fg_orient.rectification.grid import Bounds
    from fg_orient.rectification.study import Cell

app = typer.Typer(help="Rectify images: by points or on a DEM; plan the points, check the accuracy of a map.")

POINTS: Final = "CSV: id,line,sample,easting_m,northing_m (or lon_deg,lat_deg); height_m, role, sigmas if wanted."
Points = Annotated[Path, argument("POINTS", POINTS)]
#: Exit code of a map that fails a standard.
FAILED: Final = 4


@app.command("fit")
@command(PointOptions)
def fit(
    points: Points,
    options: Mapping[str, Any],
    out: Annotated[Path | None, option("Folder of the results.", "DIR")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a transformation between image and map to points, with check points and outlier tests."""
    from fg_orient.rectification.job import rectify_fit

    record = rectify_fit(points, PointOptions(**options), out=out, overwrite=overwrite, command=command_line())
    answer(record, _show_fit)


def _show_fit(record: dict[str, Any]) -> None:
    unit, axes = record["unit"], record["axes"]
    m0 = f"{record['m0']:.4g}" + ("" if record["weighted"] else f" {unit}")
    say(f"{record['title']}, {record['direction']}: {record['n_control']} control points, "
        f"{record['n_unknowns']} unknowns, redundancy {record['redundancy']}, m0 {m0}")  # fmt: skip
    rows = [
        (name, n, *(number(v) for v in values.values()))
        for name, n, values in (("control", record["n_control"], record["rmse"]),
                                ("check", record["n_check"], record["check_rmse"])) if n
    ]  # fmt: skip
    table(f"RMSE, {unit}", ("points", "n", *axes, "radial"), rows)
    if record["pair_distances"]:
        found = record["pair_distances"]
        say(f"pairwise distances, image minus map: mean {number(found['mean_m'])}, standard deviation "
            f"{number(found['standard_deviation_m'])} m ({found['pairs']} pairs)")  # fmt: skip
    if record["pruning"]:
        say(f"left out: {', '.join(record['pruning']['dropped']) or 'none'}")
    tell_findings(record)
    if record["out"]:
        say(f"written: {record['out']}")


@app.command("study")
@command(StudyOptions)
def study(
    points: Points,
    counts: Annotated[str, option("Numbers of control points.", "N,N", show_default=False)],
    options: Mapping[str, Any],
    degrees: Annotated[str, option("Degrees of the polynomial.", "Q,Q")] = "1,2,3",
) -> None:
    """Plan a rectification: RMSE at the check points by number of control points and degree."""
    from fg_orient.rectification.job import study_points

    chosen = StudyOptions(**options)
    cells = study_points(points, _numbers("counts", counts), _numbers("degrees", degrees), chosen)
    answer({"cells": [asdict(cell) for cell in cells]}, _show_study, cells)


def _show_study(cells: tuple[Cell, ...]) -> None:
    rows = [(c.n_points, c.degree, number(c.median), number(c.low), number(c.high), c.layouts) for c in cells]
    table("radial RMSE at the check points, m", ("points", "degree", "median", "low", "high", "layouts"), rows)
    for c in cells:
        if c.reason:
            note(f"{c.n_points} points, degree {c.degree}: {c.reason}")


def _numbers(option: str, text: str) -> list[int]:
    """Whole numbers between commas."""
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() for word in words):
        raise InputError.of("options.value", option=option, value=text, expected="whole numbers between commas")
    return [int(word) for word in words]


@app.command("check")
@command(AccuracyOptions)
def check(
    points: Annotated[
        Path,
        argument(
            "POINTS",
            "CSV: id,easting_m,northing_m,true_easting_m,true_northing_m or id,residual_easting_m,"
            "residual_northing_m; or a result folder of rectify fit.",
        ),
    ],
    options: Mapping[str, Any],
) -> None:
    """Assess the accuracy of a map by tested points; exit code 4 if a standard is not met."""
    from fg_orient.rectification.fit import plain_rmse
    from fg_orient.rectification.job import read_differences
    from fg_orient.rectification.standards import check_accuracy

    differences, words = read_differences(points)
    assessed = check_accuracy(differences, **options)
    x, y, radial = plain_rmse(differences)
    record = {
        "points": words, "n": len(differences), "scale": options.get("scale"), "class_m": options.get("class_m"),
        "rmse_m": {"easting": x, "northing": y, "radial": radial}, "standards": [asdict(one) for one in assessed],
    }  # fmt: skip
    answer(record, _show_check)
    if any(one.passed is False for one in assessed):
        raise typer.Exit(FAILED)


def _show_check(record: dict[str, Any]) -> None:
    rmse = record["rmse_m"]
    say(f"{record['n']} {record['points']}: RMSE {number(rmse['easting'])} east, {number(rmse['northing'])} north, "
        f"{number(rmse['radial'])} m radial")  # fmt: skip
    verdicts = {True: "passed", False: "failed", None: "-"}
    rows = [
        (s["standard"], s["measure"], number(s["value_m"]), number(s["limit_m"]), verdicts[s["passed"]],
         "-" if s["largest_scale"] != s["largest_scale"] else f"1:{s['largest_scale']:.0f}")
        for s in record["standards"]
    ]  # fmt: skip
    table("standards, m", ("standard", "measure", "value", "limit", "", "largest scale"), rows, left=2)
    for s in record["standards"]:
        for text in s["remarks"]:
            tell("note", f"{s['standard']}: {text}")
    for s in record["standards"] if session().quiet else ():  # the exit code does not name the standard
        if s["passed"] is False:
            note(f"{s['standard']}: failed, {s['measure']} {number(s['value_m'])} m, limit {number(s['limit_m'])} m")


@app.command("ortho")
@command(OrthoOptions, only=("resampling", "allow_holes", "cog"))
def ortho(
    image: Annotated[Path, argument("IMAGE", "Raster in sensor geometry.")],
    model: Annotated[Path, argument("MODEL", "Metadata file (DIMAP, RPC), or a result folder of rectify fit.")],
    out: Annotated[Path, option("GeoTIFF to write.", "TIF", show_default=False)],
    options: Mapping[str, Any],
    dem: Annotated[Path | None, option("DEM of ellipsoidal heights, m.")] = None,
    height: Annotated[float | None, option("One height instead of a DEM.", "M")] = None,
    result: Result = None,
    image_id: Annotated[str, option("Image in it; usual: by file name.", "ID")] = "",
    crs: Annotated[str, option("CRS of the map; default: from DEM or fit.", "EPSG")] = "",
    resolution: Annotated[float | None, option("Size of a map pixel; default: about an image pixel.", "SIZE")] = None,
    bounds: Annotated[str, option("Left,bottom,right,top; default: the whole common area.", "L,B,R,T")] = "",
    extrapolate_attitude: Extrapolate = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Rectify an image on a DEM (or a plane) to a GeoTIFF: by its sensor, adjusted or not, or by points."""
    from fg_orient.rectification.ortho import rectify_image

    limits = _bounds(bounds) if bounds else None
    if dem is not None and height is not None:
        raise InputError.of("options.two_ways", option="dem, height")
    with progress_bar("rectifying") as progress:
        record = rectify_image(
            image, model, out, dem=dem, height_m=height, result=result, image_id=image_id, crs=crs,
            resolution=resolution, bounds=limits, options=OrthoOptions(**options), overwrite=overwrite,
            progress=progress, extrapolate_attitude_s=extrapolate_attitude,
        )  # fmt: skip
    answer(record, _show_ortho)


def _show_ortho(record: dict[str, Any]) -> None:
    tell_findings(record)
    say(f"{record['rows']} x {record['columns']} pixels of {record['resolution']:g}, "
        f"{100 * record['filled']:.1f} % filled, {record['resampling']}")  # fmt: skip
    say(f"model evaluated every {record['knots']} pixels, interpolation error at most {record['error_px']:.1g} px")
    say(f"written: {record['out']}")


def _bounds(text: str) -> Bounds:
    try:
        left, bottom, right, top = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError.of("options.value", option="bounds", value=text, expected="four numbers") from None
    return left, bottom, right, top
