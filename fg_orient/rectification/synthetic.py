"""Simulations behind figures of İpbüker 1994 that no formula gives: digitised sheets, distances against m0.

The points of that work are not published; these are drawn anew from what it says of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.rectification.arguments import whole
from fg_orient.rectification.distances import pair_distances
from fg_orient.rectification.fit import Observations, fit
from fg_orient.rectification.models import find_model

Array = npt.NDArray[np.float64]

RUNS: Final = 400
#: What a reproduction takes the time for.
REPRODUCED_RUNS: Final = 60
#: Scene of 30 km with 30 points, noise of one coordinate in m; the ratio depends on neither size nor noise.
SCENE_M: Final = 30_000.0
SCENE_POINTS: Final = 30
SCENE_SIGMA_M: Final = 20.0
#: The calibration of the sheets (section 7.2): points, noise, the printed affine transformation (northing, easting).
SHEET_POINTS: Final = 24
SHEET_SIGMA_M: Final = 4.34
#: Extent of the nodes about the islands, east and north, assumed.
SHEET_EXTENT_KM: Final = (9, 6)
SHEET_MATRIX: Final = ((1.0010, 0.0007), (-0.0001, 1.0007))
SHEET_ORIGIN_M: Final = (4_525_000.0, 678_000.0)


@dataclass(frozen=True)
class Ratios:
    """Runs of noise alone on a scene: (runs,) arrays.

    Parameters
    ----------
    ratio : (runs,) array
        Standard deviation of the pairwise distance differences by m0 of the affine transformation.
    spread_m : (runs,) array
        Standard deviation of the distances themselves: what a scale error of 1 adds.
    """

    ratio: Array
    spread_m: Array


@cache
def distance_ratios(runs: int = RUNS, seed: int = 1) -> Ratios:
    """Pairwise distances against m0 for 30 points with noise alone; InputError without runs or seed."""
    whole("runs", runs, 2)
    rng, model = np.random.default_rng(whole("seed", seed, 0)), find_model("affine")
    ratio, spread = np.empty(runs), np.empty(runs)
    for k in range(runs):
        image = rng.uniform(0.0, SCENE_M, (SCENE_POINTS, 2))
        plane = image + rng.normal(0.0, SCENE_SIGMA_M, image.shape)
        ratio[k] = pair_distances(image, plane).standard_deviation / fit(Observations.of(image, plane), model).m0
        spread[k] = pair_distances(image, np.zeros_like(image)).standard_deviation
    return Ratios(ratio, spread)


@dataclass(frozen=True)
class Digitised:
    """Runs of a digitised sheet: (runs,) arrays.

    Parameters
    ----------
    affine_m0, distance_sd, helmert_point_error : (runs,) array
        m.
    determinant : (runs,) array
        Of the affine transformation: its scale of areas.
    """

    affine_m0: Array
    distance_sd: Array
    helmert_point_error: Array
    determinant: Array


@cache
def digitised_sheets(extent_km: tuple[int, int] = SHEET_EXTENT_KM, runs: int = RUNS, seed: int = 1) -> Digitised:
    """Digitise 24 nodes of a grid of 1 km, calibrate the sheet, and compare distances before it.

    ``extent_km`` is that of the nodes, east and north.

    Raises
    ------
    InputError
        Fewer than two runs, a negative seed, or an extent with fewer than 24 nodes.
    """
    whole("runs", runs, 2)
    whole("seed", seed, 0)
    east_km, north_km = (whole("extent", size, 1) for size in extent_km)
    whole("nodes", (east_km + 1) * (north_km + 1), SHEET_POINTS)
    rng, (affine, helmert) = np.random.default_rng(seed), (find_model("affine"), find_model("helmert"))
    north, east = np.meshgrid(*(1000.0 * np.arange(size + 1) for size in extent_km[::-1]), indexing="ij")
    nodes = np.column_stack([north.ravel(), east.ravel()])
    back, out = np.linalg.inv(np.array(SHEET_MATRIX)), np.empty((runs, 4))
    for k in range(runs):
        plane = nodes[rng.permutation(len(nodes))[:SHEET_POINTS]]
        table = plane @ back.T + rng.normal(0.0, SHEET_SIGMA_M, plane.shape)
        points = Observations.of(table, plane + np.array(SHEET_ORIGIN_M))
        found = fit(points, affine)
        x = found.transformation.plain_coefficients() or {}
        out[k] = (
            found.m0, pair_distances(table, plane).standard_deviation, np.sqrt(2.0) * fit(points, helmert).m0,
            x["a_10"] * x["b_01"] - x["a_01"] * x["b_10"],
        )  # fmt: skip
    return Digitised(*out.T)
