"""Tables 6.1 and 7.1, sections 6.2 and 7.2: accuracies at points that are not published."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.cells import CellKey
from fg_orient.rectification.study import (
    REPRODUCED_RUNS,
    SCENE_POINTS,
    SHEET_EXTENT_KM,
    admissible_points,
    digitised_sheets,
    distance_ratios,
    growing_degrees,
    terms,
)
from fg_orient.studies.reproduce.found import Found

Values = Mapping[CellKey, float]

#: Points read on each rectified image (section 7.1).
POINTS_7_1: Final = 30
DEGREES: Final = (1, 2, 3)
#: Of table 6.1: block with 20 values.
BLOCK: Final = "1024 x 1024"
#: Pixels that the RMS values of section 6.2 in metres and pixels refer to.
PIXELS_M: Final = {"welch_1984a": 28.5, "welch_1985bc": 30.0, "borgeson_1985": 28.5}


def rectifications(values: Values) -> dict[CellKey, Found]:
    """Table 7.1: which m0 is impossible, and whether the distances are those of noise alone."""
    out = {}
    for row in [key.parameter for key in values if key.table == "7.1" and key.quantity == "pair_distance_sd"]:
        keys = {q: CellKey("7.1", quantity=f"m0_degree_{q}", parameter=row) for q in DEGREES}
        m0 = {q: values[key] for q, key in keys.items()}
        for q in growing_degrees(m0, POINTS_7_1) if min(m0.values()) > 0.0 else ():
            out[keys[q]] = _impossible(m0, q)
        key = CellKey("7.1", quantity="pair_distance_sd", parameter=row)
        out[key] = _distances(row, m0[1], values[key])
    return out


def _impossible(m0: Mapping[int, float], degree: int) -> Found:
    """Least squares over the same points cannot leave more with more terms."""
    most = min(m0[q] * float(np.sqrt((POINTS_7_1 - terms(q)) / (POINTS_7_1 - terms(degree)))) for q in m0 if q < degree)
    allowed = admissible_points(m0)
    remark = (
        f"impossible over {POINTS_7_1} points: m0^2 (2n - 2p) grows with the degree; at most {most:.2f} m follows from "
        f"the lower degrees, which may be wrong instead; the row would be possible {_words(allowed)}"
    )
    return Found(most, remark, kind="differs")


def _words(allowed: tuple[int, ...]) -> str:
    """Numbers of points that would allow a row."""
    return f"with {allowed[0]} to {allowed[-1]} points" if allowed else "with no number of points"


def _distances(row: str, m0: float, printed: float) -> Found:
    """Distance differences expected of noise alone, from m0 of degree 1."""
    found = distance_ratios(REPRODUCED_RUNS)
    low, middle, high = _spread(found.ratio * m0)
    remark = (
        f"{middle / m0:.2f} m0 of degree 1 in {len(found.ratio)} simulated scenes of {SCENE_POINTS} points with noise "
        f"alone, printed {printed / m0:.2f}"
    )
    if row == "spot_pan":
        remark += "; how many points were measured in it is not printed"
    elif printed > high:
        scale = np.sqrt(printed**2 - middle**2) / found.spread_m.mean()
        remark += f"; a scale error of {100 * scale:.2f} % left over would explain it"
    return Found(middle, remark, low, high)


def north_georgia(values: Values) -> dict[CellKey, Found]:
    """Table 6.1: RMS = sigma sqrt(1 + p/n), sigma fitted to the 20 values of one block.

    All values are RMSs at the same test points: what these have in common goes into sigma, so a value is held against
    the scatter of the others about the law, not against the spread of an RMS over so many points.
    """
    factors, rms, keys = [], [], []
    for key, value in values.items():
        if key.table == "6.1" and key.parameter.startswith(BLOCK):
            n, degree = (int(word) for word in re.findall(r"(\d+) GCPs, degree (\d+)", key.parameter)[0])
            keys.append(key)
            factors.append(np.sqrt(1.0 + terms(degree) / n))
            rms.append(value)
    g, v = np.array(factors), np.array(rms)
    sigma, out = float(g @ v / (g @ g)), {}
    for k, key in enumerate(keys):
        others = np.arange(len(v)) != k
        scatter = _scatter(g[others], v[others])
        law, half = sigma * float(g[k]), 1.96 * scatter
        remark = (
            f"sigma sqrt(1 + p/n), a law found by looking at this table, sigma = {sigma:.2f} m fitted to its {len(v)} "
            f"values of this block; 1.96 times the scatter of the {len(v) - 1} others about the law, {scatter:.2f} m"
        )
        if abs(v[k] - law) > half:
            remark += f"; more than the law and the rounding to 1 m explain, {v[k] - law:+.1f} m"
        out[key] = Found(law, remark, law - half, law + half)
    return out


def _scatter(factors: npt.NDArray[np.float64], rms: npt.NDArray[np.float64]) -> float:
    """Standard deviation of values about sigma times factors, sigma fitted to them."""
    sigma = float(factors @ rms / (factors @ factors))
    return float(np.sqrt(np.sum((rms - sigma * factors) ** 2) / (len(rms) - 1)))


def literature(values: Values) -> dict[CellKey, Found]:
    """Section 6.2: RMS in pixels from that in metres, where both are printed."""
    out = {}
    for key in values:
        metres = values.get(key._replace(quantity="rmse_m"))
        pixel = PIXELS_M.get(key.parameter.partition(",")[0])
        if key.table == "s6.2" and key.quantity == "rmse_px" and metres is not None and pixel is not None:
            out[key] = Found(metres / pixel, f"the metres beside it by a pixel of {pixel:g} m")
    return out


def calibration(values: Values) -> dict[CellKey, Found]:
    """Section 7.2: three precisions of one digitised sheet must fit each other."""
    found = digitised_sheets(SHEET_EXTENT_KM, REPRODUCED_RUNS)
    extent = " x ".join(map(str, SHEET_EXTENT_KM))
    remark = (
        f"{REPRODUCED_RUNS} simulated calibrations with 24 nodes over {extent} km (assumed) and the noise that the "
        "printed m0 says"
    )
    out = {
        CellKey("s7.2", quantity="affine_m0"): Found(
            float("nan"), "the simulations take their noise from it", kind="not_reproducible"
        )
    }
    for quantity, runs in (("pair_distance_diff_sd", found.distance_sd),
                           ("helmert_mean_point_error", found.helmert_point_error)):  # fmt: skip
        low, middle, high = _spread(runs)
        out[CellKey("s7.2", quantity=quantity)] = Found(middle, remark, low, high)
    return out


def _spread(runs: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    """Mean of some runs, with 1.96 standard deviations below and above."""
    middle, half = float(runs.mean()), 1.96 * float(runs.std(ddof=1))
    return middle - half, middle, middle + half


COMPUTERS: Final[dict[str, Callable[[Values], dict[CellKey, Found]]]] = {
    "6.1": north_georgia, "7.1": rectifications, "s6.2": literature, "s7.2": calibration,
}  # fmt: skip
