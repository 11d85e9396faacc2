"""Sentences of the reports (verdict, accuracy, kinds of unknowns), and numbers as text."""

from __future__ import annotations

import math
from typing import Any

from fg_orient.model.errors import findings_of


def orientation_words(record: dict[str, Any]) -> str:
    """Return a text on the unknowns of the images: EOP set, RPC compensation."""
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
    words += [f"{kind} images" for kind in sorted(kinds - {"pushbroom", "RPC"})]
    return " · ".join(words)


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with a fixed count of decimals as text; a dash if there is no number."""
    if value is None or not math.isfinite(value):
        return "–"
    rounded = round(value, digits) + 0.0  # a zero has no minus sign
    return f"{rounded:.{digits}f}".replace("-", "−")


def signed(value: float) -> str:
    """Return a number with its sign and three decimals; a number rounded to zero has no sign."""
    text = f"{abs(value):.3f}"
    return text if float(text) == 0.0 else ("−" if value < 0.0 else "+") + text


def scientific(value: float | None, digits: int = 2) -> str:
    """Return a number with an exponent, or without it if this is short."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{digits + 1}g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.{digits}e}"
    return text.replace("-", "−")


def printable(text: object) -> str:
    """Return the text with replaced control characters, which HTML does not allow."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(text))


def regularised_words(record: dict[str, Any]) -> str:
    """Return method and kappa of a regularised result, for use after its status; "" for other results."""
    section = record.get("regularisation")
    if not section or section["solver"] is None:
        return ""
    kappa = section["kappa"]
    return f", regularised ({section['label']}{'' if kappa is None else f', kappa {kappa:.3g}'})"


def verdict(record: dict[str, Any]) -> dict[str, str]:
    """Return the verdict on a result: ``kind`` (good, warn, bad), ``title`` and ``text``."""
    words = _verdict(record)
    return {**words, "title": words["title"] + regularised_words(record)}


def _verdict(record: dict[str, Any]) -> dict[str, str]:
    """Return the verdict without the text on a regularisation."""
    status, sigma0, (low, _) = record["status"], record["sigma0"], record["sigma0_interval_99_9"]
    if status == "not_converged":
        return {"kind": "bad", "title": "No solution", "text": record["reason"]}
    if status == "not_trustworthy":
        return {"kind": "bad", "title": "Not trustworthy", "text": record["reason"]}
    if sigma0 is None:
        return {"kind": "warn", "title": "Converged, unchecked", "text": "Without redundancy nothing was checked."}
    fit = "The observations fit the model within their standard deviations."
    robust = record.get("robust")  # results of earlier versions do not contain it
    if robust is not None:
        down, n = robust["n_image_points_below_half"], record["n_image_points"]
        fit = f"The loss {record['loss']} has down-weighted {down} of {n} image points; the rest is untested."
        # least absolute values do not reject observations: a weight below 0.5 means a residual above 2 sigmas
        if record["loss"] == "lad":
            fit = f"{down} of {n} image points exceed 2 sigmas; under least absolute values the fit is untested."
    elif record.get("variance_components") is not None:
        fit = "The standard deviations were estimated from these residuals, so the fit does not test the model."
    elif low is not None and sigma0 < low:
        fit = "The observations fit the model better than they should; see the warnings."
    left = (record.get("snooping") or {}).get("n_left_out", 0)
    if left:
        fit = f"The search for gross errors left out {left} observation{'' if left == 1 else 's'}. {fit}"
    return {"kind": "warn" if findings_of(record) else "good", "title": "Converged", "text": fit}


def accuracy_words(record: dict[str, Any]) -> list[str]:
    """Return sentences on the accuracy at check points; empty without a solution."""
    if record["status"] == "not_converged":
        return []
    check = record["accuracy"]["check"]
    if not check["n"]:
        return ["There are no check points: the accuracy on the ground is not verified."]
    axes = ", ".join(f"{number(check[f'rmse_{axis}_m'], 2)} m {axis.capitalize()}" for axis in ("east", "north", "up"))
    return [check_point_words(check["n"], axes)]


def check_point_words(n: int, axes: str) -> str:
    """Return a sentence on the error at ``n`` check points; ``axes`` is the text of the errors along the axes."""
    points = "one check point" if n == 1 else f"{n} check points"
    return f"At {points}, whose coordinates were not used, the root mean square error is {axes}."
