"""Constraints between ground points agree with bordered normal equations by numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fg_orient as fg
from factors._contract import Array
from fg_orient.adjustment.constraint_rows import HEAD, constraint_observation, relation_record
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.model.block import Block
from tests.support.degenerate_blocks import with_control
from tests.support.pinhole import NOISE_PX, pinhole_block

#: Points of the figure, and shapes on which they lie (in a rotated frame), m.
N = 8
_T = np.linspace(0.0, 5.5, N)
_WAVE = np.column_stack([np.cos(_T), np.sin(_T), 0.4 * np.cos(3.0 * _T)])
SHAPES = {
    "plane": 10.0 * np.column_stack([np.cos(_T) + 0.3 * _T, np.sin(2.0 * _T), 0.0 * _T]),
    "line": 5.0 * np.column_stack([_T, 0.0 * _T, 0.0 * _T]),
    "circle": 10.0 * np.column_stack([np.cos(_T), np.sin(_T), 0.0 * _T]),
    "sphere": 10.0 * _WAVE / np.linalg.norm(_WAVE, axis=1, keepdims=True),
}


@cache
def observed(kind: str, control: bool = False) -> tuple[Block, Array]:
    """Return the noisy block of six images whose first points lie on a figure, and its true points; without priors."""
    block, truth = pinhole_block(6, 40, views=4, seed=1)
    rng, ground = np.random.default_rng(101), truth.ground_m.copy()
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if kind in SHAPES:
        ground[:N] = ground[:N].mean(axis=0) + SHAPES[kind] @ turn.T
    o = block.observations
    line, sample = o.line.copy(), o.sample.copy()
    for k, image in enumerate(block.images):
        rows = o.image == k
        line[rows], sample[rows] = image.sensor.project(ground[o.point[rows]])
    noise = rng.normal(scale=NOISE_PX, size=(2, len(line)))
    known = replace(block.points.known, ecef_m=ground)
    block = replace(
        block, observations=replace(o, line=line + noise[0], sample=sample + noise[1]),
        points=replace(block.points, known=known),
    )  # fmt: skip
    if not control:
        return block, ground
    block = with_control(block, (10, 15, 20, 30, 35), ground)
    return replace(block, options=replace(block.options, datum="control", priors=False)), ground


def started(block: Block, error_m: float, seed: int) -> Block:
    """Return the block with other start coordinates of its points."""
    known = block.points.known
    at = known.ecef_m + np.random.default_rng(seed).normal(scale=error_m, size=known.ecef_m.shape)
    return replace(block, points=replace(block.points, known=replace(known, ecef_m=at)))


def stated(kind: str, block: Block, ground: Array, sigma: float | None = None) -> tuple[fg.Constraint, ...]:
    ids = block.points.ids
    if kind == "distance":
        pairs = ((0, 1), (2, 3))
        sizes = [float(np.linalg.norm(ground[a] - ground[b])) for a, b in pairs]
        return tuple(fg.Constraint(kind, (ids[a], ids[b]), d, sigma) for (a, b), d in zip(pairs, sizes, strict=True))
    return (fg.Constraint(kind, ids[:N], sigma=sigma),)


def misclosures(kind: str, p: Array, f: Array, ground: Array) -> Array:
    """Return the misclosures of all points of a figure f, m.

    A unit vector of f has its length as a further condition.
    """
    if kind == "distance":
        return np.array(
            [np.linalg.norm(p[a] - p[b]) - np.linalg.norm(ground[a] - ground[b]) for a, b in ((0, 1), (2, 3))]
        )
    if kind == "sphere":
        return np.asarray(np.linalg.norm(p - f[:3], axis=1) - f[3])
    n = f[:3]
    unit = [n @ n - 1.0]
    if kind == "plane":
        return np.concatenate([p @ n - f[3], unit])
    if kind == "circle":
        d = p - f[3:6]
        return np.concatenate([d @ n, np.linalg.norm(d, axis=1) - f[6], unit])
    # a line: direction n, foot point f[3:6] (nearest to the origin), and no component along the direction
    d = p - f[3:6]
    k = int(np.argmax(np.abs(n)))
    across = [i for i in range(3) if i != k]
    return np.concatenate([*(d[:, i] - n[i] / n[k] * d[:, k] for i in across), unit, [f[3:6] @ n]])


def figure_start(kind: str, p: Array) -> Array:
    middle = p.mean(axis=0)
    v = np.linalg.svd(p - middle)[2]
    if kind == "sphere" or kind == "circle":
        x = np.linalg.lstsq(
            np.column_stack([2.0 * (p - middle), np.ones(len(p))]), np.sum((p - middle) ** 2, axis=1), rcond=1e-9
        )[0]
        r = np.sqrt(x[3] + x[:3] @ x[:3])
        return np.append(middle + x[:3], r) if kind == "sphere" else np.concatenate([v[2], middle + x[:3], [r]])
    return {"plane": np.append(v[2], v[2] @ middle), "line": np.concatenate([v[0], middle - (middle @ v[0]) * v[0]]),
            "distance": np.zeros(0)}[kind]  # fmt: skip


def jacobian(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the central differences."""
    steps = 1e-5 * np.eye(len(x))
    return np.column_stack([(function(x + h) - function(x - h)) / 2e-5 for h in steps])


