"""Renders the report of an adjustment: one HTML file that needs nothing else."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from fg_orient.model.errors import DECISIVE, findings_of
from fg_orient.report.charts import correction_chart, heat_maps, iteration_charts, redundancy_chart
from fg_orient.report.extent import view_of
from fg_orient.report.l_curve import l_curve_chart, ranked
from fg_orient.report.orientation import corrections, unknowns_in_words
from fg_orient.report.page import environment
from fg_orient.report.payload import payload
from fg_orient.report.residual_plots import largest_residuals, normalised, residual_panels
from fg_orient.report.svg import point_map, singular_values
from fg_orient.report.words import accuracy_words, orientation_words, verdict
from fg_orient.result.record import Result

#: Rows of a table, and images, that the page shows; the files hold all.
MANY: Final = {"rows": 100, "images": 40, "terms": 1500}
#: Suspicious observations that the first page names.
SUSPECTS: Final = 3
#: Parts of the page and their words.
SECTIONS: Final = (
    ("map", "Map"), ("accuracy", "Accuracy"), ("residuals", "Residuals"), ("orientation", "Orientation"),
    ("observability", "Observability"), ("iterations", "Iterations"), ("provenance", "Provenance"),
)  # fmt: skip
_AXES: Final = (("East", "east"), ("North", "north"), ("Up", "up"), ("ECEF X", "ecef_x"), ("ECEF Y", "ecef_y"),
                ("ECEF Z", "ecef_z"))  # fmt: skip


def render(result: Result, comparison: dict[str, Any] | None = None) -> str:
    """Give the HTML text of a result, with the comparison with a truth if there is one."""
    record, summaries = result.record, result.residual_summary()
    found, kept = verdict(record), record.get("regularisation")
    return environment().get_template("report.html.j2").render(
        r=record, verdict={**found, "text": [found["text"], *accuracy_words(record)]}, axes=_AXES, many=MANY,
        problems=_problems(record), sections=SECTIONS, what=orientation_words(record),
        payload=payload(result), clipped=view_of(record, result.points.numbers("lon_deg", "lat_deg")) is not None,
        point_map=point_map(result), up_map=point_map(result, up=True),
        residuals=summaries, panels=residual_panels(result, summaries), outliers=largest_residuals(result),
        tested=normalised(result, np.arange(len(result.residuals)))[1], redundancy=redundancy_chart(result),
        corrections=[{**c, "chart": correction_chart(**c)} for c in corrections(result)],
        heat=heat_maps(result), called=unknowns_in_words(result), singular=singular_values(record["observability"]),
        held=_not_determined(record), iterations=result.iterations,
        history=iteration_charts(result.iterations), truth=comparison, l_curve=l_curve_chart(kept),
        rules=ranked(kept) if kept else [],
    )  # fmt: skip


def _problems(record: dict[str, Any]) -> list[str]:
    """Findings that did not decide on the verdict, after the observations that a test names."""
    texts = [str(found) for found in findings_of(record) if found.severity not in DECISIVE]
    suspects = record.get("suspicious_observations") or []
    named = [f"look at {suspect['sentence']}" for suspect in suspects[:SUSPECTS]]
    left = len(suspects) - len(named)
    return [*named, *([f"{left} more observations to look at are listed with the residuals"] if left else []), *texts]


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
