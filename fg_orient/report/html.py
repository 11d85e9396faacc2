"""Renders the report of an adjustment: one HTML file that needs nothing else."""

from __future__ import annotations

import math
from typing import Any, Final

from fg_orient.report.data import Result, residual_summary
from fg_orient.report.page import environment
from fg_orient.report.svg import point_map, singular_values
from fg_orient.report.words import in_words, orientation_words, verdict

#: Units that people read more easily: name and factor.
_READABLE: Final = {"rad": ("µrad", 1e6), "m/s": ("mm/s", 1e3), "m": ("m", 1.0)}
#: Rows of a table, and images, that the page shows; the files hold all.
MANY: Final = {"rows": 100, "images": 40, "terms": 1500}
#: Parts of the page and their words.
SECTIONS: Final = (
    ("accuracy", "Accuracy"), ("map", "Map"), ("residuals", "Residuals"), ("orientation", "Orientation"),
    ("observability", "Observability"), ("iterations", "Iterations"), ("provenance", "Provenance"),
)  # fmt: skip
_DEGREES: Final = ("constant", "linear", "quadratic")
_AXES: Final = (("East", "east"), ("North", "north"), ("Up", "up"), ("ECEF X", "ecef_x"), ("ECEF Y", "ecef_y"),
                ("ECEF Z", "ecef_z"))  # fmt: skip


def render(result: Result, comparison: dict[str, Any] | None = None) -> str:
    """Give the HTML text of a result, with the comparison with a truth if there is one."""
    return environment().get_template("report.html.j2").render(
        r=result.record, verdict=verdict(result.record), axes=_AXES, point_map=point_map(result),
        up_map=point_map(result, up=True), residuals=residual_summary(result), corrections=corrections(result),
        what=orientation_words(result.record), many=MANY, sections=SECTIONS,
        problems=[in_words(t) for t in result.record["warnings"]],
        singular=singular_values(result.record["observability"]), iterations=result.iterations, truth=comparison,
    )  # fmt: skip


def _component(name: str) -> str:
    """Name a component in words."""
    if name.startswith("psi_"):
        return f"look angle ψ{name[-1]}"
    kind = {"x": "position", "vx": "velocity"}.get(name.replace("y", "x").replace("z", "x"))
    if kind is not None:
        return f"{kind} {name[-1].upper()}"
    return name.replace("_", " ")


def _degree(degree: float, parameter: str) -> str:
    """Name the power of an unknown; "" where it has none, as of a frame camera."""
    if math.isnan(degree):
        return ""
    ending, power = parameter.rpartition("_")[2], int(degree)  # of a polynomial of samples: s and its degree
    return {"s": f"s^{power}", "c": f"curve {power}"}.get(ending[0]) or _DEGREES[power]


def corrections(result: Result) -> list[dict[str, Any]]:
    """Orientation corrections per image in readable units: value, sigma, share of the prior sigma."""
    images: dict[str, list[dict[str, Any]]] = {}
    words, numbers = result.eop.words, result.eop.numbers("value_per_tau", "sigma", "prior_sigma").tolist()
    for k, image in enumerate(words["image"]):
        unit, factor = _READABLE.get(words["unit"][k], (words["unit"][k], 1.0))
        value, sigma, prior = (None if math.isnan(number) else number for number in numbers[k])
        images.setdefault(image, []).append({
            "name": _component(words["component"][k]),
            "degree": _degree(float(result.eop.figures["degree"][k]), words["parameter"][k]), "unit": unit,
            "value": None if value is None else value * factor, "sigma": None if sigma is None else sigma * factor,
            "prior": None if prior is None else prior * factor,
            "share": None if not prior or value is None else value / prior,
        })  # fmt: skip
    return [{"image": image, "rows": rows} for image, rows in images.items()]
