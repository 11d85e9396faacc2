"""DLT, resection, intersection, orientations and parallax are compared with the truth and other programs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from factors.cameras import frame_corrections
from factors.cameras.image_corrections import NAMES, ideal_points
from fg_orient.closerange.dlt import fit_dlt
from fg_orient.closerange.intersection import intersect_photos, normal_case
from fg_orient.closerange.orientation import absolute_orientation, relative_orientation
from fg_orient.closerange.photo import (
    Photo,
    PhotoInterior,
    aerial_from_rotation,
    ayhan_from_rotation,
    ayhan_matrix,
    corrections_of,
    lens_of,
    rotation_from_aerial,
    rotation_from_ayhan,
)
from fg_orient.closerange.resection import resect, three_point_poses
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError
from fg_orient.model.names import CellKey
from fg_orient.studies.reproduce import ayhan1996_photos as thesis

from .conftest import Array, Reference

CONTROL = np.array(thesis.CONTROL) - 1
DISTORTION = corrections_of(("k1", "k2", "p1", "p2"), [2e-5, -1e-8, 1e-5, -2e-5])


def scene(seed: int, n: int = 20, *, y_axis: str = "up") -> tuple[PhotoInterior, list[Photo], list[Array], Array]:
    """Return camera, two photos one metre apart, their rotations, and points of a room far from the origin."""
    rng = np.random.default_rng(seed)
    camera = PhotoInterior(60.0, np.array([0.3, -0.2]), DISTORTION, y_axis)  # type: ignore[arg-type]
    rotations = [rotation_from_ayhan(*rng.normal(scale=0.1, size=3)) for _ in range(2)]
    centres = np.array([[1000.0, 2000.0, 50.0], [1001.0, 2000.1, 50.05]])
    photos = [Photo.of(f"photo {k}", camera, r, c) for k, (r, c) in enumerate(zip(rotations, centres, strict=True))]
    points = np.array([1000.5, 2005.0, 50.0]) + rng.uniform(-1.0, 1.0, (n, 3))
    return camera, photos, rotations, points


def _pose(photo: Photo, seed: int) -> tuple[Array, Array]:
    """Return the rotation and centre of the first photo of a scene."""
    return scene(seed)[2][0], photo.origin_m


# --- axes and corrections ------------------------------------------------------------------------


@pytest.mark.oracle
def test_angles_of_the_thesis_turn_a_left_handed_triple() -> None:
    """A photo with angles of the thesis projects by its formulas, and angles return from the rotation.

    The formulas are (R1, R2, R3) = M (X - X0, Z - Z0, Y - Y0), x = c R1/R3, z = c R2/R3 (eqs. 56-66).
    """
    angles, centre, c = (0.03, -0.05, 0.02), np.array([999.4, 1000.56, 2.35]), 60.64
    point = np.array([1000.2, 1005.9, 2.9])
    d = point - centre
    r = ayhan_matrix(*angles) @ [d[0], d[2], d[1]]
    photo = Photo.of("", PhotoInterior(c), rotation_from_ayhan(*angles), centre)
    assert np.abs(photo.project(point)[0] - c * r[:2] / r[2]).max() <= 1e-12
    assert ayhan_from_rotation(rotation_from_ayhan(*angles)) == pytest.approx(angles)
    assert aerial_from_rotation(rotation_from_aerial(*angles)) == pytest.approx(angles)
    looking_down = rotation_from_aerial(0.0, 0.0, 0.0) @ [0.0, 0.0, -1.0]
    assert looking_down.tolist() == [0.0, 0.0, 1.0]


@pytest.mark.oracle
def test_corrections_are_inverted_and_have_their_slopes() -> None:
    c = np.array([2e-5, -1e-8, 3e-12, 1e-4, -2e-4, 1e-3, -2e-3])
    photo = Photo("", np.eye(3, 4), np.zeros(3), np.array([1.0, 2.0]), c)
    measured = np.random.default_rng(1).uniform(-15.0, 15.0, (20, 2))
    assert np.abs(photo.measured(photo.ideal(measured)) - measured).max() <= 1e-11
    x, y, h = 3.0, -7.0, 1e-5
    at, ends = np.array([[x, y]]), h * np.eye(2)[:, None]
    numeric = [(ideal_points(c, at + d) - ideal_points(c, at - d))[0] / (2.0 * h) for d in ends]
    xx, xy, yx, yy = frame_corrections.slopes(lens_of(c), x, y)
    assert np.abs(np.array([[xx, yx], [xy, yy]]) - numeric).max() <= 1e-8
    folded = Photo("", np.eye(3, 4), np.zeros(3), np.zeros(2), corrections_of(("k1",), [-1.0]))
    with pytest.raises(FgOrientError, match="cannot be inverted"):
        folded.measured(np.array([[5.0, 5.0]]))
    assert len(NAMES) == len(c)


# --- DLT -----------------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_dlt_recovers_the_camera(y_axis: str) -> None:
    _, photos, rotations, points = scene(2, y_axis=y_axis)
    plain = PhotoInterior(60.0, np.array([0.3, -0.2]), y_axis=y_axis)  # type: ignore[arg-type]
    photo = Photo.of("", plain, rotations[0], photos[0].origin_m)
    found = fit_dlt(points, photo.project(points))
    r = found.recovered
    assert (r.y_axis, r.cx, r.cy) == (y_axis, pytest.approx(60.0, rel=1e-9), pytest.approx(60.0, rel=1e-9))
    assert np.abs(r.principal - [0.3, -0.2]).max() <= 1e-7
    assert np.abs(r.centre_m - photo.origin_m).max() <= 1e-8
    assert np.abs(r.rotation - rotations[0]).max() <= 1e-9
    assert r.skew == pytest.approx(0.0, abs=1e-9)


@pytest.mark.oracle
def test_dlt_with_distortion_about_a_known_point() -> None:
    camera, photos, _, points = scene(3, 30)
    image = photos[0].project(points)
    found = fit_dlt(points, image, distortion=("k1", "k2", "p1", "p2"), about=camera.principal)
    assert np.abs(found.values[11:] / DISTORTION[[0, 1, 3, 4]] - 1.0).max() <= 1e-3  # k2 r^4 is 1e-5 mm here
    assert np.abs(found.photo.project(points) - image).max() <= 1e-9
    assert found.names[11:] == ("k1", "k2", "p1", "p2")
    radial = Photo.of(
        "", PhotoInterior(60.0, np.array([0.3, -0.2]), corrections_of(("k1",), [2e-5])), *_pose(photos[0], 3)
    )
    centred = fit_dlt(points, radial.project(points), distortion=("k1",))
    assert centred.values[11] == pytest.approx(2e-5, rel=1e-6)  # about the principal point of L, found by repetition
    assert np.abs(centred.recovered.principal - [0.3, -0.2]).max() <= 1e-6


@pytest.mark.behaviour
def test_dlt_of_the_thesis_with_16_parameters_settles_on_the_direct_centre(values: dict[CellKey, float]) -> None:
    """DLT with 16 parameters has a high condition and decentring terms within four sigmas of zero.

    15 points do not separate decentring from the principal point.
    """
    for fit in thesis.dlt_photos(values, ("k1", "k2", "k3", "p1", "p2")):
        assert fit.redundancy == 14
        assert fit.condition > 100.0
        assert fit.sigma is not None and (np.abs(fit.values[12:14]) < 4.0 * fit.sigma[12:14]).all()


@pytest.mark.oracle
def test_dlt_equals_an_independent_adjustment() -> None:
    """DLT has the values and cofactors of scipy's least squares of the projection; the direct solution has not."""
    _, photos, _, points = scene(4)
    image = photos[0].project(points) + np.random.default_rng(5).normal(scale=0.01, size=(20, 2))
    found, direct = fit_dlt(points, image, sigma=0.01), fit_dlt(points, image, iterate=False)
    about = points - found.photo.origin_m

    def away(x: Array) -> Array:
        p = np.append(x, 1.0).reshape(3, 4)
        q = about @ p[:, :3].T + p[:, 3]
        return np.asarray((q[:, :2] / q[:, 2:] - image).ravel() / 0.01)

    other = least_squares(away, direct.values, jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs((found.values - other.x) / np.sqrt(np.diag(found.cofactors))).max() <= 1e-6
    deviation = np.sqrt(np.diag(found.cofactors))
    away_from = found.cofactors - np.linalg.inv(other.jac.T @ other.jac)
    assert np.abs(away_from / np.outer(deviation, deviation)).max() <= 1e-6
    assert np.abs((direct.values - other.x) / np.sqrt(np.diag(found.cofactors))).max() > 1e-3  # other weights


@pytest.mark.oracle
@pytest.mark.parametrize("runs", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_dlt_sigmas_of_the_recovered_orientation(runs: int) -> None:
    """Errors of eight recovered numbers of DLT fit their sigmas in repeated fits; with half the sigmas they do not."""
    _, photos, rotations, points = scene(6)
    photo = Photo.of("", PhotoInterior(60.0), rotations[0], photos[0].origin_m)
    exact, rng, total = photo.project(points), np.random.default_rng(7), np.zeros(8)
    for _ in range(runs):
        r = fit_dlt(points, exact + rng.normal(scale=0.002, size=exact.shape), sigma=0.002)
        s = r.recovered.sigma
        assert s is not None and r.m0 is not None
        spin = r.recovered.rotation @ rotations[0].T
        errors = [*r.recovered.principal, r.recovered.cx - 60.0, *(r.recovered.centre_m - photo.origin_m), spin[2, 1],
                  spin[1, 0]]  # fmt: skip
        sigma = [s[n] for n in ("x0", "y0", "cx", "X0", "Y0", "Z0", "turn_x", "turn_z")]
        total += (np.array(errors) / np.array(sigma) * r.m0) ** 2  # sigmas a priori: the noise is known
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], runs)
    assert ((low <= total) & (total <= high)).all()
    assert not ((low <= 4.0 * total) & (4.0 * total <= high)).any()


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("code", "change"),
    [("closerange.few", lambda g, i: (g[:5], i[:5])), ("closerange.plane", lambda g, i: (g * [1, 1, 0], i)),
     ("closerange.points", lambda g, i: (g, i * np.nan))],
)  # fmt: skip
def test_dlt_refuses(code: str, change: object) -> None:
    _, photos, _, points = scene(8)
    ground, image = change(points, photos[0].project(points))  # type: ignore[operator]
    with pytest.raises(InputError) as caught:
        fit_dlt(ground, image)
    assert caught.value.problems[0].code == code


