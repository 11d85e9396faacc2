"""The tests estimate shift and drift of strips, lever arm and boresight of receiver and inertial unit."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import fg_orient as fg
from factors.conditions.navigation import ANTENNA_POSITION, INERTIAL_ATTITUDE, rotation_vector
from fg_orient.formats.metadata.frame import write_camera, write_frame_file
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role, Status
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.interior import Interior, direct_orientation
from fg_orient.sensors.navigation import TOP_FORWARD, Fix, Mounting, body_attitude, with_navigation
from fg_orient.simulate.strips import IMAGE_SIGMA_PX, MOUNTED, StripOptions, StripTruth, strip_block
from tests.support.full_statistics import step_of_numpy


@lru_cache
def small() -> tuple[Block, StripTruth]:
    return strip_block(StripOptions(seed=2, images=3, points=25))


@pytest.mark.oracle
def test_rotation_vector_is_the_logarithm() -> None:
    rng = np.random.default_rng(1)
    for angle in (0.0, 1e-9, 1e-4, 1e-2, 1.0, 3.0):
        v = rng.normal(size=3)
        v *= angle / np.linalg.norm(v)
        np.testing.assert_allclose(rotation_vector(Rotation.from_rotvec(v).as_matrix()), v, atol=1e-14, rtol=1e-13)


@pytest.mark.oracle
def test_body_attitude_is_that_of_scipy() -> None:
    """The body attitude is Rz Ry Rx from the body to North, East, Down; flying east the right wing is south."""
    place = np.array([4.08e6, 2.53e6, 4.19e6])
    lon, lat, _ = ecef_to_geodetic(place[None])
    east, north, up = enu_from_ecef(lon, lat)[0]
    ned = Rotation.from_euler("ZYX", [0.7, -0.2, 0.1]).as_matrix()
    expected = np.column_stack([north, east, -up]) @ ned
    np.testing.assert_allclose(body_attitude(0.1, -0.2, 0.7, place), expected, atol=1e-15)
    flying_east = np.column_stack([east, -north, -up])
    np.testing.assert_allclose(body_attitude(0.0, 0.0, np.pi / 2, place), flying_east, atol=1e-15)


@pytest.mark.oracle
def test_residuals_vanish_at_direct_georeferencing() -> None:
    """The pose of ``direct_orientation`` gives residuals of zero in the equations of receiver and attitude."""
    rng = np.random.default_rng(3)
    body, receiver, lever = Rotation.random(random_state=4).as_matrix(), rng.normal(size=3) + 5e6, rng.normal(size=3)
    rotation, centre = direct_orientation(receiver, body, lever, TOP_FORWARD)
    # X_0 = X_receiver + R a; the axes of the camera follow those of the body by the boresight
    assert np.abs(centre - (receiver + body @ lever)).max() < 1e-9
    assert np.abs(rotation - TOP_FORWARD @ body.T).max() < 1e-15
    camera = Interior(100, 100, 100.0, np.zeros(2)).camera(rotation, centre, {"rotation_x": 1.0})
    block = small()[0]
    first = replace(block.images[0], sensor=FrameSensor(camera, 100, 100))
    seen = block.observations.take(np.flatnonzero(block.observations.image == 0))
    block = replace(block, images=(first,), observations=seen, extra=())
    fix = Fix(block.images[0].id, "1", 0.0, receiver, np.ones(3), body, np.ones(3))
    position, attitude = with_navigation(block, [fix], Mounting(lever)).extra
    setup, x = np.array([[0.0], [1.0]]), np.zeros(1)
    assert np.abs(ANTENNA_POSITION.residual(position.record, setup, x)).max() < 1e-8
    assert np.abs(INERTIAL_ATTITUDE.residual(attitude.record, setup, x)).max() < 1e-14


@pytest.mark.oracle
def test_backends_end_where_numpy_has_no_step_left() -> None:
    """A block with navigation data has the same solution and covariance on all three backends, without a step left.

    Its extra observations of single images are blocks of the reduced system.
    """
    block, _ = small()
    graph, *others = (fg.adjust(block, backend=name) for name in ("graph", "schur", "dense"))
    assert max(max(step_of_numpy(one.problem, one.state)) for one in (graph, *others)) < 1e-7
    for other in others:
        np.testing.assert_allclose(other.state.image, graph.state.image, atol=1e-8)
        assert other.chi2 == pytest.approx(graph.chi2, rel=1e-10)
        q = [s.covariance("image:image02").values for s in (other, graph)]
        np.testing.assert_allclose(*q, rtol=1e-5, atol=1e-7 * np.abs(q[1]).max())
    assert fg.adjust(strip_block()[0]).backend == "graph"  # as without them


@pytest.mark.oracle
@pytest.mark.parametrize("optimizer", ["levenberg-marquardt", "dogleg"])
def test_damped_optimisers_end_where_numpy_has_no_step_left(optimizer: str) -> None:
    block, _ = small()
    found = fg.adjust(block, backend="schur", optimizer=optimizer)
    assert max(step_of_numpy(found.problem, found.state)) < 1e-6


@pytest.mark.oracle
def test_against_scipy() -> None:
    """scipy's least squares of independent equations has the chi2 and unknowns of the adjustment."""
    block, _ = strip_block(StripOptions(seed=2, strips=1, images=2, points=10, control=4))
    solution = fg.adjust(block)
    problem = solution.problem
    moved = solution.ground_m[problem.active] - (problem.start.ground + problem.origin_m)[problem.active]
    near = np.concatenate([problem.image_vector(solution.state), moved.ravel()])
    away = near + 0.1 * np.random.default_rng(1).standard_normal(len(near))  # soon there, but by its own way
    reference = least_squares(
        lambda x: _residuals(problem, block, x), away, x_scale="jac", max_nfev=60, xtol=1e-11, ftol=1e-12, gtol=1e-14
    )
    assert reference.status > 0
    assert 2.0 * reference.cost == pytest.approx(solution.chi2, rel=1e-7)
    found = problem.image_matrix(reference.x[: problem.n_free_unknowns])
    np.testing.assert_allclose(found, solution.state.image, atol=2e-4)  # numerical derivatives, prior sigmas


