"""Command ``match``: measure tie points in the pixels of a project's images."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from fg_orient.cli.command import (
    Dem,
    Overwrite,
    Project,
    VerticalCrs,
    command,
    command_line,
    option,
    require_project,
)
from fg_orient.cli.output import answer, number, say, table, tell, tell_findings
from fg_orient.cli.progress import progress_bar
from fg_orient.orientation.match.options import MatchOptions


@command(MatchOptions)
def match(
    project: Project,
    options: Mapping[str, Any],
    dem: Dem = None,
    dem_vertical_crs: VerticalCrs = "",
    control: Annotated[
        Path | None,
        option(
            "Control points to measure with chips: GeoPackage or table; ID.tif beside it or in a folder of its name."
        ),
    ] = None,
    workers: Annotated[int, option("Number of processes; the result does not depend on it.", "N", min=1)] = 1,
    out: Annotated[Path | None, option("Folder of the quality report; default: match, beside the project.")] = None,
    overwrite: Overwrite = False,
    resume: Annotated[
        bool, option("Continue from the finished parts of a run that was stopped.", flag="--resume")
    ] = False,
) -> None:
    """Measure tie points in the pixels of the images; add them to the tables of the project.

    The sensor models, the heights and the prior sigmas restrict the search. Each point gets the
    standard deviation of least-squares matching, times a factor that is estimated from the
    y-parallaxes.
    """
    require_project(project)
    from fg_orient.orientation.match.job import match_project

    with progress_bar("matching") as callback:
        record = match_project(
            project, out, options=MatchOptions(**options), dem=dem, vertical_crs=dem_vertical_crs, workers=workers,
            overwrite=overwrite, resume=resume, control=control, progress=callback, command=command_line(),
            warn=partial(tell, "warning"),
        )  # fmt: skip
    answer(record, _show)


def _show(record: dict[str, Any]) -> None:
    """Print the numbers of points and pairs, and the written files."""
    tell_findings(record)
    rays = ", ".join(f"{n} with {k} rays" for k, n in record["rays"].items())
    say(f"{record['n_points']} tie points ({rays}), {record['n_image_points']} image points")
    table("y-parallax, px", ("pair", "points", "RMS before", "RMS after", "sigma factor", "wrong, predicted"), [
        [f"{p['a']} - {p['b']}", p["accepted"], number(p["y_parallax_before_rms_px"]),
         number(p["y_parallax_after_rms_px"]), number(p["sigma_factor"], 2), number(p["predicted_wrong"], 1)]
        for p in record["pairs"]
    ])  # fmt: skip
    table("points in the images", ("image", "points", "mean rays", "cells with points"), [
        [i["id"], i["points"], number(i["mean_rays"], 2), f"{i['cells_with_points']} of {i['cells']}"]
        for i in record["images"]
    ])  # fmt: skip
    if "control" in record:
        c = record["control"]
        say(f"control points: {c['measured']} of {c['points']} measured, {c['image_points']} image points")
    say(f"sigma of an image point: median {number(record['sigma_px']['median'])} px")
    say(f"written: {', '.join(record['files'])}")
    say(f"report: {Path(record['out']) / 'report.html'}")
