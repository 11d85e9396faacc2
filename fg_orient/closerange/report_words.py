"""Texts of the close-range report: numbers, lengths, accuracy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from fg_orient.report.words import check_point_words

#: Units of length and their factors from m.
LENGTHS: Final = (("km", 1e-3), ("m", 1.0), ("mm", 1e3), ("µm", 1e6))
KINDS: Final = {
    "bundle": "Bundle adjustment", "dlt": "Direct linear transformation", "resection": "Resection",
    "intersection": "Intersection", "surface": "Surface",
}  # fmt: skip


def significant(value: float | None, digits: int = 3) -> str:
    """Return the number with some significant digits, without an exponent if that is short; a dash for None."""
    if value is None or not math.isfinite(value):
        return "–"
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    decimals = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(decimals, 0)}f}".replace("-", "−")


def length(metres: float) -> str:
    """Return the length in m, mm or µm."""
    unit, factor = next((one for one in LENGTHS[1:] if abs(metres) * one[1] >= 0.1), LENGTHS[-1])
    return f"{significant(metres * factor)} {unit}" if metres else "0 m"


def round_length(metres: float) -> str:
    """Return the round length of a scale bar."""
    unit, factor = next((one for one in LENGTHS if metres * one[1] >= 1.0), LENGTHS[-1])
    return f"{metres * factor:g} {unit}"


def unit_of(metres: list[float]) -> tuple[str, float]:
    """Return the unit of a column of lengths, and its factor from m: mm where the largest is below 0.2 m."""
    largest = max((abs(v) for v in metres if v is not None and math.isfinite(v)), default=0.0)
    return ("m", 1.0) if largest >= 0.2 else ("mm", 1e3)


def photo_rows(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the image points of photos that were oriented one by one, with the name of their photo."""
    return [{"photo": photo["photo"]} | row for photo in record.get("photos", []) for row in photo["points"]]


def accuracy_words(record: Mapping[str, Any]) -> list[str]:
    """Return the accuracy of the result at check points, else by its standard deviations."""
    if record["kind"] == "surface":
        worst = max(record["points"], key=lambda p: abs(p["distance_m"]))
        return [
            f"Normal distances: root mean square {length(record['rms_m'])}, largest "
            f"{length(worst['distance_m'])} at point {worst['id']}."
        ]
    if record.get("check"):
        along = ", ".join(f"{length(v / 1e3)} {axis}" for v, axis in zip(record["check"]["rms_mm"], "XYZ", strict=True))
        return [check_point_words(record["check"]["n"], along)]
    new = [p for p in record.get("points", []) if p.get("role", "new") != "control" and p.get("sigma_x_m") is not None]
    if not new:
        return []
    rms = [math.sqrt(float(np.mean([p[f"sigma_{a}_m"] ** 2 for p in new]))) for a in "xyz"]
    text = ", ".join(f"{length(v)} {axis}" for v, axis in zip(rms, "XYZ", strict=True))
    return [
        f"Mean standard deviations of {len(new)} new points: {text}. "
        "There are no check points: the accuracy is not verified."
    ]