def _residuals(problem: fg.adjustment.problem.Problem, block: Block, x: np.ndarray) -> np.ndarray:
    """Return all weighted residuals, from the definitions; unknowns in prior sigmas, points in m from their start."""
    free, points = x[: problem.n_free_unknowns], x[problem.n_free_unknowns :].reshape(-1, 3)
    ground = problem.start.ground.copy()  # from the local origin: differences of 1e-6 m keep their digits
    ground[problem.active] += points
    out, o, image = [free], block.observations, problem.image_matrix(free)
    for k, view in enumerate(block.images):
        value = dict(zip(problem.parameters[k].names, image[k] * problem.parameters[k].sigma, strict=True))
        camera = view.sensor.camera

        def of(stem: str, names: tuple[str, ...], value: dict[str, float] = value) -> np.ndarray:
            return np.array([value.get(f"{stem}_{a}", 0.0) for a in names])

        r = Rotation.from_rotvec(of("rotation", ("x", "y", "z"))).as_matrix() @ camera.rotation
        c = camera.centre_m - problem.origin_m + of("centre", ("x", "y", "z"))
        b = Rotation.from_rotvec(of("boresight", ("x", "y", "z"))).as_matrix() @ MOUNTED.camera_from_body
        rows = np.flatnonzero(o.image == k)
        q = (ground[o.point[rows]] - c) @ r.T
        pixel = camera.focal_px * q[:, [1, 0]] / q[:, 2:] + camera.principal_px
        out.append(((np.stack([o.line, o.sample], axis=1)[rows] - pixel) / IMAGE_SIGMA_PX).ravel())
        enu, rph = ("east", "north", "up"), ("roll", "pitch", "heading")
        position, attitude = (e.record for e in block.extra if e.unknowns == (f"image:{view.id}",))
        tau, axes = position[27], position[34:].reshape(3, 3)
        receiver = camera.centre_m - problem.origin_m + position[28:31]
        wrong = axes @ (of("gnss_shift", enu) + tau * of("gnss_drift", enu))
        arm = r.T @ b @ (MOUNTED.lever_m + of("lever", ("x", "y", "z")))
        out.append(position[:9].reshape(3, 3) @ (receiver - (c - arm + wrong)))
        m = Rotation.from_matrix(attitude[28:].reshape(3, 3) @ r.T @ b).as_rotvec()
        out.append((m - of("ins_shift", rph) - tau * of("ins_drift", rph)) * np.diag(attitude[:9].reshape(3, 3)))
    known = block.points.known
    for j in block.points.where(Role.CONTROL):
        lon, lat, _ = ecef_to_geodetic(known.ecef_m[j][None])
        out.append(enu_from_ecef(lon, lat)[0] @ (ground[j] + problem.origin_m - known.ecef_m[j]) / known.sigma_enu_m[j])
    return np.concatenate(out)


