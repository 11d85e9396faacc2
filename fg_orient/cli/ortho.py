"""Command ``rectify ortho``: an image on a DEM to a map raster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fg_orient.cli.common import Debug, Extrapolate, Json, Log, Overwrite, Quiet, outcome
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.rectification.grid import Bounds


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
    result: Annotated[
        Path | None, typer.Option("--result", metavar="DIR", help="Result folder of adjust: use its orientation.")
    ] = None,
    image_id: Annotated[str, typer.Option("--image-id", metavar="ID", help="Image in it; usual: by file name.")] = "",
    crs: Annotated[str, typer.Option("--crs", metavar="EPSG", help="Of the map; usual: that of the DEM or fit.")] = "",
    resolution: Annotated[
        float | None, typer.Option(metavar="SIZE", help="Of a map pixel; usual: about a pixel of the image.")
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
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Rectify an image on a DEM (or a plane) to a GeoTIFF: by its sensor, adjusted or not, or by points."""
    with outcome(as_json, debug, quiet, log):
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
        if as_json:
            emit(record)
            return
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
