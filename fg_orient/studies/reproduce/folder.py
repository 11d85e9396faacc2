"""Folder of a reproduction: ``cells.csv``, ``claims.csv``, ``result.json``, ``report.html``, ``figures``.

The page shows verdicts, a chart of all numbers, L-curves and the figures of the publication.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.model.installation import stamp
from fg_orient.report import paper
from fg_orient.report.chart import Axis, Chart, plain_exponent
from fg_orient.report.figures import FOLDER, draw_figures
from fg_orient.report.page import environment
from fg_orient.report.plots import l_curve, ranked
from fg_orient.result.plain import dumps, plain, write_records, write_rows
from fg_orient.studies.published.tables import require_source
from fg_orient.studies.reproduce.figures import SourceFigure, figures
from fg_orient.studies.reproduce.reproduction import SHUFFLES, Callback, Reproduction, Row, reproduce
from fg_orient.studies.reproduce.verdict import KINDS, LEGEND

#: Contents of the folder; result.json identifies it.
CONTENTS: Final = Contents(
    "result.json",
    ("result.json", "cells.csv", "claims.csv", "report.html", "figures/*.svg", "figures/*.pdf", "figures/captions.md"),
)
SCHEMA_VERSION: Final = 3


def reproduce_to(
    name: str,
    out: Path | None = None,
    *,
    overwrite: bool = False,
    callback: Callback | None = None,
    command: Sequence[str] = (),
    **options: Any,
) -> tuple[Reproduction, dict[str, Any]]:
    """Reproduce a publication and write the result folder.

    Parameters
    ----------
    out : Path, optional
        Folder to create; default: "reproduced-" and the name.
    overwrite : bool
        True to replace the folder of an earlier reproduction.
    command : sequence of str
        Command line, for the record.
    name, callback, **options
        See :func:`fg_orient.studies.reproduce.reproduction.reproduce`.

    Returns
    -------
    Reproduction, dict
        All rows and claims; and the record for the JSON output of the command.

    Raises
    ------
    InputError
        Options are wrong, published tables are damaged, or the output cannot be written.
    """
    require_source(name)
    target = out or Path(f"reproduced-{name}")
    require_free(target, overwrite=overwrite, contents=CONTENTS)
    result = reproduce(name, callback=callback, **options)
    with staged_folder(target, overwrite=overwrite, contents=CONTENTS) as folder, writing(target):
        _write(folder, result, command)
    return result, as_record(result) | {"out": str(target)}


def as_record(result: Reproduction) -> dict[str, Any]:
    """Return the rows and claims as plain values; numbers that are not finite become None."""
    rows = [plain(row.as_dict()) for row in result.rows]
    return {"rows": rows, "claims": [plain(asdict(claim)) for claim in result.claims]}


def _write(folder: Path, result: Reproduction, command: Sequence[str]) -> None:
    rows = [row.as_dict() for row in result.rows]
    write_records(folder / "cells.csv", rows)
    drawn = figures(result)
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
        "figures": [{"name": f.name, "title": f.title, "missing": f.missing} for f in drawn],
        "published_sha256": result.sha256,
        **stamp(command),
    }
    (folder / "result.json").write_text(dumps(record, indent=1) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(render(result, record, drawn), encoding="utf-8")
    charts = {one.file: partial(tuple, one.charts) for one in drawn if one.charts}
    if paper.available() and charts:
        draw_figures(charts, lambda _: captions(drawn), folder / FOLDER, overwrite=False)


def captions(drawn: Sequence[SourceFigure]) -> str:
    """Return the captions of the figures, with the reasons for missing ones."""
    lines = [f"{one.file}: fig. {one.name}. {one.title}. {one.caption or 'Not drawn: ' + one.missing}" for one in drawn]
    return "\n\n".join(lines) + "\n"


def render(result: Reproduction, record: dict[str, Any], drawn: Sequence[SourceFigure]) -> str:
    """Return the HTML page of the reproduction.

    Parameters
    ----------
    result : Reproduction
    record : dict
        Content of ``result.json``.
    drawn : sequence of SourceFigure
    """
    rows = {table: [row for row in result.rows if row.table == table] for table in result.titles}
    tables = [
        {
            "id": table,
            "name": table_name(table),
            "title": title,
            "counts": result.counts(table),
            "rows": rows[table],
            "shuffled": result.shuffled(table),
            "gained": result.gained(table),
            "grid": grid(rows[table]),
        }
        for table, title in result.titles.items()
    ]
    problems = [f"Claim {c.id} is not met: {c.reason or c.text}" for c in result.claims if not c.met]
    legend = {kind: (*words[:2], result.source.meanings.get(kind, words[2])) for kind, words in LEGEND.items()}
    return (
        environment("fg_orient.studies.reproduce")
        .get_template("reproduction.html.j2")
        .render(
            record=record,
            legend=legend,
            kinds=KINDS,
            tables=tables,
            claims=result.claims,
            counts=result.counts(),
            verdict=verdict(result),
            scatter=scatter(result.rows),
            problems=problems,
            curves=l_curves(result),
            figures=drawn,
            shuffles=SHUFFLES,
            seed=next(iter(result.options.get("seeds", [])), None),
        )
    )


def table_name(table: str) -> str:
    """Return the heading of a table: "Table 4.3", "Eq. (4.1)", "Sect. 4.2.2", "Text", "Summary"."""
    if table.startswith("eq"):
        return f"Eq. ({table[2:]})"
    if table.isalpha():
        return table.capitalize()
    return f"Sect. {table[1:]}" if table.startswith("s") else f"Table {table}"


def verdict(result: Reproduction) -> dict[str, str]:
    """Return the outcome as sentences: ``kind`` (good, warn), ``title`` and ``text``."""
    counts, n, met = result.counts(), len(result.rows), sum(claim.met for claim in result.claims)
    informing = Counter(row.verdict for row in result.rows if row.informs)
    by_role = counts["equal"] + counts["rounding"] - informing.total()
    title = (
        f"Of {n} published numbers {informing['equal']} are equal in all digits and {informing['rounding']} within "
        "rounding"
    )
    if result.claims:
        title += f"; {met} of {len(result.claims)} claims met"
    others = [f"{counts[kind]} {LEGEND[kind][1]}" for kind in KINDS[2:-2] if counts[kind]]
    text = (
        (
            f"Not counted: {by_role} whose digits agree as well when the printed values are exchanged at random among "
            "cells of the same role. "
            if by_role
            else ""
        )
        + (f"Weaker verdicts: {', '.join(others)}. " if others else "")
        + f"{counts['differs']} differ; {counts['not_reproducible']} cannot be reproduced, each for the reason beside "
        f"it. {result.gained():.0f} more cells agree in digits, spread or size than with exchanged values."
    )
    return {"kind": "good" if met == len(result.claims) else "warn", "title": title, "text": text}


class Grid(NamedTuple):
    """Verdicts of one table, arranged for the page.

    The fields are the names of the columns, and the lines. A line contains an address,
    and a Row or None for each column.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Row | None, ...]], ...]


