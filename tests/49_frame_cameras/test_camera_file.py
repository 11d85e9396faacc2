"""The tests cover camera files and direct georeferencing, and compare both distortion equations with numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from fg_orient.formats.exchange.bal import read_bal
from fg_orient.formats.metadata.frame import read_camera, write_camera
from fg_orient.model.errors import InputError
from fg_orient.sensors import initial
from fg_orient.sensors.frame import (
    HALF_TURN,
    IDEAL_TO_MEASURED,
    MEASURED_TO_IDEAL,
    FrameCamera,
    FrameSensor,
    opk_of_rotation,
    rotation_of_opk,
)
from fg_orient.sensors.interior import Interior, converted, direct_orientation
from tests.support import dbat
from tests.support.command import in_process

TEXT = """schema = 1
name = "Olympus C4040Z"
model = "brown_measured_to_ideal"
lines = 1704
samples = 2272
pixel_mm = 0.0032
focal = 7.457
principal = [3.615, 2.613]
first_pixel = 0.5
k1 = 4.59e-3
k2 = -4.5e-5
k3 = -2e-6
p1 = -6.1e-5
p2 = -4.4e-5
aspect = 3.9e-4
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "camera.toml"
    path.write_text(text)
    return path


def corrected_mm(u: float, v: float) -> tuple[float, float]:
    """Return the correction as photogrammetric programs print it: mm, y up."""
    x, y = (0.0032 * u - 3.615) * (1.0 + 3.9e-4), -(0.0032 * v - 2.613)
    r = x * x + y * y
    radial = 4.59e-3 * r - 4.5e-5 * r**2 - 2e-6 * r**3
    p1, p2 = -6.1e-5, -4.4e-5
    return (
        x + x * radial + p1 * (r + 2.0 * x * x) + 2.0 * p2 * x * y,
        y + y * radial + p2 * (r + 2.0 * y * y) + 2.0 * p1 * x * y,
    )


@pytest.mark.oracle
def test_a_file_gives_the_printed_equation_and_survives_writing(tmp_path: Path) -> None:
    interior = read_camera(write(tmp_path, TEXT))
    line, sample = np.array([10.0, 900.0, 1650.0]), np.array([30.0, 2000.0, 1100.0])
    for found, v, u in zip(interior.ideal(line, sample), line + 0.5, sample + 0.5, strict=True):
        x, y = corrected_mm(u, v)
        assert np.allclose(found, [x / 7.457, -y / 7.457], rtol=0.0, atol=1e-14)
    write_camera(tmp_path / "again.toml", interior)
    again = read_camera(tmp_path / "again.toml")
    assert np.abs(again.ideal(line, sample) - interior.ideal(line, sample)).max() < 1e-13
    assert (again.name, again.model, again.n_samples) == (interior.name, interior.model, 2272)


@pytest.mark.oracle
def test_a_file_from_ideal_to_measured_is_that_of_opencv(tmp_path: Path) -> None:
    text = TEXT.replace("measured_to_ideal", "ideal_to_measured").replace("pixel_mm = 0.0032\n", "")
    text = text.replace("aspect = 3.9e-4\n", "").replace("7.457", "2330.0").replace("[3.615, 2.613]", "[1130.0, 816.0]")
    interior = read_camera(write(tmp_path, text))
    x, y = 0.3, -0.2
    r = x * x + y * y
    radial = 1.0 + 4.59e-3 * r - 4.5e-5 * r**2 - 2e-6 * r**3
    u = x * radial + 2.0 * -6.1e-5 * x * y - 4.4e-5 * (r + 2.0 * x * x)
    v = y * radial - 6.1e-5 * (r + 2.0 * y * y) + 2.0 * -4.4e-5 * x * y
    found = interior.ideal(np.array([816.0 - 0.5 + 2330.0 * v]), np.array([1130.0 - 0.5 + 2330.0 * u]))
    assert np.abs(found[0] - [x, y]).max() < 1e-12


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda t: t.replace('model = "brown_measured_to_ideal"\n', ""), "model"),
        (lambda t: t.replace("measured_to_ideal", "to_nowhere"), "model"),
        (lambda t: t.replace("focal = 7.457", "focal = 0.0"), "focal"),
        (lambda t: t.replace("k1 = 4.59e-3", "k1 = nan"), "k1"),
    ],
)
def test_files_that_do_not_say_it_are_refused(tmp_path: Path, change: object, place: str) -> None:
    with pytest.raises(InputError) as caught:
        read_camera(write(tmp_path, change(TEXT)))  # type: ignore[operator]
    assert place in caught.value.problems[0].place