def bordered(problem: Problem, kind: str, ground: Array) -> tuple[State, float, Array]:
    """Return the state, squares and cofactors of the unknowns by Lagrange's bordered equations.

    The datum is the shortest step.
    """
    plain = replace(problem, block=replace(problem.block, extra=()))
    state = plain.start
    u, members = plain.n_columns, [plain.point_slice(j) for j in range(N)]
    at = np.concatenate([np.arange(m.start, m.stop) for m in members])
    f = figure_start(kind, state.ground[:N])

    def conditions(x: Array) -> Array:
        return misclosures(kind, x[: 3 * N].reshape(-1, 3), x[3 * N :], ground)

    for _ in range(30):
        r, design = assemble(plain, state)
        design = np.hstack([design, np.zeros((len(r), len(f)))])
        y = np.concatenate([state.ground[:N].ravel(), f])
        border = np.zeros((len(conditions(y)), u + len(f)))
        border[:, np.concatenate([at, u + np.arange(len(f))])] = jacobian(conditions, y)
        scale = 1.0 / np.maximum(np.linalg.norm(design, axis=0), 1e-3)
        normal = np.block([[design.T @ design, border.T], [border, np.zeros((len(border),) * 2)]])
        whole = np.concatenate([scale, np.full(len(border), 30.0)])
        solved = (
            np.linalg.lstsq(
                normal * np.outer(whole, whole), -np.concatenate([design.T @ r, conditions(y)]) * whole, rcond=1e-13
            )[0]
            * whole
        )
        state, f = plain.moved(state, solved[:u]), f + solved[u : u + len(f)]
        if np.abs(solved[:u]).max() < 1e-11:
            break
    r, _ = assemble(plain, state, jacobian=False)
    inverse = np.linalg.pinv(normal * np.outer(whole, whole), rcond=1e-13) * np.outer(whole, whole)
    return state, float(r @ r), inverse[:u, :u]


def shape(p: Array) -> Array:
    """Return the distances between all points relative to their mean."""
    d = np.linalg.norm(p[:, None] - p[None], axis=2)
    return np.asarray(d / d.mean())


@pytest.mark.oracle
@pytest.mark.parametrize(
    "backend", ["graph", *(pytest.param(name, marks=pytest.mark.slow) for name in ("dense", "schur"))]
)
@pytest.mark.parametrize("kind", ["distance", "plane", "line", "circle", "sphere"])
def test_hard_in_a_free_network_from_wrong_starts(kind: str, backend: str) -> None:
    """A hard constraint in a free network gives chi2, redundancy and shape of Lagrange's equations from two starts."""
    block, ground = observed(kind)
    constraints = stated(kind, block, ground)
    _, squares, _ = expected = _expected(kind)
    plain = fg.adjust(block, datum="inner", priors=False, backend=backend)
    for seed, error in ((3, 0.3), (4, 2.0)):
        solution = fg.adjust(
            replace(started(block, error, seed), extra=constraints), datum="inner", priors=False, backend=backend
        )
        assert solution.status is fg.Status.CONVERGED
        p = solution.ground_m
        assert np.abs(misclosures(kind, p[:N], _refined(kind, p[:N], ground), ground)).max() < 1e-10
        assert solution.chi2 == pytest.approx(squares, rel=1e-9)
        assert shape(p) == pytest.approx(shape(expected[0].ground), abs=1e-9)
        assert (
            solution.redundancy - plain.redundancy
            == {"distance": 1, "plane": 5, "line": 12, "circle": 10, "sphere": 4}[kind]
        )
        known = solution.residual_cofactors
        own = np.einsum("nii->", known.image)  # the datum is without redundancy, a hard constraint has no residual
        assert own == pytest.approx(solution.redundancy, abs=1e-5)
        assert solution.chi2 > plain.chi2 * (1.0 + 1e-6)


