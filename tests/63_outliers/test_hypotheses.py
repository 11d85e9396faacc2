"""Distributions, limits and the control of many tests agree with scipy and step-by-step definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fg_orient.model.errors import InputError
from fg_orient.quality import hypotheses
from fg_orient.quality.hypotheses import can_be_tested, global_test, level_of_each, limits, probabilities, statistics

LEVELS = (0.05, 1e-3, 1e-9)
FREEDOMS = (3, 10, 158, 100_000)


@pytest.mark.oracle
@pytest.mark.parametrize("f", FREEDOMS)
@pytest.mark.parametrize("level", LEVELS)
def test_limits_are_those_of_scipy(f: int, level: float) -> None:
    one, two = np.array([1]), np.array([2])
    fisher = 0.5 * (f - 2) * np.expm1(-2.0 / (f - 2) * np.log(level))  # closed form of F(2, n); scipy takes 1 - level
    t = stats.t.isf(level / 2.0, f - 1)
    assert limits(level, one, f, "baarda")[0] == pytest.approx(stats.norm.isf(level / 2.0), rel=1e-9)
    assert limits(level, one, f, "t")[0] == pytest.approx(t, rel=1e-9)
    pope = np.sqrt(f) * t / np.sqrt(f - 1 + t**2)  # Pope 1976
    assert limits(level, one, f, "pope")[0] == pytest.approx(pope, rel=1e-9)
    assert limits(level, two, f, "baarda")[0] == pytest.approx(stats.chi2.isf(level, 2), rel=1e-9)
    assert limits(level, two, f, "t")[0] == pytest.approx(fisher, rel=1e-9)
    assert limits(level, two, f, "pope")[0] == pytest.approx(f * stats.beta.isf(level, 1, 0.5 * (f - 2)), rel=1e-9)


@pytest.mark.truth
def test_known_limits() -> None:
    """The limits are Baarda's 3.29 for 0.1 % and 1.96 for 5 % (1968), and tau is at most sqrt(f) (Pope 1976)."""
    one = np.array([1])
    assert limits(0.001, one, 50, "baarda")[0] == pytest.approx(3.29, abs=0.005)
    assert limits(0.05, one, 50, "baarda")[0] == pytest.approx(1.96, abs=0.005)
    assert limits(1e-12, one, 4, "pope")[0] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.oracle
@pytest.mark.parametrize("d", [1, 2, 5])
def test_probabilities_are_those_of_scipy_and_pope_decides_as_t(d: int) -> None:
    f, chi2 = 12, 30.0
    t, freedom = np.linspace(0.1, 29.0, 40), np.full(40, d)
    fisher = (t / d) / ((chi2 - t) / (f - d))
    p = probabilities(t, freedom, chi2, f, "t")
    np.testing.assert_allclose(p, stats.f.sf(fisher, d, f - d), rtol=1e-9)
    np.testing.assert_allclose(probabilities(t, freedom, chi2, f, "baarda"), stats.chi2.sf(t, d), rtol=1e-9)
    assert np.array_equal(probabilities(t, freedom, chi2, f, "pope"), p)
    for test in ("baarda", "pope", "t"):
        beyond = statistics(t, freedom, chi2, f, test) > limits(0.01, freedom, f, test)
        assert np.array_equal(beyond, probabilities(t, freedom, chi2, f, test) < 0.01)


@pytest.mark.oracle
def test_tau_by_simulation() -> None:
    """Pope's limit is exceeded by 5 % of 50 000 simulated residuals, and the limit of t is not.

    The residuals are those of a mean of six numbers; the t limit in its place is a common mistake.
    """
    runs, n = 50_000, 6
    x = np.random.default_rng(7).normal(size=(runs, n))
    v = x - x.mean(axis=1, keepdims=True)
    tau = np.abs(v[:, 0]) / (np.sqrt(np.sum(v**2, axis=1) / (n - 1)) * np.sqrt(1.0 - 1.0 / n))
    low, high = np.array(stats.binom.interval(0.999, runs, 0.05)) / runs
    one = np.array([1])
    assert low <= np.mean(tau > limits(0.05, one, n - 1, "pope")[0]) <= high
    assert not low <= np.mean(tau > limits(0.05, one, n - 1, "t")[0]) <= high


