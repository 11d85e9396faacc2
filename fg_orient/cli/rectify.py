"""Commands ``rectify``: image to map by points or DEM, map accuracy; areas, projections, geometry of scanners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from fg_orient.cli.command import (
    Extrapolate,
    Light,
    Overwrite,
    Result,
    argument,
    command,
    command_line,
    effects_of,
    option,
)
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, answer_with_status, end_if, note, number, say, table, tell
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError
from fg_orient.rectification.options import AccuracyOptions, OrthoOptions, PointOptions, StudyOptions

if TYPE_CHECKING:
    from fg_orient.rectification.grid import Bounds
    from fg_orient.rectification.study import Cell

app = typer.Typer(help="Rectify images by points or on a DEM; accuracy of a map, areas, projections.")

POINTS: Final = "CSV: id,line,sample,easting_m,northing_m (or lon_deg,lat_deg); optional: height_m, role, sigmas."
Points = Annotated[Path, argument("POINTS", POINTS)]
PROJECTIONS: Final = "utm:36, gauss-krueger:30, lambert-cylindrical:R, lambert-polar:R, som:5,180 or PROJ."


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
    answer_with_status(record, _show_fit)


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
    end_if(any(one.passed is False for one in assessed))


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
    image_id: Annotated[str, option("Image in the result folder; default: by file name.", "ID")] = "",
    crs: Annotated[str, option("CRS of the map; default: from DEM or fit.", "EPSG")] = "",
    resolution: Annotated[
        float | None, option("Size of a map pixel; default: about the size of an image pixel.", "SIZE")
    ] = None,
    bounds: Annotated[str, option("Left,bottom,right,top; default: the whole common area.", "L,B,R,T")] = "",
    extrapolate_attitude: Extrapolate = 0.0,
    light: Light = "",
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
            progress=progress, extrapolate_attitude_s=extrapolate_attitude, light=effects_of(light),
        )  # fmt: skip
    answer_with_status(record, _show_ortho)


def _show_ortho(record: dict[str, Any]) -> None:
    say(f"{record['rows']} x {record['columns']} pixels of {record['resolution']:g}, "
        f"{100 * record['filled']:.1f} % filled, {record['resampling']}")  # fmt: skip
    say(f"model evaluated every {record['knots']} pixels, interpolation error at most {record['error_px']:.1g} px")
    say(f"written: {record['out']}")


@app.command("area")
@command()
def area(
    outlines: Annotated[
        Path,
        argument("OUTLINES", "CSV of vertices in order: easting_m,northing_m or lon_deg,lat_deg; optional: outline."),
    ],
    projection: Annotated[str, option("Projection of lon_deg, lat_deg: " + PROJECTIONS, "NAME|PROJ")] = "",
    ellipsoid: Annotated[str, option("PROJ's name of the ellipsoid of lon_deg, lat_deg.", "NAME")] = "WGS84",
    pixel_size: Annotated[float | None, option("Pixel size, to compute the area by counting pixels.", "M")] = None,
) -> None:
    """Compute area and perimeter of outlines, in the plane, on the ellipsoid and by count of pixels."""
    from fg_orient.rectification.measures import measure_outlines

    answer(measure_outlines(outlines, projection=projection, ellipsoid=ellipsoid, pixel_m=pixel_size), _show_areas)


def _show_areas(record: dict[str, Any]) -> None:
    names = {"area_m2": "area", "ellipsoidal_area_m2": "ellipsoid", "perimeter_m": "perimeter",
             "ellipsoidal_perimeter_m": "geodesics", "pixel_area_m2": "pixels",
             "sigma_pixel_area_m2": "sigma"}  # fmt: skip
    used = {key: name for key, name in names.items() if record["outlines"][0][key] is not None}
    rows = [(o["outline"] or "-", o["vertices"], *(f"{o[key]:.1f}" for key in used)) for o in record["outlines"]]
    table("areas, m2, and lengths, m", ("outline", "vertices", *used.values()), rows)


@app.command("projection")
@command()
def projection(
    points: Annotated[Path, argument("POINTS", "CSV: id,lon_deg,lat_deg; with --inverse id,easting_m,northing_m.")],
    to: Annotated[str, option("Projection: " + PROJECTIONS, "NAME|PROJ", show_default=False)],
    inverse: Annotated[bool, option("From plane coordinates to longitude and latitude.", flag="--inverse")] = False,
    out: Annotated[Path | None, option("Table of the results.", "CSV")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute the map projection of points and its scale factors; the datum does not change."""
    from fg_orient.rectification.measures import project_points

    answer(project_points(points, to, inverse=inverse, out=out, overwrite=overwrite), _show_projection)


