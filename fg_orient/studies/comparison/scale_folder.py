"""Run a study of sizes and write its folder: tables, figures for papers, page and record."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.atomic import Contents, require_free
from fg_orient.model.errors import as_record
from fg_orient.model.installation import stamp
from fg_orient.model.names import Progress
from fg_orient.report.figures import CAPTIONS_FILE, draw_figures, require_matplotlib
from fg_orient.result.plain import csv_of_records, dumps, plain
from fg_orient.studies.comparison.scale import scale, sizes_of
from fg_orient.studies.comparison.scale_page import captions, charts, growth_files, page

SCHEMA_VERSION: Final = 1
#: Files of the tables by the keys of the record.
TABLES: Final = {"rows": "scale.csv", "orderings": "orderings.csv", "exponents": "exponents.csv"}
#: Contents of the folder of a study.
SCALE: Final = Contents(
    "scale.csv", (*TABLES.values(), "result.json", "scale.md", CAPTIONS_FILE, "*.svg", "*.pdf")
)  # fmt: skip


def scale_to(
    out: str | Path, *, overwrite: bool = False, options: Mapping[str, Any] | None = None,
    callback: Progress | None = None, command: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """Run the study and write the folder.

    Parameters
    ----------
    out : path
        Folder to write. A hidden folder next to it contains the finished sizes until it is written.
    overwrite : bool
        Replace an existing folder of this kind when the new one is complete.
    options : mapping, optional
        Arguments of :func:`fg_orient.studies.comparison.scale.scale`.
    callback : callable, optional
        Called with (done, of, text) after each size.
    command : sequence of str
        The command line, for the record.

    Returns
    -------
    dict
        The record of the study.

    Raises
    ------
    InputError
        An option or the output folder cannot be used, or matplotlib is not installed.
    """
    require_matplotlib()
    target = Path(out)
    require_free(target, overwrite=overwrite, contents=SCALE)
    given = dict(options or {})
    sizes_of(given.get("sizes", "10"))
    kept = target.absolute().with_name(f".{target.name}.sizes")
    found = scale(callback=callback, folder=kept, **given)
    record: dict[str, Any] = plain({
        "schema": SCHEMA_VERSION, "kind": "scale", **found, "date": datetime.now(UTC).date().isoformat(),
        "command": " ".join(stamp(command)["command"]), "out": target.name, "provenance": stamp(command),
        **as_record([]),
    })  # fmt: skip
    files = {name: csv_of_records(record[key]) for key, name in TABLES.items()}
    files |= {"result.json": (dumps(record, indent=1) + "\n").encode(), "scale.md": page(record).encode()}
    grown = growth_files(record)
    draw_figures(
        charts(record), lambda shown: captions([*dict.fromkeys(Path(name).stem for name in grown), *shown]), target,
        overwrite=overwrite, contents=SCALE, more=files | grown,
    )  # fmt: skip
    shutil.rmtree(kept, ignore_errors=True)
    return record | {"out": str(out)}
