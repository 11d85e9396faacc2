"""The tests check the stages before a loss, the values that each stage passes on, and the end of each stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from factors.losses import losses
from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.robust import scaled
from fg_orient.adjustment.solve import solve
from fg_orient.adjustment.stages import EXACT, FROM_RESECTIONS, PLAIN, START, START_STAGES, WIDE, Direct, plan_of
from fg_orient.result.summary import summary
from tests.support.full_statistics import step_of_numpy

from .conftest import adjusted, control_rays, grid, moved, problem_of, spoiled, twin, with_options


def stages(log: tuple[IterationRecord, ...]) -> list[float]:
    return list(dict.fromkeys(record.mu for record in log))


@pytest.mark.behaviour
def test_stages_of_each_start() -> None:
    block, _ = spoiled(twin(), 0.1, 3)
    expected = {
        ("tukey", "none"): [PLAIN, EXACT],
        ("tukey", "huber"): [PLAIN, START, EXACT],
        ("huber", "huber"): [PLAIN, EXACT],
        ("tukey", "lts"): [FROM_RESECTIONS, WIDE - 2.0, WIDE - 1.0, EXACT],
    }
    for (loss, start), found in expected.items():
        assert stages(adjusted(block, loss=loss, robust_start=start).log) == found
    measured = stages(adjusted(block, loss="tukey", robust_scale="mad").log)
    assert measured[:3] == [PLAIN, START, START - 1.0]
    assert measured[-1] == EXACT


@pytest.mark.behaviour
def test_scale_settles_or_the_stages_end() -> None:
    plan = plan_of(with_options(twin(), loss="tukey", robust_scale="mad").options)
    assert isinstance(plan, Direct)
    none = (np.empty(0), np.empty(0))
    mu = plan.following(PLAIN, none, settled=False)
    seen = []
    while mu != EXACT:
        seen.append(mu)
        mu = plan.following(mu, none, settled=False)
    assert seen == [START - k for k in range(START_STAGES)]
    assert plan.following(START, none, settled=True) == EXACT
    wide, exact = plan.robust(FROM_RESECTIONS, (1.5, 2.0)), plan.robust(EXACT, (1.5, 2.0))
    assert wide.image.constant == 8.0 * exact.image.constant
    assert wide.control.constant == 8.0 * exact.control.constant


@pytest.mark.oracle
def test_the_start_decides_between_minima() -> None:
    """With 35 % wrong rays Tukey's loss keeps all good ones from Huber's minimum, but not from least squares."""
    block, bad = spoiled(twin(), 0.35, 8, (3.0, 60.0))
    good = np.setdiff1d(control_rays(block), bad)
    down = {}
    for start in ("none", "huber"):
        end = adjusted(block, loss="tukey", robust_start=start)
        assert end.weights is not None
        down[start] = int(np.count_nonzero(end.weights.image[good] < 0.5))
    assert down["huber"] == 0
    assert down["none"] > 20


@pytest.mark.consistency
@pytest.mark.parametrize("options", [{"robust_scale": "mad"}, {"robust_start": "lms", "robust_scale": "mad"}])
def test_a_stopped_run_goes_on_with_its_scale(tmp_path: Path, options: dict[str, str]) -> None:
    problem = problem_of(spoiled(twin(), 0.2, 3)[0], loss="tukey", **options)
    whole = solve(problem)

    class Stop(Exception):
        pass

    def stop(record: IterationRecord) -> None:
        if record.iteration == len(whole.log) - 2:
            raise Stop

    path = tmp_path / "checkpoint.npz"
    with pytest.raises(Stop):
        solve(problem, stop, checkpoint=Checkpoint(path, every_s=0.0))
    again = solve(problem, checkpoint=Checkpoint(path, resume=True))
    assert again.resumed_at > 0
    assert np.array_equal(again.state.image, whole.state.image)
    assert again.chi2 == whole.chi2
    assert again.weights is not None and whole.weights is not None
    assert again.weights.scale == whole.weights.scale != (1.0, 1.0)


@pytest.mark.behaviour
def test_an_image_turned_down_is_said() -> None:
    """If a loss down-weights most points of an image, the result is not trustworthy and names the image.

    30 of 47 points are wrong by 30 to 60 px in different directions, so that no majority exists.
    """
    block, rng = twin(), np.random.default_rng(4)
    rows = np.flatnonzero(block.observations.image == 0)[:30]
    wrong = moved(block, rows, rng.choice([-1, 1], 30) * rng.uniform(30, 60, 30), rng.uniform(-60, 60, 30))
    solution = fg.adjust(wrong, loss="tukey", max_iterations=200)
    assert solution.weights is not None
    assert solution.status is fg.Status.NOT_TRUSTWORTHY
    assert "image left" in solution.reason
    assert "depends on the other image points and on the priors" in solution.reason
    clean = fg.adjust(block, loss="tukey", max_iterations=200)
    assert clean.status is fg.Status.CONVERGED
    assert not [w for w in clean.warnings if "all rays of" in w]


@pytest.mark.behaviour
def test_a_point_without_ray_is_said() -> None:
    block = twin()
    point = block.points.where(fg.Role.CHECK)[0]
    rows = np.flatnonzero(block.observations.point == point)[:1]
    solution = fg.adjust(moved(block, rows, 20.0, 40.0), loss="tukey", max_iterations=200)
    (text,) = (w for w in solution.warnings if "all rays of" in w)
    assert block.points.ids[point] in text


@pytest.mark.behaviour
@pytest.mark.parametrize("image", [0, 1])
def test_a_wrong_ray_of_two_costs_the_point(image: int) -> None:
    """If one ray of two is wrong by 40 px, both lose their weight and the point is named, with a large sigma.

    The data do not show which ray is wrong.
    """
    block = twin()
    point = block.points.where(fg.Role.CHECK)[0]
    o = block.observations
    wrong = moved(block, np.flatnonzero((o.point == point) & (o.image == image)), 40.0, 0.0)
    solution = fg.adjust(wrong, loss="tukey", max_iterations=200)
    assert solution.weights is not None and solution.cofactors is not None
    weights = solution.weights.image[o.point == point]
    assert (weights < 1e-3).all() and weights[0] == weights[1]
    name = block.points.ids[point]
    (text,) = (w for w in solution.warnings if "all rays of" in w)
    assert name in text
    robust = summary(solution)["robust"]
    assert (robust["points_on_one_ray"], robust["points_without_ray"]) == ([], [name])
    clean = fg.adjust(block, loss="tukey", max_iterations=200)
    assert clean.cofactors is not None
    assert summary(clean)["robust"]["points_without_ray"] == []
    lost, kept = (np.sqrt(np.trace(s.cofactors.point(int(point)))) for s in (solution, clean))  # type: ignore[union-attr]
    assert lost > 100.0 * kept


@pytest.mark.behaviour
def test_least_absolute_values_have_no_covariance_and_turn_nothing_down() -> None:
    solution = fg.adjust(twin(), loss="lad", max_iterations=200)
    assert solution.weights is not None and solution.weights.image.max() > 1.0
    assert solution.status is fg.Status.CONVERGED
    assert solution.cofactors is None
    assert "above 1, which contain no information" in str(solution.unavailable[0])
    assert np.isnan(solution.accuracy.check.predicted_sigma_enu_m).all()
    (text,) = (w for w in solution.warnings if w.startswith("robust loss lad"))
    beyond = int(np.count_nonzero(solution.weights.image < 0.5))
    assert beyond > 0 and f"the residuals of {beyond} of 94 image points and 0 control points exceed 2 sigmas" in text
    robust = summary(solution)["robust"]
    assert robust["points_without_ray"] == robust["points_on_one_ray"] == robust["images_below_half"] == []
    free = fg.adjust(twin(), loss="lad", max_iterations=200, priors=False, eop_set=10)
    assert "too weakly" not in free.reason  # the control points are not the reason why it is unavailable


@pytest.mark.behaviour
def test_statistics_of_least_squares_say_why_they_refuse_a_loss() -> None:
    solution = fg.adjust(twin(), loss="tukey", max_iterations=200)
    codes = {
        "significance": "statistics.significance_weighted", "global_test": "statistics.global_weighted",
        "variance_components": "statistics.components_loss", "reliability": "statistics.reliability_weighted",
        "outlier_tests": "covariance.weighted",
    }  # fmt: skip
    for method, code in codes.items():
        with pytest.raises(fg.NoSolutionError) as caught:
            getattr(solution, method)()
        assert [p.code for p in caught.value.problems] == [code], method


@pytest.mark.behaviour
def test_names_of_losses_are_told_with_their_other_names() -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(twin(), loss="foo")
    assert {"tukey", "beaton_tukey", "lorentz", "lad"} <= set(caught.value.problems[0].remedy.replace(",", "").split())


@pytest.mark.behaviour
def test_the_unit_of_the_loss_is_said() -> None:
    block, _ = spoiled(twin(), 0.1, 3)
    solution = fg.adjust(block, loss="tukey", robust_scale="mad", max_iterations=200)
    assert solution.weights is not None
    (text,) = (w for w in solution.warnings if w.startswith("robust loss tukey"))
    assert f"the unit of the loss is {solution.weights.scale[0]:.2f} sigmas of image points" in text


@pytest.mark.oracle
@pytest.mark.parametrize("options", [{"robust_scale": "mad"}, {"robust_start": "lts"}])
def test_backends_end_where_numpy_has_no_step_left(options: dict[str, str]) -> None:
    """Schur, dense and parts have the same stages, scales and end, where numpy has no step left.

    Limits are 1e-9 prior sigma, and 1e-9 of the scales. The graph intersects its points anew at each step. Its stages
    end at other states, and the scale is measured there: it agrees within 1e-3.
    """
    block, _ = spoiled(grid(), 0.1, 3)
    wanted = {"loss": "tukey", "max_iterations": 200, **options}
    first = fg.adjust(block, backend="schur", **wanted)  # type: ignore[arg-type]
    assert first.weights is not None
    robust = scaled(losses()["tukey"], first.weights.scale)
    assert step_of_numpy(first.problem, first.state, robust)[0] <= 1e-6
    graph = fg.adjust(block, backend="graph", **wanted)  # type: ignore[arg-type]
    assert graph.weights is not None
    assert graph.weights.scale == pytest.approx(first.weights.scale, rel=1e-3)
    assert step_of_numpy(graph.problem, graph.state, scaled(losses()["tukey"], graph.weights.scale))[0] <= 1e-6
    for how in ({"backend": "dense"}, {"parts": 2}):
        other = fg.adjust(block, **how, **wanted)  # type: ignore[arg-type]
        assert other.weights is not None
        assert stages(other.log) == stages(first.log)
        assert np.abs(other.state.image - first.state.image).max() <= 1e-9
        assert other.weights.scale == pytest.approx(first.weights.scale, rel=1e-9)