@pytest.mark.behaviour
def test_what_cannot_be_tested() -> None:
    """A suspect without redundancy is not tested, nor one that leaves no redundancy for an estimated scale."""
    d = np.array([0, 1, 2, 3])
    assert can_be_tested(d, 2, "baarda").tolist() == [False, True, True, False]
    assert can_be_tested(d, 2, "t").tolist() == can_be_tested(d, 2, "pope").tolist() == [False, True, False, False]


def stepwise(p: np.ndarray, level: float, control: str) -> set[int]:
    """Return the rejected hypotheses by the definitions (Holm 1979; Benjamini & Hochberg 1995), one by one."""
    order, n = [int(k) for k in np.argsort(p)], len(p)
    if control == "holm":
        out: set[int] = set()
        for i, k in enumerate(order):
            if p[k] > level / (n - i):
                break
            out.add(k)
        return out
    if control == "benjamini_hochberg":
        last = max((i for i, k in enumerate(order, 1) if p[k] <= i * level / n), default=0)
        return set(order[:last])
    each = {"none": level, "bonferroni": level / n, "sidak": 1.0 - (1.0 - level) ** (1.0 / n)}[control]
    return {k for k in order if p[k] <= each}


@pytest.mark.oracle
@pytest.mark.parametrize("control", ["none", "bonferroni", "sidak", "holm", "benjamini_hochberg"])
def test_controls_reject_what_their_definitions_reject(control: str) -> None:
    """Each control of many tests rejects what its step-by-step definition rejects, for 200 sets.

    All but Bonferroni reject more than Bonferroni at times.
    """
    rng, more = np.random.default_rng(3), 0
    for _ in range(200):
        n = int(rng.integers(1, 31))
        p = np.where(rng.random(n) < 0.3, 10.0 ** rng.uniform(-5, -1, n), rng.random(n))
        each = level_of_each(p, 0.05, control)
        rejected = set(np.flatnonzero(p <= each).tolist())
        assert rejected == stepwise(p, 0.05, control)
        more += len(rejected) > len(stepwise(p, 0.05, "bonferroni"))
    assert (more > 0) is (control != "bonferroni")


@pytest.mark.oracle
def test_sidak_of_many_tests_keeps_its_digits() -> None:
    each = level_of_each(np.ones(10**6), 0.05, "sidak")
    assert each == pytest.approx(-np.log(0.95) / 1e6, rel=1e-6, abs=0.0)
    assert level_of_each(np.zeros(0), 0.05, "sidak") == 0.05


@pytest.mark.oracle
def test_global_test() -> None:
    found = global_test(30.0, 12, 0.05)
    assert found is not None
    assert found.limits == pytest.approx((stats.chi2.ppf(0.025, 12), stats.chi2.isf(0.025, 12)))
    assert found.probability == pytest.approx(2.0 * stats.chi2.sf(30.0, 12))
    assert not found.accepted
    low = global_test(2.0, 12, 0.05)
    assert low is not None
    assert low.probability == pytest.approx(2.0 * stats.chi2.cdf(2.0, 12))
    assert not low.accepted
    assert global_test(0.0, 0) is None
    median = global_test(float(stats.chi2.median(12)), 12)
    assert median is not None
    assert median.probability == pytest.approx(1.0)
    assert median.accepted


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("test", "control", "level", "place"),
    [("F", "none", 0.05, "test"), ("t", "fdr", 0.05, "control"), ("t", "none", 0.0, "level"),
     ("t", "none", 1.0, "level"), ("t", "none", float("nan"), "level")],
)  # fmt: skip
def test_impossible_choices_are_refused(test: str, control: str, level: float, place: str) -> None:
    with pytest.raises(InputError) as error:
        hypotheses.require_names(test, control, level)
    assert error.value.problems[0].option == place


@pytest.mark.oracle
def test_a_suspect_that_takes_all_squares_has_a_finite_statistic() -> None:
    """A suspect that explains all squares has a finite statistic, bounded by 1 / eps, at any scale."""
    for size in (1e-20, 1.0, 1e20):
        t, d = np.array([size, size * (1.0 + 1e-15)]), np.array([1, 2])
        found = statistics(t, d, size, 12, "t")
        assert np.isfinite(found).all()
        assert found == pytest.approx([np.sqrt(11.0 / np.finfo(float).eps), 5.0 / np.finfo(float).eps], rel=1e-9)
    assert statistics(np.zeros(1), np.array([1]), 0.0, 12, "t")[0] == 0.0