@cache
def _expected(kind: str) -> tuple[State, float, Array]:
    block, ground = observed(kind)
    options = replace(block.options, datum="free", priors=False)
    return bordered(compile_problem(replace(block, options=options)), kind, ground)


def _refined(kind: str, p: Array, ground: Array) -> Array:
    """Return the figure of points by Gauss-Newton."""
    f = figure_start(kind, p)
    for _ in range(10 if len(f) else 0):
        f = (
            f
            - np.linalg.lstsq(
                jacobian(lambda x: misclosures(kind, p, x, ground), f), misclosures(kind, p, f, ground), rcond=None
            )[0]
        )
    return f


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["distance", "plane", "line", "circle", "sphere"])
def test_hard_with_control_and_limit_of_soft_ones(kind: str) -> None:
    """A hard constraint with control has state and cofactors of Lagrange's equations, as one with a tiny sigma."""
    block, ground = observed(kind, control=True)
    solution = fg.adjust(replace(block, extra=stated(kind, block, ground)), priors=False)
    state, squares, q = bordered(compile_problem(block), kind, ground)
    assert solution.state.ground == pytest.approx(state.ground, abs=3e-8)
    assert solution.chi2 == pytest.approx(squares, rel=1e-9)
    problem = solution.problem
    for j in (0, 3, 7, 12):
        expected = q[problem.point_slice(j), problem.point_slice(j)]
        size = np.sqrt(np.trace(expected))
        assert np.abs(solution.cofactors.point(j) - expected).max() < 1e-5 * size**2
    soft = fg.adjust(replace(block, extra=stated(kind, block, ground, 1e-6)), priors=False)
    assert soft.state.ground == pytest.approx(solution.state.ground, abs=3e-8)
    assert soft.redundancy == solution.redundancy


ALL = {
    **SHAPES, "parallel": np.array([[0, 0, 0], [3, 1, 2], [5, 5, 0], [11, 7, 4.0]]),
    "perpendicular": np.array([[0, 0, 0], [3, 1, 2], [5, 5, 0], [6, 4, -1.0]]),
    "equal": np.array([[0, 0, 0], [3, 1, 2], [5, 5, 0], [6, 2, -2.0]]),
    "plumb line": 5.0 * np.column_stack([0.0 * _T, 0.0 * _T, _T]), "horizontal circle": SHAPES["circle"],
    "spheroid": SHAPES["sphere"] * [1.0, 0.6, 1.0],
}  # fmt: skip


def _record(extra: fg.ExtraObservation, sigma: float, shape: Array) -> Array:
    """Return the record with this sigma, axes of the unit and the constants of parallel lines, correlates zero."""
    constraint = extra.constraint  # type: ignore[attr-defined]
    own = np.zeros(0)
    if constraint.kind in ("parallel", "perpendicular", "equal"):
        own = relation_record(constraint, shape)
    head = HEAD.pack(weight=1.0 / sigma, scale=0.05, axes=np.eye(3).ravel(), frame=np.zeros(9))
    return np.concatenate([head, own, np.zeros(len(extra.record) - HEAD.size)])


