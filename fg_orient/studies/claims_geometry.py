"""Claims C1-C7: sensor geometry, step 1, check-point accuracy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.cameras import look
from factors.geometry import rotations
from fg_orient.sensors import initial
from fg_orient.sensors.kinds import require_pushbroom
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.zonguldak import zonguldak_block
from fg_orient.studies.claims import Claim, Outcome, outcome
from fg_orient.studies.study import EXACT, Study

Array = npt.NDArray[np.float64]

REFERENCE = EXACT[4]
#: Newton on two pixels; a step of 1 px for the difference quotients.
_NEWTON_STEPS = 12


def _convention_a(sensor: PushbroomSensor, line: Array, sample: Array) -> tuple[Array, Array]:
    """Rays with the orbital frame of convention A: X forward, Y left, Z outward (T 2.9, 2.19-2.21)."""
    states = sensor.states(line)
    roll, pitch, yaw = states.angles_rad.T * np.array([[1.0], [-1.0], [1.0]])
    z = states.position_m / np.linalg.norm(states.position_m, axis=1, keepdims=True)
    y = np.cross(z, states.velocity_m_s)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    frame = np.stack([np.cross(y, z), y, z], axis=2)
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    body = np.array([
        [cp * cy, -cp * sy, sp],
        [cr * sy + sr * sp * cy, cr * cy - sr * sp * sy, -sr * cp],
        [sr * sy - cr * sp * cy, cr * sp * sy + sr * cy, cr * cp],
    ]).transpose(2, 0, 1)  # fmt: skip
    psi_x, psi_y = sensor.look_angles(sample)
    u1 = np.stack([np.tan(psi_x), np.tan(psi_y), -np.ones_like(psi_x)], axis=1)
    u = np.einsum("nij,njk,nk->ni", frame, body, u1)
    return states.position_m, u / np.linalg.norm(u, axis=1, keepdims=True)


def _convention_b(sensor: PushbroomSensor, line: Array, sample: Array) -> tuple[Array, Array]:
    """Rays with the orbital frame of convention B: X right, Y forward, Z outward (T 2.23, 2.25-2.27)."""
    states = sensor.states(line)
    frame = rotations.orbital_frames(states.position_m, states.velocity_m_s)
    body = rotations.attitude_matrices(states.angles_rad, False)
    u = np.einsum("nij,njk,nk->ni", frame, body, look.direction(*sensor.look_angles(sample)))
    return states.position_m, u / np.linalg.norm(u, axis=1, keepdims=True)


def _round_trip_px(sensor: PushbroomSensor, rays: object) -> float:
    """Largest error of image -> ground (height 500 m) -> image over a grid, both with the rays given."""
    from factors.geometry import ellipsoid

    assert callable(rays)
    line, sample = (
        a.ravel() for a in np.meshgrid(np.linspace(200.0, sensor.n_lines - 201.0, 5),
                                       np.linspace(200.0, sensor.n_samples - 201.0, 5))
    )  # fmt: skip
    centre, direction = rays(sensor, line, sample)
    ground = ellipsoid.intersect(centre, direction, np.full(len(line), 500.0))

    def miss(pixel: Array) -> Array:
        p, u = rays(sensor, pixel[0], pixel[1])
        w = ground - p
        east, north = np.cross(u, p), np.cross(u, np.cross(u, p))  # two axes across the ray
        return np.stack([np.einsum("ni,ni->n", w, e) / np.linalg.norm(e, axis=1) for e in (east, north)])

    pixel = np.stack([line + 150.0, sample - 120.0])
    for _ in range(_NEWTON_STEPS):
        f = miss(pixel)
        columns = [(miss(pixel + h) - miss(pixel - h)) / 2.0 for h in (np.array([[1.0], [0]]), np.array([[0], [1.0]]))]
        (a, c), (b, d) = columns
        determinant = a * d - b * c
        pixel = pixel - np.stack([d * f[0] - b * f[1], a * f[1] - c * f[0]]) / determinant
    return float(np.abs(pixel - np.stack([line, sample])).max())


def c1(study: Study) -> Outcome:
    """Round trip of the pushbroom model in both orbital conventions."""
    images = study.two_stage.block.images
    sensors = [require_pushbroom(i.sensor, i.id) for i in images]
    a = max(_round_trip_px(sensor, _convention_a) for sensor in sensors)
    b = max(_round_trip_px(sensor, _convention_b) for sensor in sensors)
    ours = 0.0
    for image in images:
        line, sample = np.array([0.0, 6000.0, 11999.0]), np.array([11999.0, 6000.0, 0.0])
        back = image.sensor.project(image.sensor.locate(line, sample, height_m=500.0))
        ours = max(ours, float(np.abs(np.stack(back) - np.stack([line, sample])).max()))
    return outcome({"A": a < 1e-6, "B": b < 1e-6, "sensor": ours < 1e-6}, a_px=a, b_px=b, sensor_px=ours)


def c2(study: Study) -> Outcome:
    """Stereo intersection of error-free observations."""
    options = study.options(image_noise_px=0.0, errors="none", distortion_rad=0.0)
    block, truth = zonguldak_block(options)
    o = block.observations
    left, right = (np.flatnonzero(o.image == k)[np.argsort(o.point[o.image == k])] for k in (0, 1))
    pixels = np.stack([o.line[[left, right]], o.sample[[left, right]]])
    found = initial.intersect([i.sensor for i in block.images], pixels[0], pixels[1])
    error = float(np.abs(found - truth.ecef_m[o.point[left]]).max())
    return outcome({"intersection": error < 1e-6}, error_m=error)


def c3(study: Study) -> Outcome:
    """Third look component +1: an error of 1.9e6 m along the vertical; with -1 the level of the bias."""
    wrong, right = study.two_stage.uncorrected(+1.0), study.two_stage.uncorrected(-1.0)
    mean = wrong.gcp_m.mean(axis=0)
    known = study.two_stage.block.points.known.ecef_m
    vertical = np.nanmean(known, axis=0)
    cosine = abs(mean @ vertical) / np.linalg.norm(mean) / np.linalg.norm(vertical)
    angle = float(np.degrees(np.arccos(min(1.0, cosine))))
    size, correct = float(np.linalg.norm(wrong.gcp_rmse)), right.gcp_max
    checks = {"size": 1.8e6 < size < 2.0e6, "along the vertical": angle < 2.0, "correct sign": correct < 100.0}
    return outcome(checks, wrong_m=size, angle_deg=angle, correct_m=correct)


def c4(study: Study) -> Outcome:
    """Step 1 closes every condition of the control points and shows only what was put in."""
    step, errors = study.two_stage.look, study.two_stage.look_only()
    clean = study.procedure(image_noise_px=0.0, errors="none", distortion_rad=0.0, ground_noise_m=(0.0, 0.0, 0.0))
    gcp = float(np.abs(errors.gcp_m).max())
    checks = {
        "F = 0": step.largest_misclosure <= 1e-15, "five cycles": step.cycles <= 5, "intersection": gcp < 1e-6,
        "m0 vanishes with the errors": clean.look.m0_rad < 1e-2 * step.m0_rad,
    }  # fmt: skip
    return outcome(checks, misclosure=step.largest_misclosure, cycles=step.cycles, gcp_m=gcp, m0_rad=step.m0_rad,
                   m0_clean_rad=clean.look.m0_rad)  # fmt: skip


def c5(study: Study) -> Outcome:
    """Check-point RMSE per axis 3-11 m at 1 px of noise."""
    rmse = study.bundle(1, 1, REFERENCE).accuracy.icp_rmse
    return outcome({"3-11 m": bool((rmse >= 3.0).all() and (rmse <= 11.0).all())},
                   x_m=rmse[0], y_m=rmse[1], z_m=rmse[2])  # fmt: skip


def c6(study: Study) -> Outcome:
    """Half the image noise halves the check-point RMSE."""
    full = study.bundle(1, 1, REFERENCE).accuracy.icp_rmse
    half = study.variant(noise_px=0.5).bundle(1, 1, REFERENCE).accuracy.icp_rmse
    ratio = float(np.linalg.norm(half) / np.linalg.norm(full))
    return outcome({"0.4-0.6": 0.4 <= ratio <= 0.6}, ratio=ratio)


def c7(study: Study) -> Outcome:
    """Control in half of the columns costs; control in half of the lines does not."""
    h20, ga, gb = (study.variant(point_set=s).bundle(None, 1, REFERENCE).accuracy.icp_max
                   for s in ("H-20", "G-A", "G-B"))  # fmt: skip
    checks = {"half of the columns >= 1.5": ga >= 1.5 * h20, "half of the lines within 2": 0.5 <= gb / h20 <= 2.0}
    return outcome(checks, h20_m=h20, ga_m=ga, gb_m=gb, ga_ratio=ga / h20, gb_ratio=gb / h20)


CLAIMS = (
    Claim("C1", "forward and inverse pushbroom round trip below 1e-6 px in both orbital conventions", c1),
    Claim("C2", "noise-free stereo intersection below 1e-6 m", c2),
    Claim("C3", "third look component +1 gives about 1.9e6 m along the vertical, -1 tens of metres", c3),
    Claim("C4", "step 1 makes F = 0 at control points in at most 5 cycles; their intersection errs below 1e-6 m", c4),
    Claim("C5", "check-point RMSE per axis 3-11 m on H-10 with 1 px of image noise", c5),
    Claim("C6", "check-point RMSE is proportional to the image noise", c6),
    Claim("C7", "control in half of the columns: RMSE >= 1.5 x that of H-20; half of the lines: close to it", c7),
)
