"""Tables of the page: residuals by image, largest residuals, corrections and correlations in readable units."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import normal_probability
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]

#: Images, and rows of a table of directions or of coefficients, that the page shows.
MAX_IMAGES: Final = 40
MAX_TERMS: Final = 1500
#: Units that people read more easily: name and factor.
_READABLE: Final = {"rad": ("µrad", 1e6), "m/s": ("mm/s", 1e3), "m": ("m", 1.0)}
_DEGREES: Final = ("constant", "linear", "quadratic")
_SIGNS: Final = "⁰¹²³⁴⁵⁶⁷⁸⁹"


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


def short_names(result: Result) -> dict[str, list[str]]:
    """Unknowns by image as axes of a drawing: component and degree, ``X τ²``."""
    words, degrees = result.eop.words, result.eop.figures["degree"]
    out: dict[str, list[str]] = {}
    for image, component, parameter, degree in zip(
        words["image"], words["component"], words["parameter"], degrees.tolist(), strict=True
    ):
        if math.isnan(degree):  # unknowns of frame cameras are no polynomials
            out.setdefault(image, []).append(component.replace("_", " "))
            continue
        power, kind = int(degree), parameter.rpartition("_")[2][:1]
        name = {"psi_x": "ψx", "psi_y": "ψy", "vx": "vX", "vy": "vY", "vz": "vZ"}.get(component, component)
        name = name.upper() if len(name) == 1 else name
        argument = "s" if kind == "s" else "τ"
        tail = f"c{power}" if kind == "c" else ("", argument)[power] if power < 2 else argument + _SIGNS[power]
        out.setdefault(image, []).append(f"{name} {tail}".strip())
    return out


def unknowns_in_words(result: Result) -> dict[str, str]:
    """Unknowns of the record, ``right.y_0``, as the drawings name them: ``right Y``."""
    left = {image: iter(names) for image, names in short_names(result).items()}
    rows = zip(result.eop.words["image"], result.eop.words["parameter"], strict=True)
    return {f"{image}.{parameter}": f"{image} {next(left[image])}" for image, parameter in rows}


def correlations(cofactors: Array) -> Array:
    """Correlation matrix (k, k) of a cofactor matrix; nan where a variance is not positive."""
    sigma = np.sqrt(np.where(np.diag(cofactors) > 0.0, np.diag(cofactors), np.nan))
    return np.asarray(np.clip(cofactors / np.outer(sigma, sigma), -1.0, 1.0))


def image_correlations(result: Result) -> dict[str, Array]:
    """Correlations (k, k) of the unknowns by image, of images with two or more; none where covariances are unavailable.

    Rows stand in the order of the image's rows of ``eop.csv``.
    """
    found = {image: correlations(q) for image, q in result.cofactors.items() if len(q) > 1}
    return {image: rho for image, rho in found.items() if np.isfinite(rho).any()}


def largest_residuals(result: Result, count: int = 20) -> dict[str, Any] | None:
    """Image points with the largest residuals over their own sigmas, largest first; None without their tests.

    Returns
    -------
    dict or None
        ``rows``: image, id and the columns of ``residuals.csv``; ``n`` tested coordinates, ``beyond`` 3 sigmas,
        ``expected`` of these if all are normal.
    """
    table = result.residuals
    ratio, tested = result.normalised
    if not tested:
        return None
    size = np.nan_to_num(np.abs(ratio), nan=0.0)
    order = np.argsort(-size.max(axis=1), kind="stable")[:count]
    names = ("v_line_px", "v_sample_px", "w_line", "w_sample", "redundancy_line", "redundancy_sample", "mdb_line_px",
             "mdb_sample_px")  # fmt: skip
    values = table.numbers(*names)[order].tolist()
    rows = [{"image": table.words["image"][k], "id": table.words["id"][k], **dict(zip(names, row, strict=True))}
            for k, row in zip(order.tolist(), values, strict=True)]  # fmt: skip
    n = int(np.isfinite(ratio).sum())
    expected = 2.0 * n * float(normal_probability(-3.0))
    return {"rows": rows, "n": n, "beyond": int((size > 3.0).sum()),
            "expected": f"{expected:.1f}" if expected < 10.0 else f"{expected:.0f}"}  # fmt: skip


def not_determined(record: dict[str, Any]) -> list[tuple[str, str, str, float | None]]:
    """Image, direction in words, its holder ("nothing" first, or "its prior") and its singular value.

    Words of unobservable directions may stand for several of them: they have no value of their own.
    """
    rows: list[tuple[str, str, str, float | None]] = []
    for image in record["observability"][:MAX_IMAGES]:
        name = image["image"]
        rows += [(name, text.removeprefix(f"image {name}: "), "nothing", None) for text in image["sentences"]]
        held = image["held_by_the_prior"]
        values = image["singular_values"][image["determined"] :][: len(held)]
        rows += [(name, text, "its prior", s) for text, s in zip(held, values, strict=True)]
    return sorted(rows, key=lambda row: row[2] != "nothing")[:MAX_TERMS]
