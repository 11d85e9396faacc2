"""Mixed block over one window of 5 km: rigorous SPOT-5 images, RPC images of 0.7 m, frame images of 0.2 m.

The block contains two SPOT-5 HRG images from both sides, two images of one pass of a Pléiades-like satellite,
and four frame images of a large-format camera from 4 km above the ground. The Pléiades-like images look
forward and backward; their RPC are fitted to the rigorous model. The same tie points and a few control points
are measured in all images. The errors of all orientations are drawn from the prior sigmas of the adjustment;
truth is exact in the model of each sensor (:mod:`fg_orient.simulate.simulation`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from factors.cameras import frame_camera
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Image, Options
from fg_orient.rpc.virtual_grid import fit_sensor
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.frame import HALF_TURN, FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import UNKNOWNS
from fg_orient.sensors.interior import Interior
from fg_orient.sensors.metadata import AngleAttitude, Ephemeris, LineTiming, LookAngleTable, PushbroomMetadata
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.files import Scenario
from fg_orient.simulate.options import MixedOptions as MixedOptions
from fg_orient.simulate.scene import Scene, as_read, find_pass
from fg_orient.simulate.simulation import (
    Simulation,
    Truth,
    draw_errors,
    ground_points,
    numbered,
    random_streams,
    roles_in_order,
    with_noise,
)
from fg_orient.simulate.zonguldak import CENTRE_LON_LAT_DEG, IMAGES, at_centre

#: Side of the window and range of heights, m.
WINDOW_M: Final = 5000.0
HEIGHT_RANGE_M: Final = (0.0, 500.0)
#: RPC images: pitch angles (degrees), height of the orbit (m), pixels along a side, ground pixel at nadir (m).
PITCH_DEG: Final = (-12.0, 14.0)
RPC_ORBIT_M: Final = 694e3
RPC_SIDE_PX: Final = 14000
RPC_PIXEL_M: Final = 0.7
#: Speed of the nadir point, m/s, for approximately square pixels.
GROUND_SPEED_M_S: Final = 6.77e3
#: Heights for the fit of the RPC, m; the range includes the heights of the points.
RPC_HEIGHTS_M: Final = (-200.0, 1000.0)
RPC_SHIFT_SIGMA_PX: Final = 15.0
RPC_LINEAR_SIGMA_PX: Final = 2.0
#: Frames: East and North of their projection centres relative to the window's centre, their height, m; tilts (rad).
FRAMES: Final = ((-650.0, 650.0), (650.0, 650.0), (-650.0, -650.0), (650.0, -650.0))
FRAME_HEIGHT_M: Final = 4250.0
FRAME_SIDE_PX: Final = 16000
FOCAL_PX: Final = 20000.0
TILTS_RAD: Final = ((0.01, -0.02), (-0.015, 0.01), (0.02, 0.015), (-0.01, -0.01))
#: Unknowns of a frame and their prior sigmas; the interior orientation is common to all frames.
FRAME_SIGMA: Final = {
    "rotation_x": 1e-4, "rotation_y": 1e-4, "rotation_z": 1e-4, "centre_x": 0.2, "centre_y": 0.2, "centre_z": 0.2,
    "focal": 2.0, "principal_sample": 1.0, "principal_line": 1.0,
}  # fmt: skip
CAMERA: Final = "camera"
#: Points closer to the image border than this, px, are not measured, because noise could move them out of the image.
MARGIN_PX: Final = 50.0
#: Options of the adjustment for the unknowns of RPC images.
OPTIONS: Final = Options(
    rpc_compensation="shift_drift", rpc_shift_sigma_px=RPC_SHIFT_SIGMA_PX, rpc_linear_sigma_px=RPC_LINEAR_SIGMA_PX
)


def simulate(options: MixedOptions) -> Simulation:
    """Draw the mixed block of these options."""
    streams, n = random_streams(options.seed), options.points
    roles = roles_in_order(streams["roles"].permutation(n), options.control, options.check)
    place = _lon_lat_height(n, streams["points"])
    ground = ground_points(numbered(n), roles, place, options.ground_noise_m, streams["ground_noise"])
    size = 1.0 if options.errors == "prior" else 0.0
    metadata, of_spot = _spot(size, streams["orientation"])
    of_rpc = _compensations(size, streams["orientation"])
    interior, frames, of_frame = _frames(size, streams["orientation"])
    spot = tuple(Image(m.file.removesuffix(".DIM"), as_read(m)) for m in metadata)
    others = (
        *(Image(f"pleiades{k + 1}", RpcSensor(model)) for k, model in enumerate(rpc_models())),
        *(Image(f"frame{k + 1}", sensor) for k, sensor in enumerate(frames)),
    )
    corrections = (*of_spot, *of_rpc, *of_frame)
    image, point, pixels = _measured((*spot, *others), corrections, ground.ecef_m)
    noise = (options.spot_noise_px,) * 2 + (options.rpc_noise_px,) * 2 + (options.frame_noise_px,) * 4
    observed, sigma = with_noise(pixels, np.array(noise)[image][:, None], streams["image_noise"])
    truth = Truth.of(ground, [i.id for i in (*spot, *others)], corrections, pixels)
    return Simulation("mixed block", metadata, ground, image, point, observed, sigma, truth, others, interior, OPTIONS)


def _measured(images: tuple[Image, ...], corrections: tuple[Any, ...], ecef_m: Array) -> tuple[Index, Index, Array]:
    """Return the image, ground point and true pixels (k, 2) of all points inside each image."""
    parts = []
    for k, (image, correction) in enumerate(zip(images, corrections, strict=True)):
        line, sample = image.sensor.project(ecef_m, correction)
        inside = np.flatnonzero(
            image.sensor.is_inside(line - MARGIN_PX, sample - MARGIN_PX)
            & image.sensor.is_inside(line + MARGIN_PX, sample + MARGIN_PX)
        )
        parts.append((np.full(len(inside), k), inside, np.stack([line, sample], axis=1)[inside]))
    image_, point, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
    return image_.astype(np.intp), point.astype(np.intp), pixels


def _lon_lat_height(n: int, rng: np.random.Generator) -> Array:
    """Draw points uniformly in the window: longitude, latitude (degrees), height (m)."""
    unit = rng.random((n, 3))
    low, high = HEIGHT_RANGE_M
    place = at_centre(np.column_stack([(unit[:, :2] - 0.5) * WINDOW_M, np.zeros(n)]))
    lon, lat, _ = ecef_to_geodetic(place)
    return np.column_stack([lon, lat, low + (high - low) * unit[:, 2]])


def _spot(size: float, rng: np.random.Generator) -> tuple[tuple[PushbroomMetadata, ...], tuple[Correction, ...]]:
    """Return the metadata with errors of position and attitude (unknowns of the EOP set), and their corrections."""
    errors = size * draw_errors("prior", rng, len(IMAGES))
    errors[:, 3:6] = 0.0
    metadata = []
    for k, (_, mirror_deg, day, half_minutes) in enumerate(IMAGES):
        mirror = math.radians(mirror_deg)
        orbit = find_pass(geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 0.0)[0], mirror)
        scene = Scene(f"spot{k + 1}", orbit, mirror, np.datetime64(day), half_minutes, full_look_table=False)
        metadata.append(scene.metadata(errors[k]))
    return tuple(metadata), tuple(Correction(error) for error in errors)


def _compensations(size: float, rng: np.random.Generator) -> tuple[Array, ...]:
    """Return the shift and drift (6,) px of both RPC images."""
    sigma = np.array([RPC_SHIFT_SIGMA_PX] * 2 + [RPC_LINEAR_SIGMA_PX] * 2 + [0.0] * 2)
    return tuple(size * sigma * rng.standard_normal((len(PITCH_DEG), 6)))


@cache
def rpc_models() -> tuple[RpcModel, ...]:
    """Return RPC of both images, fitted to their rigorous models, as read from a file without inverse coefficients."""
    models = []
    for k, pitch in enumerate(PITCH_DEG):
        sensor = _metre_sensor(math.radians(pitch), 40_000.0 + 30.0 * k)
        model = fit_sensor(sensor, RPC_HEIGHTS_M, shape=(12, 12, 5)).model()
        models.append(
            replace(
                model,
                direct=None,
                notes=(),
                stated_validity=None,
                n_lines=None,
                n_samples=None,
                file=f"pleiades{k + 1}_RPC.TXT",
            )
        )
    return tuple(models)


def _metre_sensor(pitch_rad: float, centre_s: float) -> PushbroomSensor:
    """Return the rigorous model of an image: no errors, constant attitude."""
    attitude = (0.0, pitch_rad, 0.0)
    orbit = find_pass(geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 0.0)[0], 0.0, attitude_rad=attitude, height_m=RPC_ORBIT_M)
    time_s = centre_s + 10.0 * np.arange(-4.0, 5.0)
    sample, middle = np.array([0.0, RPC_SIDE_PX - 1.0]), (RPC_SIDE_PX - 1.0) / 2.0
    period_s = RPC_PIXEL_M / GROUND_SPEED_M_S
    across = np.arctan((sample - middle) * RPC_PIXEL_M / RPC_ORBIT_M)
    return as_read(
        PushbroomMetadata(
            file="",
            mission="simulated",
            instrument="",
            format="simulated",
            epoch=np.datetime64("2012-06-01"),
            n_lines=RPC_SIDE_PX,
            n_samples=RPC_SIDE_PX,
            timing=LineTiming(middle, centre_s, period_s),
            ephemeris=Ephemeris(time_s, *orbit.states(time_s - centre_s)),
            attitude=AngleAttitude(time_s, np.tile(attitude, (len(time_s), 1))),
            look=LookAngleTable(sample, np.zeros(2), across),
        )
    )


def _frames(size: float, rng: np.random.Generator) -> tuple[Interior, list[FrameSensor], list[Array]]:
    """Return the camera and its images with errors, and their corrections (15,)."""
    sigma = np.array(list(FRAME_SIGMA.values()))
    common = size * sigma[6:] * rng.standard_normal(3)
    true = Interior(
        FRAME_SIDE_PX, FRAME_SIDE_PX, FOCAL_PX, np.full(2, (FRAME_SIDE_PX - 1) / 2.0),
        np.array([-1e-3, 0.0, 0.0, 0.0, 0.0]), name="large format",
    )  # fmt: skip
    given = replace(true, focal_px=float(FOCAL_PX - common[0]), principal_px=true.principal_px - common[[2, 1]])
    shared = dict.fromkeys(list(FRAME_SIGMA)[6:], CAMERA)
    sensors, corrections = [], []
    for k, (rotation, centre) in enumerate(true_orientations()):
        error = size * sigma[:6] * rng.standard_normal(6)
        start = frame_camera.rotated(rotation, -error[:3])
        camera: FrameCamera = given.camera(start, centre - error[3:], FRAME_SIGMA, shared)
        sensors.append(FrameSensor(camera, FRAME_SIDE_PX, FRAME_SIDE_PX, file=f"frame{k + 1}.toml"))
        corrections.append(np.concatenate([error, common, np.zeros(len(UNKNOWNS) - 9)]))
    return given, sensors, corrections


def true_orientations() -> list[tuple[Array, Array]]:
    """Return the true rotation and projection centre of each frame."""
    enu, out = enu_from_ecef(*CENTRE_LON_LAT_DEG)[0], []
    for (east, north), tilt in zip(FRAMES, TILTS_RAD, strict=True):
        rotation = frame_camera.rotated(HALF_TURN, np.array([*tilt, 0.0]))
        out.append((rotation @ enu, at_centre(np.array([[east, north, FRAME_HEIGHT_M]]))[0]))
    return out


_MIXED: Final = Scenario("simulate mixed", MixedOptions(), lambda options, _: simulate(options))
simulate_mixed, mixed_block = _MIXED.write, _MIXED.block
