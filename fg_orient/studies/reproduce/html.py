"""Renders a reproduction: one HTML file on the shell of all reports."""

from __future__ import annotations

from typing import Any, Final

from fg_orient.report.page import environment
from fg_orient.studies.reproduce.grid import grid
from fg_orient.studies.reproduce.l_curves import l_curves
from fg_orient.studies.reproduce.reproduction import Reproduction
from fg_orient.studies.reproduce.scatter import scatter
from fg_orient.studies.reproduce.verdict import KINDS

#: Sign and meaning of each verdict; signs carry it without colour.
LEGEND: Final = {
    "equal": ("=", "equal", "all printed digits in every run"),
    "order": ("~", "order", "published and reproduced within a factor of ten"),
    "rounding": ("±", "rounding", "rounding noise: inside the spread of the runs, a decade added"),
    "pattern": ("∥", "pattern", "the same side of the limit in most runs"),
    "differs": ("≠", "differs", "none of these"),
    "not_reproducible": ("·", "not reproducible", "a fact of the real data, or decided by their rounding"),
}


def render(found: Reproduction, record: dict[str, Any]) -> str:
    """Give the HTML text.

    Parameters
    ----------
    found : Reproduction
    record : dict
        Content of ``result.json``.
    """
    tables = [_table(found, table, title) for table, title in found.titles.items()]
    legend = {kind: (*words[:2], found.source.meanings.get(kind, words[2])) for kind, words in LEGEND.items()}
    return environment("fg_orient.studies.reproduce").get_template("reproduction.html.j2").render(
        record=record, legend=legend, kinds=KINDS, tables=tables, claims=found.claims, counts=found.counts(),
        verdict=verdict(found), scatter=scatter(found.rows), problems=problems(found), curves=l_curves(found),
        seed=next(iter(found.options.get("seeds", [])), None),
    )  # fmt: skip


def _table(found: Reproduction, table: str, title: str) -> dict[str, Any]:
    rows = [row for row in found.rows if row.table == table]
    return {"id": table, "name": table_name(table), "title": title, "counts": found.counts(table), "rows": rows,
            "grid": grid(rows, found.keys)}  # fmt: skip


def problems(found: Reproduction) -> list[str]:
    """Claims that are not met, with the reason."""
    return [f"Claim {c.id} is not met: {c.reason or c.text}" for c in found.claims if not c.met]


def table_name(table: str) -> str:
    """Name a table in words: "Table 4.3", "Eq. (4.1)", "Sect. 4.2.2", "Text", "Summary"."""
    if table.startswith("eq"):
        return f"Eq. ({table[2:]})"
    if table.isalpha():
        return table.capitalize()
    return f"Sect. {table[1:]}" if table.startswith("s") else f"Table {table}"


def verdict(found: Reproduction) -> dict[str, str]:
    """Say in words what came out: ``kind`` (good, warn), ``title`` and ``text``."""
    counts, n = found.counts(), len(found.rows)
    met = sum(claim.met for claim in found.claims)
    agree = n - counts["differs"] - counts["not_reproducible"]
    title = f"{agree} of {n} published numbers agree in digits, size, spread or pattern"
    if found.claims:
        title += f"; {met} of {len(found.claims)} claims met"
    text = (
        f"{counts['equal']} agree to the printed digits (counts and definitions among them), {counts['order']} within "
        f"a factor of ten, {counts['rounding']} {found.source.counted}"
        + (f", {counts['pattern']} {found.source.patterned}" if counts["pattern"] else "")
        + f". {counts['differs']} differ; {counts['not_reproducible']} cannot be reproduced, each for the reason "
        "beside it."
    )
    return {"kind": "good" if met == len(found.claims) else "warn", "title": title, "text": text}
