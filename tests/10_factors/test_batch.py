"""Rows of the look-angle collinearity in blocks are equal to those of the scalar kernel, bit by bit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from factors.cameras import pushbroom
from fg_orient.kernels.batch import BLOCK, batch, usual
from tests.support.equation_examples import look_angle_collinearity

N = 2 * BLOCK + 11  # whole blocks and a part of one
N_IMAGES = 5
#: Position, velocity, angles: copied by tiles.
NINE = [3 * k for k in range(9)]


class Case:
    """Observations of random geometry, sorted at random, and what the rows write."""

    def __init__(self, rng: np.random.Generator, small: str, codes: list[int], n_basis: int = 2) -> None:
        records = np.stack([look_angle_collinearity(rng).record for _ in range(N)])
        records[:, pushbroom.RECORD.small_angle] = {"none": 0.0, "all": 1.0}.get(
            small, records[:, pushbroom.RECORD.small_angle]
        )
        setup = np.stack([np.array(codes, float), np.ones(len(codes))])
        self.records, self.setup = records, setup
        self.rows, self.columns = batch(pushbroom.LOOK_ANGLE_COLLINEARITY, setup, records)
        self.c = self.columns.n_components
        self.row, self.image, self.point = rng.permutation(N), rng.integers(0, N_IMAGES, N), rng.integers(0, 9, N)
        self.members = np.arange(N)
        self.basis, self.n_basis = rng.normal(size=(N, n_basis)), n_basis
        scale = np.repeat([[10.0], [1e-2], [5e-5], [1e-4]], [3, 3, 3, 2], axis=0)[: self.c, 0]
        self.wide, self.ground = (
            rng.normal(size=(N_IMAGES, n_basis * self.c)) * np.tile(scale, n_basis),
            rng.normal(size=(9, 3)),
        )

    def run(self, *ends: int, want: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Return residuals, Jacobians, and the largest of the ranges' numbers of an observation that is not finite."""
        value, d_image, d_ground = np.full((N, 2), 7.0), np.full((N, 2, self.c), 7.0), np.full((N, 2, 3), 7.0)
        bad = [
            self.rows(lo, hi, self.members, self.records, self.row, self.image, self.point, self.columns.setup,
                      self.n_basis, self.basis, self.wide, self.ground, value, d_image, d_ground, want)
            for lo, hi in pairwise(ends)
        ]  # fmt: skip
        return value, d_image, d_ground, max(bad)

    def scalar(self, a: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the value and Jacobians of the kernel at one observation, by its coefficients."""
        w, c = self.wide[self.image[a]], self.c
        x = sum(self.basis[a, b] * w[b * c : (b + 1) * c] for b in range(self.n_basis))
        kernel = pushbroom.LOOK_ANGLE_COLLINEARITY.kernel
        return kernel(self.records[self.row[a]], self.columns.setup, x, self.ground[self.point[a]], True)


@pytest.mark.consistency
@pytest.mark.parametrize("small", ["none", "all", "some"])
@pytest.mark.parametrize("n_basis", [2, 3])
@pytest.mark.parametrize("codes", [NINE, [*NINE, 27, 28], [0, 3, 6]])
def test_rows_are_those_of_the_factor(small: str, codes: list[int], n_basis: int, rng: np.random.Generator) -> None:
    case = Case(rng, small, codes, n_basis)
    value, d_image, d_ground, bad = case.run(0, N)
    assert bad == -1
    for a in range(N):
        one, j_image, j_ground = case.scalar(a)
        assert np.array_equal(value[a], one)
        assert np.array_equal(d_image[a], j_image)
        assert np.array_equal(d_ground[a], j_ground)


@pytest.mark.behaviour
def test_only_nine_components_in_their_order_are_copied_by_tiles() -> None:
    assert usual(np.arange(9))
    assert not any(usual(slot) for slot in (np.arange(8), np.arange(10), np.array([1, 0, *range(2, 9)])))


@pytest.mark.consistency
def test_rows_do_not_depend_on_the_division(rng: np.random.Generator) -> None:
    case = Case(rng, "none", NINE, 3)
    whole = case.run(0, N)
    for ends in ((0, 1, 2, N), (0, BLOCK + 3, N), (0, 5, 2 * BLOCK - 1, N)):
        assert all(np.array_equal(a, b) for a, b in zip(whole, case.run(*ends), strict=True))
    alone = case.run(0, N, want=False)
    assert np.array_equal(alone[0], whole[0])
    assert (alone[1] == 7.0).all() and (alone[2] == 7.0).all()


@pytest.mark.behaviour
@pytest.mark.parametrize("want", [False, True])
def test_the_first_observation_that_is_not_finite_is_told(want: bool, rng: np.random.Generator) -> None:
    case = Case(rng, "none", NINE, 3)
    for a in (N - 1, BLOCK + 4):
        case.records[case.row[a], pushbroom.RECORD.from_position.start] = np.nan
        assert case.run(0, N, want=want)[3] == a
