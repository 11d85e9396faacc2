"""Claims C1-C7 on sensor geometry, step 1 and check points, and claims C17-C21 on the sensor-independent RFM.

The RFM claims use 99 control points of the left synthetic image, with heights 0-1000 m and 0.5 px of image noise, both
raw and normalised.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from factors.arrays import Array
from factors.cameras import look
from factors.geometry import ellipsoid, rotations
from fg_orient.adjustment.linear.system import diagnose
from fg_orient.rpc.estimate import fit_linear
from fg_orient.rpc.form import DEGREES, RfmForm
from fg_orient.rpc.points import ControlPoints
from fg_orient.sensors import initial
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.pushbroom import PushbroomSensor, require_pushbroom
from fg_orient.simulate.zonguldak import zonguldak_block
from fg_orient.studies.claims import EXACT, Outcome, Study, claim, or_inf, outcome
from fg_orient.studies.tables_spot6 import CRAMER, METHODS, Run

REFERENCE = EXACT[4]
_NEWTON_STEPS = 12


def _convention_a(sensor: PushbroomSensor, line: Array, sample: Array) -> tuple[Array, Array]:
    """Return the rays with the orbital frame of convention A: X forward, Y left, Z outward (T 2.9, 2.19-2.21)."""
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
    """Return the rays with the orbital frame of convention B: X right, Y forward, Z outward (T 2.23, 2.25-2.27)."""
    states = sensor.states(line)
    frame = rotations.orbital_frames(states.position_m, states.velocity_m_s)
    body = rotations.attitude_matrices(states.angles_rad, False)
    u = np.einsum("nij,njk,nk->ni", frame, body, look.direction(*sensor.look_angles(sample)))
    return states.position_m, u / np.linalg.norm(u, axis=1, keepdims=True)


def _round_trip_px(sensor: PushbroomSensor, rays: Callable[..., tuple[Array, Array]]) -> float:
    """Return largest error of image -> ground (height 500 m) -> image over a grid, by Newton steps with these rays."""
    line, sample = (
        a.ravel()
        for a in np.meshgrid(
            np.linspace(200.0, sensor.n_lines - 201.0, 5), np.linspace(200.0, sensor.n_samples - 201.0, 5)
        )
    )
    centre, direction = rays(sensor, line, sample)
    ground = ellipsoid.intersect(centre, direction, np.full(len(line), 500.0))

    def miss(pixel: Array) -> Array:
        p, u = rays(sensor, pixel[0], pixel[1])
        w = ground - p
        east, north = np.cross(u, p), np.cross(u, np.cross(u, p))  # two axes across the ray
        return np.stack([np.einsum("ni,ni->n", w, e) / np.linalg.norm(e, axis=1) for e in (east, north)])

    pixel = np.stack([line + 150.0, sample - 120.0])
    for _ in range(_NEWTON_STEPS):  # difference quotients over 2 px
        f = miss(pixel)
        columns = [(miss(pixel + h) - miss(pixel - h)) / 2.0 for h in (np.array([[1.0], [0]]), np.array([[0], [1.0]]))]
        (a, c), (b, d) = columns
        determinant = a * d - b * c
        pixel = pixel - np.stack([d * f[0] - b * f[1], a * f[1] - c * f[0]]) / determinant
    return float(np.abs(pixel - np.stack([line, sample])).max())


@claim("C1", "forward and inverse pushbroom round trip below 1e-6 px in both orbital conventions")
def _c1(study: Study) -> Outcome:
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


@claim("C2", "noise-free stereo intersection below 1e-6 m")
def _c2(study: Study) -> Outcome:
    options = study.options(image_noise_px=0.0, errors="none", distortion_rad=0.0)
    block, truth = zonguldak_block(options)
    o = block.observations
    left, right = (np.flatnonzero(o.image == k)[np.argsort(o.point[o.image == k])] for k in (0, 1))
    pixels = np.stack([o.line[[left, right]], o.sample[[left, right]]])
    ground = initial.intersect([i.sensor for i in block.images], pixels[0], pixels[1])
    error = float(np.abs(ground - truth.ecef_m[o.point[left]]).max())
    return outcome({"intersection": error < 1e-6}, error_m=error)


@claim("C3", "third look component +1 gives about 1.9e6 m along the vertical, -1 tens of metres")
def _c3(study: Study) -> Outcome:
    wrong, right = study.two_stage.uncorrected(+1.0), study.two_stage.uncorrected(-1.0)
    mean = wrong.gcp_m.mean(axis=0)
    known = study.two_stage.block.points.known.ecef_m
    vertical = np.nanmean(known, axis=0)
    cosine = abs(mean @ vertical) / np.linalg.norm(mean) / np.linalg.norm(vertical)
    angle = float(np.degrees(np.arccos(min(1.0, cosine))))
    size, correct = float(np.linalg.norm(wrong.gcp_rmse)), right.gcp_max
    checks = {"size": 1.8e6 < size < 2.0e6, "along the vertical": angle < 2.0, "correct sign": correct < 100.0}
    return outcome(checks, wrong_m=size, angle_deg=angle, correct_m=correct)


@claim("C4", "step 1 makes F = 0 at control points in at most 5 cycles; their intersection errs below 1e-6 m")
def _c4(study: Study) -> Outcome:
    step, errors = study.two_stage.look, study.two_stage.look_only()
    clean = study.procedure(image_noise_px=0.0, errors="none", distortion_rad=0.0, ground_noise_m=(0.0, 0.0, 0.0))
    gcp = float(np.abs(errors.gcp_m).max())
    checks = {
        "F = 0": step.largest_misclosure <= 1e-15,
        "five cycles": step.cycles <= 5,
        "intersection": gcp < 1e-6,
        "m0 vanishes with the errors": clean.look.m0_rad < 1e-2 * step.m0_rad,
    }
    return outcome(
        checks,
        misclosure=step.largest_misclosure,
        cycles=step.cycles,
        gcp_m=gcp,
        m0_rad=step.m0_rad,
        m0_clean_rad=clean.look.m0_rad,
    )


@claim("C5", "check-point RMSE per axis 3-11 m on H-10 with 1 px of image noise")
def _c5(study: Study) -> Outcome:
    rmse = study.bundle(1, 1, REFERENCE).accuracy.icp_rmse
    return outcome(
        {"3-11 m": bool((rmse >= 3.0).all() and (rmse <= 11.0).all())}, x_m=rmse[0], y_m=rmse[1], z_m=rmse[2]
    )


@claim("C6", "check-point RMSE is proportional to the image noise")
def _c6(study: Study) -> Outcome:
    full = study.bundle(1, 1, REFERENCE).accuracy.icp_rmse
    half = study.procedure(image_noise_px=0.5).bundle(1, 1, REFERENCE).accuracy.icp_rmse
    ratio = float(np.linalg.norm(half) / np.linalg.norm(full))
    return outcome({"0.4-0.6": 0.4 <= ratio <= 0.6}, ratio=ratio)


@claim("C7", "control in half of the columns: RMSE >= 1.5 x that of H-20; half of the lines: close to it")
def _c7(study: Study) -> Outcome:
    h20, ga, gb = (
        study.procedure(point_set=s).bundle(None, 1, REFERENCE).accuracy.icp_max for s in ("H-20", "G-A", "G-B")
    )
    checks = {"half of the columns >= 1.5": ga >= 1.5 * h20, "half of the lines within 2": 0.5 <= gb / h20 <= 2.0}
    return outcome(checks, h20_m=h20, ga_m=ga, gb_m=gb, ga_ratio=ga / h20, gb_ratio=gb / h20)


N_POINTS = 99
HEIGHTS_M = (0.0, 1000.0)
NOISE_PX = 0.5
#: Smallest distance of the points from the border of the image.
MARGIN_PX = 100.0


def rfm_points(
    sensor: Sensor, seed: int, *, count: int = N_POINTS, noise_px: float = NOISE_PX, stream: int = 0
) -> ControlPoints:
    """Draw control points of a sensor: uniform pixels and heights, with noise in line and sample.

    Parameters
    ----------
    sensor : Sensor
    seed : int
    count : int
    noise_px : float
    stream : int
        Another stream gives other points for the same seed, used as check points.
    """
    rng = np.random.default_rng([seed, stream])
    last = np.array([sensor.n_lines, sensor.n_samples]) - 1.0 - MARGIN_PX
    pixels, height = rng.uniform(MARGIN_PX, last, (count, 2)), rng.uniform(*HEIGHTS_M, count)
    geodetic = ellipsoid.geodetic_array(np.ascontiguousarray(sensor.locate(*pixels.T, height_m=height)))
    line, sample = (pixels + noise_px * rng.standard_normal((count, 2))).T
    return ControlPoints(line, sample, np.column_stack([np.degrees(geodetic[:, :2]), height]))


PSEUDO, PIVOT = "moore_penrose_inverse", "gauss_partial_pivot_elimination"
RULES = ("tikhonov_hkb", "tikhonov_lw", "tikhonov_od")
#: Ranks of the raw systems by degree, and the allowed difference for other points.
RANKS, RANK_SLACK = {1: 10, 2: 18, 3: 20}, 3
#: Range of condition numbers of the normalised N, by degree.
CONDITIONS = {1: (1e1, 1e3), 2: (1e9, 1e11), 3: (1e10, 1e13)}
N_CHECK = 400


@lru_cache(maxsize=8)
def _runs(study: Study) -> dict[tuple[int, bool], Run]:
    """Return the systems of one seed, by degree and normalisation."""
    points = rfm_points(study.two_stage.block.images[0].sensor, study.seed)
    return {(degree, normalised): Run(points, degree, normalised) for degree in DEGREES for normalised in (False, True)}


def _image_rms(run: Run, method: str) -> float:
    """Return the RMS of the true image residuals of both axes; inf if there is no solution."""
    share = run.system.redundancy / (2.0 * len(run.points))
    return or_inf(run.true_m0_px(run.solution(method).x) * share**0.5)


def _m0(run: Run, method: str) -> float:
    """Return the accuracy m0 of the linear form; inf if there is no solution."""
    return or_inf(run.m0_px(run.solution(method).x))


@claim("C17", "raw RFM: rank deficient in every degree, about 10/18/20 of 14/38/78")
def _c17(study: Study) -> Outcome:
    ranks = {d: diagnose(_runs(study)[d, False].system).rank for d in DEGREES}
    checks = {f"degree {d}": abs(rank - RANKS[d]) <= RANK_SLACK for d, rank in ranks.items()}
    return outcome(checks, **{f"rank_{d}": rank for d, rank in ranks.items()})


@claim(
    "C18",
    "raw RFM: Cramer m0 > 1e3 and > 1e10 px, pseudo-inverse 1-100 px, partial pivoting good in the linear form only",
)
def _c18(study: Study) -> Outcome:
    raw = {d: _runs(study)[d, False] for d in DEGREES}
    cramer = {d: _m0(raw[d], CRAMER) for d in (1, 2)}
    pseudo = {d: _m0(raw[d], PSEUDO) for d in DEGREES}
    pivot = {d: (_m0(raw[d], PIVOT), _image_rms(raw[d], PIVOT)) for d in (2, 3)}
    checks = {
        "Cramer, degree 1": cramer[1] > 1e3,
        "Cramer, degree 2": cramer[2] > 1e10,
        "pseudo-inverse 1-100 px": all(1.0 <= value <= 100.0 for value in pseudo.values()),
        "elimination, linear form": all(linear < 0.1 for linear, _ in pivot.values()),
        "elimination, image": all(image > 3.0 for _, image in pivot.values()),
    }
    figures = {f"cramer_{d}_px": v for d, v in cramer.items()} | {f"pseudo_{d}_px": v for d, v in pseudo.items()}
    return outcome(checks, **figures, **{f"pivot_image_{d}_px": image for d, (_, image) in pivot.items()})


@claim("C19", "normalised RFM: full rank, all solvers but Cramer agree to 3 digits, m0 falls with the degree")
def _c19(study: Study) -> Outcome:
    runs = {d: _runs(study)[d, True] for d in DEGREES}
    conditioning = {d: diagnose(run.system) for d, run in runs.items()}
    m0 = {d: _m0(runs[d], PIVOT) for d in DEGREES}
    others = [method for method in METHODS if method != CRAMER]
    spread = max(abs(_m0(runs[d], method) / m0[d] - 1.0) for d in DEGREES for method in others)
    cramer = min(_m0(runs[d], CRAMER) / m0[d] for d in (2, 3))
    checks = {
        "full rank": all(c.defect == 0 for c in conditioning.values()),
        "three digits": spread < 5e-3,
        "falls with the degree": m0[1] > m0[2] > m0[3],
        "Cramer fails": cramer > 10.0,
        "condition numbers": all(CONDITIONS[d][0] <= c.cond_norm <= CONDITIONS[d][1] for d, c in conditioning.items()),
    }
    figures = {f"m0_{d}_px": v for d, v in m0.items()} | {f"cond_{d}": c.cond_norm for d, c in conditioning.items()}
    return outcome(checks, spread=spread, cramer_ratio=cramer, **figures)


@claim("C20", "normalised RFM of degree 3: image residuals and check points exceed m0 of the linear form")
def _c20(study: Study) -> Outcome:
    run = _runs(study)[3, True]
    sensor = study.two_stage.block.images[0].sensor
    check = rfm_points(sensor, study.seed, count=N_CHECK, noise_px=0.0, stream=1)
    m0, image = _m0(run, PIVOT), _image_rms(run, PIVOT)
    fit = fit_linear(run.points, RfmForm(3), solver=PIVOT, allow_pole=True)
    at_check = float(np.sqrt(np.mean(fit.residuals_px(check) ** 2)))
    return outcome({"image": image > m0, "check points": at_check > m0}, m0_px=m0, image_px=image, check_px=at_check)


@claim("C21", "Tikhonov cures no raw RFM of degree 2 or 3; OD harms the normalised ones")
def _c21(study: Study) -> Outcome:
    runs = _runs(study)
    raw = min(_image_rms(runs[d, False], rule) for d in (2, 3) for rule in RULES)
    od = min(_image_rms(runs[d, True], "tikhonov_od") for d in (2, 3))
    return outcome({"raw > 10 px": raw > 10.0, "OD, normalised > 10 px": od > 10.0}, raw_px=raw, od_px=od)
