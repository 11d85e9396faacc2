"""The Schur backend handles ground points in extra observations like the graph and full matrices."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.constraint_rows import constraint_observation
from fg_orient.adjustment.constraints import prepared
from fg_orient.adjustment.dense import DenseBackend
from fg_orient.adjustment.named_points import NamedBackend
from fg_orient.adjustment.problem import State, compile_problem
from fg_orient.adjustment.stages import plan_of
from fg_orient.model.block import Block
from tests.support.degenerate_blocks import options, with_control
from tests.support.pinhole import pinhole_block


@cache
def figure(*, every: bool = False, shared: bool = False) -> Block:
    """Return six images and 40 points with constraints.

    They are an observed and two hard distances, and a plane through some points, or through all.
    """
    block, truth = pinhole_block(6, 40, views=4, seed=5)
    ids, g = block.points.ids, truth.ground_m
    block = with_control(block, (10, 15, 20, 30, 35), g)
    sizes = [float(np.linalg.norm(g[a] - g[a + 1])) for a in (0, 2, 20)]
    extra = (
        fg.Constraint("distance", ids[:2], sizes[0], 0.01), fg.Constraint("distance", ids[2:4], sizes[1]),
        fg.Constraint("distance", ids[20:22], sizes[2]), fg.Constraint("plane", ids if every else ids[4:9], sigma=30.0),
    )  # fmt: skip
    images = block.images
    if shared:
        ties = dict.fromkeys(("focal", "k1"), "one")
        cameras = [
            replace(i.sensor.camera, sigma=i.sensor.camera.sigma | {"focal": 5.0, "k1": 1e-2}, shared=ties,
                    focal_px=images[0].sensor.camera.focal_px, distortion=np.zeros(5))
            for i in images
        ]  # fmt: skip
        images = tuple(
            replace(i, sensor=i.sensor.with_camera(camera, i.sensor.file))
            for i, camera in zip(images, cameras, strict=True)
        )
    return options(replace(block, images=images, extra=extra), datum="control", priors=False)


def equal(a: fg.Solution, b: fg.Solution, unit_m: float = 1e-7) -> None:
    """Assert equal squares, points, weights and cofactors."""
    assert a.status is b.status is fg.Status.CONVERGED
    assert a.chi2 == pytest.approx(b.chi2, rel=1e-9)
    assert a.redundancy == b.redundancy
    assert np.abs(a.ground_m - b.ground_m).max() < unit_m
    if a.cofactors is None:  # weights above 1
        assert b.cofactors is None
        return
    for q in ([s.cofactors.points(np.arange(40)) for s in (a, b)], [s.cofactors.image(2) for s in (a, b)]):
        assert np.abs(q[0] - q[1]).max() < 1e-6 * np.abs(q[1]).max()


@pytest.mark.consistency
@pytest.mark.parametrize("kind", ["some", "every", "shared"])
@pytest.mark.parametrize("optimizer", ["gauss-newton", "levenberg-marquardt", "dogleg"])
def test_equals_full_matrices(optimizer: str, kind: str) -> None:
    """With points named by observations the Schur backend equals dense and graph for all optimisers.

    This includes blocks in which every point is named, and a shared camera.
    """
    block = figure(every=kind == "every", shared=kind == "shared")
    runs = [fg.adjust(block, backend=name, optimizer=optimizer) for name in ("schur", "dense", "graph")]
    assert [run.backend for run in runs] == ["schur", "dense", "graph"]
    equal(runs[0], runs[1])
    equal(runs[0], runs[2])


@pytest.mark.consistency
@pytest.mark.parametrize("more", [{"loss": "huber"}, *(pytest.param(one, marks=pytest.mark.slow) for one in (
    {"loss": "tukey"}, {"loss": "tls", "gnc": True}, {"loss": "lad"}))])  # fmt: skip
def test_equals_full_matrices_under_a_loss(more: dict[str, object]) -> None:
    """Under a loss with two gross errors the Schur backend with named points has solution and weights of the dense one.

    One of the errors is in a ray of a named point.
    """
    block = figure()
    o, line = block.observations, block.observations.line.copy()
    for point in (2, 25):
        line[np.flatnonzero(o.point == point)[0]] += 15.0
    wrong = replace(block, observations=replace(o, line=line))
    runs = [fg.adjust(wrong, backend=name, max_iterations=300, **more) for name in ("schur", "dense")]
    equal(*runs, unit_m=1e-6)
    assert runs[0].weights.image == pytest.approx(runs[1].weights.image, abs=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize(("datum", "loss"), [("control", "none"), ("control", "tukey"), ("free", "none")])
def test_steps_equal_those_of_full_matrices(datum: str, loss: str) -> None:
    """Cost, damped and dogleg steps with named points equal those of full matrices, with their predicted cost."""
    block = figure()
    block = replace(block, extra=tuple(constraint_observation(c) for c in block.extra))
    problem = prepared(compile_problem(options(block, datum=datum, loss=loss)))
    rng = np.random.default_rng(3)
    start = problem.start
    state = State(start.image, start.ground + rng.normal(scale=0.02, size=start.ground.shape))
    state = NamedBackend(problem).linearise(state).solve(1e-3).after
    plan, systems = plan_of(problem.block.options), []
    for backend in (NamedBackend(problem), DenseBackend(problem)):
        backend.robust = None if plan is None else plan.robust(math.inf)
        systems.append(backend.linearise(state))
        assert systems[-1].error == pytest.approx(backend.error(state), rel=1e-12)
    own, full = systems
    assert own.error == pytest.approx(full.error, rel=1e-12)
    steps = [(own.solve(d), full.solve(d)) for d in (1e-2, 1e-5)]
    if datum == "control":
        steps += [(own.solve(0.0), full.solve(0.0)), *((own.dogleg(r), full.dogleg(r)) for r in (1e-4, 1e-2))]
    for mine, expected in steps:
        after = problem.moved(state, expected.data)
        size = np.abs(expected.data).max()
        assert np.abs(mine.after.image - after.image).max() < 1e-7 * size
        assert np.abs(mine.after.ground - after.ground).max() < 1e-7 * size
        assert mine.length == pytest.approx(expected.length, rel=1e-7)
        assert mine.predicted_error == pytest.approx(expected.predicted_error, rel=1e-9)


@pytest.mark.behaviour
def test_too_many_unknowns_for_one_matrix_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fg_orient.adjustment.border.FULL_BORDER", 60)
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(figure(), backend="schur")
    (problem,) = caught.value.problems
    assert problem.code == "adjust.schur" and "unknowns of images and named points" in str(caught.value)
