"""Fronts of a dissected block agree with the adjustment in one part, numpy, and the sum of all parts."""

from __future__ import annotations

import gc
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment import cofactors, schur_reduced
from fg_orient.adjustment.cofactors import order_by_point, pairs_of_images
from fg_orient.adjustment.parts import dissection, multifrontal
from fg_orient.adjustment.parts.dissection import Dissection, dissected, fronts_of, nested
from fg_orient.adjustment.parts.execution import Execution
from fg_orient.adjustment.parts.fronts import Added, write_front
from fg_orient.adjustment.parts.parts import rows_of
from fg_orient.adjustment.parts.solve import solve_in_parts
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.reduced_choice import Choice, Pattern
from fg_orient.adjustment.schur_reduced import LapackReduced, Singular
from fg_orient.adjustment.solve import solve
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.quality.covariance import Indeterminate, cofactors_of
from fg_orient.result.summary import summary
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.strips import StripOptions, strip_block
from tests.support.full_statistics import step_of_numpy
from tests.support.observed_parameters import OBSERVED_PARAMETERS
from tests.support.states import largest

#: Agreement with one part: prior sigmas, m, shares of standard deviations.
SIGMAS, METRES, COFACTORS = 1e-9, 1e-7, 1e-9


@lru_cache
def block(kind: str) -> Block:
    """Return a strip of 30 frame images, or a grid of 12 satellite images."""
    if kind == "strip":
        found, _ = strip_block(StripOptions(strips=1, images=30, points=200, control=8, navigation=False))
        return found
    found, _ = grid_block(BlockOptions(rows=3, columns=4, points=150, seed=3))
    return replace(found, options=replace(found.options, eop_set=15))


def problem_of(kind: str, **options: object) -> Problem:
    own = block(kind)
    return compile_problem(replace(own, options=replace(own.options, backend="schur", **options)))