def grid(rows: Sequence[Row]) -> Grid | None:
    """Arrange the rows of one table by solver or EOP set.

    Return None if there would be only one column.
    """
    for field in ("method", "eop_set"):
        columns = tuple(dict.fromkeys(name for row in rows if (name := getattr(row.key, field))))
        if len(columns) > 1:
            break
    else:
        return None
    lines: dict[str, dict[str, Row]] = {}
    for row in rows:  # a cell without this field goes into the first column, or into a new line if that is occupied
        column = getattr(row.key, field) or columns[0]
        line = lines.setdefault(str(row.key._replace(**{field: ""})) or row.cell, {})
        if column in line:
            line = lines.setdefault(row.cell, {})
        line[column] = row
    words = [name.replace("_", " ") if field == "method" else f"set {name}" for name in columns]
    return Grid(tuple(words), tuple((name, tuple(map(line.get, columns))) for name, line in lines.items()))


#: Name of a printed kappa among the rules in a drawing.
PRINTED: Final = "printed"
#: Unknowns of the bundle have the units of the publication, not standard deviations.
AXES: Final = ("norm of the residuals |Ax − l|", "norm of the solution |x|, units of the publication")


def l_curves(result: Reproduction) -> list[dict[str, Any]]:
    """Return the L-curve of each EOP set with the tables' kappas: ``eop_set``, ``drawing``, ``rules`` by kappa."""
    out = []
    for number, curve in result.curves.items():
        rules = [asdict(choice) | {"table": ""} for choice in curve.choices]
        labels = {f"tikhonov_{choice.rule}": choice.label for choice in curve.choices}
        for row in result.rows:
            key = row.key
            if (key.quantity, key.eop_set, key.pre_adjustment_type) == ("kappa", str(number), "1"):
                residual, solution = curve.place(row.published)
                rules.append(
                    {
                        "rule": PRINTED,
                        "label": f"{labels.get(key.method, key.method)}, printed",
                        "kappa": row.published,
                        "residual_norm": residual,
                        "solution_norm": solution,
                        "notes": (),
                        "failure": "",
                        "table": row.table,
                    }
                )
        section = plain({"rule": PRINTED, "rules": rules, "curve": asdict(curve)})
        out.append({"eop_set": number, "drawing": l_curve(section, AXES), "rules": ranked(section)})
    return out


