"""Command ``footprint``: where images look, at which angles, and how pairs of them converge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.common import (
    Debug,
    Extrapolate,
    Json,
    Log,
    ModelOf,
    Overwrite,
    Quiet,
    Result,
    VerticalCrs,
    number,
    outcome,
    read_dem,
    read_image,
    table,
    with_result,
)
from fg_orient.cli.output import emit, say, tell
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.model.block import Image

Sources = Annotated[
    list[Path], typer.Argument(metavar="IMAGE ... | PROJECT.toml", help="Metadata files, or one project file.")
]


def footprint(
    sources: Sources,
    height: Annotated[float | None, typer.Option("--height", help="Height, m above the ellipsoid.")] = None,
    dem: Annotated[
        Path | None, typer.Option("--dem", help="DEM, any raster GDAL reads; ellipsoidal unless it says otherwise.")
    ] = None,
    dem_vertical_crs: VerticalCrs = "",
    result: Result = None,
    model: ModelOf = "auto",
    extrapolate_attitude: Extrapolate = 0.0,
    out: Annotated[Path | None, typer.Option("--out", help="Write the footprints into this GeoJSON file.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Footprints, ground sampling distance, incidence; convergence and base to height of pairs.

    On the ground at --height or on --dem.
    """
    with outcome(as_json, debug, quiet, log):
        from fg_orient.sensors.viewing import View, feature_collection, viewing_records

        if (height is None) == (dem is None):
            code = "cli.no_height" if height is None else "cli.two_heights"
            raise InputError.of(code, file=sources[0], option="height, dem")
        if out is not None and out.exists() and not overwrite:
            raise InputError.of("output.exists", file=out, option="out")
        surface = read_dem(dem, dem_vertical_crs)
        images = _images(sources, model, extrapolate_attitude, result)
        views = [View(image, height or 0.0, surface) for image in images]
        records = viewing_records(views)
        if out is not None:
            _write(out, feature_collection(views, records["images"]))
        notes = [replace(found, place=f"image {view.image.id}") for view in views for found in view.image.sensor.notes]
        if as_json:
            emit({**records, "notes": list(map(str, notes)), "out": None if out is None else str(out)})
        else:
            for found in notes:
                tell("note", found)
            _show(records)
            if out is not None:
                say(f"written: {out}")


def _images(sources: list[Path], model: str, extrapolate_s: float, result: Path | None) -> tuple[Image, ...]:
    """Images of a project, or of metadata files, numbered."""
    from fg_orient.model.block import Image

    if len(sources) == 1 and sources[0].suffix.lower() == ".toml":
        from fg_orient.formats.project import read_project

        images = read_project(sources[0], extrapolate_attitude_s=extrapolate_s or None).images
        if result is None:
            return images
        return tuple(Image(image.id, with_result(image.sensor, result, image.id)) for image in images)
    sensors = [read_image(path, model, extrapolate_s, result) for path in sources]
    return tuple(Image(str(k), sensor) for k, sensor in enumerate(sensors, start=1))


def _write(out: Path, collection: dict[str, Any]) -> None:
    from fg_orient.formats.atomic import write_text
    from fg_orient.run.json import dumps

    write_text(out, dumps(collection, indent=1) + "\n")


def _show(records: dict[str, list[dict[str, Any]]]) -> None:
    columns = ("image", "GSD line", "GSD sample", "incidence", "azimuth", "height", "km2")
    table("degrees, m, at the centres of the images", columns, [
        [r["image"], *(number(r[key], digits) for key, digits in (
            ("gsd_line_m", 3), ("gsd_sample_m", 3), ("incidence_deg", 2), ("azimuth_deg", 1), ("height_m", 0),
            ("area_km2", 1)))]
        for r in records["images"]
    ])  # fmt: skip
    pairs = records["pairs"]
    if pairs:
        table("at the middle of the common ground", ("pair", "overlap", "convergence", "B/H", "asymmetry"), [
            [" - ".join(r["images"]), number(r["overlap"], 2), number(r["convergence_deg"], 2),
             number(r["base_to_height"]), number(r["asymmetry_deg"], 2)]
            for r in pairs
        ])  # fmt: skip