@pytest.fixture(autouse=True)
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the limits so that the smallest blocks use fronts and blocks of the inverse."""
    monkeypatch.setattr(cofactors, "WHOLE_LIMIT", 0)
    monkeypatch.setattr(dissection, "HELD", 0.0)
    monkeypatch.setattr(dissection, "SMALLER", 0.0)


@pytest.fixture(params=["strip", "grid"])
def problem(request: pytest.FixtureRequest) -> Problem:
    """Return the problem of each block."""
    return problem_of(request.param)


@pytest.mark.oracle
@pytest.mark.parametrize("optimizer", ["gauss-newton", "levenberg-marquardt", "dogleg"])
def test_solution_and_cofactors_are_those_of_one_part(problem: Problem, optimizer: str) -> None:
    """A block in fronts has solution and cofactors of the block in one part, for all optimisers.

    Cofactors are those of images, pairs with common points, images far apart, and points.
    """
    chosen = compile_problem(replace(problem.block, options=replace(problem.block.options, optimizer=optimizer)))
    whole, parted = solve(chosen), solve_in_parts(chosen, Execution(parts=5))
    assert whole.converged and parted.converged
    image, ground = largest(chosen, whole.state, parted.state)
    assert image <= SIGMAS and ground <= METRES
    image, ground = step_of_numpy(chosen, parted.state)
    assert image <= 1e-6 and ground <= 1e-4
    theirs, ours = (cofactors_of(chosen, e) for e in (whole, parted))
    pairs, _ = pairs_of_images(chosen, order_by_point(chosen))
    sigma = np.sqrt(np.array([np.diag(theirs.image(k)) for k in range(chosen.n_images)]))
    scale = sigma[pairs[:, 0], :, None] * sigma[pairs[:, 1], None, :]
    np.testing.assert_allclose(ours.blocks(pairs) / scale, theirs.blocks(pairs) / scale, rtol=0.0, atol=COFACTORS)
    tie, control = (int(np.flatnonzero(m & chosen.active)[0]) for m in (~chosen.observed, chosen.observed))
    every = tuple(range(chosen.n_images))
    for images in ((chosen.n_images - 1, 0), every):
        a, b = (c.joint(images, (control, tie)) for c in (theirs, ours))
        scale = np.sqrt(np.outer(np.diag(a), np.diag(a)))
        np.testing.assert_allclose(b / scale, a / scale, rtol=0.0, atol=COFACTORS)


@pytest.mark.oracle
def test_observations_of_one_image_and_images_without_points() -> None:
    """A front eliminates observations of one image and images without points; a joint observation prevents fronts."""
    own = block("grid")
    k = len(problem_of("grid").parameters[0])
    extra = tuple(
        ExtraObservation(OBSERVED_PARAMETERS, (f"image:{own.images[i].id}",), np.zeros(0),
                         np.stack([0.3 * np.ones(k), 0.5 * np.ones(k)]), k, f"own {i}")
        for i in (2, 7)
    )  # fmt: skip
    idle = replace(own.images[0], id="idle")
    chosen = replace(own, images=(*own.images, idle), extra=extra, options=replace(own.options, backend="schur"))
    problem = compile_problem(chosen)
    whole, parted = solve(problem), solve_in_parts(problem, Execution(parts=4))
    without = solve(compile_problem(replace(chosen, extra=())))
    assert largest(problem, whole.state, without.state)[0] > 1e-3
    image, ground = largest(problem, whole.state, parted.state)
    assert image <= SIGMAS and ground <= METRES
    assert parted.linear.choice is not None and parted.linear.choice.kind == "fronts"
    a, b = (cofactors_of(problem, e).joint((2, 12), ()) for e in (whole, parted))
    np.testing.assert_allclose(b, a, rtol=0.0, atol=COFACTORS)
    assert not dissected(problem, 4, joined=True).levels


@pytest.mark.oracle
@pytest.mark.parametrize("parts", [1, 2])
def test_one_front_and_a_root_without_images(parts: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One front, or two without a common image, have the solution and cofactors of the block in one part."""
    whole = problem_of("strip")
    o, middle = whole.observations, whole.n_images // 2
    left, right = (np.bincount(o.point[m], minlength=len(whole.active)) for m in (o.image < middle, o.image >= middle))
    own, (keep,) = whole.block, np.nonzero(((left == 0) | (right == 0))[o.point])
    problem = compile_problem(replace(own, observations=own.observations.take(keep)))
    first = problem.observations.image < middle
    halves = (first, ~first) if parts == 2 else (first | ~first,)
    of_half = [np.unique(problem.observations.point[m]) for m in halves]
    found = Dissection(of_half, fronts_of(problem, of_half))
    assert [len(f.unknowns) for f in found.levels[0]] == [0 if parts == 2 else problem.n_image_unknowns]
    monkeypatch.setattr(dissection, "nested", lambda problem, parts: found)
    one, parted = solve(problem), solve_in_parts(problem, Execution(parts=parts))
    image, ground = largest(problem, one.state, parted.state)
    assert image <= SIGMAS and ground <= METRES
    a, b = (cofactors_of(problem, e).joint((3, middle + 3), ()) for e in (one, parted))
    scale = np.sqrt(np.outer(np.diag(a), np.diag(a)))
    np.testing.assert_allclose(b / scale, a / scale, rtol=0.0, atol=COFACTORS)


@pytest.mark.behaviour
def test_fronts_hold_the_images_of_their_parts(problem: Problem) -> None:
    """Each image is in one front, which no other part observes, and the parent's front contains its borders."""
    found = nested(problem, 7)
    seen = np.unique(problem.observations.point)
    np.testing.assert_array_equal(np.sort(np.concatenate(found.points)), seen)
    of_part = [set(problem.observations.image[rows]) for rows in rows_of(problem, found.points)]
    assert sorted(k for level in found.levels for f in level for k in f.images.tolist()) == [*range(problem.n_images)]
    for above, level in zip(found.levels, found.levels[1:], strict=False):
        for front in level:
            (parent,) = (f for f in above if f.lo <= front.lo and front.hi <= f.hi)
            np.testing.assert_array_equal(parent.unknowns[front.above], front.unknowns[front.own :])
    for level in found.levels:
        for front in level:
            outside = set().union(*(p for n, p in enumerate(of_part) if not front.lo <= n < front.hi))
            assert not outside & set(front.images.tolist())


