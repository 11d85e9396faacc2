"""Command ``replay``: the run of a result folder repeated from its record and compared."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.adjust import load
from fg_orient.cli.common import Debug, Json, Log, Overwrite, Quiet, outcome, table
from fg_orient.cli.output import emit, say, tell, verdict
from fg_orient.cli.progress import progress
from fg_orient.model.names import EXIT_CODE, Status

if TYPE_CHECKING:
    from fg_orient.run.replay import Replay

#: Differences shown to people; ``--json`` holds all.
SHOWN = 20


def replay(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of adjust.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", help="Result folder of the repeated run; default: DIR-replay, beside DIR.")
    ] = None,
    project: Annotated[
        Path | None,
        typer.Option("--project", metavar="PROJECT.toml", help="The project file, if it is not in the folder above."),
    ] = None,
    allow_changed: Annotated[
        bool, typer.Option("--allow-changed", help="Go on where inputs have changed since, and name them.")
    ] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Repeat a run from its record, same inputs and options, and compare every value of the result.

    Ends with 0 if all agree to the last bit (all but times), with 4 if any differs.
    """
    with outcome(as_json, debug, quiet, log):
        load()
        from fg_orient.run.replay import replay as repeat

        with progress() as watch:
            found = repeat(
                folder, out, project=project, allow_changed=allow_changed, overwrite=overwrite,
                callback=watch.iteration, stage=watch.stage,
            )  # fmt: skip
        if as_json:
            emit(found.as_dict())
        else:
            show(found)
        if not found.equal:
            raise typer.Exit(EXIT_CODE[Status.NOT_TRUSTWORTHY])


def show(found: Replay) -> None:
    """Print what had changed, what differs and where the repeated result lies."""
    for problem in found.inputs:
        tell("warning", f"{problem.file}: {problem.message}")
    for entry in found.versions:
        say(f"{entry['name']}: {entry['then'] or 'missing'} then, {entry['now'] or 'missing'} now")
    if found.differences:
        rows = [(d["key"], _word(d["then"]), _word(d["now"])) for d in found.differences[:SHOWN]]
        table(f"values that differ: {len(found.differences)} of {found.n_compared}", ("key", "then", "now"), rows)
        if len(found.differences) > SHOWN:
            say(f"the first {SHOWN}; --json gives all")
    for name, same in found.tables.items():
        if not same:
            say(f"{name} differs")
    words = f"{found.n_compared} values and {len(found.tables)} tables are the same, bit by bit"
    verdict(words if found.equal else "the repeated run differs", good=found.equal)
    if found.out is not None:
        say(f"written: {found.out}")


def _word(value: Any) -> str:
    return "-" if value is None else str(value) if not isinstance(value, float) else repr(value)
