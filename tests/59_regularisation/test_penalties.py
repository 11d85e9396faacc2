"""The tests check penalties of correction functions and the units of the norm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fg_orient.adjustment.penalty import Penalty
from fg_orient.model.block import Block
from fg_orient.model.parameters import ImageParameters
from fg_orient.quality.penalties import TIMES, image_penalty
from tests.support.dense_reduced import dense_of, regularised, twin


@pytest.fixture(scope="module")
def block() -> Block:
    return twin()


def parameters(*names: str, sigma: tuple[float, ...]) -> ImageParameters:
    n = len(names)
    return ImageParameters(tuple(range(n)), np.array(sigma), names, ("",) * n, names)


@pytest.mark.truth
@pytest.mark.parametrize("order", [1, 2])
def test_penalty_is_the_mean_square_of_the_derivative(order: int) -> None:
    """The penalty of a polynomial is the mean square of its first or second derivative in prior sigmas.

    For f = s0 x0 + s1 x1 t + s2 x2 t^2 the test writes out f' and f'' over s0 at the middles of the times.
    """
    sigma, x = (2.0, 0.5, 0.25), np.array([3.0, -1.0, 2.0])
    rows = image_penalty(parameters("roll_0", "roll_1", "roll_2", sigma=sigma), order, 0)
    t = np.linspace(-1.0, 1.0, TIMES + order)
    middle = t[:-1] + 0.5 * (t[1] - t[0])
    first = (sigma[1] * x[1] + 2.0 * sigma[2] * x[2] * middle) / sigma[0]
    second = np.full(TIMES, 2.0 * sigma[2] * x[2] / sigma[0])
    assert np.sum((rows @ x) ** 2) == pytest.approx(np.mean((first if order == 1 else second) ** 2), rel=1e-12)


@pytest.mark.truth
def test_penalty_of_a_curve_is_that_of_its_values() -> None:
    """The penalty of a curve is that of curve and polynomial of its component together, without other components."""
    from factors.geometry import polynomials

    names = ("x_0", "x_1", "roll_1", "roll_c0", "roll_c1")
    sigma, x = (10.0, 1.0, 3.0, 0.5, 0.5), np.array([0.0, 0.0, 0.7, 1.1, -0.4])
    rows = image_penalty(parameters(*names, sigma=sigma), 2, 2)
    t = np.linspace(-1.0, 1.0, TIMES + 2)
    f = (3.0 * 0.7 * t + 0.5 * polynomials.curves(t, 2) @ x[3:]) / 3.0
    second = np.diff(f, n=2) / (t[1] - t[0]) ** 2
    assert np.sum((rows @ x) ** 2) == pytest.approx(np.mean(second**2), rel=1e-10)
    joined = (rows != 0.0)[:, :2].any(axis=1) & (rows != 0.0)[:, 2:].any(axis=1)
    assert not joined.any()


@pytest.mark.truth
def test_line_and_sample_of_an_rpc_image_are_different_variables() -> None:
    names = ("line_0", "line_l1", "line_s1", "sample_0", "sample_l1", "sample_s1")
    rows = image_penalty(parameters(*names, sigma=(100.0, 10.0, 10.0) * 2), 1, 0)
    np.testing.assert_allclose(np.abs(rows)[np.abs(rows) > 1e-12], 1.0, rtol=1e-12)
    assert sorted(np.argmax(np.abs(rows), axis=1).tolist()) == [1, 2, 4, 5]


@pytest.mark.oracle
@pytest.mark.parametrize("units", ["raw", "columns"])
def test_units_change_the_norm(block: Block, units: str) -> None:
    """Units of raw coefficients or of columns of unit length give numpy's units, singular values, rank and fit."""
    cut = 1e-6
    plain, problem = regularised(block, 1, regularisation="minimum_norm", regularised_units=units, rank_cut=cut)
    oracle, chosen = dense_of(plain), problem.regularisation
    assert chosen is not None
    unit = np.linalg.norm(oracle.a, axis=0)
    if units == "raw":
        per_line = [1.0, 1.0 / 5999.5, 1.0 / 5999.5**2]  # 12000 lines
        unit = np.concatenate([p.sigma * np.tile(per_line, 3) for p in plain.parameters])
    np.testing.assert_allclose(chosen.units, unit, rtol=1e-9)
    x = np.linalg.pinv(oracle.a / unit, rcond=cut) @ oracle.right
    system = chosen.standard
    assert system is not None and system.design is not None and system.observed is not None
    s = np.linalg.svd(oracle.a / unit, compute_uv=False)
    np.testing.assert_allclose(chosen.singular_values, s, rtol=0.0, atol=1e-9 * s[0])
    assert chosen.rank == int((s > cut * s[0]).sum())
    fitted = oracle.a / unit @ x
    assert float(fitted @ fitted) == pytest.approx(float(np.sum(system.observed**2)), rel=1e-8)


@pytest.mark.behaviour
def test_rows_of_one_image_are_its_own_observation(block: Block) -> None:
    """Tikhonov's penalty is one observation per image; directions held in several images are joint ones."""
    options: list[dict[str, Any]] = [{"regularisation": "tikhonov"}, {"regularisation": "truncated"}]
    own, joint = (
        [len(e.unknowns) for e in regularised(block, 20, **o)[1].block.extra if isinstance(e, Penalty)] for o in options
    )
    assert own == [1, 1] and 2 in joint
