"""Sampled traces and kappas of large systems are compared with the singular value decomposition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import cho_factor, cho_solve, hadamard

from fg_orient.adjustment.linear.kappa import Given, choose_kappa
from fg_orient.adjustment.linear.kappa_graph import SAMPLED, on_curves
from fg_orient.adjustment.linear.ridge import Ridge
from fg_orient.adjustment.linear.sampled import PROBES, SampledRidge, signs
from fg_orient.adjustment.linear.system import LinearSystem

Array = npt.NDArray[np.float64]


def system_of(seed: int, rows: int = 200, unknowns: int = 64) -> LinearSystem:
    """Return the equations with singular values 100 .. 0.01, unknowns and noise N(0, 1)."""
    rng = np.random.default_rng(seed)
    u, _ = np.linalg.qr(rng.standard_normal((rows, unknowns)))
    v, _ = np.linalg.qr(rng.standard_normal((unknowns, unknowns)))
    design = u * np.geomspace(100.0, 0.01, unknowns) @ v.T
    return LinearSystem.from_design(design, design @ rng.standard_normal(unknowns) + rng.standard_normal(rows))


def sampled(system: LinearSystem, probes: Array | None = None) -> SampledRidge:
    def factor(kappa: float) -> Callable[[Array], Array]:
        known = cho_factor(system.normal + kappa * np.eye(len(system)))
        return lambda columns: np.asarray(cho_solve(known, columns))

    design, observed = system.require_design("test")
    largest = float(np.linalg.norm(design, 2)) ** 2
    return SampledRidge(factor, system.rhs, float(observed @ observed), len(design), largest, "test", probes)


@pytest.mark.oracle
def test_true_trace_lies_within_3_standard_errors() -> None:
    """The sampled trace is within 3 standard errors of the true one for 99 % of 200 seeds, at each of three kappas."""
    system = system_of(1)
    values = np.linalg.svd(system.require_design("test")[0], compute_uv=False)
    known: dict[float, Array] = {k: np.linalg.inv(system.normal + k * np.eye(64)) for k in (1e-2, 1.0, 1e2)}
    assert PROBES >= 30
    for kappa, inverse in known.items():
        true, inside = float(np.sum(values**2 / (values**2 + kappa))), 0
        for seed in range(200):
            v = signs(64, PROBES, seed)
            ridge = SampledRidge(lambda _, q=inverse: lambda c: q @ c, system.rhs, 1.0, 200, 1.0, "test", v)
            inside += abs(ridge.trace(kappa) - true) <= 3.0 * ridge.trace_error(kappa)
        assert inside >= 198, kappa


@pytest.mark.consistency
@pytest.mark.parametrize("seed", range(3))
def test_curves_are_those_of_the_decomposition(seed: int) -> None:
    """With exact probes the sampled curves equal those of the singular value decomposition.

    The probes are all columns of a Hadamard matrix; their mean is the exact trace.
    """
    system = system_of(seed)
    one, other = sampled(system, hadamard(64).astype(float)), Ridge.of(system, "test")
    for kappa in (1e-2, 1.0, 1e2):
        assert one.norm2(kappa) == pytest.approx(other.norm2(kappa), rel=1e-8)
        assert one.norm2_slopes(kappa) == pytest.approx(other.norm2_slopes(kappa), rel=1e-7)
        assert one.residual2(kappa) == pytest.approx(other.residual2(kappa), rel=1e-6)
        assert one.trace(kappa) == pytest.approx(other.trace(kappa), rel=1e-8)
        assert one.gcv(kappa) == pytest.approx(other.gcv(kappa), rel=1e-6)
        assert one.change2(kappa) == pytest.approx(other.change2(kappa), rel=1e-7)
        assert one.change2_slope(kappa) == pytest.approx(other.change2_slope(kappa), rel=1e-6, abs=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("rule", SAMPLED)
def test_kappas_are_those_of_the_decomposition(rule: str) -> None:
    system, given = system_of(2), Given(noise_norm=float(np.sqrt(200.0)))
    exact = choose_kappa(rule, system, given).kappa
    found = on_curves(rule, sampled(system, hadamard(64).astype(float)), given).kappa
    assert found == pytest.approx(exact, rel=1e-3)  # the minimum of a flat curve is known to the root of its rounding


@pytest.mark.oracle
def test_interval_of_gcv_contains_the_exact_kappa() -> None:
    """The 95 % interval of GCV contains the exact kappa for at least 32 of 40 systems.

    Fewer than 32 have a probability of 1e-4.
    """
    inside = 0
    for seed in range(40):
        system = system_of(seed)
        ridge = sampled(system)
        low, high = ridge.gcv_interval(on_curves("gcv", ridge, Given()).kappa)
        inside += low <= choose_kappa("gcv", system).kappa <= high
        assert low < high
    assert inside >= 32
