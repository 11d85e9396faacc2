"""Random configurations of each constraint: zero at the solution, derivatives, hard as the limit of soft ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from fg_orient.adjustment.constraint_kinds import FIGURES, KINDS
from fg_orient.adjustment.loop import OPTIMIZERS, levenberg_marquardt
from fg_orient.adjustment.network import DenseNetwork, GraphNetwork, Network, Variable, bordered_inverse
from fg_orient.closerange import bundle, surface_fit
from fg_orient.closerange.bundle_network import observed_place
from fg_orient.closerange.constraints import Constraint, figure_of, figure_parts, observed_element, plain_observation

from .conftest import Array

NOISE = 0.002
POINT = ("X", "Y", "Z")
#: Of the damped steps that of a bundle.
TOLERANCES = {"gauss-newton": 1e-13, "levenberg-marquardt": bundle.TOLERANCE}


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


def _perpendicular(rng: np.random.Generator) -> Array:
    a, b, d = rng.normal(size=3), 3.0 + rng.normal(size=3), _frame(rng)
    return np.array([a, a + rng.uniform(0.5, 2.0) * d[0], b, b + rng.uniform(0.5, 2.0) * d[1]])


def _equal(rng: np.random.Generator) -> Array:
    a, b, size = rng.normal(size=3), 3.0 + rng.normal(size=3), rng.uniform(0.5, 2.0)
    return np.array([a, a + size * _frame(rng)[0], b, b + size * _frame(rng)[0]])


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
    "distance": _distance, "parallel": _parallel, "perpendicular": _perpendicular, "equal": _equal,
    "plane": _plane, "line": _line, "plumb line": _plumb,
    "circle": _circle, "horizontal circle": _horizontal, "spheroid": _spheroid,
    "sphere": lambda rng: rng.normal(size=3) + rng.uniform(0.5, 2.0) * _sphere(rng, 10),
    "base": _distance, "equal attitude": lambda rng: np.vstack([_frame(rng), _frame(rng)]),
}  # fmt: skip


@pytest.mark.behaviour
def test_every_kind_has_a_shape() -> None:
    assert set(SHAPES) == set(KINDS)


def step_of_numpy(net: Network, state: Array) -> Array:
    """The step that is left, of least squares under the conditions, by numpy: the bordered normal equations."""
    rows = net.rows(state)
    h, u = rows.border.shape
    bordered = np.block([[rows.design.T @ rows.design, rows.border.T], [rows.border, np.zeros((h, h))]])
    return np.linalg.solve(bordered, -np.concatenate([rows.design.T @ rows.residual, rows.condition]))[:u]


def networks(kind: str, shape: Array, rng: np.random.Generator, sigmas: Sequence[float | None]) -> list[Network]:
    """Points (rotation vectors for attitudes) observed with noise and the constraint, which the true ones meet.

    One network for each sigma of the constraint; None: hard.
    """
    n = 2 if kind == "equal attitude" else len(shape)
    noise, names = rng.normal(scale=NOISE, size=(n, 3)), tuple(map(str, range(n)))
    if kind == "equal attitude":  # vectors, not points
        measured, start = noise, [shape[:3], shape[3:]]
        rows = [observed_element(k, j, float(v), NOISE, "") for k, at in enumerate(measured) for j, v in enumerate(at)]
        stated = Constraint(kind, names, offset=shape[3:] @ shape[:3].T)
    else:
        measured, start = shape + noise, list(shape + noise)
        rows = [observed_place(k, at, np.full(3, NOISE), "") for k, at in enumerate(measured)]
        size = float(np.linalg.norm(shape[1] - shape[0])) if kind in ("distance", "base") else None
        stated = Constraint(kind, names, size)
    variables = [Variable(n, at, POINT, kind != "equal attitude") for n, at in zip(names, measured, strict=True)]
    figure = figure_of(stated, measured) if kind in FIGURES else None
    out = []
    for sigma in sigmas:
        one = replace(stated, sigma=sigma)
        if figure is None:
            more, own = [], [plain_observation(one, list(range(n)), start)]
        else:
            variable, own = figure_parts(one, figure, n, list(range(n)))
            more = [variable]
        out.append(Network((*variables, *more), (*rows, *own)))
    return out


def solved(net: Network, backend: type = DenseNetwork, optimizer: str = "gauss-newton") -> Array:
    found = OPTIMIZERS[optimizer](backend(net), net.start, 60, tolerance=TOLERANCES[optimizer])
    assert found.converged, found.reason
    return np.asarray(found.state)


def worst_derivative(net: Network) -> float:
    """Largest difference of the hard conditions' derivatives from central ones, beside 1 and their own size.

    Error of a central difference: h^2 + rounding/h.
    """
    out, h = 0.0, 1e-6
    for o in (o for o in net.observations if o.hard):
        x = [np.array(u if isinstance(u, np.ndarray) else net.start[net.part(u)], float) for u in o.unknowns]
        blocks = o.equation.kernel(o.record, o.setup, *x, True)[1:]
        for argument, block in zip(x, blocks, strict=True):
            for j in range(len(argument)):
                ends = []
                for step in (h, -h):
                    kept, argument[j] = argument[j], argument[j] + step
                    ends.append(o.equation.kernel(o.record, o.setup, *x, False)[0])
                    argument[j] = kept
                apart = np.abs((ends[0] - ends[1]) / (2.0 * h) - block[:, j]).max()
                out = max(out, float(apart / (1.0 + np.abs(block).max())))
    return out


@dataclass(frozen=True)
class Found:
    """Of one configuration: largest residual before and after, of the derivatives, of hard against soft ones."""

    before: float
    after: float
    derivative: float
    away: tuple[float, float]


def examined(kind: str, seed: int, optimizer: str) -> Found:
    """One configuration, hard and with two sigmas."""
    shape = SHAPES[kind](np.random.default_rng(seed))
    hard, *soft = networks(kind, shape, np.random.default_rng(seed + 1), (None, NOISE * 1e-1, NOISE * 1e-2))
    state = solved(hard, optimizer=optimizer)
    away = [float(np.abs(solved(net, optimizer=optimizer) - state)[: 3 * len(shape)].max()) for net in soft]
    before, after = (float(np.abs(hard.rows(x, jacobian=False).condition).max()) for x in (hard.start, state))
    return Found(before, after, worst_derivative(hard), (away[0], away[1]))


def check(found: Found) -> None:
    assert found.after <= 1e-12 and found.before > 1e-7  # zero at the solution, and not before
    assert found.derivative <= 1e-7
    # the difference falls with the square of the sigma
    assert found.away[0] <= 0.1 * NOISE and found.away[1] <= 0.03 * found.away[0] + 1e-12


@pytest.mark.oracle
@pytest.mark.parametrize(("runs", "optimizer"), [
    (3, "levenberg-marquardt"),
    *(pytest.param(1000, name, marks=pytest.mark.slow) for name in ("levenberg-marquardt", "gauss-newton")),
])  # fmt: skip
@pytest.mark.parametrize("kind", KINDS)
def test_random_configurations(kind: str, runs: int, optimizer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Damped steps are what users get."""
    # whether points determine a surface is no question of the constraint, whose start it is
    monkeypatch.setattr(surface_fit, "_require_steep", lambda *given: None)
    for seed in range(runs):
        check(examined(kind, 2 * seed, optimizer))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_graph_equals_correlates(kind: str) -> None:
    """States and standard deviations of every variable, figures included."""
    (net,) = networks(kind, SHAPES[kind](np.random.default_rng(5)), np.random.default_rng(6), [None])
    dense, graph = solved(net), solved(net, GraphNetwork)
    rows = net.rows(dense)
    h, u = rows.border.shape
    bordered = np.block([[rows.design.T @ rows.design, rows.border.T], [rows.border, np.zeros((h, h))]])
    whole = np.linalg.inv(bordered)[:u, :u]
    roots = np.sqrt(whole.diagonal())
    assert bordered_inverse(rows).diagonal() == pytest.approx(whole.diagonal(), rel=1e-6, abs=1e-12)
    assert np.abs(step_of_numpy(net, dense)).max() <= 1e-6 * NOISE
    assert np.abs(dense - graph).max() <= 1e-9 * NOISE
    found = np.concatenate([np.sqrt(q.diagonal()) for q in GraphNetwork(net).cofactors(dense)])
    assert found == pytest.approx(roots, rel=1e-6, abs=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_damped_steps_end_where_full_steps_do(kind: str) -> None:
    """Figures have no diagonal but for the damping, and it falls: commands damp, tests of configurations do not."""
    (net,) = networks(kind, SHAPES[kind](np.random.default_rng(5)), np.random.default_rng(6), [None])
    found = levenberg_marquardt(DenseNetwork(net), net.start, 60, tolerance=1e-12)
    assert found.converged and len(found.log) <= 12
    assert np.abs(net.rows(found.state).condition).max() <= 1e-12
    assert np.abs(found.state - solved(net)).max() <= 1e-6 * NOISE
    assert np.abs(step_of_numpy(net, found.state)).max() <= 1e-6 * NOISE
