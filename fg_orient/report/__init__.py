"""Reports: one self-contained HTML file made from a result folder.

The report is made from the record of a result (``fg_orient.result``), never from the solution. The page
of a record in memory is therefore the page of its folder (``fg-orient report DIR``).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from fg_orient.result.record import Result

REPORT_FILE: Final = "report.html"


def write_report(folder: str | Path, truth: str | Path | None = None) -> tuple[Path, dict[str, Any] | None]:
    """Write ``report.html`` of a result folder, whole or not at all.

    Parameters
    ----------
    folder : path
        Result folder of ``adjust``.
    truth : path, optional
        Folder ``truth`` of a simulation; adds a comparison with it.

    Returns
    -------
    path : Path
        File that was written.
    comparison : dict or None
        Estimated minus true; see :func:`fg_orient.report.tables.compare_truth`.

    Raises
    ------
    InputError
        The folder contains no result, or the truth belongs to another project.
    """
    from fg_orient.formats.load import foreign_bytes
    from fg_orient.result.record import read_any_result, read_result

    result, comparison = (read_any_result(Path(folder)) if truth is None else read_result(folder)), None
    with foreign_bytes("report.damaged", folder):
        if truth is not None:
            from fg_orient.report.tables import compare_truth

            comparison = compare_truth(result, Path(truth))
        return write_page(Path(folder), result, comparison), comparison


def write_page(folder: Path, result: Result, comparison: dict[str, Any] | None = None) -> Path:
    """Write the page of a result into a folder, whole or not at all."""
    from fg_orient.formats.atomic import write_text
    from fg_orient.report.html import render

    write_text(folder / REPORT_FILE, render(result, comparison, folder))
    return folder / REPORT_FILE