def _nees(seed: int) -> tuple[float, int, np.ndarray, float, int]:
    """Return normalised squared error of all image unknowns, their number, errors in sigmas, chi2 and redundancy."""
    block, truth = strip_block(StripOptions(seed=seed, images=3, points=25))
    solution = fg.adjust(block, statistics="basic")
    assert solution.status is Status.CONVERGED
    problem, ties = solution.problem, solution.problem.ties
    assert ties is not None
    wide = solution.cofactors.joint(tuple(range(problem.n_images)), ())
    place = ties.place
    error = (problem.image_columns(solution.state) - truth.image.ravel())[place]
    q = wide[np.ix_(place, place)]
    return float(error @ np.linalg.solve(q, error)), len(error), error / np.sqrt(np.diag(q)), solution.chi2, (
        solution.redundancy
    )  # fmt: skip


@pytest.mark.oracle
@pytest.mark.parametrize("seeds", [range(1, 7), pytest.param(range(1, 201), marks=pytest.mark.slow)])
def test_estimates_are_unbiased_and_their_covariance_is_right(seeds: range) -> None:
    """NEES and global test lie in their 99.8 % intervals, and no mean error is above five sigmas."""
    found = [_nees(seed) for seed in seeds]
    for value, freedom in ((sum(f[0] for f in found), sum(f[1] for f in found)),
                           (sum(f[3] for f in found), sum(f[4] for f in found))):  # fmt: skip
        low, high = stats.chi2(freedom).ppf([0.001, 0.999])
        assert low < value < high
    mean = np.mean([f[2] for f in found], axis=0) * np.sqrt(len(found))
    assert np.abs(mean).max() < 5.0


@pytest.mark.oracle
def test_drift_that_is_not_modelled_is_seen() -> None:
    """Without drift unknowns the same data fail the global test, so that the test above can fail."""
    block, _ = small()
    held = {name: 1e-9 for name in block.images[0].sensor.camera.sigma if "drift" in name or "shift" in name}
    images = tuple(
        replace(i, sensor=FrameSensor(replace(i.sensor.camera, sigma=i.sensor.camera.sigma | held), 10000, 10000))
        for i in block.images
    )
    stiff = fg.adjust(replace(block, images=images))
    assert stats.chi2(stiff.redundancy).sf(stiff.chi2) < 1e-6


@pytest.mark.behaviour
def test_what_no_control_tells_is_named() -> None:
    """One strip without control names shift, drift and boresight as held by priors; with control the shift is not."""
    block, _ = strip_block(StripOptions(strips=1, control=0, points=40))
    said = fg.adjust(block).unobservable
    for what in ("strip 1: shift of the receiver (east, north, up)", "strip 1: drift of the receiver",
                 "mounting: boresight", "strip 1: shift of the attitude"):  # fmt: skip
        assert any(text.startswith(what) and "held by its prior" in text for text in said), (what, said)
    rich, _ = strip_block(StripOptions(strips=2, control=20, points=60))
    assert not any(": shift of the receiver" in text for text in fg.adjust(rich).unobservable)