@pytest.mark.oracle
def test_conversion_tells_its_error() -> None:
    """The stated error of a camera conversion is not below that at any image corner, and of its magnitude.

    An independent root finder gives the errors at the corners.
    """
    strong = Interior(1000, 1500, 1000.0, np.array([500.0, 750.0]), np.array([-0.25, 0.1, 0.0, 1e-3, -2e-3]))
    weak = replace(strong, distortion=0.1 * strong.distortion)
    small, large = converted(weak, MEASURED_TO_IDEAL), converted(strong, MEASURED_TO_IDEAL)
    assert 0.0 < small.max_px < 0.1**2 * large.max_px * 1.5  # what no polynomial takes up is of the second order
    worst = 0.0
    for line, sample in ((0.0, 0.0), (0.0, 1499.0), (999.0, 0.0), (999.0, 1499.0)):

        def difference(xy: np.ndarray, line: float = line, sample: float = sample) -> list[float]:
            x, y = xy
            k1, k2, k3, p1, p2 = strong.distortion
            r = x * x + y * y
            radial = 1.0 + k1 * r + k2 * r**2 + k3 * r**3
            return [750.0 + 1000.0 * (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)) - sample,
                    500.0 + 1000.0 * (y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y) - line]  # fmt: skip

        truth = fsolve(difference, [(sample - 750.0) / 1000.0, (line - 500.0) / 1000.0], xtol=1e-13)
        found = large.interior.ideal(np.array([line]), np.array([sample]))[0]
        worst = max(worst, 1000.0 * float(np.linalg.norm(found - truth)))
    assert worst <= large.max_px + 1e-9
    assert worst > 0.1 * large.max_px
    with pytest.raises(InputError):
        converted(weak, "brown")
    assert converted(weak, weak.model).max_px == 0.0


@pytest.mark.consistency
def test_command_converts_and_says_what_is_left(tmp_path: Path) -> None:
    """``camera convert`` states largest and RMS error between both files, and overwrites no source file."""
    source, out = write(tmp_path, TEXT), tmp_path / "opencv.toml"
    words = ("camera", "convert", source, "--to", IDEAL_TO_MEASURED, "--out", out, "--json")
    ended = in_process(*words)
    assert ended.code == 0, ended.stderr
    line, sample = (g.ravel() for g in np.meshgrid(np.linspace(0, 1703, 41), np.linspace(0, 2271, 41)))
    there, here = (read_camera(path) for path in (out, source))
    apart = np.linalg.norm(there.ideal(line, sample) - here.ideal(line, sample), axis=1) * here.focal_px
    assert there.model == IDEAL_TO_MEASURED
    assert ended.json["max_px"] == pytest.approx(apart.max(), rel=1e-9)
    assert ended.json["rms_px"] == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-9)
    assert 0.01 < ended.json["max_px"] < 2.0  # its aspect of 3.9e-4 alone is 0.44 px at the border
    assert in_process(*words).code == 2
    over = in_process(*words[:5], "--out", source, "--overwrite")
    assert (over.code, read_camera(source).model) == (2, MEASURED_TO_IDEAL)
    assert in_process("camera", "convert", source, "--to", "brown", "--out", tmp_path / "x.toml").code == 2


