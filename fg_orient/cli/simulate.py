"""Commands ``simulate zonguldak``, ``block`` and ``mixed``: synthetic data in the real file formats."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome
from fg_orient.cli.options import flags, named_as_typed, with_options
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar
from fg_orient.simulate.options import BlockOptions, MixedOptions, ZonguldakOptions

Record = TypeVar("Record")

app = typer.Typer(help="Write synthetic projects in the real file formats, with the truth beside them.")


@app.command("zonguldak")
@with_options(ZonguldakOptions)
def zonguldak(
    options: Mapping[str, Any],
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
        from fg_orient.simulate.zonguldak import simulate_zonguldak

        chosen = _made(ZonguldakOptions, options)
        images = raster or raster_window != 0
        rasters = RasterOptions(images, raster_window, dem_step) if dem or images else None
        with progress_bar("rendering" if images else "simulating") as progress:
            project = simulate_zonguldak(out, chosen, overwrite=overwrite, rasters=rasters, progress=progress)
        _tell(project, as_json)


@app.command("block")
@with_options(BlockOptions)
def block(
    options: Mapping[str, Any],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")] = Path("block"),
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a block of overlapping SPOT-5-like scenes of any size, and its truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.simulate.block import simulate_block

        chosen = _made(BlockOptions, options)
        with progress_bar("simulating") as progress:
            project = simulate_block(out, chosen, overwrite=overwrite, progress=progress)
        _tell(project, as_json)


@app.command("mixed")
@with_options(MixedOptions)
def mixed(
    options: Mapping[str, Any],
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")] = Path("mixed"),
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a mixed block, two SPOT-5, two RPC and four frame images over one window, and its truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.simulate.mixed_files import simulate_mixed

        chosen = _made(MixedOptions, options)
        with progress_bar("simulating"):
            project = simulate_mixed(out, chosen, overwrite=overwrite)
        _tell(project, as_json)


def _made(record: type[Record], given: Mapping[str, Any]) -> Record:
    """Make the options of a simulation; errors name them as they are typed."""
    with named_as_typed(flags(record)):
        return record(**given)


def _tell(project: Path, as_json: bool) -> None:
    """Name what was written and what to do next."""
    if as_json:
        emit({"out": str(project.parent), "project": str(project), "truth": str(project.parent / "truth")})
        return
    say(f"written: {project.parent} (the truth lies in truth/ and is read by nothing but report --truth)")
    say(f"next: fg-orient adjust {project}")
