"""Study numbers of control points and degrees of polynomials; check m0 values; compare pairwise distances.

Source: İpbüker 1994, tables 6.1 and 7.1. One check of printed m0 values needs no points:
with more terms, least squares over the same points cannot give a larger sum of squares.
Therefore ``m0^2 (2n - 2p)`` must not increase with the degree.

Some figures of İpbüker 1994 do not follow from a formula: digitised sheets, and distances
compared with m0. They are simulated. The points of that work are not published, so that
they are simulated from its description.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, positive, whole
from fg_orient.rectification.fit import Observations, fit, plain_rmse
from fg_orient.rectification.transformation import find_model

RUNS: Final = 400
#: Number of runs of a reproduction.
REPRODUCED_RUNS: Final = 60
#: Size of the scene, m. The ratio does not depend on size and noise.
SCENE_M: Final = 30_000.0
#: Number of points of the scene.
SCENE_POINTS: Final = 30
#: Noise of a coordinate, m.
SCENE_SIGMA_M: Final = 20.0
#: Number of points in the calibration of a sheet (section 7.2).
SHEET_POINTS: Final = 24
#: Noise of the digitised coordinates, m.
SHEET_SIGMA_M: Final = 4.34
#: Assumed extent of the nodes around the islands, east and north.
SHEET_EXTENT_KM: Final = (9, 6)
#: Printed affine transformation of the calibration.
SHEET_MATRIX: Final = ((1.0010, 0.0007), (-0.0001, 1.0007))
SHEET_ORIGIN_M: Final = (4_525_000.0, 678_000.0)


def terms(degree: int) -> int:
    """Return the number of coefficients per axis of a polynomial: (q + 1)(q + 2)/2.

    Raises
    ------
    InputError
        The degree is below 0.
    """
    whole("degree", degree, 0)
    return (degree + 1) * (degree + 2) // 2


@dataclass(frozen=True)
class Cell:
    """One cell of a design study.

    Parameters
    ----------
    n_points, degree : int
    median, low, high : float
        Radial RMSE at the test points over the layouts, in the unit of the target; nan
        where nothing was fitted.
    layouts : int
        Number of layouts that had a solution.
    reason : str
        Reason why there is no solution; "" if there is a solution.
    """

    n_points: int
    degree: int
    median: float
    low: float
    high: float
    layouts: int
    reason: str


def design_study(
    control: Observations,
    test: Observations,
    counts: Sequence[int],
    degrees: Sequence[int],
    *,
    layouts: int = 30,
    seed: int = 1,
) -> tuple[Cell, ...]:
    """Fit polynomials to random choices of control points and compare at independent test points.

    Parameters
    ----------
    control, test : Observations
        The test points are not used in a fit.
    counts : sequence of int
        Numbers of control points, at most all of them.
    degrees : sequence of int
    layouts : int
        Number of random choices per count, the same for all degrees; all points are one choice.
    seed : int

    Returns
    -------
    tuple of Cell
        Cells of each degree for each count.

    Raises
    ------
    InputError
        A count exceeds the number of points, a degree is impossible, there are no
        layouts, or the seed is negative. A layout without a solution is not an error: its
        cell contains the reason.
    """
    most = len(control)
    for count in counts:
        if not 1 <= count <= most:
            raise InputError.of("rectify.counts", option="counts", value=count, most=most)
    whole("<layouts>", layouts, 1)
    rng, out = np.random.default_rng(whole("<seed>", seed, 0)), list[Cell]()
    for count in counts:
        n = 1 if count == most else layouts
        chosen = [np.sort(rng.permutation(most)[:count]) for _ in range(n)]
        out += [_cell(control, test, chosen, degree) for degree in degrees]
    return tuple(out)


def _cell(control: Observations, test: Observations, chosen: Sequence[Index], degree: int) -> Cell:
    model, reason, rmse = find_model("polynomial", degree), "", list[float]()
    for rows in chosen:
        try:
            t = fit(control.take(rows), model).transformation
        except InputError as error:  # raised for too few points, or for points on a line
            reason = error.problems[0].message
            continue
        rmse.append(plain_rmse(t.apply(test.source[:, :2]) - test.target)[2])
    if not rmse:
        return Cell(len(chosen[0]), degree, np.nan, np.nan, np.nan, 0, reason)
    return Cell(len(chosen[0]), degree, float(np.median(rmse)), min(rmse), max(rmse), len(rmse), "")


def growing_degrees(m0_by_degree: Mapping[int, float], n_points: int) -> tuple[int, ...]:
    """Return degrees with an impossible m0.

    Their sum of squares exceeds the sum of a lower degree over the same points.

    Parameters
    ----------
    m0_by_degree : mapping
        m0 per coordinate of polynomials of each degree, fitted to the same points.
    n_points : int

    Raises
    ------
    InputError
        A degree has no redundancy with this number of points, so that there is no m0; or an m0 is not above 0.
    """
    for degree, m0 in m0_by_degree.items():
        positive(f"m0 of degree {degree}", m0, "the target's unit")
    degrees = sorted(m0_by_degree)
    lacking = [q for q in degrees if n_points <= terms(q)]  # a degree lacks redundancy if 2n <= (q + 1)(q + 2)
    if lacking:
        raise InputError.of(
            "rectify.few_points",
            place=f"degree {lacking[0]}",
            points=n_points,
            equations=2 * n_points,
            unknowns=2 * terms(lacking[0]),
            least=terms(lacking[0]) + 1,
        )
    squares = [m0_by_degree[q] ** 2 * 2 * (n_points - terms(q)) for q in degrees]
    return tuple(q for k, q in enumerate(degrees) if k and squares[k] > min(squares[:k]))


def admissible_points(m0_by_degree: Mapping[int, float], most: int = 200) -> tuple[int, ...]:
    """Return the numbers of points up to ``most`` for which a row of m0 values is possible.

    m0 values that do not grow with the degree are possible with any number; the last number is then ``most``.

    Raises
    ------
    InputError
        No m0, or one that is not above 0.
    """
    finite("m0", list(m0_by_degree.values()))
    least = terms(max(m0_by_degree)) + 1
    return tuple(n for n in range(least, most + 1) if not growing_degrees(m0_by_degree, n))


class Ratios(NamedTuple):
    """Simulated runs of a scene that contains only noise, (runs,) arrays.

    ``ratio``: standard deviation of the pairwise distance differences, divided by m0 of
    the affine transformation; ``spread_m``: standard deviation of the distances
    themselves, the effect of a scale error of 1.
    """

    ratio: Array
    spread_m: Array


@cache
def distance_ratios(runs: int = RUNS, seed: int = 1) -> Ratios:
    """Compare pairwise distances with m0 for 30 simulated points that contain only noise.

    InputError: there are fewer than two runs, or the seed is negative.
    """
    whole("runs", runs, 2)
    rng, model = np.random.default_rng(whole("seed", seed, 0)), find_model("affine")
    ratio, spread = np.empty(runs), np.empty(runs)
    for k in range(runs):
        image = rng.uniform(0.0, SCENE_M, (SCENE_POINTS, 2))
        plane = image + rng.normal(0.0, SCENE_SIGMA_M, image.shape)
        ratio[k] = pair_distances(image, plane).standard_deviation / fit(Observations.of(image, plane), model).m0
        spread[k] = pair_distances(image, np.zeros_like(image)).standard_deviation
    return Ratios(ratio, spread)


class Digitised(NamedTuple):
    """Simulated runs of a digitised sheet, (runs,) arrays in m; ``determinant``: area scale of the affine fit."""

    affine_m0: Array
    distance_sd: Array
    helmert_point_error: Array
    determinant: Array


@cache
def digitised_sheets(extent_km: tuple[int, int] = SHEET_EXTENT_KM, runs: int = RUNS, seed: int = 1) -> Digitised:
    """Digitise 24 nodes of a grid of 1 km, calibrate the sheet, and compare distances before it.

    ``extent_km`` is the extent of the nodes, east and north.

    Raises
    ------
    InputError
        There are fewer than two runs, the seed is negative, or the extent has fewer than 24 nodes.
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
        fitted = fit(points, affine)
        x = fitted.transformation.plain_coefficients() or {}
        out[k] = (
            fitted.m0,
            pair_distances(table, plane).standard_deviation,
            np.sqrt(2.0) * fit(points, helmert).m0,
            x["a_10"] * x["b_01"] - x["a_01"] * x["b_10"],
        )
    return Digitised(*out.T)


