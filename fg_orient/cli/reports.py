"""Command ``report``: HTML report, figures and map layers of a result folder, and the comparison with a truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, number, outcome, table
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of adjust or closerange.", show_default=False)],
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="TRUTHDIR", help="Folder truth of a simulation, to compare with.")
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures", help="Also draw every plot as SVG and PDF, into the folder DIR/figures.")
    ] = False,
    figures_out: Annotated[
        Path | None, typer.Option("--figures-out", metavar="FOLDER", help="Draw them into this folder instead.")
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option("--export", metavar="FILE", help="Write points, error vectors, footprints: .gpkg or .geojson."),
    ] = None,
    vector_scale: Annotated[
        float | None, typer.Option("--vector-scale", metavar="N", help="Enlarge the error vectors of --export N times.")
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write report.html of a result folder again; with --truth, compare with the simulated truth."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.closerange.report import is_closerange

        if is_closerange(folder):
            emit_or_show(_closerange(folder, figures, figures_out, overwrite, truth or export), as_json)
            return
        from fg_orient.report import write_report

        with progress_bar("writing the report"):
            path, comparison = write_report(folder, truth)
        record: dict[str, Any] = {"report": str(path), "truth": comparison}
        if figures or figures_out is not None:
            from fg_orient.report.write import write_figures

            with progress_bar("drawing the figures") as progress:
                drawn, names = write_figures(folder, figures_out, overwrite=overwrite, progress=progress)
            record["figures"] = {"folder": str(drawn), "files": names}
        if export is not None:
            from fg_orient.report.geofiles import export as write_layers

            with progress_bar("writing the layers"):
                features = write_layers(folder, export, vector_scale=vector_scale, overwrite=overwrite)
            record["export"] = {"file": str(export), "features": features}
        emit_or_show(record, as_json)


def emit_or_show(record: dict[str, Any], as_json: bool) -> None:
    """Print a record as JSON or in words."""
    if as_json:
        emit(record)
    else:
        _show(record)


def _closerange(
    folder: Path, figures: bool, figures_out: Path | None, overwrite: bool, foreign: Path | None
) -> dict[str, Any]:
    """Report and figures of a close-range folder, which has neither a truth nor geographic layers."""
    from fg_orient.closerange.report import write_report

    if foreign is not None:
        raise InputError.of("closerange.no_layers", file=folder, option="truth, export", value=foreign)
    with progress_bar("writing the report"):
        record: dict[str, Any] = {"report": str(write_report(folder)), "truth": None}
    if figures or figures_out is not None:
        from fg_orient.closerange.figures import write_figures

        with progress_bar("drawing the figures") as progress:
            drawn, names = write_figures(folder, figures_out, overwrite=overwrite, progress=progress)
        record["figures"] = {"folder": str(drawn), "files": names}
    return record


def _show(record: dict[str, Any]) -> None:
    """Print the comparison with the truth and what was written."""
    if record["truth"] is not None:
        rows = [
            (g["name"], g["n"], number(g["rms_normalised"]), number(g["max_normalised"]))
            for g in record["truth"]["groups"]
        ]
        table("estimated minus true, in predicted standard deviations", ("what", "n", "RMS", "largest"), rows)
    say(f"report: {record['report']}")
    if "export" in record:
        layers = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in record["export"]["features"].items())
        say(f"layers: {record['export']['file']} ({layers})")
    if "figures" in record:
        say(f"figures: {record['figures']['folder']} ({len(record['figures']['files'])} files)")
