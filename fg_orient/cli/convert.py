"""Command ``convert``: ground and image points between the formats of other programs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome, table
from fg_orient.cli.output import emit, flag, say, tell
from fg_orient.model.errors import Finding, InputError, Option

if TYPE_CHECKING:
    from fg_orient.formats.exchange.registry import Format, Settings
    from fg_orient.formats.exchange.survey import Survey


def convert(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="IN [IN2]", help="File to read, or both of a format that has two.", show_default=False),
    ] = None,
    source: Annotated[
        str, typer.Option("--from", metavar="FORMAT", help="Format of IN; default: by the end of its name.")
    ] = "",
    target: Annotated[
        str, typer.Option("--to", metavar="FORMAT", help="Format of the output; default: by the end of its name.")
    ] = "",
    out: Annotated[
        list[Path] | None,
        typer.Option("--out", help="File to write; the second of two is named after it, or given by a second --out."),
    ] = None,
    crs: Annotated[str, typer.Option(metavar="EPSG:N", help="CRS of IN, where the file does not say it.")] = "",
    to_crs: Annotated[str, typer.Option(metavar="EPSG:N", help="Transform the points to this CRS.")] = "",
    sigma_ground: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="EAST NORTH UP", help="Standard deviations of ground points without any, m."),
    ] = None,
    sigma_image: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LINE SAMPLE", help="Standard deviations of image points without any, pixels."),
    ] = None,
    height: Annotated[float | None, typer.Option(help="Height of points without one, m.")] = None,
    check: Annotated[
        list[str] | None, typer.Option("--check", metavar="ID", help="Make this a check point; may be repeated.")
    ] = None,
    image: Annotated[
        str, typer.Option(metavar="NAME", help="The image, of formats that hold one image without its name.")
    ] = "",
    sigma_axes: Annotated[
        str, typer.Option(metavar="ecef|enu", help="Axes of the standard deviations in ASP's .gcp.")
    ] = "ecef",
    image_size: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LINES,SAMPLES", help="Size of an image, for formats that need it; may be repeated."),
    ] = None,
    metadata: Annotated[
        list[Path] | None,
        typer.Option("--metadata", help="Metadata of an image: points far from all of them are refused."),
    ] = None,
    accept_unverified: Annotated[
        bool, typer.Option("--accept-unverified", help="Read a format that was never tried on a file of its program.")
    ] = False,
    formats: Annotated[bool, typer.Option("--formats", help="List the formats and end.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Bring ground and image points from one format into another.

    What the new format cannot hold is said, one line each.
    """
    with outcome(as_json, debug, quiet, log):
        from fg_orient.formats.exchange.convert import Fill, filled, placed, read_survey, write_survey
        from fg_orient.formats.exchange.registry import Settings, format_named, format_of
        from fg_orient.formats.exchange.registry import formats as all_formats

        if formats:
            _list(as_json)
            return
        if not files or not out:
            raise InputError.of("cli.usage", place="fg-orient convert", text="Give IN, --out and the formats")
        if sigma_axes not in ("ecef", "enu"):
            raise InputError.of("options.value", option="sigma_axes", value=sigma_axes, expected="ecef or enu")
        reader = format_named(source, place=Option("from")) if source else format_of(files[0], place=Option("from"))
        writer = format_named(target, place=Option("to")) if target else format_of(out[0], place=Option("to"))
        _require_crs(crs, "crs")
        _require_crs(to_crs, "to_crs")
        settings = Settings(crs, image, sigma_axes, _sizes(image_size or []))
        if reader.read_model is not None and writer.write_model is not None:
            _convert_model(files, reader, out[0], writer, settings, accept_unverified, overwrite, as_json)
            return
        if writer.write is None and writer.write_model is not None:
            known = ", ".join(name for name, f in all_formats().items() if f.read_model is not None)
            raise InputError.of("interchange.needs_model", file=out[0], option="to", value=writer.name,
                                source=reader.name, known=known)  # fmt: skip
        survey, remarks = read_survey(
            files, reader, settings, accept_unverified=accept_unverified, scenes=_scenes(metadata or [])
        )
        survey = filled(survey, Fill(sigma_ground, sigma_image, height, tuple(check or ())))
        survey = placed(survey, writer, to_crs, str(out[0]))
        settings = Settings(to_crs, image, sigma_axes, settings.image_sizes)
        written, lost = write_survey(survey, out, writer, settings, overwrite=overwrite)
        _show(survey, [reader.name, writer.name], written, remarks, lost, as_json)


