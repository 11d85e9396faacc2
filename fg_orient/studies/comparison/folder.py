"""Compare a project and write the folder of the comparison: tables, figures, record and report."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, fields
from pathlib import Path
from typing import Any, Final

from factors._preparation import working_clock
from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.formats.project import read_project
from fg_orient.model.errors import Finding, NoSolutionError, as_record, finding
from fg_orient.model.names import Progress
from fg_orient.model.parameters import with_options
from fg_orient.report.paper import available
from fg_orient.result.plain import dumps, plain, write_rows
from fg_orient.result.provenance import provenance
from fg_orient.studies.comparison import plots, reference
from fg_orient.studies.comparison.compare import compare
from fg_orient.studies.comparison.model import COLUMNS, Comparison
from fg_orient.studies.comparison.report import render, summaries, verdict
from fg_orient.studies.comparison.selections import SELECTIONS
from fg_orient.studies.comparison.set_results import SetResult

SCHEMA_VERSION: Final = 2
#: These options of a comparison replace options of the project file.
OF_BLOCK: Final = ("memory_limit_gb", "priors")
#: Contents of a comparison folder.
COMPARISON: Final = Contents(
    "compare.csv",
    (
        "compare.csv",
        "sets.csv",
        "spectra.csv",
        "directions.csv",
        "l_curves.csv",
        "error_vectors.csv",
        "result.json",
        "*.svg",
        "report.html",
    ),
)
SET_COLUMNS: Final = tuple(f.name for f in fields(SetResult))
SPECTRUM_COLUMNS: Final = ("eop_set", "system", "scaling", "index", "singular_value")
DIRECTION_COLUMNS: Final = ("eop_set", "image", "direction", "held_by")
#: Columns of the L-curves. ``rule`` is the rule that chose this kappa; it is empty for other points of a curve.
CURVE_COLUMNS: Final = ("eop_set", "type", "rule", "kappa", "residual_norm", "solution_norm")
#: Columns of error vectors: computed minus measured, in the axes at the middle of the control points.
VECTOR_COLUMNS: Final = ("eop_set", "type", "solver", "role", "id", "east_m", "north_m", "up_m")


def compare_project(
    project: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    options: Mapping[str, Any] | None = None,
    callback: Progress | None = None,
    command: Sequence[str] = (),
) -> dict[str, Any]:
    """Read a project, compare and write the folder.

    Parameters
    ----------
    project : path
        Project file (TOML).
    out : path
        Folder to write.
    overwrite : bool
        Replace an existing comparison folder when the new one is complete.
    options : mapping, optional
        Arguments of :func:`fg_orient.compare`, and :data:`OF_BLOCK`. With workers, a
        hidden folder next to ``out`` contains the finished sets until ``out`` is written.
    callback : callable, optional
        Called with (done, of, text) after each adjustment.
    command : sequence of str
        The command line, for the record.

    Returns
    -------
    dict
        The record of the command ``compare``.

    Raises
    ------
    InputError
        The project, an option or the output folder cannot be used.
    NoSolutionError
        No adjustment has a solution; nothing is written.
    """
    start = working_clock()
    require_free(Path(out), overwrite=overwrite, contents=COMPARISON)
    given = dict(options or {})
    for name in [name for name in SELECTIONS if name in given]:  # checked before any file is read
        SELECTIONS[name](given[name])
    of_block = {name: given.pop(name, None) for name in OF_BLOCK}
    block = with_options(read_project(project), "compare", **of_block)
    read_s = working_clock() - start
    shared = given.get("workers", 0) > 1 or given.get("cluster") is not None
    kept = Path(out).absolute().with_name(f".{Path(out).name}.sets") if shared else None
    comparison = compare(block, callback=callback, folder=kept, **given)
    if all(row.failure for row in comparison.rows):
        raise NoSolutionError.of(
            "compare.no_solution", file=project, count=len(comparison.rows), why=comparison.rows[0].failure
        )
    record = _record(comparison, Path(project), Path(out), command)
    with staged_folder(out, overwrite=overwrite, contents=COMPARISON) as folder:
        mark = working_clock()
        drawn = plots.figures(comparison)
        end = working_clock()
        record["seconds"] = {"read": read_s, "compare": comparison.seconds, "figures": end - mark, "total": end - start}
        with writing(out):
            write_folder(folder, comparison, record, drawn)
    if kept is not None:
        shutil.rmtree(kept, ignore_errors=True)
    return {**record, "out": str(out)}


def write_folder(folder: Path, comparison: Comparison, record: Mapping[str, Any], figures: Mapping[str, str]) -> None:
    """Write every file of a comparison into an existing folder.

    Parameters
    ----------
    folder : Path
    comparison : Comparison
    record : mapping
        Content of ``result.json``.
    figures : mapping
        SVG text by file name.
    """
    write_rows(folder / "compare.csv", COLUMNS, (list(row.as_dict().values()) for row in comparison.rows))
    write_rows(folder / "sets.csv", SET_COLUMNS, ([getattr(s, n) for n in SET_COLUMNS] for s in comparison.sets))
    write_rows(folder / "spectra.csv", SPECTRUM_COLUMNS, (
        (s.eop_set, s.system, s.scaling, index, float(value))
        for s in comparison.spectra for index, value in enumerate(s.values)
    ))  # fmt: skip
    write_rows(
        folder / "directions.csv", DIRECTION_COLUMNS, (astuple(direction) for direction in comparison.directions)
    )
    if comparison.curves:
        write_rows(folder / "l_curves.csv", CURVE_COLUMNS, _curve_rows(comparison))
    if comparison.vectors:
        write_rows(folder / "error_vectors.csv", VECTOR_COLUMNS, (
            (of_row.eop_set, of_row.type, of_row.solver, role, name, *error)
            for of_row in comparison.vectors for role, names in of_row.ids.items()
            for name, error in zip(names, of_row.enu_m[role].tolist(), strict=True)
        ))  # fmt: skip
    for name, text in figures.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "result.json").write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(render(comparison, record, figures), encoding="utf-8")


def _curve_rows(comparison: Comparison) -> Iterator[tuple[object, ...]]:
    """Return the points of all curves; after each curve, the choices of the rules follow."""
    for of_set in comparison.curves:
        curve, key = of_set.curve, (of_set.eop_set, of_set.type)
        for point in zip(curve.kappa.tolist(), curve.residual_norm.tolist(), curve.solution_norm.tolist(), strict=True):
            yield (*key, "", *point)
        for choice in curve.choices:
            yield (*key, choice.rule, choice.kappa, choice.residual_norm, choice.solution_norm)


def _remarks(comparison: Comparison) -> list[Finding]:
    """Return findings on packages that are not installed."""
    found = [] if available() else [finding("compare.no_figures")]
    missing = not reference.available() and any((r.order or 0) <= reference.LIMIT for r in comparison.rows)
    return [*found, finding("compare.no_reference")] if missing else found


def _record(comparison: Comparison, project: Path, out: Path, command: Sequence[str]) -> dict[str, Any]:
    """Return the content of ``result.json`` without times."""
    record: dict[str, Any] = plain({
        "schema": SCHEMA_VERSION,
        "kind": "compare",
        "name": comparison.block.name,
        "verdict": verdict(comparison),
        "target_m": comparison.target_m,
        "target_from": comparison.target_from,
        "time_limit_s": comparison.time_limit_s,
        "advice": None if comparison.advice is None else asdict(comparison.advice),
        "sets": [asdict(one) for one in comparison.sets],
        "repeated": [{"eop_set": n, "same_as": of} for n, of in comparison.repeated.items()],
        "eop_sets": comparison.eop_sets,
        "solvers": comparison.solvers,
        "backends": comparison.backends,
        "types": comparison.types,
        "regularisations": comparison.regularisations,
        "as_run": comparison.as_run,
        "look_polynomial": comparison.block.options.look_polynomial,
        "summary": [asdict(line) for line in summaries(comparison)],
        **as_record(_remarks(comparison)),
        "rows": [row.as_dict() for row in comparison.rows],
        "directions": [asdict(direction) for direction in comparison.directions],
        "out": out.name,
        "provenance": provenance(comparison.block, project.parent, command),
    })  # fmt: skip
    return record
