"""Commands ``camera ...``: what is done with camera files alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome
from fg_orient.cli.output import emit, say
from fg_orient.model.errors import InputError

app = typer.Typer(
    help="Camera files: from one direction of the distortion polynomial to the other.", no_args_is_help=True
)


@app.callback()
def group() -> None:
    """Camera files: from one direction of the distortion polynomial to the other."""


@app.command("convert")
def convert(
    camera: Annotated[Path, typer.Argument(metavar="CAMERA.toml", help="Camera file.", show_default=False)],
    model: Annotated[
        str, typer.Option("--to", metavar="MODEL", help="brown_ideal_to_measured or brown_measured_to_ideal.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.toml", help="Camera file to write.")],
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Fit the distortion polynomial of the other direction over the whole image, and say what is left.

    Neither polynomial inverts the other: the largest and the rms difference in the image are part of the result.
    """
    with outcome(as_json, debug, quiet, log):
        from fg_orient.formats.camera import read_camera, write_camera
        from fg_orient.sensors.interior import converted

        if out.exists() and (not overwrite or out.samefile(camera)):
            raise InputError.of("output.exists", file=out, option="out")
        interior = read_camera(camera)
        found = converted(interior, model)
        write_camera(out, found.interior)
        if as_json:
            emit({"camera": interior.name, "from": interior.model, "to": model, "max_px": found.max_px,
                  "rms_px": found.rms_px, "out": str(out)})  # fmt: skip
            return
        say(f"{interior.name}: {interior.model} to {model}")
        say(f"difference over the whole image: {found.max_px:.3g} px at most, {found.rms_px:.3g} px rms")
        say(f"written: {out}")
