"""The report of an adjustment: one HTML file of sections that needs nothing else.

A section is declared once, by :func:`section`: its id, its heading, the function that supplies the values, and its
template, a text or the file ``templates/ID.html.j2``. Order of declaration is order on the page.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from fg_orient.model.errors import DECISIVE, findings_of
from fg_orient.report import maps, plots, tables
from fg_orient.report.page import environment
from fg_orient.report.payload import payload
from fg_orient.report.words import accuracy_words, orientation_words, verdict
from fg_orient.result.record import Result

Values = Mapping[str, Any]
Supply = Callable[[Result], Values | None]

#: Rows of a table, and images, that the page shows; the files hold all.
MANY: Final = {"rows": 100, "images": 40, "terms": 1500}
#: Images whose residuals and whose correlations are drawn.
MAX_PANELS: Final = 16
#: Suspicious observations that the first page names.
SUSPECTS: Final = 3


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Parameters
    ----------
    id, title : str
    values : callable
        Gives the values of the template for a result; None where the page has no such section.
    template : str
        Its text; empty: the file ``templates/ID.html.j2``. It also knows ``r``, the record; ``many``, lengths of
        tables; ``payload``, the data of the live drawings; and the macros and filters of all pages.
    """

    id: str
    title: str
    values: Supply
    template: str = ""


#: Sections of the report of an adjustment; the page of a refused block has its own (:func:`_render_deficient`).
SECTIONS: Final[list[Section]] = []


def section(id: str, title: str, template: str = "", before: str = "") -> Callable[[Supply], Supply]:
    """Add a section to the report of an adjustment.

    Parameters
    ----------
    id, title : str
        Id of the element, and heading.
    template : str
        Text of the template; empty: the file ``templates/ID.html.j2``.
    before : str
        Id of the section that follows; before the provenance where empty.
    """

    def add(values: Supply) -> Supply:
        place = next((k for k, other in enumerate(SECTIONS) if other.id == before), len(SECTIONS))
        SECTIONS.insert(place, Section(id, title, values, template))
        return values

    return add


def render(result: Result, comparison: dict[str, Any] | None = None) -> str:
    """HTML text of a result, with the comparison with a truth if there is one."""
    if not result.adjusted:
        return _render_deficient(result)
    record = result.record
    ended = verdict(record)
    truth = Section("truth", "Comparison with the simulated truth", lambda _: {"truth": comparison})
    words: Values = {**ended, "text": [ended["text"], *accuracy_words(record)]}
    return _page(result, [*SECTIONS, *([truth] if comparison else [])], words, _problems(record))


def _page(result: Result, sections: Sequence[Section], verdict: Values, problems: Sequence[str]) -> str:
    """Render the sections that the result has into the shell of all pages."""
    shell, record = environment(), result.record
    shared = {"r": record, "many": MANY, "payload": payload(result) if result.adjusted else None}
    parts = []
    for one in (*sections, _PROVENANCE):
        values = one.values(result)
        if values is not None:
            template = shell.from_string(one.template) if one.template else shell.get_template(f"{one.id}.html.j2")
            parts.append((one.id, one.title, Markup(template.render({**shared, **values}))))
    page = shell.get_template("report.html.j2")
    return page.render(shared, verdict=verdict, problems=problems, parts=parts, what=orientation_words(record))


def _problems(record: dict[str, Any]) -> list[str]:
    """Findings that did not decide on the verdict, after the observations that a test names."""
    texts = [str(found) for found in findings_of(record) if found.severity not in DECISIVE]
    suspects = record.get("suspicious_observations") or []
    named = [f"look at {suspect['sentence']}" for suspect in suspects[:SUSPECTS]]
    left = len(suspects) - len(named)
    return [*named, *([f"{left} more observations to look at are listed with the residuals"] if left else []), *texts]


# --- sections of an adjustment ---------------------------------------------------------------------

_AXES: Final = (("East", "east"), ("North", "north"), ("Up", "up"), ("ECEF X", "ecef_x"), ("ECEF Y", "ecef_y"),
                ("ECEF Z", "ecef_z"))  # fmt: skip


section("summary", "Summary")(lambda _: {"axes": _AXES})


@section("map", "Map")
def _map(result: Result) -> Values:
    return {"point_map": maps.point_map(result), "up_map": maps.point_map(result, up=True),
            "clipped": _clipped(result)}  # fmt: skip


def _clipped(result: Result) -> bool:
    return maps.view_of(result.record, result.points.numbers("lon_deg", "lat_deg")) is not None


section("figures", "Figures")(lambda _: {})
section("accuracy", "Accuracy axis by axis")(lambda _: {"axes": _AXES})


@section("residuals", "Image residuals")
def _residuals(result: Result) -> Values:
    summaries = result.residual_summary()
    return {"residuals": summaries, "panels": _panels(result, summaries), "outliers": tables.largest_residuals(result),
            "tested": result.normalised[1]}  # fmt: skip


def _panels(result: Result, summaries: list[dict[str, Any]]) -> list[Values]:
    """Charts of the images with the largest residuals, in the order of the images, with the count beyond the axis."""
    worst = {row["image"] for row in sorted(summaries, key=lambda row: -row["max_ratio"])[:MAX_PANELS]}
    out: list[Values] = []
    for name in (row["image"] for row in summaries if row["image"] in worst):
        ratio, tested = result.normalised[0][result.rows[name]], result.normalised[1]
        charts = (plots.residual_vectors(result, name), plots.histogram(ratio, name, tested),
                  plots.quantiles(ratio, name, tested))  # fmt: skip
        beyond = int((np.abs(ratio) > plots.ENDS).sum())
        out.append({"image": name, "drawings": charts, "words": f"{beyond} beyond ±{plots.ENDS:g} σ" if beyond else ""})
    return out


