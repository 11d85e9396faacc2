"""T of every kind of suspect agrees with one more column of unknowns in the full matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError, NoSolutionError, finding
from fg_orient.quality import prediction
from fg_orient.quality.outliers import assess_suspects
from fg_orient.quality.suspects import Kind, suspects
from tests.support.full_statistics import turned_rows
from tests.support.linear_twin import linear_twin
from tests.support.rpc_block import rpc_twin

KINDS: tuple[Kind, ...] = ("groups", "coordinates", "points")


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_quadratic_forms_are_what_more_unknowns_gain(kind: Kind) -> None:
    """T of each suspect is the decrease of v^T v with its error as unknown, by projection of the full matrix.

    With the residuals of another observation in the place of the suspect's the same comparison fails.
    """
    twin = linear_twin()
    problem, state = twin.solution.problem, twin.solution.state
    v, _ = turned_rows(problem, state)
    for found in twin.suspects(kind):
        t, d, _ = found.quadratic()
        rows = twin.rows(found)
        for k in range(0, len(t), max(1, len(t) // 6)):
            extra = np.zeros((len(v), found.columns.shape[2]))
            extra[rows[k]] = found.columns[k]
            extra -= twin.basis @ (twin.basis.T @ extra)
            u, s, _ = np.linalg.svd(extra / np.linalg.norm(found.columns[k], axis=0), full_matrices=False)
            gain = (u[:, s > 1e-4].T @ v) ** 2
            assert d[k] == len(gain)
            assert t[k] == pytest.approx(gain.sum(), rel=1e-6, abs=1e-8)
            assert t[k] != pytest.approx(replace(found, v=np.roll(found.v, 1, axis=0)).quadratic()[0][k], rel=1e-3)


@pytest.mark.consistency
@pytest.mark.parametrize("backend", ["graph", "schur"])
def test_all_backends_test_alike(backend: str) -> None:
    """Each backend has the quadratic forms and dimensions of the dense one, for all kinds of suspects."""
    block = rpc_twin("affine", seed=5).block
    dense, other = fg.adjust(block, backend="dense"), fg.adjust(block, backend=backend)
    for kind in KINDS:
        one, two = dense.outlier_tests(kind=kind), other.outlier_tests(kind=kind)
        order_one, order_two = (np.lexsort((x.row, x.point, x.part)) for x in (one, two))
        assert np.array_equal(one.dimension[order_one], two.dimension[order_two])
        np.testing.assert_allclose(one.quadratic[order_one], two.quadratic[order_two], rtol=1e-5, atol=1e-7)


@pytest.mark.behaviour
def test_rows_and_columns_say_the_same() -> None:
    twin = linear_twin()
    tests = twin.solution.outlier_tests(kind="coordinates")
    assert len(tests) == 2 * 94 + 3 * 37
    first, last = tests[0], tests[-1]
    assert first.statistic == tests.statistic[0]
    assert first.probability == pytest.approx(tests.probability.min())
    assert first.symbol == "t"
    assert {test.part for test in tests} == {"line", "sample", "east", "north", "up"}
    assert all(len(test.error) == 1 for test in tests)
    assert last.dimension <= 1
    assert [test.name for test in tests[:2]] == [tests[0].name, tests[1].name]
    assert tests[0].name != tests[1].name
    whole = twin.solution.outlier_tests(kind="points", test="pope")
    assert len(whole) == 47
    assert whole[0].name.endswith("with all its observations")
    assert whole[0].symbol == "T/m0^2"
    assert len(whole[0].error) == 0


def one_ray_more_than_needed() -> Block:
    """Return a block in which tie points of two rays are checked in one direction only."""
    return rpc_twin("shift").block


@pytest.mark.behaviour
def test_inseparable_suspects_are_one_hypothesis() -> None:
    """The two rays of a tie point, which have the same statistic, count as one test."""
    solution = fg.adjust(one_ray_more_than_needed())
    tests = solution.outlier_tests()
    roles = solution.block.points.roles
    tie = [k for k in range(len(tests)) if roles[tests.point[k]] != "control"]
    assert tests.n_tested == len(tests) - len(tie) // 2
    assert np.allclose(tests.level_each, 1.0 - 0.95 ** (1.0 / tests.n_tested))


@pytest.mark.behaviour
def test_what_is_not_tested_has_no_figures() -> None:
    """A suspect that is not tested has None as statistic, limit and probability, and a sentence with the reason.

    Baarda's test needs no redundancy for the scale.
    """
    twin = rpc_twin("shift")
    block = twin.block
    control = np.flatnonzero([role == "control" for role in block.points.roles])[:1]
    keep = (block.observations.point == control[0]) & (block.observations.image == 0)
    alone = replace(block, images=block.images[:1], observations=block.observations.take(keep))
    solution = fg.adjust(alone, check_points="exclude")
    assert solution.redundancy == 2
    tests = solution.outlier_tests()
    image = next(test for test in tests if test.part == "image")
    assert (image.statistic, image.critical, image.probability) == (None, None, None)
    assert "not tested" in image.sentence()
    assert not image.suspicious
    assert solution.outlier_tests(test="baarda")[0].statistic is not None


@pytest.mark.behaviour
def test_tests_that_cannot_be_are_refused() -> None:
    """Tests are refused with the reason without covariance, under a loss, or for an unknown kind."""
    plain = linear_twin().solution
    bare, robust = (
        replace(plain, cofactors=None, unavailable=(finding("unavailable.indeterminate", why="singular"),)),
        fg.adjust(rpc_twin("shift").block, loss="huber"),
    )
    for refused, error, words in (
        (bare.outlier_tests, NoSolutionError, "no covariance"), (robust.outlier_tests, NoSolutionError, "robust loss"),
        (robust.global_test, NoSolutionError, "needs least squares"),
        (lambda: plain.outlier_tests(kind="images"), InputError, "groups, coordinates, points"),  # type: ignore[arg-type]
    ):  # fmt: skip
        with pytest.raises(error, match=words):
            refused()


@pytest.mark.behaviour
def test_what_an_intersection_takes_up_is_not_checked() -> None:
    """Errors that an intersection absorbs have no dimension to test, also if rounding leaves 1e-17 of them."""
    v, s = np.array([0.3, -0.2]), np.eye(2)
    for left in (0.0, 1e-17):
        e = np.array([[1.0, 0.0], [0.0, left]])
        found = prediction._judged(v, e, s, 100.0, 50, "t")
        assert found.dimension == 1
        assert found.quadratic == pytest.approx(0.09)
    assert prediction._judged(v, 1e-17 * np.eye(2), s, 100.0, 50, "t").dimension == 0
    solution = fg.adjust(rpc_twin("shift").block, backend="dense")
    problem, state, cofactors = solution.problem, solution.state, solution.cofactors
    assert cofactors is not None
    j = int(problem.observations.point[0])
    rest = replace(problem, active=problem.active & (np.arange(len(problem.active)) != j))
    for excluded in (prediction.Excluded(j, (0,), False, "image", 0), prediction.Excluded(j, (), True, "height")):
        alone = prediction.misclosures(problem, rest, state, [excluded])[0]
        assert alone is not None
        test = alone.consistency(cofactors, solution.chi2, rest.redundancy, "t")
        assert (test.dimension, test.statistic) == (0, None)


@pytest.mark.behaviour
def test_suspects_of_different_points_are_never_one_class() -> None:
    """Suspects of different points with equal T and d stay separate hypotheses."""
    twin = linear_twin()
    found = suspects(twin.solution.residual_cofactors)[0]
    one = replace(found, point=np.array([0, 0, 1]), row=np.array([0, 1, 2]), v=10.0 * found.v[[0, 0, 0]],
                  q=found.q[[0, 0, 0]], columns=found.columns[[0, 0, 0]])  # fmt: skip
    tests = assess_suspects(twin.solution.problem, [one], 1e4, level=0.05, test="baarda", control="none")
    assert tests.n_tested == 2
    assert sorted(len(test.inseparable) for test in tests) == [0, 1, 1]
