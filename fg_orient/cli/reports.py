"""Command ``report``: the HTML report of a result folder, and the comparison with a simulated truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fg_orient.cli.common import Debug, Json, emit, number, outcome, say, table


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of adjust.", show_default=False)],
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="TRUTHDIR", help="Folder truth of a simulation, to compare with.")
    ] = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write report.html of a result folder again; with --truth, compare with the simulated truth."""
    with outcome(as_json, debug):
        from fg_orient.report import write_report

        path, comparison = write_report(folder, truth)
        if as_json:
            emit({"report": str(path), "truth": comparison})
            return
        if comparison is not None:
            rows = [
                (g["name"], g["n"], number(g["rms_normalised"]), number(g["max_normalised"]))
                for g in comparison["groups"]
            ]
            table("estimated minus true, in predicted standard deviations", ("what", "n", "RMS", "largest"), rows)
        say(f"report: {path}")
