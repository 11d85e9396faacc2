"""Accuracy standards give the verdicts of the description; each formula is written a second time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from fg_orient.model.errors import InputError
from fg_orient.rectification.options import STANDARDS
from fg_orient.rectification.standards import (
    StandardCompliance,
    check_accuracy,
    cmas_m,
    effective_resolution_m,
    nmas_limit_m,
)


def assess_rmse(x: float, y: float, n_points: int = 40, **options: object) -> tuple[StandardCompliance, ...]:
    """Return the compliance of points with these RMSEs."""
    return check_accuracy(np.full((n_points, 2), (x, y)), **options)


def by_name(found: tuple[StandardCompliance, ...]) -> dict[str, StandardCompliance]:
    return {verdict.standard: verdict for verdict in found}


@pytest.mark.truth
def test_limits_of_nmas() -> None:
    assert nmas_limit_m(24_000) == pytest.approx(12.192)
    assert nmas_limit_m(20_000) == pytest.approx(10.16)
    assert nmas_limit_m(19_999) == pytest.approx(19_999 * 0.0254 / 30)
    assert effective_resolution_m(25_000) == 12.5


@pytest.mark.truth
@pytest.mark.parametrize(
    ("m0", "cmas", "passes", "fails"),
    [(14.61, 31.4, 100_000, 50_000), (19.97, 42.9, 100_000, 50_000), (8.86, 19.0, 50_000, 25_000),
     (9.20, 19.7, 50_000, 25_000)],
)  # fmt: skip
def test_verdicts_on_the_m0s_of_table_7_1(m0: float, cmas: float, passes: int, fails: int) -> None:
    for scale, passed in ((passes, True), (fails, False)):
        (found,) = assess_rmse(m0, m0, scale=scale, standards=("CMAS",))
        assert round(found.value_m, 1) == cmas
        assert found.passed is passed


@pytest.mark.truth
def test_what_1_to_50000_and_1_to_24000_need() -> None:
    assert nmas_limit_m(50_000) / 2.1460 == pytest.approx(11.84, abs=0.005)
    assert nmas_limit_m(24_000) / 2.1460 == pytest.approx(5.7, abs=0.05)
    assert nmas_limit_m(24_000) / 1.5175 == pytest.approx(8.0, abs=0.05)
    assert cmas_m(12.9, 12.9) == pytest.approx(27.7, abs=0.05)
    assert cmas_m(12.9 / math.sqrt(2), 12.9 / math.sqrt(2)) == pytest.approx(19.6, abs=0.05)
    (wong,) = assess_rmse(55 / math.sqrt(2), 55 / math.sqrt(2), scale=250_000, standards=("CMAS",))
    assert wong.passed


@pytest.mark.oracle
def test_factors_are_quantiles_of_the_circular_normal_distribution() -> None:
    assert stats.rayleigh.ppf(0.90) == pytest.approx(2.1460, abs=5e-5)
    assert stats.rayleigh.ppf(0.95) == pytest.approx(2.4477, abs=5e-5)
    values = by_name(assess_rmse(1.0, 1.0))
    assert values["CMAS"].value_m == pytest.approx(1.5175 * math.sqrt(2), rel=1e-4)
    assert values["NSSDA"].value_m == pytest.approx(1.7308 * math.sqrt(2), rel=1e-4)


@pytest.mark.truth
def test_nmas_counts_points() -> None:
    """NMAS permits two of 20 points beyond the limit, and not three."""
    d = np.zeros((20, 2))
    d[:2, 0] = 100.0
    d[2, 1] = 25.4
    (found,) = check_accuracy(d, scale=50_000, standards=("NMAS",))
    assert found.passed and found.value_m == found.limit_m == pytest.approx(25.4)
    d[2, 1] = 25.41
    (found,) = check_accuracy(d, scale=50_000, standards=("NMAS",))
    assert not found.passed
    (nine,) = check_accuracy(d[:9], scale=50_000, standards=("NMAS",))
    assert nine.value_m == 100.0


def admissible(error_m: float, scale: float) -> bool:
    return error_m <= nmas_limit_m(scale) * (1 + 1e-12)


@pytest.mark.truth
@pytest.mark.parametrize("error", [0.5, 10.0, 10.2, 12.0, 16.9, 17.0, 40.0])
def test_largest_scale_is_the_border_of_what_passes(error: float) -> None:
    """The largest scale passes NMAS and a slightly larger one does not, also where the limit drops.

    12 m pass at 1:15000 and at 1:24000, not at 1:20000.
    """
    (found,) = check_accuracy([[error, 0.0]], standards=("NMAS",))
    assert admissible(error, found.largest_scale) and not admissible(error, 0.9999 * found.largest_scale)
    assert bool([text for text in found.remarks if "not from" in text]) == (10.16 < error < 20_000 * 0.0254 / 30)
    assert found.passed is None


@pytest.mark.truth
def test_asprs() -> None:
    found = by_name(assess_rmse(3.0, 4.0, scale=20_000, class_m=4.5, check_point_rmse_m=0.5, n_points=25))
    assert (found["ASPRS-1990"].limit_m, found["ASPRS-1990"].passed) == (pytest.approx(5.0), True)
    assert found["ASPRS-1990"].largest_scale == pytest.approx(16_000)
    assert (found["ASPRS-2014"].value_m, found["ASPRS-2014"].passed) == (4.0, True)
    assert (found["ASPRS-2023"].value_m, found["ASPRS-2023"].passed) == (pytest.approx(math.sqrt(25.25)), False)
    assert any("30" in text for text in found["ASPRS-2023"].remarks)
    (second,) = assess_rmse(7.0, 8.0, scale=20_000, standards=("ASPRS-1990",))
    assert second.passed is False and second.remarks == ("class 2 is met",)
    (small,) = assess_rmse(1.0, 1.0, scale=50_000, standards=("ASPRS-1990",))
    assert small.passed and "1:20000" in small.remarks[0]


@pytest.mark.behaviour
def test_all_standards_in_one_call_and_unequal_axes_are_remarked() -> None:
    rng = np.random.default_rng(1)
    found = check_accuracy(rng.normal(size=(40, 2)) * (1.0, 3.0), scale=10_000)
    assert tuple(verdict.standard for verdict in found) == STANDARDS
    assert all(any("circle" in text for text in by_name(found)[name].remarks) for name in ("CMAS", "NSSDA"))
    assert by_name(found)["NSSDA"].passed is None


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("ask", "code"),
    [(lambda: check_accuracy([[1.0]]), "rectify.differences"),
     (lambda: check_accuracy([[np.nan, 1.0]]), "rectify.differences"),
     (lambda: check_accuracy([[1.0, 1.0]], scale=0.0), "options.value"),
     (lambda: check_accuracy([[1.0, 1.0]], class_m=-1.0), "options.value"),
     (lambda: check_accuracy([[1.0, 1.0]], check_point_rmse_m=-4.0), "options.value"),
     (lambda: check_accuracy([[1.0, 1.0]], check_point_rmse_m=np.nan, standards=("NMAS",)), "options.value"),
     (lambda: check_accuracy([[1.0, 1.0]], standards=("EMAS",)), "rectify.standard")],
)  # fmt: skip
def test_refusals(ask: Callable[[], object], code: str) -> None:
    with pytest.raises(InputError) as caught:
        ask()
    assert caught.value.problems[0].code == code


@pytest.mark.behaviour
def test_no_error_limits_no_scale() -> None:
    found = by_name(check_accuracy([[0.0, 0.0]], scale=1000.0))
    assert all(math.isnan(verdict.largest_scale) for verdict in found.values())
    assert all(found[name].passed for name in ("NMAS", "CMAS", "ASPRS-1990"))
