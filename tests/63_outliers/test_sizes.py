"""Level and power of the tests are correct in simulated adjustments of the twin with v = Q_vv l."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, ncf, ncx2

from fg_orient.quality import hypotheses
from fg_orient.quality.outliers import _classes, assess_suspects
from fg_orient.quality.reliability import noncentrality
from fg_orient.quality.suspects import Suspects
from tests.support.linear_twin import LinearTwin, linear_twin

pytestmark = pytest.mark.oracle

TESTS = ("baarda", "pope", "t")
LEVELS = (0.05, 0.001)
#: Seed, runs: the full simulation and its fast twin.
RUNS = [(63, 1000), pytest.param(64, 10_000, marks=pytest.mark.slow)]


def interval(rate: float, runs: int) -> tuple[float, float]:
    """Return the 99.9 % interval of a count of independent alarms, as a rate."""
    low, high = binom.interval(0.999, runs, rate)
    return low / runs, high / runs


def preselected(twin: LinearTwin) -> dict[str, tuple[Suspects, int]]:
    """Return one suspect of each part, of a control point in the middle of the list."""
    problem = twin.solution.problem
    control = np.flatnonzero(problem.observed)
    j = int(control[len(control) // 2])
    families = [*twin.suspects(), *twin.suspects("coordinates"), *twin.suspects("points")]
    return {f.part: (f, int(np.flatnonzero(f.point == j)[0])) for f in families if (f.point == j).any()}


def one(found: Suspects, k: int) -> Suspects:
    """Return the family that holds suspect ``k`` alone."""
    parts = (found.point, found.row, found.rows, found.v, found.q, found.columns)
    return Suspects(found.part, found.unit, *(part[[k]] for part in parts))


def alarm_rates(twin: LinearTwin, v: np.ndarray, scale: float = 1.0) -> dict[tuple[str, str, float], float]:
    """Return the rate of alarms per part, test and level; ``scale`` multiplies all residuals."""
    chi2, out = scale**2 * np.sum(v**2, axis=1), {}
    for part, (found, k) in preselected(twin).items():
        t, d, _ = twin.drawn(one(found, k), scale * v).quadratic()
        t = t[:, 0]
        assert d[0] == {"position": 2, "image": 2, "point": 4}.get(part, 1)
        for test in TESTS:
            p = hypotheses.probabilities(t, d, chi2, twin.redundancy, test)
            statistic = hypotheses.statistics(t, d, chi2, twin.redundancy, test)
            for level in LEVELS:
                limit = hypotheses.limits(level, d, twin.redundancy, test)
                assert np.array_equal(p <= level, statistic >= limit)
                out[part, test, level] = float(np.mean(statistic > limit))
    return out


@pytest.mark.parametrize(("seed", "runs"), RUNS)
def test_rate_of_alarms_is_the_level(seed: int, runs: int) -> None:
    """The rate of alarms is the level for each kind of suspect, test and level.

    Suspects are image point, line, sample, position, height, East, North, Up and whole point; levels are 5 and 0.1 %.
    """
    twin = linear_twin()
    rates = alarm_rates(twin, twin.residuals(twin.noise(seed, runs)))
    assert len(rates) == 9 * len(TESTS) * len(LEVELS)
    print(f"\nseed {seed}, {runs} adjustments, redundancy {twin.redundancy}")
    for (part, test, level), rate in rates.items():
        low, high = interval(level, runs)
        print(f"  {part:8s} {test:6s} {level}: {rate:.4f} in {low:.4f} .. {high:.4f}")
        assert low <= rate <= high, (part, test, level)


def test_wrong_sigmas_show_in_the_rates() -> None:
    """With errors of 1.3 sigmas Baarda's rate leaves its interval, but those of Pope and t do not."""
    twin, runs = linear_twin(), 1000
    rates = alarm_rates(twin, twin.residuals(twin.noise(63, runs)), scale=1.3)
    low, high = interval(0.05, runs)
    parts = {part for part, _, _ in rates}
    assert all(rates[part, "baarda", 0.05] > high for part in parts)
    assert all(low <= rates[part, test, 0.05] <= high for part in parts for test in ("pope", "t"))


def test_wrong_ratios_of_sigmas_show_in_the_rates() -> None:
    """With errors of 2 sigmas in one image the rates of its image points leave their intervals in all tests."""
    twin, runs = linear_twin(), 1000
    noise = twin.noise(63, runs)
    o, (found, k) = twin.solution.problem.observations, preselected(twin)["image"]
    wrong = np.flatnonzero(o.image == o.image[found.row[k]])
    noise[:, (2 * wrong[:, None] + np.arange(2)).ravel()] *= 2.0
    rates = alarm_rates(twin, twin.residuals(noise))
    low, high = interval(0.05, runs)
    for test in TESTS:
        assert not low <= rates["image", test, 0.05] <= high


def test_wrong_cofactors_show_in_the_rates() -> None:
    """With Q_vv = I, as if nothing were estimated, the rate of alarms is below its interval."""
    twin, runs = linear_twin(), 1000
    v = twin.residuals(twin.noise(63, runs))
    single = one(*preselected(twin)["point"])
    t, d, _ = twin.drawn(replace(single, q=np.eye(7)[None]), v).quadratic()
    p = hypotheses.probabilities(t[:, 0], d, np.sum(v**2, axis=1), twin.redundancy, "baarda")
    assert np.mean(p <= 0.05) < interval(0.05, runs)[0]


