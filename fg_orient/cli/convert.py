"""Commands ``convert`` and ``camera convert``: convert points, models and cameras to another format."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.command import (
    SENSORS,
    CheckIds,
    Height,
    ImageSize,
    Overwrite,
    Sensors,
    SigmaGround,
    SigmaImage,
    argument,
    command,
    image_sizes,
    option,
)
from fg_orient.cli.new import LEVEL, LEVEL_FLAGS, OFFICE, crs_code
from fg_orient.cli.output import answer, flag, number, say, table, tell
from fg_orient.model.errors import Finding, InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from fg_orient.formats.registry import Format


@command(several=OFFICE | LEVEL | SENSORS, named=LEVEL_FLAGS)
def convert(
    files: Annotated[
        list[Path] | None, argument("IN [IN2]", "File to read, or both files of a format that has two.")
    ] = None,
    source: Annotated[str, option("Format of IN; default: by the end of its name.", "FORMAT", flag="--from")] = "",
    target: Annotated[
        str, option("Format of the output; default: by the end of its name.", "FORMAT", flag="--to")
    ] = "",
    out: Annotated[
        list[Path] | None, option("File to write; a second file gets a similar name, or the name of a second --out.")
    ] = None,
    crs: Annotated[str, option("CRS of IN, if the file does not state it.", "EPSG:N")] = "",
    to_crs: Annotated[str, option("Transform the points to this CRS.", "EPSG:N")] = "",
    sigma_ground: SigmaGround = None,
    sigma_image: SigmaImage = None,
    height: Height = None,
    check: CheckIds = None,
    image: Annotated[str, option("Name of the image, for formats that do not contain it.", "NAME")] = "",
    sigma_axes: Annotated[str, option("Axes of the standard deviations in ASP's .gcp.", "ecef|enu")] = "ecef",
    image_size: ImageSize = None,
    metadata: Annotated[
        list[Path] | None, option("Metadata of an image; points far from all these images are refused.")
    ] = None,
    accept_unverified: Annotated[
        bool, option("Read a format that was never tested with a file from its program.", flag="--accept-unverified")
    ] = False,
    bands: Annotated[
        int, option("With --to csm-state: number of bands of columns; each band becomes a state file.", "N")
    ] = 1,
    formats: Annotated[bool, option("List the formats and end.", flag="--formats")] = False,
    overwrite: Overwrite = False,
    office: Any = None,
    level: Any = None,
    sensors: Any = None,
) -> None:
    """Bring ground and image points, or an image's model, from one format into another.

    The command prints one line for each kind of information that the new format cannot
    contain. With --to csm-state or isd IN is the metadata of an image, adjusted with
    --result.
    """
    from fg_orient.formats.exchange.convert import filled, placed, read_survey, write_survey
    from fg_orient.formats.heights import without_vertical
    from fg_orient.formats.registry import Settings, format_named, format_of
    from fg_orient.formats.registry import formats as all_formats
    from fg_orient.formats.sensor import read_sensor

    if formats:
        _list()
        return
    image_formats = {name: f for name, f in all_formats("image").items() if f.write_image}
    if not files or not out:
        raise InputError.of("cli.usage", place="fg-orient convert", text="Give IN, --out and the formats")
    if target in image_formats:
        _convert_image(files, image_formats[target], out, sensors, bands, overwrite)
        return
    if bands != 1:
        raise InputError.of("csm.bands", option="bands", value=bands)
    if sigma_axes not in ("ecef", "enu"):
        raise InputError.of("options.value", option="sigma_axes", value=sigma_axes, expected="ecef or enu")
    reader = format_named(source, place="<from>") if source else format_of(files[0], place="<from>")
    writer = format_named(target, place="<to>") if target else format_of(out[0], place="<to>")
    crs, to_crs = crs_code(crs), crs_code(to_crs, "to_crs")
    images = {path.stem: read_sensor(path) for path in metadata or []}
    sizes = image_sizes(image_size)
    settings = Settings(crs, image, sigma_axes, sizes, incomplete=True, office=office, sensors=images)
    if reader.read_model is not None and writer.write_model is not None:
        from fg_orient.formats.exchange.convert import convert_model
        from fg_orient.formats.exchange.ties import model_survey

        model, lost = convert_model(
            files, reader, out[0], writer, settings, accept_unverified=accept_unverified, overwrite=overwrite
        )
        survey = replace(model_survey(model), notes=model.notes)
        written: tuple[Path, ...] = (out[0],)
        remarks: tuple[Finding, ...] = ()
    else:
        if writer.write is None and writer.write_model is not None:
            known = ", ".join(name for name, f in all_formats().items() if f.read_model is not None)
            raise InputError.of("interchange.needs_model", file=out[0], option="to", value=writer.name,
                                source=reader.name, known=known)  # fmt: skip
        survey, remarks = read_survey(
            files, reader, settings, accept_unverified=accept_unverified, scenes=_scenes(images)
        )
        survey = filled(
            survey, sigma_ground_m=sigma_ground, sigma_image_px=sigma_image, height_m=height, check=check or ()
        )
        survey = level.applied(without_vertical(survey)) if level else survey
        survey = placed(survey, writer, to_crs, str(out[0]))
        settings = Settings(to_crs, image, sigma_axes, settings.image_sizes)
        written, lost = write_survey(survey, out, writer, settings, overwrite=overwrite)
    counts = {
        "points": len(survey.ids), "images": len(survey.images), "image_points": len(survey.observed),
        **{str(role): survey.roles.count(role) for role in dict.fromkeys(survey.roles)},
    }  # fmt: skip
    record = {
        "from": reader.name, "to": writer.name, "out": [str(path) for path in written], **counts,
        "remarks": [p.as_dict(flag) for p in remarks], "lost": [p.as_dict(flag) for p in lost],
        "notes": list(map(str, survey.notes)),
    }  # fmt: skip
    answer(record, _show, {"note": survey.notes, "remark": remarks, "lost": lost}, counts, written)


#: Fewest columns of a band.
NARROW = 32


def _convert_image(
    files: list[Path], form: Format, out: list[Path], sensors: Sensors, bands: int, overwrite: bool
) -> None:  # fmt: skip
    """Write the model of an image, with or without adjusted orientation, in the format of another program."""
    from fg_orient.formats.atomic import outputs, require_free_files

    if len(files) != 1 or len(out) != 1:
        raise InputError.of("cli.usage", place="fg-orient convert", text="Give one image and one --out")
    if bands < 1:
        raise InputError.of("options.value", option="bands", value=bands, expected="1 or more")
    if bands > 1 and not form.in_bands:
        raise InputError.of("csm.bands", option="bands", value=form.name)
    paths = [out[0].with_name(f"{out[0].stem}_{k + 1}{out[0].suffix}") for k in range(bands)] if bands > 1 else [out[0]]
    require_free_files(*paths, overwrite=overwrite)
    read = sensors.read(files[0])
    sensor, correction = getattr(read, "sensor", read), getattr(read, "correction", None)
    if bands > 1 and sensor.n_samples < NARROW * bands:
        raise InputError.of("options.value", option="bands", value=bands, expected=f"1 .. {sensor.n_samples // NARROW}")
    assert form.write_image is not None  # the user has chosen a format that writes images
    with outputs(*paths, overwrite=overwrite):
        if bands == 1:
            record = form.write_image(paths[0], sensor, correction)
        else:
            record = _bands(form.write_image, paths, sensor, correction)
    record = {"from": str(files[0]), "to": form.name, "out": list(map(str, paths)), **record}
    answer(record, _show_image, paths, record)


def _bands(
    write: Callable[..., dict[str, Any]], paths: list[Path], sensor: Any, correction: Any
) -> dict[str, Any]:  # fmt: skip
    """Write bands of about the same number of columns.

    Return the record of each band, and the differences of all bands.
    """
    ends = [round(k * sensor.n_samples / len(paths)) for k in range(len(paths) + 1)]
    columns = list(itertools.pairwise(ends))
    records = [write(path, sensor, correction, own) for path, own in zip(paths, columns, strict=True)]
    return {
        "largest_px": max(one["largest_px"] for one in records),
        "mean_px": sum(one["mean_px"] for one in records) / len(records),
        "bands": [{"columns": list(own)} | one for own, one in zip(columns, records, strict=True)],
    }


def _show_image(paths: list[Path], record: dict[str, Any]) -> None:
    if "largest_px" in record:
        largest, mean = (number(record[f"{name}_px"], 6) for name in ("largest", "mean"))
        say(f"difference from the image: largest {largest} px, mean {mean} px")
    for path, band in zip(paths, record.get("bands", [None] * len(paths)), strict=True):
        say(
            f"written: {path}"
            + (", columns {} .. {}".format(band["columns"][0], band["columns"][1] - 1) if band else "")
        )


def _scenes(sensors: dict[str, Any]) -> list[Any]:
    from fg_orient.formats.scenes import Scene

    return [Scene.from_footprint(name, sensor.footprint(), sensor.body) for name, sensor in sensors.items()]


def _show(findings: dict[str, tuple[Finding, ...]], counts: dict[str, int], written: tuple[Path, ...]) -> None:
    for kind, own in findings.items():
        for one in own:
            tell(kind, one)
    say(", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items()))
    for path in written:
        say(f"written: {path}")


def _list() -> None:
    """Print a list of the formats with their conventions."""
    from fg_orient.formats.registry import formats

    record = {"formats": [
        {**{name: getattr(f, name) for name in (
            "name", "title", "help", "files", "suffixes", "first_pixel", "pixel_axes", "ground_axes", "verified",
            "evidence")}, "holds": sorted(f.holds), "reads": f.read is not None, "writes": f.write is not None}
        for f in formats().values()
    ]}  # fmt: skip
    rows = [
        [f.name, ", ".join(f.files), "-" if f.first_pixel is None else "{:g}, {:g}".format(*f.first_pixel),
         "yes" if f.verified else "no"]
        for f in formats().values()
    ]  # fmt: skip
    answer(record, lambda _: table("formats", ("name", "files", "first pixel", "verified"), rows, left=2))


camera = typer.Typer(
    help="Convert camera files to another direction, or to another program's convention.", no_args_is_help=True
)


@camera.callback()
def camera_group() -> None:
    """Convert camera files to another direction, or to another program's convention."""


