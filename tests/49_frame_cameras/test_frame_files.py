"""Files of frame images are read and written, used in a project and by the commands."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fg_orient as fg
from fg_orient.formats.metadata.frame import read_frame_file, write_camera, write_frame_file
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL, FrameSensor, rotation_of_opk
from fg_orient.sensors.interior import Interior
from tests.support.command import in_process
from tests.support.full_statistics import step_of_numpy

LON, LAT, HEIGHT = 31.8, 41.4, 1500.0
ERROR = {"rotation_x": 3e-4, "rotation_y": 3e-4, "rotation_z": 3e-4, "centre_x": 0.5, "centre_y": 0.5, "centre_z": 0.5}
FOCAL_ERROR_PX = 2.0
NOISE_PX = 0.3
CAMERA = {"focal_px": 4000.0, "principal_px": np.array([1510.0, 1990.0])}
DISTORTION = np.array([-0.04, 0.01, 0.0, 2e-4, -1e-4])


def interior(model: str, focal_px: float = 4000.0) -> Interior:
    return Interior(
        3000, 4000, focal_px, CAMERA["principal_px"], DISTORTION, model,
        unit_px=4000.0 if model == MEASURED_TO_IDEAL else None, name='the "wide" one',
    )  # fmt: skip


@dataclass(frozen=True)
class Written:
    project: Path
    truth: dict[str, FrameSensor]


@pytest.fixture(scope="module", params=[IDEAL_TO_MEASURED, MEASURED_TO_IDEAL])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return four images of one camera, 25 points; start values and focal length off by their prior sigmas."""
    folder, rng = tmp_path_factory.mktemp("frames"), np.random.default_rng(5)
    up = enu_from_ecef(LON, LAT)[0]
    origin = geodetic_to_ecef(LON, LAT, 0.0)[0]
    true = interior(request.param)
    start = interior(request.param, 4000.0 + FOCAL_ERROR_PX)
    write_camera(folder / "camera.toml", start)
    sigma, truth = ERROR | {"focal": FOCAL_ERROR_PX}, {}
    for k in range(4):
        place = origin + np.array([300.0 * (k % 2), 250.0 * (k // 2), HEIGHT]) @ up
        turn = rotation_of_opk(*rng.normal(0.0, 0.03, 2), 0.1 * k) @ up
        truth[f"IMG_{k}"] = FrameSensor(true.camera(turn, place), 3000, 4000)
        off = rng.normal(size=6) * list(ERROR.values())
        camera = start.camera(
            Rotation.from_rotvec(off[:3]).as_matrix() @ turn, place + off[3:], sigma, {"focal": "wide"}
        )
        write_frame_file(folder / f"IMG_{k}.toml", FrameSensor(camera, 3000, 4000), "camera.toml")
    enu = np.column_stack([rng.uniform(-100.0, 400.0, (25, 2)), rng.uniform(0.0, 120.0, 25)])
    _write_tables(folder, truth, origin + enu @ up, rng)
    options = Options(backend="dense")
    write_project(
        folder / "project.toml", name="frames", images=[(i, f"{i}.toml") for i in truth], options=options
    )  # fmt: skip
    return Written(folder / "project.toml", truth)


def _write_tables(folder: Path, truth: dict[str, FrameSensor], ground: np.ndarray, rng: np.random.Generator) -> None:
    """Write nine control points with small sigmas, ten check points and six tie points."""
    roles = [fg.Role.CONTROL] * 9 + [fg.Role.CHECK] * 10 + [fg.Role.TIE] * 6
    coordinates = np.stack(ecef_to_geodetic(ground), axis=1)
    sigma = np.full((25, 3), 0.02)
    coordinates[19:], sigma[19:] = np.nan, np.nan
    ids = [f"P{j}" for j in range(25)]
    write_points(folder / "points.csv", ids, roles, coordinates, sigma)
    rows = []
    for name, sensor in truth.items():
        pixel = np.stack(sensor.project(ground), axis=1)
        seen = np.flatnonzero(sensor.is_inside(*pixel.T))
        rows += [(name, ids[j], pixel[j] + rng.normal(0.0, NOISE_PX, 2)) for j in seen]
    pixels = np.array([row[2] for row in rows])
    write_observations(folder / "observations.csv", [row[0] for row in rows], [row[1] for row in rows], pixels,
                       np.full_like(pixels, NOISE_PX))  # fmt: skip


@pytest.mark.consistency
def test_a_file_survives_writing(written: Written) -> None:
    block = fg.read_project(written.project)
    for image in block.images:
        again = read_frame_file(written.project.parent / f"{image.id}.toml").camera
        assert np.array_equal(again.rotation, image.sensor.camera.rotation)
        assert np.array_equal(again.centre_m, image.sensor.camera.centre_m)
        assert again.shared == {"focal": "wide"}
        assert again.sigma["centre_y"] == 0.5


@pytest.mark.oracle
def test_the_adjustment_finds_the_cameras(written: Written, tmp_path: Path) -> None:
    """``adjust`` finds the focal length within four sigmas, and ``locate --result`` is three times more accurate."""
    out = tmp_path / "result"
    ended = in_process("adjust", written.project, "--out", out, "--backend", "graph", "--json")
    assert ended.code == 0, ended.stderr
    record = ended.json
    assert record["sigma0_interval_99_9"][0] < record["sigma0"] < record["sigma0_interval_99_9"][1]
    with (out / "eop.csv").open() as stream:
        focal = [row for row in csv.DictReader(stream) if row["parameter"] == "focal"]
    assert len({row["value_per_tau"] for row in focal}) == 1
    assert {(row["component"], row["degree"], row["shared"]) for row in focal} == {("focal", "", "wide")}
    _recomputed(record, out)
    assert abs(float(focal[0]["value_per_tau"]) + FOCAL_ERROR_PX) < 4.0 * float(focal[0]["sigma"])
    assert "rotation x" in (out / "report.html").read_text()
    name, sensor = next(iter(written.truth.items()))
    image = written.project.parent / f"{name}.toml"
    pixel = ("--line", 700, "--sample", 2900, "--height", 50)
    here, there = (in_process("locate", image, *pixel, *more, "--json").json["points"][0]
                   for more in ((), ("--result", out)))  # fmt: skip
    truth = sensor.locate(700.0, 2900.0, height_m=50.0)[0]
    away = [np.linalg.norm(truth - [p["x_m"], p["y_m"], p["z_m"]]) for p in (here, there)]
    assert 3.0 * away[1] < away[0]
    words = [f"--{key}={there[column]!r}" for key, column in (("lon", "lon_deg"), ("lat", "lat_deg"),
                                                              ("height", "height_m"))]  # fmt: skip
    back = in_process("project", image, *words, "--result", out, "--json").json["points"][0]
    assert (back["line"], back["sample"]) == pytest.approx((700.0, 2900.0), abs=1e-5)


def _recomputed(record: dict, out: Path) -> None:
    """Assert that the tables give the chi-square when a shared prior counts once."""

    def rows(name: str) -> list[dict[str, str]]:
        with (out / name).open() as stream:
            return list(csv.DictReader(stream))

    pairs = [(r[f"v_{a}_px"], r[f"sigma_{a}_px"]) for r in rows("residuals.csv") for a in ("line", "sample")]
    pairs += [(r[f"difference_{a}_m"], r[f"own_sigma_{a}_m"]) for r in rows("points.csv") if r["role"] == "control"
              for a in ("east", "north", "up")]  # fmt: skip
    once = {
        (r["shared"] or r["image"], r["parameter"]): (r["value_per_tau"], r["prior_sigma"]) for r in rows("eop.csv")
    }
    pairs += once.values()
    assert sum((float(v) / float(s)) ** 2 for v, s in pairs) == pytest.approx(record["chi2"], rel=1e-9)


@pytest.mark.oracle
def test_errors_are_those_of_the_covariance(written: Written) -> None:
    """The true errors of each image's pose and focal length lie in the 99.8 % interval of their covariance."""
    solution = fg.adjust(fg.read_project(written.project, backend="graph"))
    for image in solution.block.images:
        start, true = image.sensor.camera, written.truth[image.id].camera
        turn = Rotation.from_matrix(true.rotation @ start.rotation.T).as_rotvec()
        wanted = np.array([*turn, *(true.centre_m - start.centre_m), -FOCAL_ERROR_PX])
        found = solution.correction(image.id)[:7]
        covariance = solution.covariance(f"image:{image.id}").values / solution.scale**2
        error = found - wanted
        assert 0.7 < error @ np.linalg.solve(covariance, error) < 24.3  # 99.8 % of chi-square of 7


@pytest.mark.oracle
def test_backends_end_where_numpy_has_no_step_left(written: Written) -> None:
    found = [fg.adjust(fg.read_project(written.project, backend=name)) for name in ("graph", "schur", "dense")]
    assert max(max(step_of_numpy(one.problem, one.state)) for one in found) < 1e-7
    for other in found[1:]:
        assert np.abs(other.state.image - found[0].state.image).max() < 1e-7
        assert other.chi2 == pytest.approx(found[0].chi2, rel=1e-9)


TEXT = """schema = 1
kind = "frame"
camera = "camera.toml"
crs = "EPSG:4979"
centre = [31.8, 41.4, 1500.0]
omega_phi_kappa_deg = [2.0, -1.0, 30.0]

[sigma]
centre_x = 0.1
"""


def frame_file(folder: Path, text: str = TEXT) -> Path:
    write_camera(folder / "camera.toml", interior(IDEAL_TO_MEASURED))
    (folder / "image.toml").write_text(text)
    return folder / "image.toml"


@pytest.mark.oracle
def test_angles_turn_east_north_up(tmp_path: Path) -> None:
    """The angles of a frame file rotate East, North, Up at the projection centre as scipy's rotations do."""
    sensor = read_sensor(frame_file(tmp_path))
    assert isinstance(sensor, FrameSensor)
    local = np.array([120.0, -80.0, -1400.0])
    ground = geodetic_to_ecef(31.8, 41.4, 1500.0)[0] + local @ enu_from_ecef(31.8, 41.4)[0]
    photogrammetric = Rotation.from_euler("XYZ", [2.0, -1.0, 30.0], degrees=True).inv().apply(local)
    x, y, z = photogrammetric * [1.0, -1.0, -1.0]
    k1, k2, _, p1, p2 = DISTORTION
    u, v = x / z, y / z
    r = u * u + v * v
    radial = 1.0 + k1 * r + k2 * r * r
    expected = (1510.0 + 4000.0 * (v * radial + p1 * (r + 2 * v * v) + 2 * p2 * u * v),
                1990.0 + 4000.0 * (u * radial + 2 * p1 * u * v + p2 * (r + 2 * u * u)))  # fmt: skip
    assert np.array(sensor.project(ground)).ravel() == pytest.approx(expected, abs=1e-6)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "place"),
    [
        (('kind = "frame"', 'kind = "fisheye"'), "kind"),
        (("omega_phi_kappa_deg = [2.0, -1.0, 30.0]\n", ""), "omega_phi_kappa_deg, rotation"),
        (('"camera.toml"', '"nowhere.toml"'), ""),
        (("centre_x = 0.1", "centre_x = -0.1"), "sigma"),
        (("centre_x = 0.1", "height = 0.1"), "height"),
        (('"EPSG:4979"', '"EPSG:1"'), ""),
        (("30.0]", "nan]"), "omega_phi_kappa_deg"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, change: tuple[str, str], place: str) -> None:
    path = frame_file(tmp_path, TEXT.replace(*change))
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    (found,) = caught.value.problems
    assert place in found.place
    assert found.file.endswith(".toml")
    assert found.remedy