@pytest.mark.parametrize(("seed", "runs"), RUNS)
def test_global_test_keeps_its_level(seed: int, runs: int) -> None:
    """The global test rejects at its level, and with errors of 1.1 sigmas its rate leaves the interval.

    Both sides count together.
    """
    twin = linear_twin()
    chi2 = np.sum(twin.residuals(twin.noise(seed, runs)) ** 2, axis=1)
    for level in LEVELS:
        for scale, holds in ((1.0, True), (1.1, False)):
            found = [hypotheses.global_test(float(c) * scale**2, twin.redundancy, level) for c in chi2]
            rejected = np.mean([not test.accepted for test in found if test is not None])
            low, high = interval(level, runs)
            print(f"\nseed {seed}, errors {scale} sigmas, level {level}: {rejected:.4f} in {low:.4f} .. {high:.4f}")
            assert bool(low <= rejected <= high) is holds


CONTROLS = ("bonferroni", "sidak", "holm", "benjamini_hochberg")


def any_alarm(twin: LinearTwin, v: np.ndarray, test: str, level: float) -> dict[str, float]:
    """Return the share of the adjustments with any alarm among all image points, positions and heights."""
    families = twin.suspects()
    parts = [twin.drawn(f, v).quadratic() for f in families]
    t, d = np.concatenate([p[0] for p in parts], axis=1), np.concatenate([p[1] for p in parts])
    chi2, f = np.sum(v**2, axis=1), twin.redundancy
    tested = hypotheses.can_be_tested(d, f, test)
    point = np.concatenate([s.point for s in families])
    classes, _ = _classes(point, d, t[0], tested)
    p = hypotheses.probabilities(t[:, classes], d[classes], chi2[:, None], f, test)
    out = {}
    for control in (*CONTROLS, "none"):
        alarms = [row.min() <= hypotheses.level_of_each(row, level, control) for row in p]
        out[control] = float(np.mean(alarms))
        for run in range(0, 3):  # the same through the public path
            drawn = [replace(s, v=v[run][twin.rows(s)]) for s in families]
            found = assess_suspects(
                twin.solution.problem, drawn, float(chi2[run]), level=level, test=test, control=control
            )
            assert bool(found.suspicious()) is bool(alarms[run])
            assert found.n_tested == len(classes)
    return out


@pytest.mark.parametrize(("seed", "runs"), RUNS)
def test_any_false_alarm_is_controlled(seed: int, runs: int) -> None:
    """The rate of any alarm is between alpha/2 and alpha with each control, and above 90 % without control.

    Tests depend on each other, so that it may be below alpha.
    """
    twin, level = linear_twin(), 0.05
    v = twin.residuals(twin.noise(seed, runs))
    for test in TESTS:
        rates = any_alarm(twin, v, test, level)
        low, high = interval(level / 2.0, runs)[0], interval(level, runs)[1]
        print(f"\nseed {seed}, {runs} adjustments, {test}: {rates}; {low:.4f} .. {high:.4f}")
        for control in CONTROLS:
            assert low <= rates[control] <= high, (test, control)
        assert rates["none"] > 0.9


@pytest.mark.parametrize(("seed", "runs"), RUNS)
def test_minimal_detectable_bias_is_found_with_its_power(seed: int, runs: int) -> None:
    """A minimal detectable bias is found in 80 % by Baarda's test, and as non-central F says by others.

    A bias of 0.7 of that size is not.
    """
    twin, f = linear_twin(), linear_twin().redundancy
    noise = twin.noise(seed, runs)
    print(f"\nseed {seed}, {runs} adjustments")
    for part, (found, k) in preselected(twin).items():
        single = one(found, k)
        d = {"position": 2, "image": 2, "point": 4}.get(part, 1)
        delta = noncentrality(0.001, 0.80, d)
        bias, rows = biased(single, delta), twin.rows(single)[0]
        for factor in (1.0, 0.7):  # a smaller bias than the minimal one is not found with that power
            shifted = noise.copy()
            shifted[:, rows] += factor * bias
            v = twin.residuals(shifted)
            t, freedom, _ = twin.drawn(single, v).quadratic()
            for test in TESTS:
                p = hypotheses.probabilities(t[:, 0], freedom, np.sum(v**2, axis=1), f, test)
                limit = hypotheses.limits(0.001, np.array([d]), f, "t")[0] ** (1 + (d == 1))
                power = ncf.sf(limit, d, f - d, delta) if test != "baarda" else 0.80
                low, high = interval(float(power), runs)
                rate = float(np.mean(p <= 0.001))
                if factor == 1.0:
                    print(f"  {part:8s} {test:6s}: {rate:.4f}, expected {power:.4f} in {low:.4f} .. {high:.4f}")
                assert bool(low <= rate <= high) is (factor == 1.0), (part, test)


def biased(single: Suspects, delta: float) -> np.ndarray:
    """Return whitened errors (m,) of a suspect with this non-centrality.

    They lie along its best checked direction.
    """
    e = single.columns[0] / np.linalg.norm(single.columns[0], axis=0)
    size, axes = np.linalg.eigh(e.T @ single.q[0] @ e)
    return np.asarray(e @ axes[:, -1] * np.sqrt(delta / size[-1]))


def test_noncentral_chi_square_of_the_bias() -> None:
    """The non-centrality of the bias has a power of 80 % at the limit of 0.1 % by scipy."""
    for d in (1, 2, 4):
        limit = hypotheses.limits(0.001, np.array([d]), 10, "baarda")[0] ** (1 + (d == 1))
        assert ncx2.sf(limit, d, noncentrality(0.001, 0.80, d)) == pytest.approx(0.80, abs=1e-9)
