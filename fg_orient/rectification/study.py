"""Design study: how many control points, which degree (İpbüker 1994, tables 6.1 and 7.1), and what m0s may say.

Two checks of printed m0s need no points. Least squares over the same points cannot leave larger squares with more
terms: ``m0^2 (2n - 2p)`` must not grow with the degree. And whether a degree improves the last one is an F test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import f_tail
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, positive, whole
from fg_orient.rectification.fit import Observations, fit, plain_rmse
from fg_orient.rectification.models import find_model

Array = npt.NDArray[np.float64]


def terms(degree: int) -> int:
    """Coefficients per axis of a polynomial: (q + 1)(q + 2)/2.

    Raises
    ------
    InputError
        A degree below 0.
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
        Radial RMSE at the test points over the layouts, in the unit of the target; nan where nothing was fitted.
    layouts : int
        Layouts that had a solution.
    reason : str
        Why there is none; "" if there is.
    """

    n_points: int
    degree: int
    median: float
    low: float
    high: float
    layouts: int
    reason: str


def design_study(
    control: Observations, test: Observations, counts: Sequence[int], degrees: Sequence[int], *, layouts: int = 30,
    seed: int = 1,
) -> tuple[Cell, ...]:  # fmt: skip
    """Fit polynomials to random choices of control points and compare at independent test points.

    Parameters
    ----------
    control, test : Observations
        The test points take no part.
    counts : sequence of int
        Numbers of control points, each at most the number there is.
    degrees : sequence of int
    layouts : int
        Random choices per number; the choice of all points is one. The same choices serve all degrees.
    seed : int

    Returns
    -------
    tuple of Cell
        For each count, each degree.

    Raises
    ------
    InputError
        A count that is not there, an impossible degree, no layouts, a negative seed; no layout is refused for this: its
        cell has the reason.
    """
    most = len(control)
    for count in counts:
        if not 1 <= count <= most:
            raise InputError.of("rectify.counts", option="counts", value=count, most=most)
    if seed < 0:
        raise InputError.of("rectify.seed", option="seed", value=seed)
    whole("<layouts>", layouts, 1)
    rng, out = np.random.default_rng(seed), list[Cell]()
    for count in counts:
        n = 1 if count == most else layouts
        chosen = [np.sort(rng.permutation(most)[:count]) for _ in range(n)]
        out += [_cell(control, test, chosen, degree) for degree in degrees]
    return tuple(out)


def _cell(control: Observations, test: Observations, chosen: Sequence[npt.NDArray[np.intp]], degree: int) -> Cell:
    model, reason, found = find_model("polynomial", degree), "", list[float]()
    for rows in chosen:
        try:
            t = fit(control.take(rows), model).transformation
        except InputError as error:  # too few points, or on a line
            reason = error.problems[0].message
            continue
        found.append(plain_rmse(t.apply(test.source[:, :2]) - test.target)[2])
    if not found:
        return Cell(len(chosen[0]), degree, np.nan, np.nan, np.nan, 0, reason)
    return Cell(len(chosen[0]), degree, float(np.median(found)), min(found), max(found), len(found), "")


def growing_degrees(m0_by_degree: Mapping[int, float], n_points: int) -> tuple[int, ...]:
    """Degrees whose sum of squares is larger than that of a lower one over the same points: impossible values.

    Parameters
    ----------
    m0_by_degree : mapping
        m0 per coordinate of polynomials of each degree, fitted to the same points.
    n_points : int

    Raises
    ------
    InputError
        A degree has no redundancy with so many points, so there is no m0 to test; an m0 that is not above 0.
    """
    for degree, m0 in m0_by_degree.items():
        positive(f"m0 of degree {degree}", m0, "the target's unit")
    degrees = sorted(m0_by_degree)
    lacking = without_redundancy(degrees, n_points)
    if lacking:
        raise InputError.of(
            "rectify.few_points", place=f"degree {lacking[0]}", points=n_points, equations=2 * n_points,
            unknowns=2 * terms(lacking[0]), least=terms(lacking[0]) + 1,
        )  # fmt: skip
    squares = [m0_by_degree[q] ** 2 * 2 * (n_points - terms(q)) for q in degrees]
    return tuple(q for k, q in enumerate(degrees) if k and squares[k] > min(squares[:k]))


def without_redundancy(degrees: Sequence[int], n_points: int) -> tuple[int, ...]:
    """Degrees for which 2n <= (q + 1)(q + 2)."""
    return tuple(q for q in degrees if n_points <= terms(q))


def admissible_points(m0_by_degree: Mapping[int, float], most: int = 200) -> tuple[int, ...]:
    """Numbers of points up to and with ``most`` for which a row of m0s is possible.

    m0s that do not grow with the degree are possible with any number: ``most`` at the end is then where the search
    stopped, no limit of the row.

    Raises
    ------
    InputError
        No m0, or one that is not above 0.
    """
    finite("m0", list(m0_by_degree.values()))
    least = terms(max(m0_by_degree)) + 1
    return tuple(n for n in range(least, most + 1) if not growing_degrees(m0_by_degree, n))


def improvement_test(
    m0_low: float, degree_low: int, m0_high: float, degree_high: int, n_points: int
) -> tuple[float, float]:
    """F test of a higher degree against a lower one, from their m0s over the same points.

    Returns
    -------
    float, float
        F, and the probability of such an F if the terms added are zero; nan if the squares grow.

    Raises
    ------
    InputError
        The higher degree has no redundancy, it is not the higher one, or an m0 is not above 0.
    """
    if degree_high <= degree_low:
        raise InputError.of("options.value", place="higher degree", value=degree_high, expected=f"above {degree_low}")
    growing_degrees({degree_low: m0_low, degree_high: m0_high}, n_points)  # refuses without redundancy
    f_low, f_high = (2 * (n_points - terms(q)) for q in (degree_low, degree_high))
    squares_low, squares_high = m0_low**2 * f_low, m0_high**2 * f_high
    if squares_high > squares_low:
        return np.nan, np.nan
    added = f_low - f_high
    statistic = (squares_low - squares_high) / added / m0_high**2
    return float(statistic), float(f_tail(added, f_high, statistic))
