"""DLT refuses points that are flat within the noise, and keeps spatial points with correct deviations."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm, t

from fg_orient.closerange.dlt import ALLOWED, LEVEL, DltFit, fit_dlt, limits
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.errors import InputError
from tests.support.command import in_process as run

from .conftest import Array

SIGMA = 0.003
CAMERA = PhotoInterior(60.0, np.array([0.3, -0.2]), y_axis="down")


def scene(
    seed: int, heights_m: float, n: int, *, distance_m: float = 3.0, sigma: float = SIGMA
) -> tuple[Array, Array, Array]:
    """Return points, projection centre and noisy image coordinates of a scene from above.

    The points lie on 1 m, with heights up to ``heights_m`` apart.
    """
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), heights_m * rng.uniform(-0.5, 0.5, n)])
    angles = [180.0 + rng.uniform(-25.0, 25.0), rng.uniform(0.0, 360.0)]
    turn = Rotation.from_euler("xz", angles, degrees=True).as_matrix()
    centre = -turn.T @ [0.1, 0.05, distance_m]
    image = Photo.of("", CAMERA, turn, centre).project(points)
    return points, centre, image + rng.normal(scale=sigma, size=image.shape)


def tried(points: Array, image: Array, sigma: float | None, distortion: tuple[str, ...] = ()) -> DltFit | str:
    try:
        return fit_dlt(points, image, sigma=sigma, distortion=distortion)
    except InputError as error:
        return error.problems[0].code


@pytest.mark.truth
def test_the_limit_is_where_the_inverse_of_a_number_is_honest() -> None:
    """The limit of flatness keeps the inverse of an estimated number within its allowed error at the stated level.

    A number t sigmas from 0, estimated as T, has an inverse that is T (T - t)/t of its own sigmas off.
    """
    noise, needed = limits(29, known=True)
    truth = needed**2 / (needed + ALLOWED)  # that T = needed is ALLOWED sigmas off
    assert norm.sf(noise) == pytest.approx(LEVEL) and norm.sf(needed - truth) == pytest.approx(LEVEL, rel=1e-9)
    for other in truth * np.array([0.5, 0.8, 1.2, 2.0]):  # no other truth is worse
        drifted = 0.5 * (other + np.sqrt(other**2 + 4.0 * ALLOWED * other))
        assert norm.sf(max(drifted, needed) - other) < LEVEL
    assert limits(29, known=False) == pytest.approx(np.array([1.0, needed / noise]) * t.isf(LEVEL, 29), rel=1e-9)
    assert limits(1, known=False) == pytest.approx((ALLOWED, ALLOWED * needed / noise), rel=1e-9)


@pytest.mark.behaviour
@pytest.mark.parametrize(("shape", "code"), [("cubic", "closerange.critical"), ("plane", "closerange.plane")])
def test_deep_points_of_a_critical_configuration_are_no_plane(shape: str, code: str) -> None:
    """Points and camera on a twisted cubic are refused as critical, points of a plane as a plane.

    Nine points on such a cubic do not determine L.
    """

    def cubic(t: Array) -> Array:
        return np.column_stack([t, 1.4 * t**2, 1.6 * (t**3 - 0.8 * t)])

    points, centre = cubic(np.linspace(-1.0, 1.0, 9)), cubic(np.array([2.0]))[0]
    if shape == "plane":
        points[:, 2] = 0.3 * points[:, 0]
    view = (points.mean(axis=0) - centre) / np.linalg.norm(points.mean(axis=0) - centre)
    right = np.cross([0.0, 0.0, 1.0], view) / np.linalg.norm(view[:2])
    photo = Photo.of("", CAMERA, np.array([right, np.cross(view, right), view]), centre)
    assert tried(points, photo.project(points), SIGMA) == code
    if shape == "cubic":  # elsewhere the same points do
        beside = Photo.of("", CAMERA, np.array([right, np.cross(view, right), view]), centre + 10.0 * right)
        assert isinstance(tried(points, beside.project(points), SIGMA / 1e3), DltFit)


@pytest.mark.behaviour
@pytest.mark.parametrize(("runs", "sizes"), [(8, (8, 20)), pytest.param(300, (6, 8, 20), marks=pytest.mark.slow)])
@pytest.mark.parametrize("heights_m", [1e-5, 1e-4, 1e-3])
def test_no_camera_from_flat_points(heights_m: float, runs: int, sizes: tuple[int, ...]) -> None:
    """DLT refuses points that are flat within the noise, with or without sigma.

    More than half of the cameras returned earlier were wrong by 5 to 11000 standard deviations.
    """
    for n in sizes:
        for seed in range(runs):
            points, _, image = scene(seed, heights_m, n)
            for sigma in (SIGMA, None) if n > 6 else (SIGMA,):
                assert tried(points, image, sigma) in ("closerange.flat", "closerange.plane")
            if n > 8:
                assert tried(points, image, SIGMA, ("k1",)) in ("closerange.flat", "closerange.plane")


@pytest.mark.oracle
@pytest.mark.parametrize("runs", [60, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("heights_m", [0.1, 1.0])
def test_spatial_points_are_accepted_with_honest_deviations(heights_m: float, runs: int) -> None:
    """DLT accepts spatial points, and errors of the centre fit its sigmas; half or twice the sigmas fail.

    The noise is known.
    """
    total = 0.0
    for seed in range(runs):
        points, centre, image = scene(1000 + seed, heights_m, 20)
        found, relative = tried(points, image, SIGMA), tried(points, image, None)
        assert isinstance(found, DltFit) and isinstance(relative, DltFit)
        sigma = found.recovered.sigma
        assert sigma is not None and found.m0 is not None
        total += ((found.recovered.centre_m[2] - centre[2]) / sigma["Z0"] * found.m0) ** 2
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], runs)
    assert low <= total <= high
    assert not low <= 4.0 * total <= high and not low <= 0.25 * total <= high


@pytest.mark.behaviour
def test_a_projection_parallel_within_the_noise_is_called_so() -> None:
    """A photo from 30 m is refused as parallel within the noise, one from 10 m is doubted, from 3 m accepted."""
    said = []
    for distance_m in (30.0, 10.0, 3.0):
        points, _, image = scene(1, 1.0, 20, distance_m=distance_m, sigma=0.05)
        found = tried(points, image, 0.05)
        said.append(found if isinstance(found, str) else found.doubt)
    assert said[0] == "closerange.parallel_noise" and said[2] is None
    assert "sigmas from a parallel one: standard deviations of the centre" in str(said[1])


@pytest.mark.behaviour
def test_the_command_names_the_flatness_and_asks_for_sigma(tmp_path: Path) -> None:
    def table(heights_m: float, n: int, seed: int) -> Path:
        points, _, image = scene(seed, heights_m, n)
        path = tmp_path / "control.csv"
        with path.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["id", "x", "y", "x_m", "y_m", "z_m"])
            writer.writerows([k, *a, *b] for k, (a, b) in enumerate(zip(image.tolist(), points.tolist(), strict=True)))
        return path

    ended = run("closerange", "dlt", table(1e-4, 20, 0), "--sigma", SIGMA)
    assert ended.code == 2 and "(RMS distance from the plane 2.4e-05 m)" in ended.stderr
    done = run("closerange", "dlt", table(1.0, 6, 2), "--json")
    assert done.code == 0 and "redundancy 1" in done.json["photos"][0]["warnings"][0]
    stated = run("closerange", "dlt", tmp_path / "control.csv", "--sigma", SIGMA, "--json").json
    assert stated["photos"][0]["warnings"] == []