def _show_projection(record: dict[str, Any]) -> None:
    names = ("lon_deg", "lat_deg", "easting_m", "northing_m")
    scales = ("scale_meridian", "scale_parallel", "scale_area")
    rows = [(p["id"], *(f"{p[n]:.6f}" for n in names[:2]), *(f"{p[n]:.3f}" for n in names[2:]),
             *(f"{p[n]:.6f}" for n in scales)) for p in record["points"]]  # fmt: skip
    table(record["projection"], ("id", "lon", "lat", "easting", "northing", "meridian", "parallel", "area"), rows)
    if record["out"]:
        say(f"written: {record['out']}")


@app.command("scanner")
@command()
def scanner(
    height: Annotated[float, option("Height above the datum.", "M", show_default=False)],
    ifov_along: Annotated[float, option("Angular resolution along the track.", "RAD", show_default=False)],
    ifov_across: Annotated[float | None, option("Angular resolution across; default: as along.", "RAD")] = None,
    angles: Annotated[str, option("Scan angles from nadir; default: to the edge of the swath.", "DEG,DEG")] = "",
    swath: Annotated[float | None, option("Width of the swath over flat ground.", "M")] = None,
    relief: Annotated[float, option("Height of a point, for its displacement.", "M")] = 0.0,
    focal: Annotated[float | None, option("Focal length.", "M")] = None,
    speed: Annotated[float | None, option("Speed of the ground track.", "M/S")] = None,
    overlap: Annotated[float, option("Overlap of strips, 0 to below 1.")] = 0.0,
    rotation: Annotated[float | None, option("Time in which the scan angle changes by 2 pi.", "S")] = None,
) -> None:
    """Compute element sizes and displacements of an across-track scanner over flat ground, by scan angle."""
    from fg_orient.rectification.measures import scanner_record

    record = scanner_record(
        height, ifov_along, ifov_across, angles_deg=_floats("angles", angles) if angles else (), swath_m=swath,
        relief_m=relief, overlap=overlap, focal_m=focal, speed_m_s=speed, rotation_s=rotation,
    )  # fmt: skip
    answer(record, _show_scanner)


def _show_scanner(record: dict[str, Any]) -> None:
    facts = {"strip_m": "strip {:.4g} m", "image_element_m": "element in the image {:.4g} m",
             "line_time_s": "{:.4g} s from strip to strip", "total_angle_deg": "total angle {:.4g} deg"}  # fmt: skip
    say(", ".join(words.format(record[name]) for name, words in facts.items() if record[name] is not None))
    rows = [(f"{row['scan_angle_deg']:.3f}", *(number(value) for value in list(row.values())[1:]))
            for row in record["angles"]]  # fmt: skip
    names = ("angle, deg", "ground Y", "along", "across", "panoramic", "relief", "mirror")
    table("element sizes and displacements on the ground, m", names, rows)


def _floats(name: str, text: str, count: int | None = None) -> tuple[float, ...]:
    """Numbers between commas."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or count not in (None, len(values)):
        expected = "numbers between commas" if count is None else f"{count} numbers between commas"
        raise InputError.of("options.value", option=name, value=text, expected=expected)
    return values


def _bounds(text: str) -> Bounds:
    left, bottom, right, top = _floats("bounds", text, 4)
    return left, bottom, right, top
