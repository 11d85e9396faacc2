"""Renders a reproduction: one HTML file without scripts or anything from elsewhere."""

from __future__ import annotations

from typing import Any, Final

from fg_orient.report.words import printable, scientific
from fg_orient.reproduce.reproduction import Reproduction
from fg_orient.reproduce.verdict import KINDS

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
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fg_orient.reproduce"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"scientific": scientific, "printable": printable}
    tables = [
        {"id": table, "name": table_name(table), "title": title, "counts": found.counts(table),
         "rows": [row for row in found.rows if row.table == table]}
        for table, title in found.titles.items()
    ]  # fmt: skip
    legend = {kind: (*words[:2], found.source.meanings.get(kind, words[2])) for kind, words in LEGEND.items()}
    return environment.get_template("report.html.j2").render(
        record=record, legend=legend, kinds=KINDS, tables=tables, claims=found.claims, counts=found.counts(),
        verdict=verdict(found),
    )  # fmt: skip


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
