"""Generic tests run for every registered equation, also for a new one."""

from __future__ import annotations

from importlib import import_module
from pkgutil import walk_packages

import numpy as np
import pytest

import factors
from factors._contract import Equation, evaluate, register, registered
from factors.cameras.pushbroom import RECORD
from tests.support.complex_step import Derived, derived_uncompiled
from tests.support.equation_examples import EXAMPLES
from tests.support.equation_examples import example as draw

for found in walk_packages(factors.__path__, "factors."):
    import_module(found.name)  # registers
#: Equations of the package, whatever other tests have registered.
EQUATIONS = sorted((registered()[name] for name in EXAMPLES), key=lambda e: e.name)
#: Modules of the package that register equations.
PACKAGE = {m.name for m in walk_packages(factors.__path__, "factors.")} - {"factors._contract"}
DRAWS = 60


@pytest.fixture(scope="module")
def references() -> dict[str, list[Derived]]:
    """Return the examples of every equation and their Jacobians by complex step."""
    return derived_uncompiled(DRAWS, seed=1)


@pytest.mark.repository
def test_every_equation_has_examples() -> None:
    """Every registered equation of the package has an example.

    Equations of other modules are ignored, because other tests may register them.
    """
    own = (e for e in registered().values() if {e.kernel.__module__, e.residual.__module__} & PACKAGE)
    assert {e.name for e in own} == set(EXAMPLES)


@pytest.mark.oracle
@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda e: e.name)
def test_jacobian_equals_complex_step(equation: Equation, references: dict[str, list[Derived]]) -> None:
    """Every Jacobian equals that by complex steps within 1e-13 of the largest element of its row.

    The measured difference is 7e-16; the published limit is 1e-11, in prior sigmas.
    """
    worst = 0.0
    assert len(references[equation.name]) == DRAWS
    for example, expected in references[equation.name]:
        _, *jacobians = equation.kernel(example.record, example.setup, *example.unknowns, True)
        for jacobian, reference in zip(jacobians, expected, strict=True):
            row = np.abs(reference).max(axis=1, keepdims=True)
            worst = max(worst, float((np.abs(jacobian - reference) / np.where(row > 0, row, 1.0)).max()))
    assert worst <= 1e-11
    assert worst <= 1e-13  # the analytic form reaches this; a loss of two digits would be an error


@pytest.mark.oracle
@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda e: e.name)
def test_jacobian_equals_central_differences(equation: Equation) -> None:
    """Every Jacobian equals central differences of the real-valued kernel within 1e-6 of its row.

    The differences have five points h = 1e-3 apart: h^4 / 30 of the fifth derivative and 1.5 / h roundings of the terms
    of the value. With 20 seeds both stay below 3e-7 of the row; two points 1e-4 apart left 1.9e-6, all of it rounding.
    """
    rng, step = np.random.default_rng(2), 1e-3
    for _ in range(10):
        example = draw(equation, rng)
        _, *jacobians = equation.kernel(example.record, example.setup, *example.unknowns, True)
        for k, jacobian in enumerate(jacobians):
            for c in range(jacobian.shape[1]):
                at = {}
                for steps in (-2, -1, 1, 2):
                    u = [x.copy() for x in example.unknowns]
                    u[k][c] += steps * step
                    at[steps] = equation.kernel(example.record, example.setup, *u, False)[0]
                numeric = (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * step)
                scale = np.abs(jacobian).max(axis=1)
                assert np.all(np.abs(numeric - jacobian[:, c]) <= 1e-6 * scale)


@pytest.mark.consistency
@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda e: e.name)
def test_value_does_not_depend_on_the_request_for_jacobians(equation: Equation) -> None:
    rng = np.random.default_rng(3)
    for _ in range(DRAWS):
        example = draw(equation, rng)
        with_j = equation.kernel(example.record, example.setup, *example.unknowns, True)[0]
        without = equation.kernel(example.record, example.setup, *example.unknowns, False)[0]
        assert np.array_equal(with_j, without)
        assert np.array_equal(without, equation.residual(example.record, example.setup, *example.unknowns))


@pytest.mark.consistency
@pytest.mark.parametrize("equation", [e for e in EQUATIONS if e.fill], ids=lambda e: e.name)
def test_fill_gives_the_same_numbers_and_refuses_wrong_sizes(equation: Equation) -> None:
    rng = np.random.default_rng(12)
    e = draw(equation, rng)
    value, *jacobians = equation.kernel(e.record, e.setup, *e.unknowns, True)
    out = np.full((len(value), 1 + sum(len(u) for u in e.unknowns)), 7.0)
    assert equation.fill(e.record[None].copy(), 0, e.setup, *e.unknowns, out, True)
    assert np.array_equal(out, np.hstack([value[:, None], *jacobians]))
    assert not equation.fill(e.record[None].copy(), 0, e.setup, e.unknowns[0][:-1], *e.unknowns[1:], out, True)
    narrow = np.empty((len(out), out.shape[1] - 1))
    assert not equation.fill(e.record[None].copy(), 0, e.setup, *e.unknowns, narrow, True)
    broken = [u.copy() for u in e.unknowns]
    broken[-1][0] = np.nan
    assert not equation.fill(e.record[None].copy(), 0, e.setup, *broken, out, False)


