"""Tables of the page: largest residuals, corrections and correlations in readable units, comparison with a truth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.table_write import table_file
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.distributions import normal_probability
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import N_EOP, parameter_name
from fg_orient.result.plain import Table, read_table
from fg_orient.result.record import Result, require_earth

#: Maximum numbers of images, and of rows of tables of directions or coefficients, on the page.
MAX_IMAGES: Final = 40
MAX_TERMS: Final = 1500
#: Units that are easier to read: name and factor.
_READABLE: Final = {"rad": ("µrad", 1e6), "m/s": ("mm/s", 1e3), "m": ("m", 1.0)}
_DEGREES: Final = ("constant", "linear", "quadratic")
#: Terms that the truth of an image always contains. Other terms (look polynomial, linear terms of an RPC) are
#: zero if they are missing.
_NAMED: Final = {parameter_name(code) for code in range(N_EOP)} | {"line_0", "sample_0"}
_SIGNS: Final = "⁰¹²³⁴⁵⁶⁷⁸⁹"


def _component(name: str) -> str:
    """Return the name of a component as words."""
    if name.startswith("psi_"):
        return f"look angle ψ{name[-1]}"
    kind = {"x": "position", "vx": "velocity"}.get(name.replace("y", "x").replace("z", "x"))
    if kind is not None:
        return f"{kind} {name[-1].upper()}"
    return name.replace("_", " ")


def _degree(degree: float, parameter: str) -> str:
    """Return the power of an unknown as words; "" if it has none, as the unknowns of a frame camera."""
    if math.isnan(degree):
        return ""
    # if a polynomial depends on the sample, the names of its coefficients end with s and the degree
    ending, power = parameter.rpartition("_")[2], int(degree)
    return {"s": f"s^{power}", "c": f"curve {power}"}.get(ending[0]) or _DEGREES[power]


def corrections(result: Result) -> list[dict[str, Any]]:
    """Return the orientation corrections of each image in readable units: value, sigma, share of the prior sigma."""
    images: dict[str, list[dict[str, Any]]] = {}
    words = (result.eop.words[name] for name in ("image", "component", "parameter", "unit"))
    numbers = result.eop.numbers("degree", "value_per_tau", "sigma", "prior_sigma").tolist()
    for image, component, parameter, given, (degree, *row) in zip(*words, numbers, strict=True):
        unit, factor = _READABLE.get(given, (given, 1.0))
        value, sigma, prior = (None if math.isnan(number) else number * factor for number in row)
        images.setdefault(image, []).append({
            "name": _component(component), "degree": _degree(degree, parameter), "unit": unit, "value": value,
            "sigma": sigma, "prior": prior, "share": None if not prior or value is None else row[0] / row[2],
        })  # fmt: skip
    return [{"image": image, "rows": rows} for image, rows in images.items()]


def short_names(result: Result) -> dict[str, list[str]]:
    """Return the short names of unknowns by image for the axes of a drawing: component and degree, ``X τ²``."""
    words, degrees = result.eop.words, result.eop.figures["degree"]
    out: dict[str, list[str]] = {}
    for image, component, parameter, degree in zip(
        words["image"], words["component"], words["parameter"], degrees.tolist(), strict=True
    ):
        if math.isnan(degree):  # unknowns of frame cameras are not coefficients of polynomials
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
    """Return unknowns of the record, such as ``right.y_0``, with the names of the drawings: ``right Y``."""
    left = {image: iter(names) for image, names in short_names(result).items()}
    rows = zip(result.eop.words["image"], result.eop.words["parameter"], strict=True)
    return {f"{image}.{parameter}": f"{image} {next(left[image])}" for image, parameter in rows}


def correlations(cofactors: Array) -> Array:
    """Return the correlation matrix (k, k) of a cofactor matrix; nan if a variance is not positive."""
    sigma = np.sqrt(np.where(np.diag(cofactors) > 0.0, np.diag(cofactors), np.nan))
    return np.asarray(np.clip(cofactors / np.outer(sigma, sigma), -1.0, 1.0))


def image_correlations(result: Result) -> dict[str, Array]:
    """Return the correlations (k, k) of the unknowns of each image that has two or more, in the order of ``eop.csv``.

    The result is empty without covariances.
    """
    matrices = {image: correlations(q) for image, q in result.cofactors.items() if len(q) > 1}
    return {image: rho for image, rho in matrices.items() if np.isfinite(rho).any()}


def largest_rows(result: Result, count: int) -> Index:
    """Return the rows of the image points with the largest normalised residuals, largest first."""
    worst = np.nan_to_num(np.abs(result.normalised[0]), nan=0.0).max(axis=1)
    least = np.partition(worst, -count)[-count] if len(worst) > count else 0.0
    among = np.flatnonzero(worst >= least)  # a partial sort is faster for few of very many rows
    return among[np.argsort(-worst[among], kind="stable")[:count]]


def largest_residuals(result: Result, count: int = 20) -> dict[str, Any] | None:
    """Return image points with the largest residuals over their own sigmas, largest first; None without tests.

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
    size, order = np.nan_to_num(np.abs(ratio), nan=0.0), largest_rows(result, count)
    names = ("v_line_px", "v_sample_px", "w_line", "w_sample", "redundancy_line", "redundancy_sample", "mdb_line_px",
             "mdb_sample_px")  # fmt: skip
    values = table.numbers(*names, rows=order).tolist()
    rows = [{"image": table.words["image"][k], "id": table.words["id"][k], **dict(zip(names, row, strict=True))}
            for k, row in zip(order.tolist(), values, strict=True)]  # fmt: skip
    n = int(np.isfinite(ratio).sum())
    expected = 2.0 * n * float(normal_probability(-3.0))
    return {"rows": rows, "n": n, "beyond": int((size > 3.0).sum()),
            "expected": f"{expected:.1f}" if expected < 10.0 else f"{expected:.0f}"}  # fmt: skip


