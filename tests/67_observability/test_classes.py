"""On the twin, the directions of the twenty EOP sets have three classes, and each image has a statement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.problem import compile_problem
from fg_orient.quality.deficiency import judge_observability
from fg_orient.quality.observability import NEEDS_SCALING, analyse
from tests.support.degenerate_blocks import options, pinhole, pushbroom
from tests.support.scalar_rows import scalar_rows

WITH_VELOCITY = {5, 6, 7, 8, 13, 14, 17, 18, 19, 20}
ALSO_YAW = {17, 18, 19, 20}


@pytest.mark.behaviour
@pytest.mark.parametrize("eop_set", range(1, 21))
def test_velocity_is_named_where_it_is_an_unknown_and_nowhere_else(eop_set: int) -> None:
    problem = compile_problem(options(pushbroom(), eop_set=eop_set))
    for found in judge_observability(problem):
        k = len(problem.parameters[0])
        assert found.rank_defect + found.weak + found.determined == k == len(found.singular_values)
        assert len(found.held) == len(set(found.held)) == found.weak
        assert found.summary.startswith(f"image {found.image}: ")
        assert f"{found.weak} of {k} held by the prior" in found.summary
        if eop_set in WITH_VELOCITY:
            assert "on nothing" in found.summary and "velocity " in found.summary
            assert "full rank" not in found.summary and found.condition is found.raw_condition is None
        else:
            assert "velocity" not in found.summary and found.sentences == ()
            assert "full rank" in found.summary
        assert ("across-track velocity equals yaw" in found.summary) == (eop_set in ALSO_YAW)


@pytest.mark.behaviour
def test_sentence_of_the_set_with_position_velocity_and_attitude() -> None:
    left, right = judge_observability(compile_problem(options(pushbroom(), eop_set=20)))
    assert left.summary.startswith(
        "image left: velocity along track and radial act on nothing; across-track velocity equals yaw; "
    )
    assert right.summary.startswith("image right: velocity along track and radial act on nothing; ")
    solution = fg.adjust(pushbroom(), eop_set=20)
    assert left.summary in solution.warnings and right.summary in solution.warnings


@pytest.mark.behaviour
def test_set_15_is_of_full_rank_and_wants_scaled_units() -> None:
    """EOP set 15 has full rank, and in raw units it needs scaling; sets 2 and 3 do not.

    Raw units are metres, radians and lines, as in publications.
    """
    problem = compile_problem(options(pushbroom(), eop_set=15))
    for found in judge_observability(problem):
        assert found.summary.startswith(
            f"image {found.image}: full rank; {found.weak} of 18 held by the prior; raw units"
        )
        assert "need scaling" in found.summary
        assert 0 < found.weak < 18
        assert found.condition < 1e7 < NEEDS_SCALING < found.raw_condition
    for eop_set in (2, 3):
        assert (
            "need scaling" not in judge_observability(compile_problem(options(pushbroom(), eop_set=eop_set)))[0].summary
        )


@pytest.mark.oracle
def test_classes_and_conditions_are_those_of_the_jacobian() -> None:
    """Classes, singular values and conditions of an image are those of its Jacobian, by numpy.

    Raw units follow from the central line and the prior sigmas.
    """
    problem = compile_problem(options(pushbroom(), eop_set=15))
    _, j_image, _ = scalar_rows(problem, problem.start)
    for k, found in enumerate(judge_observability(problem)):
        j = np.vstack([j_image[r] for r in np.flatnonzero(problem.observations.image == k)])
        s = np.linalg.svd(j, compute_uv=False)
        assert found.singular_values == pytest.approx(s, rel=1e-8)
        assert (found.weak, found.determined) == (int(((s > 1e-5) & (s < 1.0)).sum()), int((s >= 1.0).sum()))
        assert found.condition == pytest.approx(s[0] / s[-1], rel=1e-6)
        half = 0.5 * (problem.block.images[k].sensor.n_lines - 1)
        degree = np.array([code % 3 for code in problem.parameters[k].codes])
        unit = problem.parameters[k].sigma / half**degree
        # beyond 1 / eps the smallest singular value of j / unit is rounding; its inverse from that of j is not
        raw = np.linalg.norm(j / unit, 2) * np.linalg.norm(unit[:, None] * np.linalg.pinv(j), 2)
        assert found.raw_condition == pytest.approx(raw, rel=1e-6)


@pytest.mark.oracle
def test_tighter_priors_hold_more() -> None:
    """With prior sigmas ten times smaller singular values are a tenth, and more directions are held by the prior."""
    block = pushbroom()
    o = block.options
    tight = options(
        block, eop_set=15, position_sigma_m=tuple(0.1 * np.array(o.position_sigma_m)),
        attitude_sigma_rad=tuple(0.1 * np.array(o.attitude_sigma_rad)),
    )  # fmt: skip
    problem = compile_problem(options(block, eop_set=15))
    _, j_image, _ = scalar_rows(problem, problem.start)
    s = np.linalg.svd(
        np.vstack([j_image[r] for r in np.flatnonzero(problem.observations.image == 0)]), compute_uv=False
    )
    a, b = (judge_observability(x)[0] for x in (problem, compile_problem(tight)))
    assert b.singular_values == pytest.approx(0.1 * s, rel=1e-6)
    assert b.weak == int(((s > 1e-4) & (s < 10.0)).sum()) > a.weak


@pytest.mark.behaviour
def test_names_of_what_the_prior_holds() -> None:
    """Directions that the prior holds have words of the model, also if the prior holds all of them."""
    problem = compile_problem(pinhole((0, 7, 12, 20)))
    for found in judge_observability(problem):
        assert set(found.held) <= set(problem.parameters[0].words)
    weaker = options(pushbroom(), eop_set=16)
    o = weaker.observations
    coarse = replace(o, sigma_line_px=1e3 * o.sigma_line_px, sigma_sample_px=1e3 * o.sigma_sample_px)
    found = judge_observability(compile_problem(replace(weaker, observations=coarse)))[0]
    assert found.determined == 0 and len(found.held) == 6


@pytest.mark.truth
def test_names_stand_in_the_order_of_their_singular_values(rng: np.random.Generator) -> None:
    """Directions held by the prior are named in the order of their singular values, the largest first.

    Each column has a planted length and is a direction of its own.
    """
    problem = compile_problem(pushbroom())
    model, words = problem.models[0], problem.parameters[0].words
    k = len(words)
    lengths = np.geomspace(50.0, 2e-3, k)[rng.permutation(k)]
    found = analyse("left", np.linalg.qr(rng.standard_normal((2 * k, k)))[0] * lengths, model)
    weak = [j for j in np.argsort(-lengths).tolist() if lengths[j] < 1.0]
    assert weak != sorted(weak) and found.held == tuple(words[j] for j in weak)
    assert found.singular_values[found.determined :] == pytest.approx(lengths[weak], rel=1e-9)


@pytest.mark.behaviour
def test_record_of_a_solution() -> None:
    solution = fg.adjust(pushbroom(), eop_set=15)
    view = solution.block_view.as_dict()
    assert view["unobservable"] == 0 and view["held_by_the_prior"] + view["determined"] == 36
    assert (view["structural_defect"], view["parts"], view["free_motions"]) == (0, 1, 0)
    image = solution.observability[0].as_dict()
    assert len(image["held_by_the_prior"]) == image["weak"] and image["raw_condition"] > image["condition"]
