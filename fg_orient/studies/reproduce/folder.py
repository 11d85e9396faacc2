"""Writes a reproduction as a folder: ``cells.csv``, ``claims.csv``, ``result.json``, ``report.html``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.model.installation import stamp
from fg_orient.result.plain import dumps, plain, write_records, write_rows
from fg_orient.studies.published.tables import require_source
from fg_orient.studies.reproduce.html import render
from fg_orient.studies.reproduce.reproduction import Callback, Reproduction, reproduce

#: Contents of the folder; result.json identifies it.
CONTENTS: Final = Contents("result.json", ("result.json", "cells.csv", "claims.csv", "report.html"))
SCHEMA_VERSION: Final = 2


def reproduce_to(
    name: str, out: Path | None = None, *, overwrite: bool = False, callback: Callback | None = None,
    command: Sequence[str] = (), **options: Any,
) -> tuple[Reproduction, dict[str, Any]]:  # fmt: skip
    """Reproduce a publication and write the folder.

    Parameters
    ----------
    out : Path, optional
        Folder to make; default "reproduced-" and the name.
    overwrite : bool
        Replace the folder of an earlier reproduction.
    command : sequence of str
        Command line, for the record.
    name, callback, **options
        See :func:`fg_orient.studies.reproduce.reproduction.reproduce`.

    Returns
    -------
    Reproduction, dict
        All rows and claims, and the record for the JSON output of the command.

    Raises
    ------
    InputError
        Bad options, damaged published tables, or an output that cannot be written.
    """
    require_source(name)
    target = out or Path(f"reproduced-{name}")
    require_free(target, overwrite=overwrite, contents=CONTENTS)
    result = reproduce(name, callback=callback, **options)
    with staged_folder(target, overwrite=overwrite, contents=CONTENTS) as folder, writing(target):
        _write(folder, result, command)
    return result, as_record(result) | {"out": str(target)}


def as_record(result: Reproduction) -> dict[str, Any]:
    """Rows and claims as plain values; numbers that are not finite become None."""
    rows = [plain(row.as_dict()) for row in result.rows]
    return {"rows": rows, "claims": [plain(asdict(claim)) for claim in result.claims]}


def _write(folder: Path, result: Reproduction, command: Sequence[str]) -> None:
    rows = [row.as_dict() for row in result.rows]
    write_records(folder / "cells.csv", rows)
    claims = [asdict(c) | {"low": c.interval[0], "high": c.interval[1]} for c in result.claims]
    columns = ("id", "passed", "of", "low", "high", "met", "text", "reason")
    write_rows(folder / "claims.csv", columns, ([claim[name] for name in columns] for claim in claims))
    record = {
        "schema": SCHEMA_VERSION,
        "source": result.source.name,
        "title": result.source.title,
        "about": result.source.about,
        "options": result.options,
        "verdicts": result.counts(),
        "shuffled": result.shuffled(),
        "gained": result.gained(),
        "tables": {
            table: {
                "title": title,
                "verdicts": result.counts(table),
                "shuffled": result.shuffled(table),
                "gained": result.gained(table),
            }
            for table, title in result.titles.items()
        },
        "claims": as_record(result)["claims"],
        "published_sha256": result.sha256,
        **stamp(command),
    }
    (folder / "result.json").write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(render(result, record), encoding="utf-8")