def not_determined(record: dict[str, Any]) -> list[tuple[str, str, str, float | None]]:
    """Return image, direction in words, what determines it ("nothing" first, or "its prior") and singular value.

    A sentence may describe several unobservable directions, so these rows have no singular value.
    """
    rows: list[tuple[str, str, str, float | None]] = []
    for image in record["observability"][:MAX_IMAGES]:
        name = image["image"]
        rows += [(name, text.removeprefix(f"image {name}: "), "nothing", None) for text in image["sentences"]]
        held = image["held_by_the_prior"]
        values = image["singular_values"][image["determined"] :][: len(held)]
        rows += [(name, text, "its prior", s) for text, s in zip(held, values, strict=True)]
    return sorted(rows, key=lambda row: row[2] != "nothing")[:MAX_TERMS]


# --- comparison with the truth of a simulation; no other function reads the truth -------------------


def compare_truth(result: Result, truth: Path) -> dict[str, Any]:
    """Compare estimated orientation and points with the truth, in predicted standard deviations.

    Parameters
    ----------
    result : Result
    truth : Path
        Folder with the tables ``eop`` and ``points``.

    Returns
    -------
    dict
        ``groups``: name, n, rms_normalised, max_normalised; ``eop``: image, parameter, unit,
        estimated, true, difference, sigma, normalised; ``points``: n and RMSE East, North, Up (m)
        by role. Standard deviations are in prior scale (sigma0 = 1).

    Raises
    ------
    InputError
        The folder contains no truth, or the truth of another project.
    """
    of_eop, of_points = (table_file(truth, name) for name in ("eop", "points"))
    for file in (of_eop, of_points):
        if not file.is_file():
            raise InputError.of("report.no_truth", file=truth, option="truth", value=f"no {file.name}")
    table = read_table(of_eop, "image", "parameter", "value_per_tau", code="report.no_truth")
    eop = _compare_eop(result, table, str(of_eop))
    table = read_table(of_points, "id", "lon_deg", "lat_deg", "height_m", code="report.no_truth")
    points, normalised = _compare_points(result, table, str(of_points))
    of_images: dict[str, list[float]] = {}
    for row in eop:
        of_images.setdefault(row["image"], []).append(row["normalised"])
    groups = [_truth_group(f"orientation of image {image}", np.array(own)) for image, own in of_images.items()]
    for role, ratio in normalised.items():
        axes = zip(("East", "North", "Up"), ratio.T, strict=True)
        groups += [_truth_group(f"{role} points, {axis}", own) for axis, own in axes]
    return {"groups": groups, "eop": eop, "points": points}


