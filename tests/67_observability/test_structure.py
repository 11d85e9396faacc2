"""The structural rank agrees with the matching of single unknowns and observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, sparse
from scipy.sparse import csgraph

import fg_orient as fg
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.quality import observability, structure
from fg_orient.quality.structure import analyse_structure
from tests.support.degenerate_blocks import options, pinhole, seen_once, two_pinhole_blocks


def thinned(seed: int, *, priors: bool) -> Problem:
    """Return a pinhole block with observations left out at random: short of points, rays, or nothing."""
    rng = np.random.default_rng(seed)
    block = pinhole((0, 7, 12)[: int(rng.integers(0, 4))])
    o = block.observations
    keep = rng.random(len(o)) < rng.uniform(0.2, 1.0)
    keep[0] = True
    datum = "priors" if priors else "free"
    return compile_problem(options(replace(block, observations=o.take(keep)), priors=priors, datum=datum))


def incidence(problem: Problem) -> np.ndarray:
    """Return which single observation determines which single unknown, by the definition."""
    rows = list[np.ndarray]()
    for k, j in zip(problem.observations.image, problem.observations.point, strict=True):
        row = np.zeros(problem.n_columns, bool)
        row[problem.image_slice(int(k))] = True
        if problem.active[j]:
            row[problem.point_slice(int(j))] = True
        rows += [row, row]
    for j in np.flatnonzero(problem.observed):
        row = np.zeros(problem.n_columns, bool)
        row[problem.point_slice(int(j))] = True
        rows += [row] * 3
    if problem.block.options.priors:
        rows += list(np.eye(problem.n_image_unknowns, problem.n_columns, dtype=bool))
    return np.array(rows)


def under_determined(design: np.ndarray) -> set[int]:
    """Return the columns that alternating paths reach from those that a largest matching leaves out.

    Dulmage & Mendelsohn's decomposition.
    """
    of_row = csgraph.maximum_bipartite_matching(sparse.csr_matrix(design), perm_type="column")
    reached = set(range(design.shape[1])) - set(of_row.tolist())
    todo = list(reached)
    while todo:
        for row in np.flatnonzero(design[:, todo.pop()]):
            other = int(of_row[row])
            if other >= 0 and other not in reached:
                reached.add(other)
                todo.append(other)
    return reached


@pytest.mark.oracle
@pytest.mark.parametrize("priors", [False, True])
def test_rank_and_names_are_those_of_single_unknowns(priors: bool) -> None:
    defects = []
    for seed in range(15):
        problem = thinned(seed, priors=priors)
        found, design = analyse_structure(problem), incidence(problem)
        assert found.defect == design.shape[1] - csgraph.structural_rank(sparse.csr_matrix(design)), seed
        ids = problem.block.points.ids
        reached = under_determined(design)
        images = {
            problem.block.images[k].id for k in range(problem.n_images) if problem.image_slice(k).start in reached
        }
        points = {ids[j] for j in np.flatnonzero(problem.active) if problem.point_slice(int(j)).start in reached}
        assert {i for lack in found.lacks for i in lack.images} == images, seed
        assert {p for lack in found.lacks for p in lack.points} == points, seed
        defects.append(found.defect)
    assert 0 in defects and max(defects) > 3, "both kinds are among the seeds"


@pytest.mark.oracle
def test_a_ray_that_counts_three_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = thinned(1, priors=False)
    design = incidence(problem)
    assert analyse_structure(problem).defect == design.shape[1] - csgraph.structural_rank(sparse.csr_matrix(design)) > 0
    right = structure._groups
    monkeypatch.setattr(structure, "_groups", lambda p: (*right(p)[:2], 3 * (right(p)[2] // 2)))
    assert analyse_structure(problem).defect != design.shape[1] - csgraph.structural_rank(sparse.csr_matrix(design))


@pytest.mark.consistency
def test_equal_shares_are_never_too_generous() -> None:
    """A block that passes the quick test of the structural rank has no defect by the flow either."""
    passed = 0
    for seed in range(25):
        problem = thinned(seed, priors=False)
        if structure._enough(problem, *structure._needs(problem)):
            passed += 1
            assert structure._lacking(problem, *structure._needs(problem)) == ()
    assert passed


@pytest.mark.truth
def test_parts_of_a_block() -> None:
    found = analyse_structure(compile_problem(two_pinhole_blocks(())))
    assert found.n_parts == 2
    assert found.part.tolist() == [0] * 4 + [1] * 4
    assert found.point_part.tolist() == [0] * 25 + [1] * 25


@pytest.mark.behaviour
@pytest.mark.parametrize("priors", [True, False])
def test_points_seen_once_are_refused_with_their_number(priors: bool) -> None:
    """Points seen once without control are refused with image and free motions, also with priors.

    Priors of images do not determine the depth of a point.
    """
    block = seen_once(pinhole((0, 7, 12)), [5, 9])
    image = block.images[block.observations.image[block.observations.point == 5][0]].id
    with pytest.raises(fg.RankDeficientError) as caught:
        fg.adjust(block, priors=priors)
    first = caught.value.problems[0]
    assert first.code == "statistics.too_few"
    assert first.place == f"points 6, 10: seen in image {image} only, without control: 2 free motions, along the rays"
    assert "second image" in first.remedy and caught.value.exit_code == 3


@pytest.mark.behaviour
def test_control_points_seen_once_are_determined() -> None:
    assert fg.adjust(seen_once(pinhole((0, 7, 12)), [0])).status is fg.Status.CONVERGED


@pytest.mark.behaviour
def test_images_with_too_few_points_and_without_any() -> None:
    block = pinhole((0, 7, 12, 20))
    o = block.observations
    few = np.flatnonzero(o.image == 2)[3:]
    few = few[~np.isin(few, np.flatnonzero(o.image == 3))]
    keep = ~np.isin(np.arange(len(o)), few) & (o.image != 3)
    with pytest.raises(fg.RankDeficientError) as caught:
        fg.adjust(replace(block, observations=o.take(keep)), priors=False)
    places = [p.place for p in caught.value.problems]
    assert "image 4: in no observation, its 9 unknowns are free" in places
    assert any(p.startswith("image 3: 3 image points are too few for 9 unknowns") for p in places)
    remedies = [p.remedy for p in caught.value.problems if p.code.endswith("too_few") and p.place.startswith("image")]
    assert len(remedies) == 2 and all("measure more points in image" in text for text in remedies)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(12))
def test_parts_are_the_connected_components(seed: int) -> None:
    """The parts of a block are the connected components of its links, for random sparse links."""
    rng = np.random.default_rng(seed)
    m, n = 40, 25
    links = rng.integers(0, m + n, (int(rng.integers(1, 70)), 2))
    graph = sparse.coo_matrix((np.ones(len(links)), links.T), shape=(m + n, m + n))
    expected = csgraph.connected_components(graph, directed=False)[1][:m]
    found = structure._joined(m, [(int(a), int(b)) for a, b in links])
    assert all(root <= k for k, root in enumerate(found))
    assert np.array_equal(np.equal.outer(found, found), np.equal.outer(expected, expected))


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(20))
def test_directions_are_named_as_by_the_best_assignment(seed: int) -> None:
    """Unobservable directions get the names of scipy's best assignment, also with equal shares.

    Two directions may have the same best unknown.
    """
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(7, 7)))[0][:, : 3 + seed % 4].T
    if seed % 3 == 0:
        directions = np.round(directions, 1)
    words = tuple("abcdefg")
    expected = optimize.linear_sum_assignment(-(directions**2))[1]
    assert observability._name_by_unknowns(directions, words) == tuple(words[j] for j in expected)
