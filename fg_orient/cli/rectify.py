"""Commands ``rectify fit``, ``study``, ``check`` and ``ortho``: image to map by points or DEM, map accuracy."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from fg_orient.cli.command import command
from fg_orient.cli.common import Extrapolate, Overwrite, Result, command_line
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, note, number, say, table, tell, tell_findings
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.rectification.grid import Bounds
    from fg_orient.rectification.study import Cell

app = typer.Typer(help="Rectify images: by points or on a DEM; plan the points, check the accuracy of a map.")

Points = Annotated[
    Path,
    typer.Argument(
        metavar="POINTS", show_default=False,
        help="CSV: id,line,sample,easting_m,northing_m (or lon_deg,lat_deg); height_m, role, sigmas if wanted.",
    ),
]  # fmt: skip
Crs = Annotated[str, typer.Option("--crs", metavar="EPSG", help="Projected coordinate system of the map, EPSG:n.")]
#: Exit code of a map that fails a standard.
FAILED: Final = 4


@app.command("fit")
@command()
def fit(
    points: Points,
    model: Annotated[
        str | None,
        typer.Option(help="polynomial, affine, helmert, projective; affine-3d, parallel, dlt (ground to image)."),
    ] = None,
    degree: Annotated[int | None, typer.Option(metavar="Q", help="Degree of the polynomial, 1 to 5.")] = None,
    direction: Annotated[
        str | None, typer.Option(help="image-to-map (usual for plane models) or map-to-image.")
    ] = None,
    crs: Crs = "",
    pixel_size: Annotated[
        float | None, typer.Option("--pixel-size", metavar="M", help="Compare pairwise distances, image with map.")
    ] = None,
    prune_to: Annotated[
        float | None, typer.Option("--prune-to", metavar="RMSE", help="Leave out the worst point until this is met.")
    ] = None,
    prune_by: Annotated[
        Literal["residual", "test"], typer.Option("--prune-by", help="Worst by residual, or by the F test.")
    ] = "residual",
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Fit a transformation between image and map to points, with check points and outlier tests."""
    from fg_orient.rectification.job import rectify_fit
    from fg_orient.rectification.transformation import find_model

    chosen = find_model(model or ("affine" if degree is None else "polynomial"), degree)
    record = rectify_fit(
        points, chosen, direction=direction, crs=crs, pixel_size_m=pixel_size, prune_to=prune_to,
        prune_by=prune_by, out=out, overwrite=overwrite, command=command_line(),
    )  # fmt: skip
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
@command()
def study(
    points: Points,
    counts: Annotated[str, typer.Option(metavar="N,N", help="Numbers of control points.", show_default=False)],
    degrees: Annotated[str, typer.Option(metavar="Q,Q", help="Degrees of the polynomial.")] = "1,2,3",
    layouts: Annotated[int, typer.Option(metavar="N", help="Random choices of the points.")] = 30,
    seed: Annotated[int, typer.Option(help="Seed of these choices.")] = 1,
    crs: Crs = "",
) -> None:
    """Plan a rectification: RMSE at the check points by number of control points and degree."""
    from fg_orient.rectification.job import study_points

    cells = study_points(points, _numbers("counts", counts), _numbers("degrees", degrees), layouts=layouts,
                         seed=seed, crs=crs)  # fmt: skip
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
@command()
def check(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="POINTS",
            show_default=False,
            help="CSV: id,easting_m,northing_m,true_easting_m,true_northing_m or id,residual_easting_m,"
            "residual_northing_m; or a result folder of rectify fit.",
        ),
    ],
    scale: Annotated[float | None, typer.Option(metavar="N", help="Judge the scale 1:N.")] = None,
    class_m: Annotated[float | None, typer.Option("--class-m", metavar="M", help="Judge this class (ASPRS).")] = None,
    standard: Annotated[
        str, typer.Option(help="NMAS, CMAS, NSSDA, ASPRS-1990, ASPRS-2014, ASPRS-2023; usual: all.")
    ] = "",
    check_point_rmse: Annotated[
        float, typer.Option("--check-point-rmse", metavar="M", help="Radial RMSE of the check points themselves.")
    ] = 0.0,
) -> None:
    """Judge the accuracy of a map by tested points; ends with 4 if a standard is not met."""
    from fg_orient.rectification.fit import plain_rmse
    from fg_orient.rectification.job import read_differences
    from fg_orient.rectification.standards import NAMES, check_accuracy

    wanted = tuple(word.strip() for word in standard.split(",")) if standard else NAMES
    differences, words = read_differences(points)
    found = check_accuracy(differences, scale=scale, class_m=class_m, check_point_rmse_m=check_point_rmse,
                           standards=wanted)  # fmt: skip
    x, y, radial = plain_rmse(differences)
    record = {
        "points": words, "n": len(differences), "scale": scale, "class_m": class_m,
        "rmse_m": {"easting": x, "northing": y, "radial": radial},
        "standards": [asdict(verdict) for verdict in found],
    }  # fmt: skip
    answer(record, _show_check)
    if any(verdict.passed is False for verdict in found):
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
@command()
def ortho(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", show_default=False, help="Raster in sensor geometry.")],
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL",
            show_default=False,
            help="Metadata file (DIMAP, RPC), or a result folder of rectify fit.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="TIF", help="GeoTIFF to write.", show_default=False)],
    dem: Annotated[Path | None, typer.Option("--dem", help="DEM of ellipsoidal heights, m.")] = None,
    height: Annotated[float | None, typer.Option(metavar="M", help="One height instead of a DEM.")] = None,
    result: Result = None,
    image_id: Annotated[str, typer.Option("--image-id", metavar="ID", help="Image in it; usual: by file name.")] = "",
    crs: Annotated[str, typer.Option("--crs", metavar="EPSG", help="CRS of the map; default: from DEM or fit.")] = "",
    resolution: Annotated[
        float | None, typer.Option(metavar="SIZE", help="Size of a map pixel; default: about an image pixel.")
    ] = None,
    bounds: Annotated[
        str, typer.Option(metavar="L,B,R,T", help="Left,bottom,right,top; usual: all that is covered.")
    ] = "",
    resampling: Annotated[
        str, typer.Option(metavar="NAME", help="nearest, bilinear, cubic (a = -0.5), cubic-sharp (a = -1).")
    ] = "bilinear",
    allow_holes: Annotated[
        bool, typer.Option("--allow-holes", help="Leave pixels empty where the DEM has no height.")
    ] = False,
    cog: Annotated[bool, typer.Option("--cog", help="Cloud optimised GeoTIFF, with overviews.")] = False,
    extrapolate_attitude: Extrapolate = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Rectify an image on a DEM (or a plane) to a GeoTIFF: by its sensor, adjusted or not, or by points."""
    from fg_orient.rectification.ortho import OrthoOptions
    from fg_orient.rectification.ortho_job import rectify_image

    options = OrthoOptions(resampling, allow_holes, cog)
    limits = _bounds(bounds) if bounds else None
    if dem is not None and height is not None:
        raise InputError.of("options.two_ways", option="dem, height")
    with progress_bar("rectifying") as progress:
        record = rectify_image(
            image, model, out, dem=dem, height_m=height, result=result, image_id=image_id, crs=crs,
            resolution=resolution, bounds=limits, options=options, overwrite=overwrite, progress=progress,
            extrapolate_attitude_s=extrapolate_attitude,
        )  # fmt: skip
    answer(record, _show_ortho, record, resampling)


def _show_ortho(record: dict[str, Any], resampling: str) -> None:
    say(f"{record['rows']} x {record['columns']} pixels of {record['resolution']:g}, "
        f"{100 * record['filled']:.1f} % filled, {resampling}")  # fmt: skip
    say(f"model asked every {record['knots']} pixels, at most {record['error_px']:.1g} px wrong between")
    say(f"written: {record['out']}")


def _bounds(text: str) -> Bounds:
    try:
        left, bottom, right, top = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError.of("options.value", option="bounds", value=text, expected="four numbers") from None
    return left, bottom, right, top
