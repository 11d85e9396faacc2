"""The loop solves the 27 certified regressions of NIST StRD from both starts of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.adjustment.regression import CurveFit, fit_curve
from fg_orient.model.errors import NoSolutionError
from tests.support.nist import MODELS, Certified, digits, read_set

pytestmark = pytest.mark.truth

#: The certified values must be reached to this number of digits.
DIGITS = 6.0
#: From these starts Gauss-Newton does not reach the certified values, because equations have
#: no solution, the error increases, or steps repeat in a cycle. MGH09 ends at another
#: stationary point (sum of squares 4.2e-4).
BEYOND_GAUSS_NEWTON = {
    ("BoxBOD", 1), ("Eckerle4", 1), ("Gauss3", 2), ("Hahn1", 1), ("MGH09", 1), ("MGH09", 2), ("MGH10", 1),
    ("MGH17", 1), ("Misra1b", 2), ("Misra1c", 1), ("Nelson", 1), ("Nelson", 2), ("Rat42", 1), ("Rat43", 1),
    ("Thurber", 1),
}  # fmt: skip
#: 3200 iterations along a valley: the parameter b1 grows from 1e-47 to 6e-3.
LONG = ("MGH10", 1)

MISRA1A = Certified(
    "Misra1a",
    x=np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0]),
    y=np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78]),
    starts=np.array([[500.0, 1e-4], [250.0, 5e-4]]),
    parameters=np.array([2.3894212918e2, 5.5015643181e-4]),
    standard_deviations=np.array([2.7070075241, 7.2668688436e-6]),
    squares=1.2455138894e-1,
)
DANWOOD = Certified(
    "DanWood",
    x=np.array([1.309, 1.471, 1.490, 1.565, 1.611, 1.680]),
    y=np.array([2.138, 3.421, 3.597, 4.340, 4.882, 5.660]),
    starts=np.array([[1.0, 5.0], [0.7, 4.0]]),
    parameters=np.array([7.6886226176e-1, 3.8604055871]),
    standard_deviations=np.array([1.8281973860e-2, 5.1726610913e-2]),
    squares=4.3173084083e-3,
)


def least_digits(fit: CurveFit, certified: Certified) -> float:
    """Return the least number of right digits of parameters, standard deviations and sum of squares."""
    assert fit.standard_deviations is not None, fit.unavailable
    pairs = [(fit.parameters, certified.parameters), (fit.standard_deviations, certified.standard_deviations)]
    return min(digits(found, value) for found, value in [*pairs, (fit.chi2, certified.squares)])


def fitted(certified: Certified, start: int, **choice: Any) -> CurveFit:
    return fit_curve(MODELS[certified.name], certified.x, certified.y, certified.starts[start - 1], **choice)


def runs() -> list[Any]:
    slow = {LONG: [pytest.mark.slow]}
    return [pytest.param(name, k, marks=slow.get((name, k), [])) for name in MODELS for k in (1, 2)]


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "start"), runs())
def test_certified_values_from_both_starts(name: str, start: int, real_data: Path) -> None:
    certified = read_set(real_data / "nist-strd" / f"{name}.dat")
    fit = fitted(certified, start)
    assert fit.converged, fit.reason
    assert fit.redundancy == len(certified.y) - len(certified.parameters)
    if name == "Lanczos1":  # its residuals are the rounding of the data: the certified ones are beyond float64
        assert fit.chi2 < 1e-20
        assert digits(fit.parameters, certified.parameters) >= DIGITS
    else:
        assert least_digits(fit, certified) >= DIGITS


@pytest.mark.real_data
def test_gauss_newton_beside_it(real_data: Path) -> None:
    """Gauss-Newton has the certified values wherever it converges, except at one known stationary point."""
    beyond = set()
    for name in MODELS:
        certified = read_set(real_data / "nist-strd" / f"{name}.dat")
        for start in (1, 2):
            try:
                fit = fitted(certified, start, optimizer="gauss-newton", max_iterations=150)
            except NoSolutionError:
                beyond.add((name, start))
                continue
            reached = digits(fit.parameters, certified.parameters) >= DIGITS
            assert reached or not fit.converged or (name, start) == ("MGH09", 2)
            if not reached:
                beyond.add((name, start))
    assert beyond == BEYOND_GAUSS_NEWTON


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("certified", [MISRA1A, DANWOOD], ids=lambda c: c.name)
def test_two_small_sets_always(certified: Certified, start: int) -> None:
    for optimizer in ("levenberg-marquardt", "gauss-newton"):
        fit = fitted(certified, start, optimizer=optimizer)
        assert fit.converged
        assert least_digits(fit, certified) >= DIGITS


@pytest.mark.parametrize("planted", ["weight", "model", "observation"])
def test_the_check_fails_on_planted_errors(planted: str) -> None:
    x, y, sigma = MISRA1A.x, MISRA1A.y.copy(), np.ones(len(MISRA1A.y))
    model = MODELS["Misra1a"]
    if planted == "weight":
        sigma[3] = 1.01
    elif planted == "observation":
        y[3] += 1e-4
    else:
        model = lambda x, b1, b2: b1 * (1.0 - np.exp(-b2 * x)) + 1e-5  # noqa: E731
    assert least_digits(fit_curve(model, x, y, MISRA1A.starts[0], sigma=sigma), MISRA1A) < DIGITS
