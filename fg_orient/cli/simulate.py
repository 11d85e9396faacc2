"""Commands ``simulate zonguldak``, ``block`` and ``mixed``: write synthetic data in the real file formats."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.command import Overwrite, command, option
from fg_orient.cli.output import answer, say
from fg_orient.cli.progress import progress_bar
from fg_orient.simulate.options import BlockOptions, MixedOptions, ZonguldakOptions

app = typer.Typer(help="Write synthetic projects in the real file formats, with the truth in a folder.")


@app.command("zonguldak")
@command(ZonguldakOptions)
def zonguldak(
    options: Mapping[str, Any],
    dem: Annotated[bool, option("Write dem.tif, a terrain that contains the points.", flag="--dem")] = False,
    raster: Annotated[
        bool,
        option(
            "Render the images on this terrain (12000 x 12000 pixels, takes minutes); also writes dem.tif.",
            flag="--raster",
        ),
    ] = False,
    dem_step: Annotated[float, option("Cell size of the DEM, m.", "M")] = 30.0,
    raster_window: Annotated[
        int, option("Render only squares of this size around the points; 0: all pixels.", "PX")
    ] = 0,
    out: Annotated[Path, option("Folder to write.")] = Path("zonguldak"),
    overwrite: Overwrite = False,
) -> None:
    """Write the Zonguldak twin: a SPOT-5 stereo pair with 47 points, and its truth."""
    from fg_orient.simulate.render import RasterOptions
    from fg_orient.simulate.zonguldak import simulate_zonguldak

    chosen = ZonguldakOptions(**options)
    images = raster or raster_window != 0
    rasters = RasterOptions(images, raster_window, dem_step) if dem or images else None
    with progress_bar("rendering" if images else "simulating") as progress:
        project = simulate_zonguldak(out, chosen, overwrite=overwrite, rasters=rasters, progress=progress)
    _name(project)


@app.command("block")
@command(BlockOptions)
def block(
    options: Mapping[str, Any],
    out: Annotated[Path, option("Folder to write.")] = Path("block"),
    overwrite: Overwrite = False,
) -> None:
    """Write a block of overlapping SPOT-5-like scenes of any size, and its truth."""
    from fg_orient.simulate.block import simulate_block

    chosen = BlockOptions(**options)
    with progress_bar("simulating") as progress:
        project = simulate_block(out, chosen, overwrite=overwrite, progress=progress)
    _name(project)


@app.command("mixed")
@command(MixedOptions)
def mixed(
    options: Mapping[str, Any],
    out: Annotated[Path, option("Folder to write.")] = Path("mixed"),
    overwrite: Overwrite = False,
) -> None:
    """Write a mixed block, two SPOT-5, two RPC and four frame images over one window, and its truth."""
    from fg_orient.simulate.mixed import simulate_mixed

    chosen = MixedOptions(**options)
    with progress_bar("simulating"):
        project = simulate_mixed(out, chosen, overwrite=overwrite)
    _name(project)


def _name(project: Path) -> None:
    """Print the written files and the next command."""
    folder = project.parent
    answer({"out": str(folder), "project": str(project), "truth": str(folder / "truth")}, _show, project)


def _show(project: Path) -> None:
    say(f"written: {project.parent} (the true values are in truth/; only report --truth reads them)")
    say(f"next: fg-orient adjust {project}")