@pytest.mark.behaviour
def test_separators_of_a_strip_are_narrow() -> None:
    problem = problem_of("strip")
    found = nested(problem, 4)
    assert found.choice.front < problem.n_image_unknowns / 2
    work = [np.bincount(problem.observations.point)[p] for p in found.points]
    pairs = [int((n * (n + 1) // 2).sum()) for n in work]
    assert max(pairs) <= 1.2 * min(pairs)


@pytest.mark.behaviour
def test_small_blocks_and_wide_fronts_are_summed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block is divided into fronts only if it exceeds the memory of one process and fronts make it smaller."""
    problem = problem_of("strip")
    assert dissected(problem, 4, joined=False).levels
    monkeypatch.setattr(dissection, "SMALLER", 1e6)
    assert not dissected(problem, 4, joined=False).levels
    monkeypatch.setattr(dissection, "SMALLER", 0.0)
    monkeypatch.setattr(dissection, "HELD", 6.0 * problem.n_image_unknowns**2)
    assert not dissected(problem, 4, joined=False).levels  # the band is narrow
    monkeypatch.setattr(dissection, "choose", lambda pattern, band: Choice("iterative", 0.0, 0.0))
    assert dissected(problem, 4, joined=False).levels  # the covariance needs a factor
    monkeypatch.setattr(dissection, "HELD", 0.3e9)
    assert not dissected(problem, 4, joined=False).levels


@pytest.mark.oracle
def test_singular_fronts_raise_the_error_of_the_whole_system(tmp_path: Path) -> None:
    """A singular front raises the error of the whole system and leaves no file.

    One has an image without image points, one a matrix that is not definite.
    """
    size, first = np.array([3]), np.array([0, 3])
    at = np.zeros(1, np.int64)
    front = dissection.Front(0, 1, at, np.arange(3), 3, at[:0])
    for matrix in (np.diag([1.0, 0.0, 2.0]), np.diag([1.0, 1.0, 1.0]) + 2.0 * (1.0 - np.eye(3))):
        with pytest.raises(Singular) as theirs:
            LapackReduced(Pattern(size, at, at), first, matrix[None], 0.0)
        with pytest.raises(Singular, match=str(theirs.value)):
            rows = np.vstack([matrix, np.zeros(3)])
            write_front(str(tmp_path), "one", front, rows, Added(0.0, np.zeros(3), ()))
    assert not list(tmp_path.iterdir())


@pytest.mark.consistency
def test_an_image_without_points_or_priors_is_refused_as_in_one_part(monkeypatch: pytest.MonkeyPatch) -> None:
    own = block("strip")
    images = (*own.images, replace(own.images[0], id="idle"))
    idle = compile_problem(replace(own, images=images, options=replace(own.options, priors=False)))
    said = []
    for held in (0.0, 1e9):
        monkeypatch.setattr(dissection, "HELD", held)
        with pytest.raises(fg.NoSolutionError) as caught:
            solve_in_parts(idle, Execution(parts=3))
        said.append(str(caught.value))
    assert said[0] == said[1] and "in no observation" in said[0]


@pytest.mark.behaviour
def test_covariance_of_an_ill_conditioned_block_is_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of("strip")
    parted, whole = solve_in_parts(problem, Execution(parts=3)), solve(problem)
    ours, theirs = parted.linear.reduced(0.0), whole.linear.reduced(0.0)
    assert isinstance(ours, multifrontal.Multifrontal) and isinstance(theirs, LapackReduced)
    assert 0.3 * theirs.condition() <= ours.condition() <= 3.0 * theirs.condition()
    monkeypatch.setattr(schur_reduced, "CONDITION_LIMIT", 1.0)
    with pytest.raises(Indeterminate, match="condition"):
        cofactors_of(problem, parted)


@pytest.mark.behaviour
def test_files_exist_as_long_as_the_solution(tmp_path: Path) -> None:
    """Only the last factors of a step have files, those of the solution exist as long as it, and none remains."""
    counts = Counter[int]()

    def count(_: object) -> None:
        (folder,) = tmp_path.glob(".*.tmp")
        counts[len(list(folder.glob("**/front-*")))] += 1
        assert not list(folder.glob("**/rest-*"))

    problem = problem_of("strip", optimizer="levenberg-marquardt")
    estimate = solve_in_parts(problem, Execution(parts=3, work_dir=tmp_path), count)
    assert estimate.iterations > 3 and max(counts) <= 3 * 5
    (kept,) = tmp_path.glob(".*.tmp")
    assert len(list(kept.iterdir())) == 5
    cofactors_of(problem, estimate).image(4)
    del estimate
    gc.collect()
    assert not list(tmp_path.iterdir())


@pytest.mark.behaviour
def test_the_record_names_the_method(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = fg.adjust(block("strip"), parts=4)
    found = summary(solution)["reduced_system"]
    assert found["method"] == "fronts" and found["largest_front"] == nested(problem_of("strip"), 4).choice.front
    assert found["predicted_bytes"] == 8 * found["largest_front"] ** 2
    monkeypatch.setattr(dissection, "HELD", 0.3e9)
    found = summary(fg.adjust(block("strip"), parts=4))["reduced_system"]
    assert found["method"] in ("banded", "dense") and found["largest_front"] is None
