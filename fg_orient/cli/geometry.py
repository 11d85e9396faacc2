"""Commands ``locate``, ``project``, ``intersect``, ``footprint``.

They use the metadata or an adjusted orientation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fg_orient.cli.command import SENSORS, Dem, Overwrite, Sensors, VerticalCrs, argument, command, option, read_dem
from fg_orient.cli.output import (
    answer,
    answer_with_status,
    end_if,
    number,
    say,
    table,
    tell,
    write_records,
)
from fg_orient.model.errors import Finding, InputError, by_severity, decisive, judged

if TYPE_CHECKING:
    from factors.arrays import Array
    from fg_orient.model.block import Image, ImagePoints
    from fg_orient.sensors.surface import RasterDem

#: Allowed range of ground heights, m. Other values probably have a wrong unit or are from a wrong column.
HEIGHT_RANGE_M = (-12e3, 100e3)
GROUND = ("id", "line", "sample", "lon_deg", "lat_deg", "height_m", "x_m", "y_m", "z_m")
FRAME = (*GROUND, "file_lon_deg", "file_lat_deg", "misfit_m", "misfit_east_m", "misfit_north_m", "height_from")
#: Printed columns of the frame points; more columns do not fit into 80 characters.
SHOWN_FRAME = ("id", "height_m", "misfit_m", "misfit_east_m", "misfit_north_m")
SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
PIXEL = ("id", "line", "sample", "inside")

ImageFile = Annotated[Path, argument("IMAGE", "Metadata file of the image (DIMAP, RPC).")]
Height = Annotated[float | None, option("Height, m above the ellipsoid.")]
Out = Annotated[Path | None, option("Also write the points to this CSV file.")]
Sources = Annotated[list[Path], argument("IMAGE ... | PROJECT.toml", "Metadata files, or one project file.")]
Points = Annotated[Path | None, option("CSV file of points; the columns are listed below.")]


@command(several=SENSORS)
def locate(
    image: ImageFile,
    sensors: Sensors,
    line: Annotated[float | None, option("Line, pixels; 0 is the centre of the first line.")] = None,
    sample: Annotated[float | None, option("Sample, pixels; 0 is the centre of the first sample.")] = None,
    height: Height = None,
    dem: Dem = None,
    dem_vertical_crs: VerticalCrs = "",
    frame: Annotated[bool, option("Locate the file's own frame points and compare.", flag="--frame")] = False,
    points: Points = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Image to ground: compute the ground point of a pixel, at a height or on a DEM.

    Points of a CSV file: columns id,line,sample and, without --height or --dem, height_m.
    """
    _exclude({"--line": line, "--sample": sample}, {"--points": points}, {"--frame": frame or None})
    if height is not None and dem is not None:
        raise InputError.of("cli.two_heights", file=image, option="height, dem")
    from fg_orient.sensors.ground import frame_records

    sensor = sensors.read(image)
    surface = read_dem(dem, dem_vertical_crs)
    if frame:
        records = frame_records(sensor, height, surface)
    else:
        records = _located(sensor, image, points, (line, sample), height, surface)
    _publish(sensor, records, FRAME if frame else GROUND, out, overwrite)


def _exclude(*ways: dict[str, object]) -> None:
    """Raise InputError if the user gives options that exclude each other; None means that an option is not given."""
    given = [[name for name, value in way.items() if value is not None] for way in ways]
    names = [way[0] for way in given if way]
    if len(names) > 1:
        options = ", ".join(" with ".join(way) for way in ways)
        raise InputError.of("cli.two_ways", place=", ".join(names), options=options)


