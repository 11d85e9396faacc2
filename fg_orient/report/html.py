"""The report of an adjustment: one HTML file of sections that needs no other file.

A section is declared once, with its id, heading and template. The template calls the functions of charts and
tables. The sections have the order of their declaration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from fg_orient.model.errors import DECISIVE, Finding, findings_of
from fg_orient.report import maps, plots, tables
from fg_orient.report.page import environment
from fg_orient.report.payload import payload
from fg_orient.report.pictures import pictures_of
from fg_orient.report.words import accuracy_words, orientation_words, verdict
from fg_orient.result.record import Result

Values = Mapping[str, Any]
Supply = Callable[[Result], Values | None]

#: Maximum numbers of table rows, of images in tables and of drawn images on the page. The files contain all data.
MANY: Final = {"rows": 100, "images": tables.MAX_IMAGES, "terms": tables.MAX_TERMS, "panels": plots.MAX_PANELS}
#: Maximum number of suspicious observations in the verdict.
SUSPECTS: Final = 3
_AXES: Final = (("East", "east"), ("North", "north"), ("Up", "up"), ("ECEF X", "ecef_x"), ("ECEF Y", "ecef_y"),
                ("ECEF Z", "ecef_z"))  # fmt: skip


@dataclass(frozen=True)
class Section:
    """Part of the page, omitted if its template gives no text.

    Parameters
    ----------
    id, title : str
    template : str
        Text of the template; empty: the file
        ``templates/ID.html.j2``. It can use ``result`` and its record ``r``; ``many``,
        lengths of tables; ``payload``, the data of the live drawings; ``pictures``, the
        pixels; the modules ``plots``, ``maps`` and ``tables``;
        and the macros and filters of all pages.
    values : callable
        Function that returns further values for a result, or None if the page does not have this section.
    """

    id: str
    title: str
    template: str = ""
    values: Supply = lambda _: {}


#: Sections of the report of an adjustment; the page of a refused block has its own (:func:`_render_deficient`).
SECTIONS: Final = [Section(name, title) for name, title in (
    ("summary", "Summary"), ("map", "Map"), ("figures", "Figures"), ("accuracy", "Accuracy axis by axis"),
    ("residuals", "Image residuals"), ("reliability", "Reliability"),
    ("orientation", "Corrections of the exterior orientation"), ("jitter", "Jitter"), ("constraints", "Constraints"),
    ("features", "Control features"),
    ("metadata", "Orientation of the metadata"), ("light", "Effects on light"), ("observability", "Observability"),
    ("regularisation", "Regularisation"), ("iterations", "Iterations"),
)]  # fmt: skip


def section(id: str, title: str, template: str = "", before: str = "") -> Callable[[Supply], Supply]:
    """Add a section to the report of an adjustment; decorates the function of its values.

    Parameters
    ----------
    id, title : str
        Id of the element, and heading.
    template : str
        Text of the template; empty: the file ``templates/ID.html.j2``.
    before : str
        Id of the section that follows; empty: the provenance.
    """

    def add(values: Supply) -> Supply:
        place = next((k for k, other in enumerate(SECTIONS) if other.id == before), len(SECTIONS))
        SECTIONS.insert(place, Section(id, title, template, values))
        return values

    return add


def render(result: Result, comparison: dict[str, Any] | None = None, folder: Path | None = None) -> str:
    """Return the page of a result as HTML. A comparison with a truth, and pixels from a folder, are optional."""
    if not result.adjusted:
        return _render_deficient(result)
    record = result.record
    ended = verdict(record)
    truth = Section("truth", "Comparison with the simulated truth", values=lambda _: {"truth": comparison})
    first = [one for one in findings_of(record) if _is_first(one)]
    # the first doubt is the verdict itself, which ``ended`` contains
    doubts = [str(one) for one in first[any(one.severity in DECISIVE for one in first) :]]
    words: Values = {**ended, "text": [ended["text"], *doubts, *accuracy_words(record)]}
    return _page(result, [*SECTIONS, *([truth] if comparison else [])], words, _problems(record), folder)


def _page(
    result: Result, sections: Sequence[Section], verdict: Values, problems: Sequence[str], folder: Path | None = None
) -> str:
    """Render the sections that the result has into the shell of all pages."""
    shell, record, pictures = environment(), result.record, pictures_of(result, folder)
    shared = {
        "result": result, "r": record, "many": MANY, "axes": _AXES, "plots": plots, "maps": maps, "tables": tables,
        "payload": payload(result, pictures.used) if result.adjusted else None, "pictures": pictures,
    }  # fmt: skip
    parts = []
    for one in (*sections, Section("provenance", "Provenance")):
        values = one.values(result)
        template = shell.from_string(one.template) if one.template else shell.get_template(f"{one.id}.html.j2")
        text = "" if values is None else template.render({**shared, **values})
        if text.strip():
            parts.append((one.id.removesuffix("-start"), one.title, Markup(text)))
    page = shell.get_template("report.html.j2")
    return page.render(shared, verdict=verdict, problems=problems, parts=parts, what=orientation_words(record))


def _is_first(found: Finding) -> bool:
    """Return whether a finding is shown on the first screen: doubts and their likely causes."""
    return found.severity in DECISIVE or found.code == "verdict.cause"


def _problems(record: dict[str, Any]) -> list[str]:
    """Return the problems: suspicious observations, then findings that did not determine the verdict."""
    texts = [str(found) for found in findings_of(record) if not _is_first(found)]
    suspects = record.get("suspicious_observations") or []
    named = [f"look at {suspect['sentence']}" for suspect in suspects[:SUSPECTS]]
    left = len(suspects) - len(named)
    return [*named, *([f"{left} more observations to look at are listed with the residuals"] if left else []), *texts]


# --- a block with undetermined unknowns -----------------------------------------------------

#: Number of directions of one cause that are shown at once, and maximum number that the page lists.
#: result.json contains all.
FEW: Final = 6


def _render_deficient(result: Result) -> str:
    """Return the page of a result with the status ``rank_deficient`` as HTML."""
    record, points = result.record, result.points
    groups: dict[tuple[str, str], list[str]] = {}
    for e in record["errors"]:
        groups.setdefault((e["message"], e["remedy"]), []).append(e["place"])
    sections = (
        Section("undetermined", "Undetermined directions", values=lambda _: {
            "groups": [(*key, places) for key, places in groups.items()], "few": FEW}),
        Section("map-start", "Map", values=lambda _: {"without": [
            name for name, lon in zip(points.words["id"], points.figures["lon_deg"].tolist(), strict=True)
            if math.isnan(lon)]}),
        Section("observability-start", "Observability", values=_spectra),
    )  # fmt: skip
    remedies = list(dict.fromkeys(remedy for _, remedy in groups))
    return _page(result, sections, _nothing(record, remedies), ())


def _nothing(record: dict[str, Any], remedies: list[str]) -> Values:
    """Return the verdict for a block without result: the number of undetermined directions, and the remedies."""
    n = len(record["errors"])
    what = "one of the unknowns, or a combination of them," if n == 1 else f"{n} unknowns or combinations of them"
    text = [
        f"Nothing was adjusted: {what} {'is' if n == 1 else 'are'} determined neither by observations nor by priors. "
        "No coordinate and no orientation of this page is a result.",
        *(f"What to do: {remedy}." for remedy in remedies[:3]),
    ]
    return {"kind": "bad", "title": "Not determined: nothing was adjusted", "text": text}


def _spectra(result: Result) -> Values:
    """Return the singular values of the block and of each image, with the numbers of undetermined directions."""
    block = result.record["block_observability"]
    spectra = [*result.record["observability"]]
    if block and block["singular_values"]:
        spectra.insert(0, {"image": "whole block", "singular_values": block["singular_values"]})
    least = []
    for one in spectra:
        values = np.array([v or 0.0 for v in one["singular_values"]], float)
        least.append((one["image"], len(values), int((values <= 1e-5).sum()), values.min() if len(values) else None))
    return {"singular": plots.singular_values(spectra), "least": least}
