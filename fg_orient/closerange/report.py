"""Report of close range: one self-contained HTML file made from the record of a command.

The page is made from ``closerange.json`` alone, so that ``fg-orient report DIR`` writes it again at any time.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from fg_orient.model.errors import InputError

#: Record that makes a folder one of close range, and the page in it.
RECORD_FILE: Final = "closerange.json"
REPORT_FILE: Final = "report.html"


def is_closerange(folder: Path) -> bool:
    """Whether a folder holds a result of close range."""
    return (folder / RECORD_FILE).is_file()


def read_record(folder: Path) -> dict[str, Any]:
    """Record of a folder; InputError if it is missing or damaged, or of a version that has no report."""
    path = folder / RECORD_FILE
    try:
        record = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError.of("report.damaged", file=path, value=error) from None
    if not isinstance(record, dict) or "report" not in record:
        raise InputError.of("report.damaged", file=path, value="written by an earlier version")
    return record


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` of a close-range folder, whole or not at all; path of the file."""
    from fg_orient.closerange.report_html import render
    from fg_orient.formats.atomic import write_text

    path = Path(folder) / REPORT_FILE
    write_text(path, render(read_record(Path(folder))))
    return path