def _located(
    sensor: Any, image: Path, points: Path | None, pixel: tuple[float | None, float | None],
    height: float | None, dem: RasterDem | None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Locate one pixel or the pixels of a CSV file, and return records."""
    import numpy as np

    from fg_orient.sensors.ground import ground_records

    given_height = height is not None or dem is not None
    if points is not None:
        ids, (lines, samples, *heights) = _columns(points, ("line", "sample"), "height_m")
        if heights and given_height:
            raise InputError.of("cli.two_heights", file=points, place="column height_m")
    elif pixel[0] is None or pixel[1] is None:
        raise InputError.of("cli.no_pixel", file=image, option="line, sample")
    else:
        ids, heights, lines, samples = ["1"], [], np.array([pixel[0]]), np.array([pixel[1]])
    if not given_height and not heights:
        raise InputError.of("cli.no_height", file=points or image, option="height")
    if dem is not None:
        return ground_records(ids, lines, samples, sensor.locate(lines, samples, dem=dem), sensor.body)
    height_m = heights[0] if heights else np.full(len(ids), height)
    low, high = HEIGHT_RANGE_M
    bad = np.flatnonzero(~((height_m >= low) & (height_m <= high)))
    if len(bad):
        place, value = f"point {ids[bad[0]]}", f"{height_m[bad[0]]:g}"
        raise InputError.of("cli.height_range", file=points or image, place=place, value=value, low=low, high=high)
    return ground_records(ids, lines, samples, sensor.locate(lines, samples, height_m=height_m), sensor.body)


@command(several=SENSORS)
def project(
    image: ImageFile,
    sensors: Sensors,
    lon: Annotated[float | None, option("Longitude, degrees East (WGS84).")] = None,
    lat: Annotated[float | None, option("Latitude, degrees North (WGS84).")] = None,
    height: Height = None,
    points: Points = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Ground to image: compute the pixel that shows a ground point.

    Points of a CSV file: columns id,lon_deg,lat_deg,height_m.
    """
    _exclude({"--lon": lon, "--lat": lat, "--height": height}, {"--points": points})
    import numpy as np

    from fg_orient.geodesy.bodies import ground_on
    from fg_orient.quality.direct_points import points_outside
    from fg_orient.sensors.ground import pixel_records

    if points is not None:
        ids, columns = _columns(points, ("lon_deg", "lat_deg", "height_m"))
    elif lon is None or lat is None or height is None:
        raise InputError.of("cli.no_ground", file=image, option="lon, lat, height")
    else:
        ids, columns = ["1"], [np.array([value]) for value in (lon, lat, height)]
    sensor = sensors.read(image)
    records = pixel_records(sensor, ids, ground_on(sensor.body, *columns))
    _publish(sensor, records, PIXEL, out, overwrite, points_outside(sensor, records, *columns))


@command(several=SENSORS)
def intersect(
    sources: Sources,
    sensors: Sensors,
    pixel: Annotated[
        list[str] | None, option("Pixel, one per image, in the order of the images.", "LINE,SAMPLE")
    ] = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Stereo: compute the ground point where rays of several images meet.

    With a project file, the command computes all points that are measured twice or more; their
    coordinates in the file are not used. Sigmas of a point follow from its image points (--pixel: 1
    pixel each); the orientation is assumed to have no errors. The exit code is 4 if rays cannot belong
    to one point.
    """
    from fg_orient.quality.direct_points import impossible_rays, rays_beyond_pixels
    from fg_orient.sensors.ground import intersection_records

    if len(sources) == 1 and sources[0].suffix.lower() == ".toml":
        _exclude({"PROJECT.toml": sources[0]}, {"--pixel": pixel or None})
        block = sensors.project(sources[0])
        images, observations, ids = block.images, block.observations, block.points.ids
    else:
        images, observations = _pixels_of(sources, pixel or [], sensors)
        ids = ("1",)
    records = intersection_records(images, observations, ids)
    adjusted = sensors.result is not None
    taken = dict.fromkeys(one for image in images for one in decisive(image.sensor.notes))
    doubts = [*taken, *impossible_rays(records), *rays_beyond_pixels(records, images, observations, adjusted=adjusted)]
    if out is not None:
        write_records(out, (*GROUND, "miss_m", *SIGMAS), records, overwrite)
    record = {"points": records, "images": [image.id for image in images], **judged(by_severity(doubts)),
              "out": None if out is None else str(out)}  # fmt: skip
    shown = ("id", "lon_deg", "lat_deg", "height_m", "miss_m", "sigma_up_m")
    answer_with_status(record, _show_points, records, shown, (), out)


def _pixels_of(sources: list[Path], pixels: list[str], sensors: Sensors) -> tuple[tuple[Image, ...], ImagePoints]:
    """Return the images and the image points of one ground point from the command line."""
    import numpy as np

    from fg_orient.model.block import ImagePoints

    if len(sources) < 2:
        raise InputError.of("cli.one_image", file=sources[0], place="IMAGE", value=f"{len(sources)} file")
    if len(pixels) != len(sources):
        raise InputError.of("cli.pixel_count", option="pixel", pixels=len(pixels), images=len(sources))
    values = np.array([_pixel(text) for text in pixels])
    images = _images(sources, sensors)
    for k, image in enumerate(images):
        image.sensor.require_inside(values[k : k + 1, 0], values[k : k + 1, 1])
    n = len(images)
    one = np.ones(n)
    return images, ImagePoints(np.arange(n), np.zeros(n, np.intp), values[:, 0], values[:, 1], one, one)


def _pixel(text: str) -> tuple[float, float]:
    try:
        line, sample = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError.of("cli.pixel", option="pixel", value=text) from None
    return line, sample


def _columns(path: Path, names: tuple[str, ...], optional: str = "") -> tuple[list[str], list[Array]]:
    """Read the ids and numeric columns of a CSV file; the last column is ``optional``.

    InputError: the file has errors; all are listed.
    """
    from fg_orient.formats.tables import read_numbers

    layouts = [("id", *names), *([("id", *names, optional)] if optional else [])]
    values, table = read_numbers(path, layouts, ("id",))
    return list(table.cells["id"]), list(values.T)


def _publish(
    sensor: Any, records: list[dict[str, Any]], columns: tuple[str, ...], out: Path | None, overwrite: bool,
    warnings: Sequence[Finding] = (),
) -> None:  # fmt: skip
    """Print warnings, write a CSV file if ``--out`` is given, then print JSON or a table."""
    for one in warnings:
        tell("warning", one)
    if out is not None:
        write_records(out, columns, records, overwrite)
    where = None if out is None else str(out)
    notes = list(map(str, (*sensor.notes, *warnings)))
    record = {"points": records, "image": Path(sensor.file).name, "notes": notes, "out": where}
    framed = sensor.metadata.frame_note if columns is FRAME else None
    noted = (*sensor.notes, *(() if framed is None or framed in sensor.notes else [framed]))
    shown = SHOWN_FRAME if columns is FRAME else tuple(name for name in columns if name not in ("x_m", "y_m", "z_m"))
    answer(record, _show_points, records, shown, noted, out)
    end_if(decisive(sensor.notes))


def _show_points(
    records: list[dict[str, Any]], columns: tuple[str, ...], notes: tuple[Finding, ...] = (), out: Path | None = None
) -> None:
    """Print notes, a table of the points, and the name of the file that contains them."""
    for one in by_severity(notes):
        tell(one.severity, one)
    table("", columns, [[_cell(name, record[name]) for name in columns] for record in records])
    if out is not None:
        say(f"written: {out}")


def _cell(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    digits = 7 if name in ("lon_deg", "lat_deg") else 3
    return number(value, digits) if isinstance(value, float) else str(value)


@command(several=SENSORS)
def footprint(
    sources: Sources,
    sensors: Sensors,
    height: Height = None,
    dem: Dem = None,
    dem_vertical_crs: VerticalCrs = "",
    out: Annotated[Path | None, option("Write the footprints into this GeoJSON file.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Footprints, ground sampling distance, incidence; convergence and base to height of pairs.

    The ground is at --height or on --dem.
    """
    from fg_orient.formats.atomic import outputs, require_free_files, write_text
    from fg_orient.sensors.viewing import View, feature_collection, viewing_records

    if (height is None) == (dem is None):
        code = "cli.no_height" if height is None else "cli.two_heights"
        raise InputError.of(code, file=sources[0], option="height, dem")
    require_free_files(out, overwrite=overwrite)
    surface = read_dem(dem, dem_vertical_crs)
    images = _images(sources, sensors)
    views = [View(image, height or 0.0, surface) for image in images]
    records = viewing_records(views)
    if out is not None:
        from fg_orient.result.plain import dumps

        with outputs(out, overwrite=overwrite):
            write_text(out, dumps(feature_collection(views, records["images"]), indent=1) + "\n")
    notes = [replace(one, place=f"image {view.image.id}") for view in views for one in view.image.sensor.notes]
    record = {**records, "notes": list(map(str, notes)), "out": None if out is None else str(out)}
    answer(record, _show_footprints, records, notes, out)
    end_if(decisive(notes))


def _images(sources: list[Path], sensors: Sensors) -> tuple[Image, ...]:
    """Return the images of a project, or of metadata files, which are then numbered."""
    if len(sources) == 1 and sources[0].suffix.lower() == ".toml":
        return sensors.images(sources[0])
    from fg_orient.model.block import Image

    return tuple(Image(str(k), sensors.read(path)) for k, path in enumerate(sources, start=1))


def _show_footprints(records: dict[str, list[dict[str, Any]]], notes: list[Finding], out: Path | None) -> None:
    for one in by_severity(notes):
        tell(one.severity, one)
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
    if out is not None:
        say(f"written: {out}")