SIZE: Final = 520.0
#: Largest range of the axes, as powers of ten; numbers outside are drawn at the border.
RANGE: Final = (-30, 15)
#: Largest ratio of two numbers that have the same order of magnitude.
BAND: Final = 10.0


def scatter(rows: Sequence[Row]) -> Chart | None:
    """Return the sizes of all nonzero numbers that are published and reproduced; None if fewer than two.

    Points at the same place are drawn only once.
    """
    pairs = [(abs(r.published), abs(r.reproduced), r) for r in rows]
    pairs = [p for p in pairs if all(math.isfinite(v) and v > 0.0 for v in p[:2])]
    if len(pairs) < 2:
        return None
    powers = [math.log10(v) for p in pairs for v in p[:2]]
    low, high = (min(max(f, RANGE[0]), RANGE[1]) for f in (math.floor(min(powers)), math.ceil(max(powers))))
    limits = 10.0**low, 10.0 ** max(high, low + 1)
    x, y = (
        Axis(words, limits, log=True, write=lambda v: plain_exponent(f"{v:.0e}"))
        for words in ("published", "reproduced")
    )
    chart = Chart("published against reproduced sizes", x, y, width=SIZE, height=SIZE, left=60.0)
    line = np.array(limits)
    chart.add("area", "band", np.append(line, line[::-1]), np.append(line * BAND, line[::-1] / BAND))
    chart.add("line", "curve", line, line)
    drawn: dict[tuple[int, int, str], tuple[float, float, Row]] = {}
    for published, reproduced, row in pairs:
        across, up = (min(max(v, limits[0]), limits[1]) for v in (published, reproduced))
        at = chart.place(across, up)
        drawn.setdefault((round(at[0]), round(at[1]), row.verdict), (across, up, row))
    for kind in dict.fromkeys(row.verdict for _, _, row in drawn.values()):
        mine = [dot for dot in drawn.values() if dot[2].verdict == kind]
        tips = [f"{r.table}, {r.cell}: published {r.printed}, reproduced {r.reproduced:.3g}" for _, _, r in mine]
        chart.add("dots", f"dot {kind}", [p for p, _, _ in mine], [v for _, v, _ in mine], tips=tips)
    return chart
