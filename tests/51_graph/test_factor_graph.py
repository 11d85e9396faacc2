"""The tests check the factor graph for users of GTSAM: names, keys, solutions at values, their optimisers."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.quality import verdict
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block


@pytest.fixture(scope="module")
def twin() -> Block:
    block = zonguldak_block(ZonguldakOptions(seed=1))[0]
    return replace(block, options=replace(block.options, eop_set=15))


def optimised(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Run GTSAM's Levenberg-Marquardt with its own rule for the end, then one Gauss-Newton step."""
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    last = gtsam.GaussNewtonOptimizer(graph, found)
    last.iterate()
    return gtsam.Values(last.values())


@pytest.mark.oracle
@pytest.mark.parametrize("points", ["eliminated", "explicit"])
def test_gtsam_on_its_own_finds_the_solution(twin: Block, points: str) -> None:
    base = fg.adjust(twin, backend="dense")
    graph = fg.factor_graph(twin, points=points)  # type: ignore[arg-type]
    found = graph.solution(optimised(graph.graph, graph.values))
    assert found.status is base.status is Status.CONVERGED
    assert found.chi2 == pytest.approx(base.chi2, rel=1e-11)
    assert np.abs(found.state.image - base.state.image).max() <= 1e-9
    assert np.nanmax(np.abs(found.ground_m - base.ground_m)) <= 1e-7
    assert found.cofactors is not None
    assert base.cofactors is not None
    assert np.allclose(found.cofactors.image(0), base.cofactors.image(0), rtol=1e-6)


@pytest.mark.behaviour
def test_values_that_are_no_solution_are_not_converged(twin: Block) -> None:
    graph = fg.factor_graph(twin)
    begin = graph.solution(graph.values)
    assert begin.status is Status.NOT_CONVERGED
    assert "standard deviations" in begin.ended
    assert graph.gradient(graph.values) > 1.0


@pytest.mark.behaviour
def test_own_optimiser_of_adjust(twin: Block) -> None:
    base = fg.adjust(twin)
    found = fg.adjust(twin, optimizer=optimised)
    assert found.status is Status.CONVERGED
    assert np.abs(found.state.image - base.state.image).max() <= 1e-9
    with pytest.raises(InputError, match="your own optimiser"):
        fg.adjust(twin, optimizer=optimised, snoop=True)


@pytest.mark.behaviour
def test_names_and_keys_lead_to_each_other(twin: Block) -> None:
    graph = fg.factor_graph(twin)
    assert {graph.name(key) for key in graph.values.keys()} == {"image:left", "image:right"}
    assert graph.name(graph.key("image:left")) == "image:left"
    point = f"point:{twin.points.ids[4]}"
    (group,) = graph.factors(point)
    assert set(group.keys()) == {graph.key("image:left"), graph.key("image:right")}
    explicit = fg.factor_graph(twin, points="explicit")
    assert explicit.name(explicit.key(point)) == point
    assert len(explicit.factors(point)) >= 2
    with pytest.raises(InputError, match="no variable of this name"):
        graph.key(point)
    with pytest.raises(InputError, match="no variable of this name"):
        graph.key("image:none")
    control = next(f"point:{twin.points.ids[j]}" for j in np.flatnonzero(explicit.prepared.problem.observed))
    known = twin.points.known
    held = replace(twin, points=replace(twin.points, known=replace(
        known, fixed=~np.isnan(known.ecef_m[:, 0]), sigma_enu_m=np.full_like(known.sigma_enu_m, np.nan)
    )))  # fmt: skip
    assert len(fg.factor_graph(held).factors(control)) == 1
    with pytest.raises(InputError, match="no variable of this name"):
        fg.factor_graph(held, points="explicit").factors(control)


@pytest.mark.behaviour
def test_rays_that_do_not_intersect_at_given_values_are_named(twin: Block) -> None:
    graph = fg.factor_graph(twin)
    values, key = graph.values, graph.key("image:left")
    far = gtsam.Values(values)
    far.update(key, values.atVector(key) + 1e6)
    with pytest.raises(fg.NoSolutionError, match="is not determined by its rays") as caught:
        graph.solution(far)
    assert any(f": point {name} is not determined" in str(caught.value) for name in twin.points.ids)


@pytest.mark.behaviour
def test_a_wide_factor_is_told_with_its_seconds(twin: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "solution.wide_factor" not in {one.code for one in fg.adjust(twin).findings}
    monkeypatch.setattr(verdict, "WIDE", 10)
    (told,) = (one for one in fg.adjust(twin).findings if one.code == "solution.wide_factor")
    assert f"{compile_problem(twin).n_image_unknowns} unknowns" in str(told)
    assert "solution.wide_factor" not in {one.code for one in fg.adjust(twin, backend="schur").findings}


@pytest.mark.behaviour
def test_what_has_no_graph_is_refused(twin: Block) -> None:
    with pytest.raises(InputError, match="cannot contain a robust loss"):
        fg.factor_graph(replace(twin, options=replace(twin.options, loss="huber")))
    with pytest.raises(InputError, match="explicit"):
        fg.factor_graph(replace(twin, options=replace(twin.options, eop_set=2, priors=False)))


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", range(1, 21))
def test_all_sets_of_the_twin_on_all_backends(twin: Block, eop_set: int) -> None:
    """For each EOP set and optimiser the graph ends at the dense backend's solution.

    Limits are 1e-11 of chi2, 1e-9 prior sigma and 1e-7 m.
    """
    base = fg.adjust(twin, eop_set=eop_set, backend="dense")
    for optimizer in ("gauss-newton", "levenberg-marquardt", "dogleg"):
        found = fg.adjust(twin, eop_set=eop_set, backend="graph", optimizer=optimizer)
        assert found.status is base.status, optimizer
        assert found.chi2 == pytest.approx(base.chi2, rel=1e-11)
        assert np.abs(found.state.image - base.state.image).max() <= 1e-9, optimizer
        assert np.nanmax(np.abs(found.ground_m - base.ground_m)) <= 1e-7, optimizer
