"""Random configurations of each constraint: zero at the solution, derivatives, hard as the limit of soft ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.adjustment.loop import gauss_newton
from fg_orient.adjustment.network import DenseNetwork, Network, Variable, bordered_inverse
from fg_orient.adjustment.network_graph import GraphNetwork
from fg_orient.closerange.bundle_network import observed_place
from fg_orient.closerange.constraints import (
    FIGURES,
    KINDS,
    Constraint,
    figure_observations,
    figure_of,
    observed_element,
    plain_observation,
    variable_of,
)

from .conftest import Array

NOISE = 0.002
POINT = ("X", "Y", "Z")


def _frame(rng: np.random.Generator) -> Array:
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def _round(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    angle = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    return np.cos(angle), np.sin(angle)


def _sphere(rng: np.random.Generator, n: int) -> Array:
    u = rng.normal(size=(n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def _distance(rng: np.random.Generator) -> Array:
    return rng.normal(size=(2, 3))


def _parallel(rng: np.random.Generator) -> Array:
    a, b, d = rng.normal(size=3), 3.0 + rng.normal(size=3), _frame(rng)[0]
    return np.array([a, a + rng.uniform(0.5, 2.0) * d, b, b + rng.uniform(0.5, 2.0) * d])


def _plane(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.normal(size=(6, 2)) @ _frame(rng)[:2]


def _line(rng: np.random.Generator) -> Array:
    along = np.arange(5.0) - 2.0 + rng.uniform(-0.3, 0.3, 5)
    return rng.normal(size=3) + along[:, None] * _frame(rng)[0]


def _plumb(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) * [1, 1, 0] + rng.normal(size=(4, 1)) * [0, 0, 1]


def _circle(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.uniform(0.5, 2.0) * np.column_stack(_round(rng, 6)) @ _frame(rng)[:2]


def _horizontal(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + rng.uniform(0.5, 2.0) * np.column_stack([*_round(rng, 6), np.zeros(6)])


def _spheroid(rng: np.random.Generator) -> Array:
    return rng.normal(size=3) + _sphere(rng, 14) * [1.0, rng.uniform(0.6, 0.9), 1.0]


SHAPES: dict[str, Callable[[np.random.Generator], Array]] = {
    "distance": _distance, "parallel": _parallel, "plane": _plane, "line": _line, "plumb line": _plumb,
    "circle": _circle, "horizontal circle": _horizontal, "spheroid": _spheroid,
    "sphere": lambda rng: rng.normal(size=3) + rng.uniform(0.5, 2.0) * _sphere(rng, 10),
    "base": _distance, "equal attitude": lambda rng: np.vstack([_frame(rng), _frame(rng)]),
}  # fmt: skip


def test_every_kind_has_a_shape() -> None:
    assert set(SHAPES) == set(KINDS)


def network(kind: str, shape: Array, rng: np.random.Generator, sigma: float | None) -> Network:
    """Points (rotation vectors for attitudes) observed with noise and the constraint, which the true ones meet."""
    if kind == "equal attitude":
        start, offset = [shape[:3], shape[3:]], shape[3:] @ shape[:3].T
        true, names, noise = np.zeros((2, 3)), ("1", "2"), rng.normal(scale=NOISE, size=(2, 3))
        stated = Constraint(kind, names, sigma=sigma, offset=offset)
    else:
        true, names, noise = shape, tuple(map(str, range(len(shape)))), rng.normal(scale=NOISE, size=shape.shape)
        value = float(np.linalg.norm(shape[1] - shape[0])) if kind in ("distance", "base") else None
        start, stated = list(shape + noise), Constraint(kind, names, value, sigma)
    measured = true + noise
    variables = [Variable(n, at, POINT, kind != "equal attitude") for n, at in zip(names, measured, strict=True)]
    rows = [observed_place(k, at, np.full(3, NOISE), "") for k, at in enumerate(measured)]
    if kind == "equal attitude":  # vectors, not points
        rows = [observed_element(k, j, float(v), NOISE, "") for k, at in enumerate(measured) for j, v in enumerate(at)]
    if kind in FIGURES:
        figure = figure_of(stated, measured)
        variables.append(variable_of(stated, figure))
        rows += figure_observations(stated, figure, len(names), list(range(len(names))))
    else:
        rows.append(plain_observation(stated, list(range(len(names))), start))
    return Network(tuple(variables), tuple(rows))


def solved(net: Network, backend: type = DenseNetwork) -> Array:
    found = gauss_newton(backend(net), net.start, 60, tolerance=1e-13)
    assert found.converged, found.reason
    return np.asarray(found.state)


def check(kind: str, seed: int) -> None:
    """One configuration."""
    shape = SHAPES[kind](np.random.default_rng(seed))
    hard = network(kind, shape, np.random.default_rng(seed + 1), None)
    state, rows = solved(hard), hard.rows(hard.start)
    assert np.abs(hard.rows(state).condition).max() <= 1e-12  # zero at the solution
    assert np.abs(rows.condition).max() > 1e-7  # and not before
    for k in range(hard.n_unknowns):  # derivatives: error h^2 + rounding/h
        ends = [hard.rows(hard.start + s * 1e-6 * np.eye(hard.n_unknowns)[k], jacobian=False) for s in (1.0, -1.0)]
        numeric = (ends[0].condition - ends[1].condition) / 2e-6
        assert np.abs(numeric - rows.border[:, k]).max() <= 1e-7 * (1.0 + np.abs(rows.border).max())
    points = hard.n_soft
    away = []
    for sigma in (NOISE * 1e-1, NOISE * 1e-2):
        soft = network(kind, shape, np.random.default_rng(seed + 1), sigma)
        away.append(float(np.abs(solved(soft) - state)[:points].max()))
    # the difference falls with the square of the sigma
    assert away[0] <= 0.1 * NOISE and away[1] <= 0.03 * away[0] + 1e-12


@pytest.mark.parametrize("runs", [3, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_random_configurations(kind: str, runs: int) -> None:
    for seed in range(runs):
        check(kind, 2 * seed)


@pytest.mark.parametrize("kind", KINDS)
def test_graph_equals_correlates(kind: str) -> None:
    """States and standard deviations of every variable, figures included."""
    net = network(kind, SHAPES[kind](np.random.default_rng(5)), np.random.default_rng(6), None)
    dense, graph = solved(net), solved(net, GraphNetwork)
    roots = np.sqrt(bordered_inverse(net.rows(dense)).diagonal())
    assert np.abs(dense - graph).max() <= 1e-9 * NOISE
    found = np.concatenate([np.sqrt(q.diagonal()) for q in GraphNetwork(net).cofactors(dense)])
    assert found == pytest.approx(roots, rel=1e-6, abs=1e-9)
