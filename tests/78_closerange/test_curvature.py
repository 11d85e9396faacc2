"""The tests check whether the covariance is valid: a known parabola and distant cameras bend the unknowns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fg_orient.closerange.minima import BENT, bend
from fg_orient.closerange.orientation import absolute_orientation, relative_orientation
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.closerange.resection import resect
from tests.support.repetitions import some_slow

from .conftest import Array

CAMERA = PhotoInterior(60.0, y_axis="down")
SIGMA = 0.005


@pytest.mark.truth
def test_bend_of_a_parabola() -> None:
    """The bend of a parabola is 3 * 0.2^2 / 0.1, m0 = 2 doubles it, and that of a product is 0.9 / sqrt(3).

    x1 + 3 x0^2 is observed with 0.1 and x0 with 0.2, with a rotation between them and the unknowns.
    """
    turn = Rotation.from_euler("z", 0.4).as_matrix()[:2, :2]

    def rows(y: Array, want: bool) -> tuple[Array, Array]:
        x = turn @ y
        design = np.array([[5.0, 0.0], [60.0 * x[0], 10.0], [0.0, 0.0]]) @ turn
        return np.array([5.0 * x[0], 10.0 * (x[1] + 3.0 * x[0] ** 2), 1.0]), design if want else np.zeros((0, 2))

    assert bend(rows, np.zeros(2), None) == pytest.approx(1.2, rel=1e-9)
    assert bend(rows, np.zeros(2), 2.0) == pytest.approx(2.4, rel=1e-9)

    def mixed(y: Array, want: bool) -> tuple[Array, Array]:
        design = np.array([[1.0, 0.0], [0.9 * y[1], 1.0 + 0.9 * y[0]]])
        return np.array([y[0], y[1] + 0.9 * y[0] * y[1]]), design if want else np.zeros((0, 2))

    # mean of (0.9 e0 e1)^2 is 0.81 = 3 bend^2
    assert bend(mixed, np.zeros(2), None) == pytest.approx(0.9 / np.sqrt(3.0), rel=1e-9)


def squares(distance_m: float, runs: int) -> tuple[Array, Array, Array]:
    """Return squared errors of resections by the covariance (n,) and by single deviations (n, 6), and bends.

    Each resection has six points.
    """
    whole, single, bends = [], [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        points, rotation = rng.uniform(-1.0, 1.0, (6, 3)), Rotation.random(rng=rng).as_matrix()
        photo = Photo.of("", CAMERA, rotation, -rotation.T @ [0.0, 0.0, distance_m])
        found = resect(CAMERA, points, photo.project(points) + rng.normal(scale=SIGMA, size=(6, 2)), sigma=SIGMA)
        turn = Rotation.from_matrix(found.rotation @ rotation.T).as_rotvec()
        error = np.concatenate([turn, found.centre_m - photo.origin_m])
        whole.append(float(error @ np.linalg.solve(found.cofactors, error)))
        single.append(error**2 / np.diag(found.cofactors))
        bends.append(found.bend)
    return np.array(whole), np.array(single), np.array(bends)


@pytest.mark.oracle
@pytest.mark.parametrize("runs", some_slow([12, 400]))
def test_a_bend_tells_where_the_covariance_is_optimistic_as_a_whole(runs: int) -> None:
    """At 8 m the covariance holds; at 150 m the squares of errors grow by 3 bend^2/6 per unknown.

    Single sigmas hold at both distances.
    """
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], runs)
    whole, single, bends = squares(8.0, runs)
    assert bends.max() < BENT
    assert chi2.ppf(1e-4, 6 * runs) <= whole.sum() <= chi2.ppf(1.0 - 1e-4, 6 * runs)
    assert ((low <= single.sum(axis=0)) & (single.sum(axis=0) <= high)).all()
    whole, single, bends = squares(150.0, runs)
    assert np.median(bends) > 4.0 * BENT
    assert whole.mean() > 12.0  # six by the covariance
    assert 0.4 <= (whole.mean() - 6.0) / (3.0 * np.mean(bends**2)) <= 2.5
    assert ((low <= single.sum(axis=0)) & (single.sum(axis=0) <= high)).all()


@pytest.mark.behaviour
def test_orientations_tell_their_bend() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-1.0, -1.0, 4.0], [1.0, 1.0, 6.0], (12, 3))
    bends = []
    for base_m in (1.0, 0.05):
        pair = [Photo.of("", CAMERA, np.eye(3), [x, 0.0, 0.0]).project(points) for x in (0.0, base_m)]
        noisy = [image + rng.normal(scale=0.001, size=image.shape) for image in pair]
        bends.append(relative_orientation(CAMERA, CAMERA, *noisy, sigma=0.001).bend)
    assert 0.0 < bends[0] < BENT < bends[1]
    model = np.outer([-1.0, 0.1, 1.2], [1.0, 0.0, 0.0])
    thin, wide = (model + rng.normal(scale=s, size=(3, 3)) for s in (0.003, 1.0))
    found = [absolute_orientation(m, m + rng.normal(scale=0.003, size=(3, 3)), sigma_m=0.003) for m in (thin, wide)]
    assert found[0].bend > BENT > found[1].bend > 0.0