@pytest.mark.consistency
@pytest.mark.parametrize("model", [IDEAL_TO_MEASURED, MEASURED_TO_IDEAL])
def test_round_trips_over_the_whole_image_and_depth(tmp_path: Path, model: str) -> None:
    """Pixels of both distortion models return within 1e-6 px over the image, from half a metre to a kilometre.

    This includes converted cameras.
    """
    interior = read_camera(write(tmp_path, TEXT))
    for one in (interior, converted(interior, IDEAL_TO_MEASURED).interior):
        camera = (one if model == one.model else converted(one, model).interior).camera(
            rotation_of_opk(0.3, -0.2, 1.1), np.array([5.0, -3.0, 20.0])
        )
        sensor = FrameSensor(camera, 1704, 2272, georeferenced=False)
        line, sample = (g.ravel() for g in np.meshgrid(np.linspace(-0.5, 1703.5, 41), np.linspace(-0.5, 2271.5, 41)))
        centre, direction = sensor.rays(line, sample)
        for depth_m in (0.5, 5.0, 50.0, 1000.0):
            back = sensor.project(centre + depth_m * direction)
            assert np.abs(np.array(back) - [line, sample]).max() <= 1e-6


@pytest.mark.consistency
@pytest.mark.real_data
def test_round_trips_of_real_frames_over_their_objects(real_data: Path) -> None:
    """Every measured pixel of Ladybug 49 and camcal returns within 1e-6 px at nearest and farthest depth."""
    ladybug = read_bal(real_data / "bal" / "problem-49-7776-pre.txt.gz", keep_behind=False)
    camcal = dbat.camcal(real_data / "dbat" / "script" / "camcaldemo")
    for block in (ladybug, camcal):
        o, worst = block.observations, 0.0
        ground = initial.ground_points(block.images, o, block.points.ids, block.points.known.ecef_m)
        for k, image in enumerate(block.images):
            rows = o.image == k
            centre, direction = image.sensor.rays(o.line[rows], o.sample[rows])
            depth = np.linalg.norm(ground[o.point[rows]] - centre, axis=1)
            for there in (depth.min(), depth.max()):
                back = np.array(image.sensor.project(centre + there * direction))
                worst = max(worst, float(np.abs(back - [o.line[rows], o.sample[rows]]).max()))
        assert worst <= 1e-6


@pytest.mark.oracle
def test_angles_and_their_derivatives() -> None:
    angles = np.array([0.3, -0.7, 2.5])
    rotation = rotation_of_opk(*angles)
    r1, r2, r3 = (Rotation.from_rotvec(-a * e).as_matrix() for a, e in zip(angles, np.eye(3), strict=True))
    assert np.allclose(rotation, HALF_TURN @ r3 @ r2 @ r1, atol=1e-15)
    found, derivatives = opk_of_rotation(rotation)
    assert np.abs(found - angles).max() < 1e-15
    step = 1e-6
    for k, axis in enumerate(np.eye(3)):
        more, less = (opk_of_rotation(Rotation.from_rotvec(s * axis).as_matrix() @ rotation)[0] for s in (step, -step))
        assert np.abs((more - less) / (2.0 * step) - derivatives[:, k]).max() < 1e-9


@pytest.mark.oracle
def test_direct_georeferencing() -> None:
    attitude, boresight = (Rotation.from_rotvec(v).as_matrix() for v in ([0.1, 0.2, -0.4], [1.0, -2.0, 0.5]))
    receiver, lever = np.array([10.0, 20.0, 500.0]), np.array([0.3, -0.1, 1.2])
    rotation, centre = direct_orientation(receiver, attitude, lever, boresight)
    body = np.array([4.0, -3.0, 100.0])  # a point in body axes about the receiver
    ground = receiver + attitude @ body
    assert np.allclose(rotation @ (ground - centre), boresight @ (body - lever), atol=1e-12)
    same = direct_orientation(receiver, np.eye(3), np.zeros(3), np.eye(3))
    assert np.array_equal(same[0], np.eye(3))
    assert np.array_equal(same[1], receiver)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("fault", "place"),
    [
        ({"model": "brown"}, "model"), ({"aspect": np.nan}, "aspect"), ({"unit_px": 0.0}, "unit_px"),
        ({"sigma": {"aspect": 0.0}}, "aspect"), ({"shared": {"focal": "a"}}, "shared focal"),
    ],
)  # fmt: skip
def test_cameras_that_cannot_be_are_refused(fault: dict, place: str) -> None:
    with pytest.raises(InputError) as caught:
        FrameCamera(np.eye(3), np.zeros(3), 1000.0, **fault)
    assert caught.value.problems[0].place == place