def _truth_group(name: str, ratio: Array) -> dict[str, Any]:
    ratio = ratio[np.isfinite(ratio)]
    rms, largest = (float(np.sqrt(np.mean(ratio**2))), float(np.abs(ratio).max())) if len(ratio) else (None, None)
    return {"name": name, "n": len(ratio), "rms_normalised": rms, "max_normalised": largest}


def _prior_scale(result: Result, table: Table) -> Array:
    """Return the factors that convert the standard deviations of a table to prior scale."""
    sigma0 = result.record["sigma0"] or np.nan
    return np.array([1.0 / sigma0 if scale == "posterior" else 1.0 for scale in table.words["sigma_scale"]])


def _compare_eop(result: Result, truth: Table, file: str) -> list[dict[str, Any]]:
    names = zip(truth.words["image"], truth.words["parameter"], strict=True)
    true = dict(zip(names, truth.figures["value_per_tau"].tolist(), strict=True))
    words = (result.eop.words[name] for name in ("image", "parameter", "unit"))
    values = result.eop.numbers("value_per_tau", "sigma") * [[1.0, k] for k in _prior_scale(result, result.eop)]
    out = []
    for image, parameter, unit, (estimated, sigma) in zip(*words, values.tolist(), strict=True):
        if (image, parameter) not in true and parameter in _NAMED:
            raise InputError.of("report.other_truth", file=file, value=f"{image} {parameter}")
        known = true.get((image, parameter), 0.0)
        out.append({
            "image": image, "parameter": parameter, "unit": unit, "estimated": estimated, "true": known,
            "difference": estimated - known, "sigma": sigma,
            "normalised": (estimated - known) / sigma if sigma > 0.0 else float("nan"),
        })  # fmt: skip
    return out


def _compare_points(result: Result, truth: Table, file: str) -> tuple[dict[str, Any], dict[str, Array]]:
    ids, roles = result.points.words["id"], np.array(result.points.words["role"], dtype=str)
    known = {name: k for k, name in enumerate(truth.words["id"])}
    missing = [name for name in ids if name not in known]
    if missing:
        raise InputError.of("report.other_truth", file=file, value=f"point {missing[0]}")
    require_earth(result, file)
    geodetic = truth.numbers("lon_deg", "lat_deg", "height_m")[[known[name] for name in ids]]
    difference = result.points.numbers("x_m", "y_m", "z_m") - geodetic_to_ecef(*geodetic.T)
    enu = np.einsum("nij,nj->ni", enu_from_ecef(geodetic[:, 0], geodetic[:, 1]), difference)
    sigma = result.points.numbers("sigma_east_m", "sigma_north_m", "sigma_up_m")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = enu / (sigma * _prior_scale(result, result.points)[:, None])
    summary, normalised = {}, {}
    for role in dict.fromkeys(result.points.words["role"]):
        mask = (roles == role) & np.isfinite(enu).all(axis=1)
        rmse = np.sqrt(np.mean(enu[mask] ** 2, axis=0)) if mask.any() else np.full(3, np.nan)
        names = ("rmse_east_m", "rmse_north_m", "rmse_up_m")
        summary[role] = {"n": int(mask.sum()), **{name: float(v) for name, v in zip(names, rmse, strict=True)}}
        normalised[role] = ratio[mask]
    return summary, normalised
