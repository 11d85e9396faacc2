"""Project ground points into a pushbroom image by solving the look-angle collinearity for line and sample.

Newton's method solves for both pixel coordinates together (docs/equations.md 6). The
conditions F_y, F_x are the conditions of the observation equation. Therefore every correction (EOP,
look angles) is included. Their derivatives are differences over half a pixel to both sides. Attitudes
and look angles are piecewise linear, and a pixel may contain a knot. For this reason, up to 30 steps
are needed. The iteration ends when steps are below 1e-9 px, or below 1e-6 px if they no longer become
smaller. The reason is rounding: a time of day has 11 digits, which is 1e-8 px.

Lines are evaluated only inside the image. For a point outside, line and sample are
extrapolated linearly from the border. They are nan if the satellite cannot see the point,
or if the steps do not converge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factors._contract import compiled
from factors._plain import FEW_ARRAYS, plain
from factors.arrays import Array
from factors.cameras import pushbroom
from factors.cameras.pushbroom_record import CURVE, CURVES, N_EOP, RECORD, correction, corrections, observation
from fg_orient.sensors.correction import Correction

if TYPE_CHECKING:
    from fg_orient.sensors.pushbroom import PushbroomSensor

MAX_STEPS = 30
STEP_PX = 1e-9
ROUNDING_PX = 1e-6
#: If a step is shorter than this, the derivative of the last step is used again.
SAME_SLOPE_PX = 0.5
#: Number of points whose four neighbours are evaluated together. More points would need more memory and not less time.
AT_ONCE = 4096


def physical_unknowns(correction: Correction) -> tuple[Array, Array]:
    """Return setup (2, k) and unknowns (k,) of the equation for a correction in physical units, without zeros."""
    codes = np.arange(N_EOP + correction.look.size, dtype=float)
    x = np.concatenate([correction.eop.ravel(), correction.look.T.ravel()])
    # the record contains the sum of all curves of an EOP as one curve with the coefficient 1
    if not correction.is_quadratic:
        codes = np.concatenate([codes, CURVE + (CURVES + 1.0) * np.arange(9)])
        x = np.concatenate([x, np.ones(9)])
    codes, x = codes[x != 0.0], x[x != 0.0]
    return np.ascontiguousarray(np.stack([codes, np.ones_like(codes)])), x


def conditions(sensor: PushbroomSensor, line: Array, sample: Array, ground_m: Array, correction: Correction) -> Array:
    """Return the conditions F_y, F_x (N, 2), which are tangents, of N pixels and ground points."""
    records = sensor.records(line, sample, ground_m, small_angle=correction.small_angle)
    return _conditions(records, ground_m, correction)


def _conditions(records: Array, ground_m: Array, correction: Correction) -> Array:
    """Return the conditions (N, 2) of records (N, d)."""
    setup, x = physical_unknowns(correction)
    if not correction.is_quadratic:
        records = np.hstack([records, correction.curve_at(records[:, RECORD.tau])])
    return residuals(records, setup, x, np.ascontiguousarray(ground_m))


def residuals(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """Return the residuals (N, 2) of N observations (N, d) of one image at N ground points (N, 3)."""
    if len(records) > FEW_ARRAYS:
        return _residuals(records, setup, x, ground)
    record = np.ascontiguousarray(records.T)  # the equation computes all observations together
    with np.errstate(all="ignore"):  # compiled code gives no warnings either
        changes = plain(correction)(plain(corrections)(record, setup, x), 0, 1)
        small = record[RECORD.small_angle].any()
        constants = plain(observation)(record, 0, 1)
        value, _ = plain(pushbroom.collinearity)(constants, changes, tuple(ground.T.copy()), small)
    return np.stack(value, axis=1)


@compiled
def _residuals(records: Array, setup: Array, x: Array, ground: Array) -> Array:
    """Compute :func:`residuals` by a compiled loop."""
    out = np.empty((len(records), 2))
    for i in range(len(records)):
        value = pushbroom.residual(records[i], setup, x, ground[i])
        out[i, 0], out[i, 1] = value[0], value[1]
    return out


def pixel_derivative(
    sensor: PushbroomSensor, line: Array, sample: Array, ground_m: Array, correction: Correction
) -> Array:
    """Return the derivative J = dF/d(line, sample) of the conditions: (N, 2, 2), rad per pixel."""
    return linearised(sensor, line, sample, ground_m, correction).slope


class Linearised(NamedTuple):
    """Records (N, 34) of pixels, and the derivatives (N, 2, 2) of their conditions by line and sample."""

    records: Array
    slope: Array


def linearised(
    sensor: PushbroomSensor, line: Array, sample: Array, ground_m: Array, correction: Correction
) -> Linearised:
    """Return the records of pixels inside the image, and the derivatives of their conditions."""
    if len(line) > AT_ONCE:
        parts = [slice(lo, lo + AT_ONCE) for lo in range(0, len(line), AT_ONCE)]
        found = [linearised(sensor, line[k], sample[k], ground_m[k], correction) for k in parts]
        return Linearised(*(np.concatenate(each) for each in zip(*found, strict=True)))
    n, small = len(line), correction.small_angle
    before, after = (np.clip(line + s, sensor.first_line - 0.5, sensor.last_line + 0.5) for s in (-0.5, 0.5))
    low, high = (np.clip(sample + s, sensor.first_sample - 0.5, sensor.last_sample + 0.5) for s in (-0.5, 0.5))
    states = sensor.states(np.concatenate([line, before, after]))
    ground = np.tile(ground_m, (3, 1))
    psi_x, psi_y = sensor.look_angles(sample)
    thrice = np.tile(sample, 3), (np.tile(psi_x, 3), np.tile(psi_y, 3))
    records = sensor.records_of(states, *thrice, ground, small_angle=small)
    f_before, f_after = _conditions(records[n:], ground[n:], correction).reshape(2, n, 2)
    by_line = (f_after - f_before) / (after - before)[:, None]
    if sensor.bends_light:  # light effects make the mounting depend on the sample
        here, other = states.first(n), ((s, sensor.look_angles(s)) for s in (low, high))
        there = [sensor.records_of(here, *one, ground_m, small_angle=small) for one in other]
        f_low, f_high = (_conditions(part, ground_m, correction) for part in there)
    else:  # F_y = f1/f3 - tan psi_y, F_x = f2/f3 + tan psi_x: f1, f2, f3 do not depend on the sample
        f_low, f_high = (_tangents(sensor, s, correction) for s in (low, high))
    return Linearised(records[:n], np.stack([by_line, (f_high - f_low) / (high - low)[:, None]], axis=2))


def _tangents(sensor: PushbroomSensor, sample: Array, correction: Correction) -> Array:
    """Return the terms -tan psi_y, tan psi_x (N, 2) of the conditions."""
    psi_x, psi_y = sensor.corrected_look(sensor.look_angles(sample), sample, correction)
    return np.stack([-np.tan(psi_y), np.tan(psi_x)], axis=1)


def project(sensor: PushbroomSensor, ground_m: Array, correction: Correction) -> tuple[Array, Array]:
    """Return line and sample of N ECEF points (N, 3), m; see the module docstring."""
    line = np.full(len(ground_m), (sensor.first_line + sensor.last_line) / 2.0)
    sample = np.full(len(ground_m), (sensor.first_sample + sensor.last_sample) / 2.0)
    centre = sensor.centre_position()
    visible = np.isfinite(ground_m).all(axis=1)
    visible &= np.einsum("ij,ij->i", np.nan_to_num(ground_m) - centre, np.nan_to_num(ground_m)) < 0.0
    line[~visible], sample[~visible] = np.nan, np.nan
    todo = np.flatnonzero(visible)
    previous, slope = np.full(len(todo), np.inf), np.zeros((len(line), 2, 2))
    for _ in range(MAX_STEPS):
        if not len(todo):
            break
        at = line[todo], sample[todo]
        inside = (np.clip(at[0], sensor.first_line - 0.5, sensor.last_line + 0.5),
                  np.clip(at[1], sensor.first_sample - 0.5, sensor.last_sample + 0.5))  # fmt: skip
        # within a pixel, the derivative is nearly constant: each step is still a thousand times shorter than the last
        if (previous > SAME_SLOPE_PX).any():
            records, slope[todo] = linearised(sensor, *inside, ground_m[todo], correction)
            f = _conditions(records, ground_m[todo], correction)
        else:
            f = conditions(sensor, *inside, ground_m[todo], correction)
        step = np.stack(inside, axis=1) - np.stack(at, axis=1) - np.linalg.solve(slope[todo], f[:, :, None])[:, :, 0]
        line[todo] += step[:, 0]
        sample[todo] += step[:, 1]
        length = np.abs(step).max(axis=1)
        going = (length > STEP_PX) & ((length > ROUNDING_PX) | (length < 0.5 * previous))
        todo, previous = todo[going], length[going]
    line[todo], sample[todo] = np.nan, np.nan
    return line, sample
