"""Renders the report: one HTML file without scripts or anything from elsewhere."""

from __future__ import annotations

import math
import re
from typing import Any, Final

from fg_orient.report.data import Result, residual_summary
from fg_orient.report.svg import point_map, singular_values

#: Units that people read more easily: name and factor.
_READABLE: Final = {"rad": ("µrad", 1e6), "m/s": ("mm/s", 1e3), "m": ("m", 1.0)}
#: Rows of a table, and images, that the page shows; the files hold all.
MANY: Final = {"rows": 100, "images": 40, "terms": 1500}
#: Figures of the record in words, for reasons why they are absent.
_FIGURES: Final = {
    "sigma0_interval_99_9": "the interval of sigma0", "global_test": "the global test",
    "outlier_tests": "tests of single observations", "suspicious_observations": "suspicious observations",
    "reliability": "redundancy numbers and minimal detectable biases",
    "correlations": "correlations of the orientation",
    "us_per_observation_iteration": "the time per image point and iteration",
}  # fmt: skip
_DEGREES: Final = ("constant", "linear", "quadratic")
_AXES: Final = (("East", "east"), ("North", "north"), ("Up", "up"), ("ECEF X", "ecef_x"), ("ECEF Y", "ecef_y"),
                ("ECEF Z", "ecef_z"))  # fmt: skip


def render(result: Result, comparison: dict[str, Any] | None = None) -> str:
    """Give the HTML text of a result, with the comparison with a truth if there is one."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fg_orient.report"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"number": number, "scientific": scientific, "printable": printable}
    template = environment.get_template("report.html.j2")
    return template.render(
        r=result.record, verdict=verdict(result.record), axes=_AXES, point_map=point_map(result),
        up_map=point_map(result, up=True), residuals=residual_summary(result), corrections=corrections(result),
        what=orientation_words(result.record), many=MANY, warnings=[in_words(t) for t in result.record["warnings"]],
        singular=singular_values(result.record["observability"]), iterations=result.iterations, truth=comparison,
    )  # fmt: skip


def orientation_words(record: dict[str, Any]) -> str:
    """What was unknown of the images, by their kinds: EOP set, RPC compensation."""
    kinds = {image.get("model", "pushbroom") for image in record["images"]}
    words = []
    if record.get("image_unknowns"):
        return f"unknowns {', '.join(record['image_unknowns'])}"
    if "pushbroom" in kinds:
        words.append(f"EOP set {record['eop_set']} {record['eop_set_name']}")
        if record["look_polynomial"] is not None:
            words.append(f"look-angle polynomial of degree {record['look_polynomial']}")
    if "RPC" in kinds:
        words.append(f"RPC compensation: {record['rpc_compensation'].replace('_', ' and ')}")
    return " · ".join(words)


def in_words(warning: str) -> str:
    """Say a warning about absent figures without the keys of result.json."""
    keys, found, why = re.match(r"(?:([a-z0-9_, ]*?) (is|are) null: )?(.*)", warning, re.DOTALL).groups()  # type: ignore[union-attr]
    if found is None:
        if warning.startswith("the counts of block_observability are null: "):
            return warning.replace("block_observability are null", "directions of the whole block are not given", 1)
        return warning
    names = [_FIGURES.get(key, key.replace("_", " ")) for key in re.split(r", | and ", keys)]
    listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    return f"Not given: {listed}; {why}"


def number(value: float | None, digits: int = 3) -> str:
    """Write a number with a fixed count of decimals; a dash for none."""
    if value is None or not math.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # no minus before a zero
    return f"{rounded:.{digits}f}".replace("-", "−")


def scientific(value: float | None, digits: int = 2) -> str:
    """Write a number with an exponent, or plainly where that is short."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{digits + 1}g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.{digits}e}"
    return text.replace("-", "−")


def printable(text: object) -> str:
    """Replace control characters, which HTML does not allow."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(text))


def verdict(record: dict[str, Any]) -> dict[str, str]:
    """Say in words how it ended: ``kind`` (good, warn, bad), ``title`` and ``text``."""
    status, sigma0, (low, _) = record["status"], record["sigma0"], record["sigma0_interval_99_9"]
    if status == "not_converged":
        return {"kind": "bad", "title": "No solution", "text": record["reason"]}
    if status == "not_trustworthy":
        return {"kind": "bad", "title": "Not trustworthy", "text": record["reason"]}
    if sigma0 is None:
        return {"kind": "warn", "title": "Converged, unchecked", "text": "Without redundancy nothing was checked."}
    fit = "The observations fit the model within their standard deviations."
    robust = record.get("robust")  # results of earlier versions have none
    if robust is not None:
        down, n = robust["n_image_points_below_half"], record["n_image_points"]
        fit = f"The loss {record['loss']} has turned down {down} of {n} image points; the fit of the rest is untested."
        if record["loss"] == "lad":  # its weights turn nothing down
            fit = f"{down} of {n} image points lie beyond 2 sigmas; under least absolute values the fit is untested."
    elif record.get("variance_components") is not None:
        fit = "The standard deviations were estimated from these residuals, so the fit does not test the model."
    elif low is not None and sigma0 < low:
        fit = "The observations fit the model better than they should; see the warnings."
    return {"kind": "warn" if record["warnings"] else "good", "title": "Converged", "text": fit}


def _component(name: str) -> str:
    """Name a component in words."""
    if name.startswith("psi_"):
        return f"look angle ψ{name[-1]}"
    kind = {1: "position", 2: "velocity"}.get(len(name))
    return f"{kind} {name[-1].upper()}" if kind else name


def corrections(result: Result) -> list[dict[str, Any]]:
    """Orientation corrections per image in readable units: value, sigma, share of the prior sigma."""
    images: dict[str, list[dict[str, Any]]] = {}
    words, numbers = result.eop.words, result.eop.numbers("value_per_tau", "sigma", "prior_sigma").tolist()
    for k, image in enumerate(words["image"]):
        unit, factor = _READABLE.get(words["unit"][k], (words["unit"][k], 1.0))
        value, sigma, prior = (None if math.isnan(number) else number for number in numbers[k])
        degree = int(result.eop.figures["degree"][k])
        ending = words["parameter"][k].rpartition("_")[2]  # of a polynomial of samples: s and its degree
        images.setdefault(image, []).append({
            "name": _component(words["component"][k]),
            "degree": {"s": f"s^{degree}", "c": f"curve {degree}"}.get(ending[0]) or _DEGREES[degree], "unit": unit,
            "value": None if value is None else value * factor, "sigma": None if sigma is None else sigma * factor,
            "prior": None if prior is None else prior * factor,
            "share": None if not prior or value is None else value / prior,
        })  # fmt: skip
    return [{"image": image, "rows": rows} for image, rows in images.items()]
