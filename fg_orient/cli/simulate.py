"""Commands ``simulate zonguldak``, ``block`` and ``mixed``: synthetic data in the real file formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar
from fg_orient.errors import InputError

app = typer.Typer(help="Write synthetic projects in the real file formats, with the truth beside them.")

Seed = Annotated[int, typer.Option(help="Seed of all random numbers.")]
ImageNoise = Annotated[float, typer.Option(metavar="PX", help="Sigma of the noise in line and in sample, pixels.")]


@app.command("zonguldak")
def zonguldak(
    seed: Seed = 1,
    point_set: Annotated[str, typer.Option(help="H-0, H-10, H-20, H-30, H-40, G-A, G-B or G-C.")] = "H-10",
    image_noise: ImageNoise = 0.3,
    errors: Annotated[
        str, typer.Option(metavar="constant|prior|none", help="Errors of the metadata's orientation.")
    ] = "constant",
    distortion: Annotated[
        float, typer.Option(metavar="RAD", help="True look angles exceed the file's by this s^2, rad.")
    ] = 0.0,
    radial_velocity: Annotated[
        float, typer.Option(metavar="M/S", help="Rate of the distance from the geocentre, m/s.")
    ] = 0.0,
    attitude: Annotated[
        str,
        typer.Option(
            metavar="ROLL,PITCH,YAW", help="True attitude, rad, for instance --attitude=-1.6e-4,-7.2e-4,9e-4."
        ),
    ] = "0,0,0",
    dem: Annotated[bool, typer.Option("--dem", help="Write dem.tif, a terrain through the points.")] = False,
    raster: Annotated[
        bool, typer.Option("--raster", help="Render the images on this terrain (12000 x 12000, minutes); writes both.")
    ] = False,
    dem_step: Annotated[float, typer.Option(metavar="M", help="Edge of the DEM's cells, m.")] = 30.0,
    raster_window: Annotated[
        int, typer.Option(metavar="PX", help="Render only squares of this size about the points; 0: all pixels.")
    ] = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")] = Path("zonguldak"),
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write the Zonguldak twin: a SPOT-5 stereo pair with 47 points, and its truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.simulate.render import RasterOptions
        from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak

        options = ZonguldakOptions(
            seed=seed, point_set=point_set, image_noise_px=image_noise, errors=errors, distortion_rad=distortion,
            radial_velocity_m_s=radial_velocity, attitude_rad=_three(attitude),
        )  # fmt: skip
        images = raster or raster_window != 0
        rasters = RasterOptions(images, raster_window, dem_step) if dem or images else None
        with progress_bar("rendering" if images else "simulating") as progress:
            project = simulate_zonguldak(out, options, overwrite=overwrite, rasters=rasters, progress=progress)
        _tell(project, as_json)


@app.command("block")
def block(
    rows: Annotated[int, typer.Option(help="Rows of scenes, 1-20.")] = 2,
    columns: Annotated[int, typer.Option(help="Columns of scenes, 1-20.")] = 2,
    points: Annotated[int, typer.Option(help="Ground points, each seen twice or more.")] = 400,
    seed: Seed = 1,
    spacing: Annotated[float, typer.Option(metavar="M", help="Distance of neighbouring scenes, m.")] = 28e3,
    roll: Annotated[float, typer.Option(metavar="DEG", help="Mirror angle, to both sides in turn, degrees.")] = 12.0,
    control_share: Annotated[float, typer.Option(help="Share of control points (at least 6 points).")] = 0.02,
    check_share: Annotated[float, typer.Option(help="Share of check points; the rest are tie points.")] = 0.1,
    image_noise: ImageNoise = 0.3,
    errors: Annotated[
        str, typer.Option(metavar="prior|constant|none", help="Errors of the metadata's orientation.")
    ] = "prior",
    max_height: Annotated[float, typer.Option(metavar="M", help="Heights are uniform from 0 to this, m.")] = 500.0,
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")] = Path("block"),
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a block of overlapping SPOT-5-like scenes of any size, and its truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.simulate.block import BlockOptions, simulate_block

        options = BlockOptions(
            rows=rows, columns=columns, points=points, seed=seed, spacing_m=spacing, roll_deg=roll,
            control_share=control_share, check_share=check_share, image_noise_px=image_noise, errors=errors,
            max_height_m=max_height,
        )  # fmt: skip
        with progress_bar("simulating") as progress:
            project = simulate_block(out, options, overwrite=overwrite, progress=progress)
        _tell(project, as_json)


@app.command("mixed")
def mixed(
    points: Annotated[int, typer.Option(help="Ground points in all.")] = 90,
    control: Annotated[int, typer.Option(help="Of them control points.")] = 8,
    check: Annotated[int, typer.Option(help="Of them check points; the rest are tie points.")] = 12,
    seed: Seed = 1,
    spot_noise: Annotated[float, typer.Option(metavar="PX", help="Noise of the SPOT-5 images, pixels.")] = 0.4,
    rpc_noise: Annotated[float, typer.Option(metavar="PX", help="Noise of the RPC images, pixels.")] = 0.3,
    frame_noise: Annotated[float, typer.Option(metavar="PX", help="Noise of the frame images, pixels.")] = 0.5,
    errors: Annotated[str, typer.Option(metavar="prior|none", help="Errors of the orientation.")] = "prior",
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")] = Path("mixed"),
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a mixed block, two SPOT-5, two RPC and four frame images over one window, and its truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.simulate.mixed import MixedOptions
        from fg_orient.simulate.mixed_files import simulate_mixed

        options = MixedOptions(
            seed=seed, points=points, control=control, check=check, spot_noise_px=spot_noise, rpc_noise_px=rpc_noise,
            frame_noise_px=frame_noise, errors=errors,
        )  # fmt: skip
        with progress_bar("simulating"):
            project = simulate_mixed(out, options, overwrite=overwrite)
        _tell(project, as_json)


def _three(text: str) -> tuple[float, float, float]:
    try:
        roll, pitch, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError.of("cli.three_numbers", option="attitude", value=text) from None
    return roll, pitch, yaw


def _tell(project: Path, as_json: bool) -> None:
    """Name what was written and what to do next."""
    if as_json:
        emit({"out": str(project.parent), "project": str(project), "truth": str(project.parent / "truth")})
        return
    say(f"written: {project.parent} (the truth lies in truth/ and is read by nothing but report --truth)")
    say(f"next: fg-orient adjust {project}")