def _require_crs(crs: str, option: str) -> None:
    """Refuse a CRS by the name of its option; none given is none wrong."""
    from fg_orient.geodesy import crs_kind

    try:
        if crs:
            crs_kind(crs)
    except InputError as error:
        raise InputError(*(replace(problem, place="", option=option) for problem in error.problems)) from None


def _convert_model(
    files: list[Path], reader: Format, out: Path, writer: Format, settings: Settings, accept: bool, overwrite: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Between formats that hold cameras and poses, the whole model."""
    from fg_orient.formats.exchange.models import convert_model
    from fg_orient.formats.exchange.ties import model_survey

    model, lost = convert_model(
        files, reader, out, writer, settings, accept_unverified=accept, overwrite=overwrite
    )  # fmt: skip
    survey = replace(model_survey(model), notes=model.notes)
    _show(survey, [reader.name, writer.name], (out,), (), lost, as_json)


def _sizes(words: list[str]) -> dict[str, tuple[int, int]]:
    """Sizes of images as given: lines, samples."""
    sizes = {}
    for word in words:
        name, _, size = word.rpartition("=")
        parts = size.split(",")
        if not name or len(parts) != 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
            raise InputError.of("interchange.image_size", option="image_size", value=word)
        sizes[name] = int(parts[0]), int(parts[1])
    return sizes


def _scenes(paths: list[Path]) -> list[Any]:
    from fg_orient.formats.scenes import Scene
    from fg_orient.formats.sensor import read_sensor

    return [Scene.from_footprint(path.name, read_sensor(path).footprint()) for path in paths]


def _show(
    survey: Survey,
    names: list[str],
    written: tuple[Path, ...],
    remarks: tuple[Finding, ...],
    lost: tuple[Finding, ...],
    as_json: bool,
) -> None:
    counts = {
        "points": len(survey.ids), "images": len(survey.images), "image_points": len(survey.observed),
        **{str(role): survey.roles.count(role) for role in dict.fromkeys(survey.roles)},
    }  # fmt: skip
    if as_json:
        emit({"from": names[0], "to": names[1], "out": [str(path) for path in written], **counts,
              "remarks": [p.as_dict(flag) for p in remarks], "lost": [p.as_dict(flag) for p in lost],
              "notes": list(map(str, survey.notes))})  # fmt: skip
        return
    for found in survey.notes:
        tell("note", found)
    for found in remarks:
        tell("remark", found)
    for found in lost:
        tell("lost", found)
    say(", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items()))
    for path in written:
        say(f"written: {path}")


def _list(as_json: bool) -> None:
    """List the formats with their conventions."""
    from fg_orient.formats.exchange.registry import formats

    found = formats().values()
    if as_json:
        emit({"formats": [
            {"name": f.name, "title": f.title, "files": f.files, "suffixes": f.suffixes, "first_pixel": f.first_pixel,
             "pixel_axes": f.pixel_axes, "ground_axes": f.ground_axes, "verified": f.verified, "evidence": f.evidence,
             "holds": sorted(f.holds), "reads": f.read is not None, "writes": f.write is not None}
            for f in found
        ]})  # fmt: skip
        return
    table("formats", ("name", "files", "first pixel", "verified"), [
        [f.name, ", ".join(f.files), "-" if f.first_pixel is None else "{:g}, {:g}".format(*f.first_pixel),
         "yes" if f.verified else "no"]
        for f in found
    ], left=2)  # fmt: skip
