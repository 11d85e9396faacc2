"""HTML report of a reproduction, in the template of all reports: verdicts of each table, L-curves with its kappas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final, NamedTuple

from fg_orient.model.cells import CellKey
from fg_orient.report.page import environment
from fg_orient.report.plots import l_curve, ranked
from fg_orient.result.plain import plain
from fg_orient.studies.reproduce.reproduction import Reproduction, Row
from fg_orient.studies.reproduce.scatter import scatter
from fg_orient.studies.reproduce.verdict import KINDS

#: Sign, name and meaning of each verdict; the signs are readable without colour.
LEGEND: Final = {
    "equal": ("=", "equal", "all printed digits in every run"),
    "order": ("~", "order", "published and reproduced within a factor of ten"),
    "rounding": ("±", "rounding", "rounding noise: inside the spread of the runs, a decade added"),
    "pattern": ("∥", "pattern", "the same side of the limit in most runs"),
    "differs": ("≠", "differs", "none of these"),
    "not_reproducible": ("·", "not reproducible", "a fact of the real data, or decided by their rounding"),
}


def render(result: Reproduction, record: dict[str, Any]) -> str:
    """HTML text.

    Parameters
    ----------
    result : Reproduction
    record : dict
        Content of ``result.json``.
    """
    tables = [_table(result, table, title) for table, title in result.titles.items()]
    legend = {kind: (*words[:2], result.source.meanings.get(kind, words[2])) for kind, words in LEGEND.items()}
    return environment("fg_orient.studies.reproduce").get_template("reproduction.html.j2").render(
        record=record, legend=legend, kinds=KINDS, tables=tables, claims=result.claims, counts=result.counts(),
        verdict=verdict(result), scatter=scatter(result.rows), problems=problems(result), curves=l_curves(result),
        seed=next(iter(result.options.get("seeds", [])), None),
    )  # fmt: skip


def _table(result: Reproduction, table: str, title: str) -> dict[str, Any]:
    rows = [row for row in result.rows if row.table == table]
    return {"id": table, "name": table_name(table), "title": title, "counts": result.counts(table), "rows": rows,
            "grid": grid(rows, result.keys)}  # fmt: skip


def problems(result: Reproduction) -> list[str]:
    """Claims that are not met, with the reason."""
    return [f"Claim {c.id} is not met: {c.reason or c.text}" for c in result.claims if not c.met]


def table_name(table: str) -> str:
    """Name a table in words: "Table 4.3", "Eq. (4.1)", "Sect. 4.2.2", "Text", "Summary"."""
    if table.startswith("eq"):
        return f"Eq. ({table[2:]})"
    if table.isalpha():
        return table.capitalize()
    return f"Sect. {table[1:]}" if table.startswith("s") else f"Table {table}"


def verdict(result: Reproduction) -> dict[str, str]:
    """Outcome in sentences: ``kind`` (good, warn), ``title`` and ``text``."""
    counts, n = result.counts(), len(result.rows)
    met = sum(claim.met for claim in result.claims)
    agree = n - counts["differs"] - counts["not_reproducible"]
    title = f"{agree} of {n} published numbers agree in digits, size, spread or pattern"
    if result.claims:
        title += f"; {met} of {len(result.claims)} claims met"
    text = (
        f"{counts['equal']} agree to the printed digits (counts and definitions among them), {counts['order']} within "
        f"a factor of ten, {counts['rounding']} {result.source.counted}"
        + (f", {counts['pattern']} {result.source.patterned}" if counts["pattern"] else "")
        + f". {counts['differs']} differ; {counts['not_reproducible']} cannot be reproduced, each for the reason "
        "beside it."
    )
    return {"kind": "good" if met == len(result.claims) else "warn", "title": title, "text": text}


class Grid(NamedTuple):
    """Verdicts of one table: names of the columns, then address and a Row or None per column for each line."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Row | None, ...]], ...]


def grid(rows: Sequence[Row], keys: Mapping[tuple[str, str], CellKey]) -> Grid | None:
    """Arrange the cells of a table by solver or EOP set; None for a single column.

    Parameters
    ----------
    rows : sequence of Row
        Rows of one table.
    keys : mapping
        (table, address) to the key.
    """
    pairs = [(row, keys.get((row.table, row.cell), CellKey(row.table))) for row in rows]
    for field in ("method", "eop_set"):
        columns = tuple(dict.fromkeys(getattr(key, field) for _, key in pairs if getattr(key, field)))
        if len(columns) > 1:
            break
    else:
        return None
    lines: dict[str, dict[str, Row]] = {}
    for row, key in pairs:  # a cell without this field is in the first column; if that is occupied, in a new line
        column = getattr(key, field) or columns[0]
        line = lines.setdefault(str(key._replace(**{field: ""})) or row.cell, {})
        if column in line:
            line = lines.setdefault(row.cell, {})
        line[column] = row
    words = [name.replace("_", " ") if field == "method" else f"set {name}" for name in columns]
    return Grid(tuple(words), tuple((name, tuple(map(line.get, columns))) for name, line in lines.items()))


#: Name of a printed kappa among the rules of a drawing.
PRINTED: Final = "printed"
#: Unknowns of the bundle are in the units of the publication, not in standard deviations.
AXES: Final = ("norm of the residuals |Ax − l|", "norm of the solution |x|, units of the publication")


def l_curves(result: Reproduction) -> list[dict[str, Any]]:
    """L-curve of each EOP set with the kappas of the tables: ``eop_set``, ``drawing``, ``rules`` by their kappas."""
    out = []
    for number, curve in result.curves.items():
        rules = [asdict(choice) | {"table": ""} for choice in curve.choices]
        labels = {f"tikhonov_{choice.rule}": choice.label for choice in curve.choices}
        for row in result.rows:
            key = result.keys[row.table, row.cell]
            if (key.quantity, key.eop_set, key.pre_adjustment_type) == ("kappa", str(number), "1"):
                residual, solution = curve.place(row.published)
                rules.append({
                    "rule": PRINTED, "label": f"{labels.get(key.method, key.method)}, printed",
                    "kappa": row.published, "residual_norm": residual, "solution_norm": solution, "notes": (),
                    "failure": "", "table": row.table,
                })  # fmt: skip
        section = plain({"rule": PRINTED, "rules": rules, "curve": asdict(curve)})
        out.append({"eop_set": number, "drawing": l_curve(section, AXES), "rules": ranked(section)})
    return out