def _written(folder: Path, block: Block) -> Path:
    """Return the block as a project with a navigation table, angles from its own observations."""
    camera = block.images[0].sensor.camera
    write_camera(folder / "camera.toml", Interior(10000, 10000, camera.focal_px, camera.principal_px, name="c"))
    lines = ["image,strip,time_s,x_m,y_m,z_m,sigma_east_m,sigma_north_m,sigma_up_m,roll_deg,pitch_deg,heading_deg,"
             "sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg"]  # fmt: skip
    for k, image in enumerate(block.images):
        own = {n: s for n, s in image.sensor.camera.sigma.items() if n.startswith(("rotation", "centre"))}
        plain = FrameSensor(replace(image.sensor.camera, sigma=own, shared={}), 10000, 10000)
        write_frame_file(folder / f"{image.id}.toml", plain, "camera.toml")
        position, attitude = (e.record for e in block.extra if e.unknowns == (f"image:{image.id}",))
        place = plain.camera.centre_m + position[28:31]
        lon, lat, _ = ecef_to_geodetic(place[None])
        east, north, up = enu_from_ecef(lon, lat)[0]
        ned = np.stack([north, east, -up]) @ attitude[28:].reshape(3, 3).T
        heading, pitch, roll = Rotation.from_matrix(ned).as_euler("ZYX", degrees=True)
        sigma = np.degrees(1.0 / np.diag(attitude[:9].reshape(3, 3)))
        cells = [*place, 0.05, 0.05, 0.08, roll, pitch, heading, *sigma]
        strip, number = divmod(k, 3)
        lines.append(f"{image.id},{strip + 1},{10.0 * number},{','.join(repr(float(v)) for v in cells)}")
    (folder / "navigation.csv").write_text("\n".join(lines) + "\n")
    known = block.points.known
    write_points(folder / "points.csv", block.points.ids, block.points.roles, known.ecef_m, known.sigma_enu_m,
                 kind="geocentric")  # fmt: skip
    o = block.observations
    write_observations(
        folder / "observations.csv", [block.images[i].id for i in o.image], [block.points.ids[j] for j in o.point],
        np.stack([o.line, o.sample], axis=1), np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1),
    )  # fmt: skip
    project = folder / "project.toml"
    write_project(project, name="strips", images=[(i.id, f"{i.id}.toml") for i in block.images], crs="EPSG:4978")
    degrees = {name: [float(np.degrees(v)) for v in getattr(MOUNTED, field)] for name, field in (
        ("attitude_shift_sigma_deg", "turn_sigma_rad"), ("attitude_drift_sigma_deg", "turn_drift_sigma_rad"),
        ("boresight_sigma_deg", "boresight_sigma_rad"))}  # fmt: skip
    table = ["", "[navigation]", 'file = "navigation.csv"', 'crs = "EPSG:4978"', "lever_m = [0.3, -0.2, 1.5]",
             "shift_sigma_m = [0.3, 0.3, 0.3]", "drift_sigma_m = [0.1, 0.1, 0.1]", "lever_sigma_m = [0.02, 0.02, 0.02]",
             *(f"{name} = {value}" for name, value in degrees.items()), ""]  # fmt: skip
    project.write_text(project.read_text() + "\n".join(table))
    return project


@pytest.mark.consistency
def test_project_with_a_navigation_table(tmp_path: Path) -> None:
    """A project with a navigation table has the solution of the block in memory within 1e-6."""
    block, _ = small()
    read = fg.read_project(_written(tmp_path, block))
    assert len(read.extra) == 2 * len(block.images)
    assert any(source.path.endswith("navigation.csv") for source in read.sources)
    found, expected = fg.adjust(read), fg.adjust(block)
    np.testing.assert_allclose(found.state.image, expected.state.image, atol=1e-6)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("old", "new", "code"),
    [("image02,1", "image99,1", "navigation.image"), ("image02,1", "image01,1", "navigation.twice"),
     (",0.05,0.05,", ",0.0,0.05,", "navigation.sigma")],
)  # fmt: skip
def test_faults_of_a_table_are_named(tmp_path: Path, old: str, new: str, code: str) -> None:
    project = _written(tmp_path, small()[0])
    table = tmp_path / "navigation.csv"
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        fg.read_project(project)
    assert [p.code for p in caught.value.problems] == [code]
    assert caught.value.problems[0].file == str(table)


@pytest.mark.behaviour
def test_satellite_images_are_refused(tmp_path: Path) -> None:
    from fg_orient.simulate.zonguldak import zonguldak_block

    fix = Fix("left", "1", 0.0, np.array([4e6, 2.5e6, 4.2e6]), np.ones(3))
    with pytest.raises(InputError, match="only frame images"):
        with_navigation(zonguldak_block()[0], [fix], MOUNTED)


@pytest.mark.behaviour
def test_positions_alone_leave_the_attitude_out() -> None:
    block, _ = small()
    bare = replace(block, extra=(), images=tuple(
        replace(i, sensor=FrameSensor(replace(i.sensor.camera, sigma={"centre_x": 1.0}, shared={}), 10000, 10000))
        for i in block.images
    ))  # fmt: skip
    fixes = [Fix(i.id, "1", float(k), i.sensor.camera.centre_m, np.ones(3)) for k, i in enumerate(block.images)]
    made = with_navigation(bare, fixes, MOUNTED)
    assert len(made.extra) == len(block.images)
    names = made.images[0].sensor.camera.sigma
    assert "gnss_drift_up" in names
    assert not any(name.startswith(("ins_", "boresight")) for name in names)