@pytest.mark.oracle
@pytest.mark.parametrize("kind", list(ALL))
def test_derivatives_by_complex_steps(kind: str) -> None:
    """Derivatives of a constraint equal complex steps on the figure, and the gradient of the squares holds anywhere.

    The basis N of the rows has no effect on the figure.
    """
    rng = np.random.default_rng(7)
    shape = ALL[kind] + rng.normal(size=3)
    observed = {"circle": {"radius": (9.0, 0.1)}, "spheroid": {"a": (9.9, 0.2)}}.get(kind, {})
    extra = constraint_observation(fg.Constraint(kind, tuple(map(str, range(len(shape)))), observed=observed))
    assert len(extra.constraint.members) == len(shape)
    for noise in (0.0, 0.05):
        at = shape + rng.normal(scale=noise, size=shape.shape) if noise else shape
        record = _record(extra, 0.2, shape)
        value, *blocks = extra.equation.kernel(record, np.zeros((2, 0)), *at, True)
        assert value == pytest.approx(extra.equation.residual(record, np.zeros((2, 0)), *at), abs=1e-12)
        assert value.shape == (extra.n_residuals,) and (np.abs(value).max() < 1e-11) == (not noise and not observed)
        for k, block in enumerate(blocks):
            for i in range(3):
                moved = at.astype(complex)
                moved[k, i] += 1e-30j
                row = np.imag(extra.equation.residual(record, np.zeros((2, 0)), *moved)) / 1e-30
                if not noise and not observed:
                    assert block[:, i] == pytest.approx(row, abs=1e-9)
                steps = [at + h * np.eye(len(at))[:, [k]] * np.eye(3)[i] for h in (1e-5, -1e-5)]
                ahead, behind = (extra.equation.residual(record, np.zeros((2, 0)), *p) for p in steps)
                slope = (ahead @ ahead - behind @ behind) / 4e-5
                assert block[:, i] @ value == pytest.approx(slope, abs=1e-7 * max(1.0, value @ value) / 0.2)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("made", "code", "names"),
    [
        (lambda i, d: [("distance", i[:2], d), ("distance", i[1::-1], d)], "closerange.dependent",
         ["distance of 1, 0"]),
        (lambda i, d: [("distance", i[:2], d), ("distance", i[1::-1], 2 * d)], "closerange.contradiction",
         ["distance of 0, 1", "distance of 1, 0"]),
        (lambda i, d: [("distance", i[:2], d), ("distance", i[1:3], d), ("distance", (i[0], i[2]), 3 * d)],
         "closerange.contradiction", ["distance of 0, 1", "distance of 1, 2", "distance of 0, 2"]),
        (lambda i, d: [("plane", i[:6], None), ("plane", i[:5], None)], "closerange.dependent",
         ["plane of 0, 1, 2, 3, 4"]),
        (lambda i, d: [("plane", i[:3], None)], "closerange.constraint", ["plane of 0, 1, 2"]),
        (lambda i, d: [("base", i[:2], d)], "adjust.extra_unknown", ["base of 0, 1"]),
    ],
)  # fmt: skip
def test_contradictions_and_dependent_constraints_are_named(
    made: Callable[[tuple[str, ...], float], list[tuple[str, tuple[str, ...], float | None]]], code: str,
    names: list[str],
) -> None:  # fmt: skip
    """Contradictory or dependent constraints are refused in one error that names them."""
    block, ground = observed("plane")
    block = replace(block, points=replace(block.points, ids=tuple(map(str, range(len(block.points.ids))))))
    size = float(np.linalg.norm(ground[0] - ground[1]))
    extra = tuple(fg.Constraint(*one) for one in made(block.points.ids, size))
    with pytest.raises(fg.InputError) as error:
        fg.adjust(replace(block, extra=extra), datum="inner", priors=False)
    (problem,) = error.value.problems
    assert problem.code == code and all(name in str(error.value) for name in names)


@pytest.mark.oracle
def test_snooping_losses_and_components_with_hard_constraints() -> None:
    """With a hard plane the search finds an error of 30 px, and losses and components keep the plane."""
    block, ground = observed("plane", control=True)
    o = block.observations
    row = int(np.flatnonzero(o.point == 2)[0])
    line = o.line.copy()
    line[row] += 30.0
    wrong = replace(block, observations=replace(o, line=line), extra=stated("plane", block, ground))
    snooped = fg.adjust(wrong, priors=False, snoop=True)
    assert [(t.image, t.point) for t in snooped.snooping.tests] == [
        (block.images[o.image[row]].id, block.points.ids[2])
    ]
    clean = np.delete(np.arange(len(o)), row)
    without = replace(wrong, observations=o.take(clean))
    expected = bordered(compile_problem(replace(without, extra=())), "plane", ground)
    assert snooped.chi2 == pytest.approx(expected[1], rel=1e-9)
    for more in ({"loss": "huber", "max_iterations": 200}, {"variance_components": ["image", "control"]}):
        p = fg.adjust(wrong if "loss" in more else without, priors=False, **more).ground_m[:N]
        assert np.abs(misclosures("plane", p, _refined("plane", p, ground), ground)).max() < 1e-10