@section("reliability", "Reliability")
def _reliability(result: Result) -> Values | None:
    names, found = tables.short_names(result), tables.image_correlations(result)
    heat = [{"image": image, "drawing": plots.heat_map(f"image {image}", names[image], rho)}
            for image, rho in list(found.items())[:MAX_PANELS]]  # fmt: skip
    if not (heat or result.record.get("reliability") or result.record.get("correlations")):
        return None
    numbers = result.residuals.numbers("redundancy_line", "redundancy_sample")
    return {"heat": heat, "called": tables.unknowns_in_words(result), "redundancy": plots.redundancy_chart(numbers)}


@section("orientation", "Corrections of the exterior orientation")
def _orientation(result: Result) -> Values:
    return {"corrections": [{**one, "chart": plots.correction_chart(**one)} for one in tables.corrections(result)]}


@section("metadata", "Orientation of the metadata")
def _metadata(result: Result) -> Values | None:
    return {} if any(image.get("metadata_polynomials") for image in result.record["images"]) else None


@section("observability", "Observability")
def _observability(result: Result) -> Values:
    record = result.record
    return {"singular": plots.singular_values(record["observability"]), "held": _not_determined(record)}


def _not_determined(record: dict[str, Any]) -> list[tuple[str, str, str, float | None]]:
    """Image, direction in words, what holds it and its singular value: nothing (unobservable ones first) or the prior.

    Words of unobservable directions may stand for several of them: they have no value of their own.
    """
    rows: list[tuple[str, str, str, float | None]] = []
    for image in record["observability"][: MANY["images"]]:
        name = image["image"]
        rows += [(name, text.removeprefix(f"image {name}: "), "nothing", None) for text in image["sentences"]]
        held = image["held_by_the_prior"]
        values = image["singular_values"][image["determined"] :][: len(held)]
        rows += [(name, text, "its prior", s) for text, s in zip(held, values, strict=True)]
    return sorted(rows, key=lambda row: row[2] != "nothing")[: MANY["terms"]]


@section("regularisation", "Regularisation")
def _regularisation(result: Result) -> Values | None:
    kept = result.record.get("regularisation")
    return {"l_curve": plots.l_curve(kept), "rules": plots.ranked(kept)} if kept else None


@section("iterations", "Iterations")
def _iterations(result: Result) -> Values:
    return {"iterations": result.iterations, "history": plots.iteration_charts(result.iterations)}


#: The last section of every page.
_PROVENANCE: Final = Section("provenance", "Provenance", lambda _: {})


# --- a block whose unknowns nothing determines -----------------------------------------------------

#: Directions of one cause that the page shows at once, and that it lists; result.json has all.
FEW: Final = 6


def _render_deficient(result: Result) -> str:
    """HTML text of a result with the status ``rank_deficient``."""
    record, points = result.record, result.points
    groups: dict[tuple[str, str], list[str]] = {}
    for e in record["errors"]:
        groups.setdefault((e["message"], e["remedy"]), []).append(e["place"])
    sections = (
        Section("undetermined", "Undetermined directions", lambda _: {
            "groups": [(*key, places) for key, places in groups.items()], "few": FEW}),
        Section("map", "Map", lambda result: {
            "point_map": maps.point_map(result), "clipped": _clipped(result), "without": [
                name for name, lon in zip(points.words["id"], points.figures["lon_deg"].tolist(), strict=True)
                if math.isnan(lon)]}, '{% include "map-start.html.j2" %}'),
        Section("observability", "Observability", _spectra, '{% include "observability-start.html.j2" %}'),
    )  # fmt: skip
    remedies = list(dict.fromkeys(remedy for _, remedy in groups))
    return _page(result, sections, _nothing(record, remedies), ())


def _nothing(record: dict[str, Any], remedies: list[str]) -> Values:
    """Verdict: there is no result, how much is missing, and the remedies."""
    n = len(record["errors"])
    what = "one of the unknowns, or a combination of them," if n == 1 else f"{n} unknowns or combinations of them"
    text = [
        f"Nothing was adjusted: {what} {'is' if n == 1 else 'are'} determined neither by observations nor by priors. "
        "No coordinate and no orientation of this page is a result.",
        *(f"What to do: {remedy}." for remedy in remedies[:3]),
    ]
    return {"kind": "bad", "title": "Not determined: nothing was adjusted", "text": text}


def _spectra(result: Result) -> Values:
    """Singular values of the block and of the images, and of each the number of undetermined directions."""
    block = result.record["block_observability"]
    spectra = [*result.record["observability"]]
    if block and block["singular_values"]:
        spectra.insert(0, {"image": "whole block", "singular_values": block["singular_values"]})
    least = []
    for one in spectra:
        values = np.array([v or 0.0 for v in one["singular_values"]], float)
        least.append((one["image"], len(values), int((values <= 1e-5).sum()), values.min() if len(values) else None))
    return {"singular": plots.singular_values(spectra), "least": least}