@pytest.mark.consistency
@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda e: e.name)
def test_batch_equals_scalar(equation: Equation) -> None:
    rng = np.random.default_rng(4)
    examples = [draw(equation, rng) for _ in range(7)]
    unknowns = [[e.unknowns[k] for e in examples] for k in range(len(equation.arguments))]
    values, blocks = evaluate(equation, np.array([e.record for e in examples]), [e.setup for e in examples], *unknowns)
    for i, e in enumerate(examples):
        single = equation.kernel(e.record, e.setup, *e.unknowns, True)
        assert np.array_equal(values[i], single[0])
        for k, block in enumerate(blocks):
            assert np.array_equal(block[i], single[1 + k])


@pytest.mark.behaviour
def test_two_equations_of_one_name_are_refused() -> None:
    known = EQUATIONS[0]
    with pytest.raises(ValueError, match=known.name):
        register(Equation(known.name, lambda *a: (), known.residual, known.arguments, ""))


def reference_conditions(record: np.ndarray, setup: np.ndarray, x: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return f_y and F_x written straight from docs/equations.md 2 and 3.3 with matrices, in extended precision."""
    ld = np.longdouble
    r = record.astype(ld)
    correction = np.zeros(27, ld)
    look, curve = np.zeros(2, ld), np.zeros(9, ld)
    for code, sigma, value in zip(setup[0].astype(int), setup[1].astype(ld), x.astype(ld), strict=True):
        if code < 27:
            correction[code] += sigma * value
        elif code >= 64:
            curve[(code - 64) // 32] += sigma * value * r[34 + (code - 64) % 32]
        else:
            look[(code - 27) % 2] += sigma * value * r[21] ** ((code - 27) // 2)
    eop = r[0:9] + correction.reshape(9, 3) @ np.array([1.0, r[18], r[18] ** 2], ld) + curve
    frame_state = eop if record[RECORD.follows] > 0.5 else r
    p, v = frame_state[0:3], frame_state[3:6]
    z = p / np.sqrt(p @ p)
    n = np.cross(v, z)
    x_axis = n / np.sqrt(n @ n)
    r_og = np.stack([x_axis, np.cross(z, x_axis), z], axis=1)
    roll, pitch, yaw = eop[6:9]
    if record[RECORD.small_angle] > 0.5:
        r_uy = np.array([[1, -yaw, roll], [yaw, 1, -pitch], [-roll, pitch, 1]], ld)
    else:
        rx = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]], ld)
        ry = np.array([[np.cos(roll), 0, np.sin(roll)], [0, 1, 0], [-np.sin(roll), 0, np.cos(roll)]], ld)
        rz = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]], ld)
        r_uy = rx @ ry @ rz
    d = (r[31:34] + r[0:3]) + (ground.astype(ld) - r[28:31]) - eop[0:3]  # reference point + difference - P
    f = r[9:18].reshape(3, 3).T @ r_uy.T @ r_og.T @ d
    psi_x, psi_y = r[19] + look[0], r[20] + look[1]
    return np.array([f[0] / f[2] - np.tan(psi_y), f[1] / f[2] + np.tan(psi_x)], ld)


@pytest.mark.oracle
def test_pushbroom_equals_an_independent_evaluation() -> None:
    """The pushbroom residual equals plain matrices in 80-bit floats within 2e-15 rad, a few roundings."""
    equation = registered()["look_angle_collinearity"]
    rng = np.random.default_rng(5)
    for _ in range(DRAWS):
        e = draw(equation, rng)
        record = e.record.copy()
        record[RECORD.whitening] = 1.0, 0.0, 0.0, 1.0
        ours = equation.residual(record, e.setup, *e.unknowns)
        theirs = reference_conditions(record, e.setup, *e.unknowns)
        assert np.abs(ours - theirs).max() < 2e-15


@pytest.mark.oracle
def test_differences_keep_their_digits() -> None:
    """A correction of 1e-9 prior sigmas changes F by its derivative within 1e-6, so that no digits cancel."""
    equation = registered()["look_angle_collinearity"]
    rng = np.random.default_rng(6)
    e = draw(equation, rng)
    record = e.record.copy()
    record[RECORD.follows], record[RECORD.small_angle] = 1.0, 0.0
    zero = np.zeros_like(e.unknowns[0])
    base = equation.residual(record, e.setup, zero, np.zeros(3))
    _, j, _ = equation.kernel(record, e.setup, zero, np.zeros(3), True)
    for c in range(len(zero)):
        x = zero.copy()
        x[c] = 1e-9
        change = equation.residual(record, e.setup, x, np.zeros(3)) - base
        floor = 4.0 * np.spacing(np.abs(base).max())  # F itself is stored with 16 digits
        assert np.all(np.abs(change - 1e-9 * j[:, c]) <= 1e-6 * np.abs(1e-9 * j[:, c]) + floor)