@pytest.mark.oracle
@pytest.mark.parametrize("sigma", [None, 0.05])
def test_figures_are_those_of_lagrange(sigma: float | None) -> None:
    """Values and sigmas of a sphere equal those of bordered equations (hard) or of all rows (soft)."""
    block, ground = observed("sphere", control=True)
    solution = fg.adjust(replace(block, extra=stated("sphere", block, ground, sigma)), priors=False)
    (figure,) = solution.figures()
    assert figure.names == ("x", "y", "z", "radius")
    p = solution.state.ground[:N]
    f = _refined("sphere", p, ground)
    assert figure.values == pytest.approx(f, abs=1e-6 if sigma is None else 1e-2)

    def conditions(x: Array) -> Array:
        return misclosures("sphere", x[: 3 * N].reshape(-1, 3), x[3 * N :], ground)

    problem = compile_problem(block)
    state = State(solution.state.image, solution.state.ground)
    _, design = assemble(replace(problem, block=replace(problem.block, extra=())), state)
    columns = np.concatenate([np.arange(s.start, s.stop) for s in map(problem.point_slice, range(N))])
    border = np.zeros((N, design.shape[1] + 4))
    border[:, np.append(columns, design.shape[1] + np.arange(4))] = jacobian(
        conditions, np.append(p.ravel(), figure.values)
    )
    design = np.hstack([design, np.zeros((len(design), 4))])
    scale = np.append(1.0 / np.linalg.norm(design[:, :-4], axis=0), np.full(4, 0.01))
    if sigma is None:
        whole = np.block([[design.T @ design * np.outer(scale, scale), (border * scale).T],
                          [border * scale, np.zeros((N, N))]])  # fmt: skip
    else:
        rows = np.vstack([design, border / sigma]) * scale
        whole = rows.T @ rows
    q = np.linalg.inv(whole)[: len(scale), : len(scale)] * np.outer(scale, scale)
    roots = solution.scale * np.sqrt(np.diag(q)[-4:])
    assert np.sqrt(np.diag(figure.covariance)) == pytest.approx(roots, rel=1e-3)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "dense", "schur"])
def test_a_base_between_images_with_priors(backend: str) -> None:
    """A hard base between images with priors is met, and the gradient lies along the constraint."""
    block, _ = pinhole_block(4, 30, views=3, seed=2)
    first, second = (image.sensor.camera.centre_m for image in block.images[:2])  # type: ignore[attr-defined]
    ids, size = tuple(image.id for image in block.images[:2]), float(np.linalg.norm(second - first)) + 0.05
    solution = fg.adjust(replace(block, extra=(fg.Constraint("base", ids, size),)), backend=backend)
    at = [solution.correction(name)[3:6] + c for name, c in zip(ids, (first, second), strict=True)]
    assert np.linalg.norm(at[1] - at[0]) == pytest.approx(size, abs=1e-9)
    problem = replace(solution.problem, block=replace(solution.problem.block, extra=()))
    r, design = assemble(problem, solution.state)
    along = (at[1] - at[0]) / size
    border = np.zeros(problem.n_columns)
    for k, sign in ((0, -1.0), (1, 1.0)):
        names = list(problem.parameters[k].names)
        for axis, name in enumerate(("centre_x", "centre_y", "centre_z")):
            j = names.index(name)
            border[problem.first[k] + j] = sign * along[axis] * problem.parameters[k].sigma[j]
    gradient = design.T @ r
    correlate = -(border @ gradient) / (border @ border)  # Lagrange: the gradient lies along the constraint
    scale = np.linalg.norm(design, axis=0)
    assert np.abs((gradient + correlate * border) / scale).max() < 1e-6