@pytest.mark.behaviour
def test_dlt_refuses_points_close_to_a_plane() -> None:
    """DLT refuses points with 1 mm of depth on 2 m as a plane, and accepts 20 cm."""
    _, photos, _, points = scene(8)
    photo = Photo.of("", PhotoInterior(60.0), *_pose(photos[0], 8))  # distortion would be noise
    for depth, code in ((1e-3, "closerange.plane"), (0.2, "")):
        thin = np.column_stack([points[:, 0], 2005.0 + depth * (points[:, 1] - 2005.0), points[:, 2]])
        image = photo.project(thin) + np.random.default_rng(1).normal(scale=1e-5, size=(20, 2))
        if code:
            with pytest.raises(InputError, match="projection centre") as caught:
                fit_dlt(thin, image, sigma=1e-5)
            assert caught.value.problems[0].code == code
        else:
            assert fit_dlt(thin, image, sigma=1e-5).redundancy == 29


@pytest.mark.truth
def test_dlt_of_the_thesis(values: dict[CellKey, float], reference: Reference) -> None:
    """DLT has the printed points within 0.1/0.6/0.15 mm rms, and those of the other program within 0.05 mm.

    The rms counts 15 points; the other program has other weights.
    """
    found = thesis.dlt_points(values).points_m
    printed = thesis.points_of(values, "ek2.control", thesis.DLT_POINT, thesis.CONTROL)
    rms = 1e3 * np.sqrt(np.mean((found[CONTROL] - printed) ** 2, axis=0))
    assert (rms <= [0.1, 0.6, 0.15]).all()
    others = [k for k in range(49) if k != 38]  # point 39: printed twice, differently
    assert np.abs(found - reference("dlt11_points_49", "x_m", "y_m", "z_m"))[others].max() <= 5e-5
    all_printed = thesis.points_of(values, "ek2.points", thesis.DLT_POINT)
    assert 1e3 * np.sqrt(np.mean((found - all_printed) ** 2, axis=0)) == pytest.approx([0.37, 1.90, 1.09], abs=0.02)
    assert 1e3 * np.abs(found - all_printed).max() == pytest.approx(6.7, abs=0.05)