@camera.command("convert")
@command()
def convert_camera(
    file: Annotated[Path, argument("CAMERA.toml", "Camera file, or cameras exported by Metashape (XML).")],
    model: Annotated[str, option(
        "brown_ideal_to_measured, brown_measured_to_ideal, or a program's convention (docs/frame-cameras.md).", "MODEL",
        flag="--to",
    )],
    out: Annotated[Path, option("Camera file to write.", "FILE.toml")],
    pixel_mm: Annotated[float | None, option("Size of a pixel, mm; default: the file's.", "MM")] = None,
    r0_mm: Annotated[float | None, option("Radius of balanced radial terms, mm; default: the file's.", "MM")] = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Convert a camera file to the other direction of the distortion polynomial, or to a program's convention.

    If no exact conversion exists, the new camera is fitted over the whole image. The result states the
    largest difference and the RMS difference in the image.
    """
    from fg_orient.formats.atomic import outputs, require_free_files
    from fg_orient.formats.metadata.frame import read_camera, read_convention, write_camera, write_convention
    from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL
    from fg_orient.sensors.interior import converted

    require_free_files(out, overwrite=overwrite)
    theirs = read_convention(file)
    if theirs is not None:
        pixel_mm, r0_mm = pixel_mm or theirs.pixel_mm, r0_mm or theirs.r0_mm
        theirs = theirs.model_copy(update={"pixel_mm": pixel_mm, "r0_mm": r0_mm})
    interior = read_camera(file) if theirs is None else theirs.converted(file).interior
    record = {
        "camera": interior.name, "from": interior.model if theirs is None else theirs.convention, "to": model,
        "out": str(out),
    }  # fmt: skip
    if model in (IDEAL_TO_MEASURED, MEASURED_TO_IDEAL):
        fitted = converted(interior, model)
        with outputs(out, overwrite=overwrite):
            write_camera(out, fitted.interior)
        answer(record | {"max_px": fitted.max_px, "rms_px": fitted.rms_px}, _show_camera)
        return
    from fg_orient.sensors.camera_conversion import converted_interior
    from fg_orient.sensors.conventions import Image

    if theirs is None:
        unit = interior.unit_px if interior.model == MEASURED_TO_IDEAL else None
        pixel_mm = pixel_mm or (1.0 / unit if unit else None)
        image = Image(interior.n_lines, interior.n_samples, 1.0 / pixel_mm if pixel_mm else 0.0, r0_mm or 0.0)
        found = converted_interior(interior, model, image)
    else:
        found = theirs.converted(file, model)
    with outputs(out, overwrite=overwrite):
        write_convention(out, found, pixel_mm, r0_mm)
    answer(record | {
        "values": dict(found.values), "sigma": found.sigma, "exact": found.is_exact, "max_px": found.max_px,
        "rms_px": found.rms_px, "at_px": list(found.at_px),
    }, _show_camera)  # fmt: skip


def _show_camera(record: dict[str, Any]) -> None:
    say(f"{record['camera']}: {record['from']} to {record['to']}")
    if "values" in record:
        sigma = record["sigma"]
        rows = [[name, f"{value:.10g}", *([f"{sigma[name]:.3g}"] if sigma else [])]
                for name, value in record["values"].items()]  # fmt: skip
        table("values", ("name", "value", *(["sigma"] if sigma else [])), rows, left=1)
    say(f"difference over the whole image: {record['max_px']:.3g} px at most, {record['rms_px']:.3g} px rms")
    say(f"written: {record['out']}")
