"""Comparison of a result with the truth of its simulation; nothing else reads the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import N_EOP, parameter_name
from fg_orient.result.plain import Table, read_table
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]

#: What the truth of an image names; other terms (look polynomial, linear terms of an RPC) are zero unless named.
_NAMED = {parameter_name(code) for code in range(N_EOP)} | {"line_0", "sample_0"}


def compare(result: Result, truth: Path) -> dict[str, Any]:
    """Compare estimated orientation and points with the truth, in predicted standard deviations.

    Parameters
    ----------
    result : Result
    truth : Path
        Folder with ``eop.csv`` and ``points.csv``.

    Returns
    -------
    dict
        ``groups``: name, n, rms_normalised, max_normalised; ``eop``: image, parameter, unit,
        estimated, true, difference, sigma, normalised; ``points``: n and RMSE East, North, Up (m)
        by role. Standard deviations are in prior scale (sigma0 = 1).

    Raises
    ------
    InputError
        The folder holds no truth, or that of another project.
    """
    for name in ("eop.csv", "points.csv"):
        if not (truth / name).is_file():
            raise InputError.of("report.no_truth", file=truth, option="truth", value=f"no {name}")
    table = _read(truth / "eop.csv", "image", "parameter", "value_per_tau")
    eop = _compare_eop(result, table, str(truth / "eop.csv"))
    points, normalised = _compare_points(result, _read(truth / "points.csv"), str(truth / "points.csv"))
    groups = [_group(f"orientation of image {image}", np.array([r["normalised"] for r in eop if r["image"] == image]))
              for image in dict.fromkeys(r["image"] for r in eop)]  # fmt: skip
    groups += [_group(f"{role} points, {axis}", normalised[role][:, k])
               for role in normalised for k, axis in enumerate(("East", "North", "Up"))]  # fmt: skip
    return {"groups": groups, "eop": eop, "points": points}


def _group(name: str, ratio: Array) -> dict[str, Any]:
    ratio = ratio[np.isfinite(ratio)]
    rms, largest = (float(np.sqrt(np.mean(ratio**2))), float(np.abs(ratio).max())) if len(ratio) else (None, None)
    return {"name": name, "n": len(ratio), "rms_normalised": rms, "max_normalised": largest}


def _read(path: Path, *columns: str) -> Table:
    try:
        return read_table(path, *columns)
    except ValueError as error:
        raise InputError.of("report.no_truth", file=path, value=error) from None


def _prior_scale(result: Result, table: Table) -> Array:
    """Factors that turn the standard deviations of a table into prior scale."""
    sigma0 = result.record["sigma0"] or np.nan
    return np.array([1.0 / sigma0 if scale == "posterior" else 1.0 for scale in table.words["sigma_scale"]])


def _compare_eop(result: Result, truth: Table, file: str) -> list[dict[str, Any]]:
    words = result.eop.words
    names = zip(truth.words["image"], truth.words["parameter"], strict=True)
    true = dict(zip(names, truth.figures["value_per_tau"].tolist(), strict=True))
    scale = _prior_scale(result, result.eop)
    estimated, sigma = result.eop.numbers("value_per_tau", "sigma").T
    out = []
    for k, key in enumerate(zip(words["image"], words["parameter"], strict=True)):
        if key not in true and key[1] in _NAMED:
            raise InputError.of("report.other_truth", file=file, value=" ".join(key))
        difference = float(estimated[k] - true.get(key, 0.0))
        predicted = float(sigma[k] * scale[k])
        out.append({
            "image": key[0], "parameter": key[1], "unit": words["unit"][k], "estimated": float(estimated[k]),
            "true": true.get(key, 0.0), "difference": difference, "sigma": predicted,
            "normalised": difference / predicted if predicted > 0.0 else float("nan"),
        })  # fmt: skip
    return out


def _compare_points(result: Result, truth: Table, file: str) -> tuple[dict[str, Any], dict[str, Array]]:
    ids, roles = result.points.words["id"], np.array(result.points.words["role"], dtype=str)
    known = {name: k for k, name in enumerate(truth.words["id"])}
    missing = [name for name in ids if name not in known]
    if missing:
        raise InputError.of("report.other_truth", file=file, value=f"point {missing[0]}")
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