# --- resection -----------------------------------------------------------------------------------


@pytest.mark.truth
def test_three_points_give_the_pose_among_four() -> None:
    rng = np.random.default_rng(9)
    for _ in range(200):
        rotation, points = Rotation.random(rng=rng).as_matrix(), rng.normal(size=(3, 3))
        centre = -rotation.T @ np.array([*rng.normal(scale=0.3, size=2), rng.uniform(4.0, 9.0)])
        q = (points - centre) @ rotation.T
        if (q[:, 2] > 0.1).all():
            poses = three_point_poses(points, q[:, :2] / q[:, 2:])
            assert min(np.linalg.norm(c - centre) for _, c in poses) <= 1e-5  # double roots lose half the digits


@pytest.mark.oracle
@pytest.mark.parametrize("runs", [4, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("flat", [False, True])
def test_resection_and_its_sigmas(flat: bool, runs: int) -> None:
    """Errors of repeated resections fit their covariance, for points in space and in a plane; half the sigmas fail."""
    camera, photos, rotations, points = scene(10, 12)
    points = points * [1.0, 0.0, 1.0] + [0.0, 2005.0, 0.0] if flat else points
    exact, rng, total = photos[0].project(points), np.random.default_rng(11), 0.0
    for _ in range(runs):
        found = resect(camera, points, exact + rng.normal(scale=0.003, size=exact.shape), sigma=0.003)
        turn = Rotation.from_matrix(found.rotation @ rotations[0].T).as_rotvec()
        error = np.concatenate([turn, found.centre_m - photos[0].origin_m])
        total += float(error @ np.linalg.solve(found.cofactors, error))
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 6 * runs)
    assert low <= total <= high
    assert not low <= 4.0 * total <= high


@pytest.mark.oracle
@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_residuals_of_a_resection_are_computed_minus_ideal(y_axis: str) -> None:
    camera, photos, _, points = scene(16, 8, y_axis=y_axis)
    image = photos[0].project(points) + np.random.default_rng(17).normal(scale=0.003, size=(8, 2))
    found = resect(camera, points, image, sigma=0.003)
    q = (points - found.photo.origin_m) @ found.photo.matrix[:, :3].T + found.photo.matrix[:, 3]
    assert np.abs(found.residuals - q[:, :2] / q[:, 2:] + found.photo.ideal(image)).max() <= 1e-9


def flat_scene(
    seed: int, distance_m: float, n: int, sigma: float, tilt_deg: float
) -> tuple[PhotoInterior, Photo, Array, Array, Array]:
    """Return camera, true photo and rotation, points of a plane seen from above, and noisy image coordinates."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-1.0, 1.0, (n, 2)), np.zeros(n)])
    turn = Rotation.from_euler("xz", [180.0 + tilt_deg, rng.uniform(0.0, 360.0)], degrees=True).as_matrix()
    camera = PhotoInterior(60.0, np.zeros(2), y_axis="down")
    photo = Photo.of("", camera, turn, -turn.T @ [0.0, 0.0, distance_m])
    return camera, photo, turn, points, photo.project(points) + rng.normal(scale=sigma, size=(n, 2))


def _misclosures(x: Array, photo: Photo, rotation: Array, points: Array, image: Array) -> Array:
    """Return computed minus measured coordinates (2 n,) after turns and a shift of a photo."""
    q = (points - photo.origin_m - x[3:]) @ (Rotation.from_rotvec(x[:3]).as_matrix() @ rotation).T
    return np.asarray((60.0 * q[:, :2] / q[:, 2:] - image).ravel())


@pytest.mark.oracle
def test_resection_on_a_plane_takes_the_better_of_two_minima() -> None:
    """A resection on four points of a plane has squares no larger than the minimum at the true pose.

    The minimum reached first is often the other one.
    """
    for seed in range(8):
        camera, photo, rotation, points, image = flat_scene(seed, 10.0, 4, 0.01, 15.0)
        found = resect(camera, points, image, sigma=0.01)

        own = (
            2.0
            * least_squares(
                _misclosures, np.zeros(6), method="lm", xtol=1e-12, args=(photo, rotation, points, image)
            ).cost
        )
        assert float(np.sum(found.residuals**2)) <= own * (1.0 + 1e-6)
        assert found.weighted_squares == pytest.approx(np.sum(found.residuals**2) / 0.01**2, rel=1e-9)


@pytest.mark.oracle
def test_far_control_in_a_plane_tells_its_second_pose() -> None:
    """From 200 m a resection on a plane states a rival pose, of which one is the truth; from 3 m it has none.

    Perspective is half a sigma at 200 m, so both tilts fit.
    """
    for seed in range(4):
        camera, photo, _, points, image = flat_scene(seed, 200.0, 6, 0.001, 20.0)
        found = resect(camera, points, image, sigma=0.001)
        assert found.rival is not None and 1.0 <= found.rival.ratio <= found.rival.limit
        apart = [float(np.linalg.norm(c - photo.origin_m)) for c in (found.centre_m, found.rival.place)]
        assert min(apart) < 0.25 * max(apart)
        assert "a second pose fits nearly as well, centre at" in str(found.second_pose()[0])
        camera, _, _, points, image = flat_scene(seed, 3.0, 6, 0.001, 20.0)
        assert resect(camera, points, image, sigma=0.001).rival is None


@pytest.mark.behaviour
def test_resection_refuses_points_on_a_line() -> None:
    camera, photos, _, points = scene(12, 6)
    line = points[0] + np.linspace(0.0, 1.0, 6)[:, None] * (points[1] - points[0])
    # without noise the start or the accuracy fails, with noise the convergence; the cause is the same
    for noise in (0.0, 0.003):
        image = photos[0].project(line) + np.random.default_rng(1).normal(scale=noise, size=(6, 2))
        with pytest.raises(InputError) as caught:
            resect(camera, line, image, sigma=0.003)
        assert caught.value.problems[0].code == "closerange.line"
    with pytest.raises(InputError, match="too few"):
        resect(camera, points[:3], photos[0].project(points[:3]))


# --- intersection, parallax ----------------------------------------------------------------------


@pytest.mark.oracle
def test_intersection_equals_scipy_and_its_sigmas_hold() -> None:
    _, photos, _, points = scene(13)
    rng, n = np.random.default_rng(14), len(points)
    sigma = rng.uniform(0.001, 0.006, (2 * n, 2))
    image = np.concatenate([p.project(points) for p in photos]) + rng.normal(scale=sigma)
    which, of = np.repeat([0, 1], n), np.tile(np.arange(n), 2)
    found = intersect_photos(photos, which, of, image, sigma=sigma)
    ideal = [photos[k].ideal(image[which == k]) for k in (0, 1)]
    for j in (0, 7):

        def away(d: Array, j: int = j) -> Array:
            out = []
            for photo, seen in zip(photos, ideal, strict=True):
                q = photo.matrix[:, :3] @ (points[j] + d - photo.origin_m) + photo.matrix[:, 3]
                out.append(q[:2] / q[2] - seen[j])
            return np.concatenate(out) / sigma[of == j].ravel()

        other = least_squares(away, np.zeros(3), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(found.points_m[j] - points[j] - other.x).max() <= 1e-9
        assert (
            np.abs(found.cofactors[j] - np.linalg.inv(other.jac.T @ other.jac)).max() <= 1e-6 * found.cofactors[j].max()
        )
    error = found.points_m - points
    total = float(np.einsum("ni,ni->", error, np.linalg.solve(found.cofactors, error[:, :, None])[:, :, 0]))
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 3 * n)
    assert low <= total <= high
    assert not low <= 4.0 * total <= high


@pytest.mark.truth
def test_intersection_of_the_thesis_equals_the_independent_program(
    values: dict[CellKey, float], reference: Reference
) -> None:
    """Intersections with the thesis's weights equal the independent program within 1e-6 m, least squares within 4e-5 m.

    The difference is the square of the residuals.
    """
    photos, refined = thesis.oriented(values), thesis.points_of(values, "ek1.refined", thesis.REFINED)
    expected = reference("intersection_49", "x_m", "y_m", "z_m")
    ours = thesis._intersected(photos, refined, reweighted=True).points_m
    assert np.abs(ours - expected).max() <= 1e-6
    plain = thesis._intersected(photos, refined).points_m
    assert 1e-6 < np.abs(plain - expected).max() <= 4e-5
    others = np.setdiff1d(np.arange(49), CONTROL)
    off = 1e3 * (ours - thesis.points_of(values, "ek1.points", thesis.PHOTO))[others]
    assert np.sqrt(np.mean(off**2, axis=0)) == pytest.approx([0.17, 0.69, 0.07], abs=0.005)
    assert np.abs(off).max() == pytest.approx(1.6, abs=0.05)


@pytest.mark.behaviour
def test_intersection_refuses() -> None:
    _, photos, _, points = scene(15, 4)
    image = np.concatenate([p.project(points) for p in photos])
    which, of = np.repeat([0, 1], 4), np.tile(np.arange(4), 2)
    with pytest.raises(InputError, match="point c: the point is seen in one photo only"):
        intersect_photos(photos, which[:6], of[:6], image[:6], ids="abcd")
    with pytest.raises(InputError, match="close to parallel"):
        intersect_photos([photos[0], photos[0]], which, of, np.concatenate([image[:4], image[:4]]), sigma=0.003)
    with pytest.raises(FgOrientError, match="behind the camera"):
        intersect_photos(photos[::-1], which, of, image, sigma=0.003)
    _, photos, rotations, points = scene(12, 4)  # one that becomes singular names its point
    far = Photo.of("far", PhotoInterior(1e11), rotations[1], photos[1].origin_m)
    image = np.vstack([p.project(points) for p in photos])
    with pytest.raises(NoSolutionError, match="intersection of point a"):
        intersect_photos([photos[0], far], which, of, image, ids=list("abcd"))


@pytest.mark.truth
def test_parallax_is_the_intersection_of_the_normal_case() -> None:
    left = Photo.of("1", PhotoInterior(60.0), rotation_from_ayhan(0.0, 0.0, 0.0), [1000.0, 2000.0, 50.0])
    right = Photo.of("2", PhotoInterior(61.0), rotation_from_ayhan(0.0, 0.0, 0.0), [1001.2, 2000.0, 50.0])
    points = np.array([[1000.3, 2005.0, 50.4], [1001.0, 2008.0, 49.0]])
    found = normal_case(left.project(points), right.project(points), 1.2, 60.0, 61.0, left.origin_m)
    assert np.abs(found - points).max() <= 1e-10
    turned = Photo.of("3", PhotoInterior(61.0), rotation_from_ayhan(0.0, 0.05, 0.0), right.origin_m)
    image = turned.project(points)
    x, z = image.T  # Ayhan 1996, eq. 27
    below = -x * np.sin(0.05) + 61.0 * np.cos(0.05)
    back = 61.0 * np.column_stack([x * np.cos(0.05) + 61.0 * np.sin(0.05), z]) / below[:, None]
    assert np.abs(back - right.project(points)).max() <= 1e-10
    with pytest.raises(InputError, match="parallax is not above 0"):
        normal_case(right.project(points), left.project(points), 1.2, 60.0)


# --- relative and absolute orientation -----------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("runs", [4, pytest.param(500, marks=pytest.mark.slow)])
def test_relative_orientation_and_its_sigmas(runs: int) -> None:
    """Errors of repeated relative orientations fit their covariance; with half the sigmas they do not."""
    camera, photos, rotations, points = scene(16, 15)
    exact, rng, total = [p.project(points) for p in photos], np.random.default_rng(17), 0.0
    relative = rotations[1] @ rotations[0].T
    base = rotations[0] @ (photos[1].origin_m - photos[0].origin_m)
    base /= np.linalg.norm(base)
    for _ in range(runs):
        noisy = [image + rng.normal(scale=0.001, size=image.shape) for image in exact]
        found = relative_orientation(camera, camera, *noisy, sigma=0.001)
        turn = Rotation.from_matrix(found.rotation @ relative.T).as_rotvec()
        error = np.concatenate([turn, -found.base_axes @ base])
        total += float(error @ np.linalg.solve(found.cofactors, error))
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 5 * runs)
    assert low <= total <= high
    assert not low <= 4.0 * total <= high


@pytest.mark.oracle
def test_model_and_ground_by_absolute_orientation() -> None:
    camera, photos, _, points = scene(18)
    found = relative_orientation(camera, camera, *(p.project(points) for p in photos))
    ground = absolute_orientation(found.model, points)
    assert np.abs(ground.apply(found.model) - points).max() <= 1e-8
    assert ground.scale == pytest.approx(float(np.linalg.norm(photos[1].origin_m - photos[0].origin_m)), rel=1e-8)
    with pytest.raises(InputError, match="too few"):
        relative_orientation(camera, camera, photos[0].project(points[:5]), photos[1].project(points[:5]))


@pytest.mark.oracle
def test_absolute_orientation_equals_scipy_and_its_sigmas_hold() -> None:
    """An absolute orientation with unequal weights is scipy's minimum with its cofactors.

    Points on a line are refused.
    """
    rng = np.random.default_rng(19)
    model, turn = rng.normal(size=(9, 3)), Rotation.from_rotvec([0.2, -0.4, 1.0])
    sigma = rng.uniform(0.5e-3, 3e-3, (9, 3))
    ground = [1000.0, 2000.0, 50.0] + 2.5 * turn.apply(model) + rng.normal(size=(9, 3)) * sigma
    found = absolute_orientation(model, ground, sigma_m=sigma)

    def away(x: Array) -> Array:
        moved = found.scale * np.exp(x[3]) * (Rotation.from_rotvec(x[:3]).as_matrix() @ found.rotation @ model.T).T
        return np.asarray(((found.shift_m + x[4:] + moved - ground) / sigma).ravel())

    other = least_squares(away, np.zeros(7), jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    deviation = np.sqrt(np.diag(found.cofactors))
    assert np.abs(other.x / deviation).max() <= 1e-5
    inverse = np.linalg.inv(other.jac.T @ other.jac)
    assert np.abs((found.cofactors - inverse) / np.outer(deviation, deviation)).max() <= 1e-6
    with pytest.raises(InputError, match="on a line"):
        absolute_orientation(np.outer(np.arange(4.0), [1, 2, 3]), np.outer(np.arange(4.0), [1, 0, 0]))