# --- distances of pairs ---------------------------------------------------------------------------


class PairDistances(NamedTuple):
    """Differences of the distances between all pairs of points, m.

    ``differences`` (K,): first minus second list, pairs in the order 01, 02, ..., 12,
    ...; their standard deviation (K - 1 in the divisor) and mean; ``of_point`` (n,): root
    mean square about the mean of the differences of each point's pairs, large for a gross
    error.
    """

    differences: Array
    standard_deviation: float
    mean: float
    of_point: Array


def pair_distances(first: npt.ArrayLike, second: npt.ArrayLike) -> PairDistances:
    """Compare the distances of all pairs of points in two plane systems of one scale, without a transformation.

    İpbüker 1994, appendix EK 3, program KEN.BAS: ``d_ij = s_ij(image in metres) -
    s_ij(map)`` for i < j. Their standard deviation measures the precision of both lists
    together. A constant cancels, a scale error does not. With noise alone it is about
    1.39 m0 for 30 points.

    Parameters
    ----------
    first, second : (n, 2) array_like
        The same points, both in metres.

    Raises
    ------
    InputError
        Fewer than three points (two pairs are needed), or lists of different shapes.
    """
    a, b = (finite("pair distances", values) for values in (first, second))
    if a.ndim != 2 or a.shape[1] != 2 or b.shape != a.shape or len(a) < 3:
        raise InputError.of("rectify.points", place="pair distances", value=f"{a.shape}, {b.shape}")
    n = len(a)
    i, j = np.triu_indices(n, 1)
    d = np.hypot(*(a[i] - a[j]).T) - np.hypot(*(b[i] - b[j]).T)
    mean = float(d.mean())
    squares = np.zeros((n, n))
    squares[i, j] = squares[j, i] = (d - mean) ** 2
    return PairDistances(d, float(d.std(ddof=1)), mean, np.sqrt(squares.sum(axis=1) / (n - 1)))
