"""Command ``reproduce``: published numbers beside reproduced ones, with a verdict each."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome, table
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar

if TYPE_CHECKING:
    from fg_orient.studies.reproduce.reproduction import Reproduction


def reproduce(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="terlemezoglu2019, topan2010, ipbuker1994, ayhan1996.", show_default=False
        ),
    ],
    tables: Annotated[
        str, typer.Option(metavar="TABLES", help="Tables and ranges: 4.3-4.9,4.28; all if not given.")
    ] = "",
    seeds: Annotated[int, typer.Option(metavar="N", help="Twins, with the seeds 1 to N.")] = 10,
    as_run: Annotated[
        bool,
        typer.Option("--as-run", help="As the authors' program works, on a twin with radial velocity and attitude."),
    ] = False,
    claims: Annotated[bool, typer.Option(help="Judge the claims about the publication, too.")] = True,
    published: Annotated[
        Path | None, typer.Option("--published", metavar="DIR", help="Other folder of published tables (CSV).")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="FILE_OR_FOLDER", help="Control points of SPOT-6 (tables 4.35-4.55)."),
    ] = None,
    permutations: Annotated[int, typer.Option(metavar="N", help="Orders of these points, with the seeds 1 to N.")] = 50,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results; default: reproduced-SOURCE.")
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Run a published study again on the synthetic twin and compare, table by table."""
    with outcome(as_json, debug, quiet, log):
        from fg_orient.studies.reproduce.folder import reproduce_to

        with progress_bar("tables") as callback:
            found, record = reproduce_to(
                source, out, overwrite=overwrite, callback=callback,
                command=["fg-orient", *sys.argv[1:]], tables=tables, n_seeds=seeds, as_run=as_run, claims=claims,
                published=published, data=data, permutations=permutations,
            )  # fmt: skip
        if as_json:
            emit(record)
        else:
            _show(found, Path(record["out"]))


def _show(found: Reproduction, out: Path) -> None:
    """Print verdicts by table, claims, and where the result lies."""
    from fg_orient.studies.reproduce.html import LEGEND, verdict

    words = verdict(found)
    say(words["title"])
    say(words["text"])
    say()
    rows = [
        (name, sum(found.counts(name).values()), *(found.counts(name)[kind] or "" for kind in LEGEND))
        for name in found.titles
    ]
    table(
        "cells by verdict",
        ("table", "cells", *("not repr." if kind == "not_reproducible" else kind for kind in LEGEND)),
        rows,
    )
    judged = [
        (c.id, f"{c.passed}/{c.of}", f"{c.interval[0]:.2f}-{c.interval[1]:.2f}", "met" if c.met else "not met",
         c.reason or c.text)
        for c in found.claims
    ]  # fmt: skip
    if judged:
        table("claims", ("id", "seeds", "95 %", "", "claim"), judged, left=5)
    say(f"report: {out / 'report.html'}")
