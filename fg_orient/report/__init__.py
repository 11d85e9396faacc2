"""Reports: one self-contained HTML file made from a result folder.

The report reads the folder only, never the solution in memory, so that it can be made
again at any time (``fg-orient report DIR``) and shows what was really written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

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
        The file written.
    comparison : dict or None
        Estimated minus true; see :func:`fg_orient.report.truth.compare`.

    Raises
    ------
    InputError
        The folder holds no result, or the truth does not belong to it.
    """
    from fg_orient.formats.atomic import write_text
    from fg_orient.report.data import nothing_adjusted, read_record, read_result
    from fg_orient.report.html import render

    path = Path(folder) / REPORT_FILE
    record = read_record(Path(folder))
    if truth is None and nothing_adjusted(record):
        from fg_orient.report.deficient import render_deficient

        write_text(path, render_deficient(Path(folder), record))
        return path, None
    result = read_result(Path(folder))
    comparison = None
    if truth is not None:
        from fg_orient.report.truth import compare

        comparison = compare(result, Path(truth))
    write_text(path, render(result, comparison))
    return path, comparison
