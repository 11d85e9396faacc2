"""Command ``accuracy``: heights of a result against a reference elevation model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Quiet, number, outcome, table
from fg_orient.cli.output import emit, say, tell_findings
from fg_orient.cli.progress import progress_bar


def accuracy(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of adjust.", show_default=False)],
    dem: Annotated[
        Path,
        typer.Option("--dem", help="Reference DEM of ellipsoidal heights, any raster GDAL reads.", show_default=False),
    ],
    role: Annotated[str | None, typer.Option("--role", help="Only points of this role: control, check or tie.")] = None,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Compare the heights of adjusted points with a DEM: bias, scatter, and the shift that explains them."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.quality.dem_accuracy import compare_dem, rows_of_role
        from fg_orient.report.data import read_result
        from fg_orient.sensors.surface import RasterDem

        points = read_result(folder).points
        chosen = rows_of_role(points.words["role"], role)
        with progress_bar("comparing"):
            found = compare_dem(points.numbers("x_m", "y_m", "z_m")[chosen], RasterDem(dem)).as_dict()
        if as_json:
            emit(found)
            return
        shift = found["shift"]
        rows = [(key, str(value) if isinstance(value, int) else number(value)) for key, value in found.items()
                if isinstance(value, (int, float))]  # fmt: skip
        table("adjusted minus reference height", ("figure", "value"), rows)
        if shift is not None:
            significant = shift["significant"]
            shifts = [
                (a, number(shift[f"{a}_m"]), number(shift[f"sigma_{a}_m"]), "yes" if a in significant else "no")
                for a in ("east", "north", "up")
            ]
            table("shift of the points against the reference, m", ("axis", "shift", "sigma", "significant"), shifts)
            before, after = number(shift["rmse_before_m"]), number(shift["rmse_after_m"])
            say(f"RMSE of {shift['n']} points: {before} m, without the shift {after} m")
        tell_findings(found)
