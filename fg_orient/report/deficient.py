"""Report of a block that was not adjusted because nothing determines some of its unknowns."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from fg_orient.report.extent import view_of
from fg_orient.report.page import environment
from fg_orient.report.svg import point_map, singular_values
from fg_orient.report.words import orientation_words
from fg_orient.result.record import Result

#: Directions of one cause that the page lists, and those that it shows at once; result.json has all.
MANY: Final = 100
FEW: Final = 6
SECTIONS: Final = (
    ("undetermined", "What is not determined"), ("map", "Map"), ("observability", "Observability"),
    ("provenance", "Provenance"),
)  # fmt: skip


def render_deficient(result: Result) -> str:
    """Give the HTML text of a result with the status ``rank_deficient``."""
    record, points = result.record, result.points
    block = record["block_observability"]
    spectra = [*record["observability"]]
    if block and block["singular_values"]:
        spectra.insert(0, {"image": "whole block", "singular_values": block["singular_values"]})
    groups: dict[tuple[str, str], list[str]] = {}
    for e in record["errors"]:
        groups.setdefault((e["message"], e["remedy"]), []).append(e["place"])
    remedies = list(dict.fromkeys(remedy for _, remedy in groups))
    lon = points.figures["lon_deg"]
    return environment().get_template("deficient.html.j2").render(
        r=record, what=orientation_words(record), sections=SECTIONS, many=MANY, few=FEW, problems=(),
        verdict=_verdict(record, remedies), groups=[(*key, places) for key, places in groups.items()],
        clipped=view_of(record, points.numbers("lon_deg", "lat_deg")) is not None,
        point_map=point_map(result),
        singular=singular_values(spectra), least=_least(spectra),
        without=[name for name, value in zip(points.words["id"], lon.tolist(), strict=True) if math.isnan(value)],
    )  # fmt: skip


def _verdict(record: dict[str, Any], remedies: list[str]) -> dict[str, Any]:
    """Say that there is no result, how much is missing, and the way out."""
    n = len(record["errors"])
    what = "one of the unknowns, or a combination of them," if n == 1 else f"{n} unknowns or combinations of them"
    verb = "is" if n == 1 else "are"
    text = [
        f"Nothing was adjusted: {what} {verb} determined neither by observations nor by priors. No coordinate and no "
        "orientation of this page is a result.",
        *(f"What to do: {remedy}." for remedy in remedies[:3]),
    ]
    return {"kind": "bad", "title": "Not determined: nothing was adjusted", "text": text}


def _least(spectra: list[dict[str, Any]]) -> list[tuple[str, int, int, float | None]]:
    """Name, number of unknowns, of directions without a determination, and least singular value of each spectrum."""
    rows = []
    for one in spectra:
        values = np.array([v or 0.0 for v in one["singular_values"]], float)
        rows.append((one["image"], len(values), int((values <= 1e-5).sum()), values.min() if len(values) else None))
    return rows
