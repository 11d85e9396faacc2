"""Rays of pushbroom metadata are computed a second time by numpy and scipy, without the sensor."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator, make_interp_spline
from scipy.spatial.transform import Rotation

from fg_orient.sensors.correction import Correction
from fg_orient.sensors.metadata import (
    AngleAttitude,
    Ephemeris,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
)
from tests.support.published_conditions import attitude, frame

#: Samples of an orbit that a polynomial goes through: the nearest.
NEAREST = 8


def state(orbit: Ephemeris, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and velocity (n, 3) by scipy's polynomials through the nearest samples."""
    samples = np.hstack([orbit.position_m, orbit.velocity_m_s])
    use = min(NEAREST, len(samples))
    first = np.clip(np.searchsorted(orbit.time_s, time_s) - use // 2, 0, len(samples) - use)
    out = np.empty((len(time_s), 6))
    for k in np.unique(first):
        near = slice(k, k + use)
        middle = samples[near].mean(axis=0)
        out[first == k] = middle + BarycentricInterpolator(orbit.time_s[near], samples[near] - middle)(
            time_s[first == k]
        )
    return out[:, :3], out[:, 3:]


def rays(
    m: PushbroomMetadata, line: np.ndarray, sample: np.ndarray, correction: Correction | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the projection centres (n, 3) and unit viewing directions (n, 3) in ECEF; no curves, no small angles."""
    line, sample = (a.ravel() for a in np.broadcast_arrays(np.asarray(line, float), np.asarray(sample, float)))
    c = correction or Correction()
    time_s = m.timing.reference_time_s + (line - m.timing.reference_line) * m.timing.line_period_s
    p, v = state(m.ephemeris, time_s)
    half = (m.n_lines - 1) / 2.0
    moved = np.polynomial.polynomial.polyval(line / half - 1.0, c.eop.T).T
    at = p + moved[:, :3]
    if isinstance(m.look, LookAngleTable):
        psi = np.stack([m.look.psi_x_rad, m.look.psi_y_rad], axis=1)
        tangents = list(make_interp_spline(m.look.sample, np.tan(psi), k=1)(sample).T)  # goes on at the ends
    else:
        d = sample - m.look.origin_sample
        tangents = [np.polynomial.polynomial.polyval(d, a) for a in (m.look.tan_psi_x, m.look.tan_psi_y)]
    if c.look.shape[1]:
        bend = np.polynomial.polynomial.polyval(2.0 * sample / (m.n_samples - 1) - 1.0, c.look.T)
        tangents = [np.tan(np.arctan(t) + b) for t, b in zip(tangents, bend, strict=True)]
    body = np.stack([-tangents[1], tangents[0], -np.ones_like(line)], axis=1)
    if isinstance(m.attitude, AngleAttitude):
        angles = make_interp_spline(m.attitude.time_s, m.attitude.angles_rad, k=1)(time_s)
        axes = frame(at, v + moved[:, 3:6], False)
        turned = np.einsum("nij,njk,nk->ni", axes, attitude(angles + moved[:, 6:], False), body)
    else:
        if isinstance(m.attitude, QuaternionList):
            q = make_interp_spline(m.attitude.time_s, m.attitude.quaternion, k=1)(time_s)
        else:
            scaled = (time_s - m.attitude.offset_s) / m.attitude.scale_s
            q = np.polynomial.polynomial.polyval(scaled, m.attitude.coefficients.T).T
        # corrections turn the body in the orbital frame of the metadata
        axes, to_ecef = frame(p, v, False), Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
        mount = np.einsum("nji,njk->nik", axes, to_ecef)
        seen = np.einsum("nij,nj->ni", mount, body[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
        turned = np.einsum("nij,njk,nk->ni", axes, attitude(moved[:, 6:], False), seen)
    return at, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def misses_m(
    m: PushbroomMetadata, line: np.ndarray, sample: np.ndarray, ground_m: np.ndarray,
    correction: Correction | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the distances (n,) of ground points from the rays of their pixels."""
    centre, direction = rays(m, line, sample, correction)
    return np.asarray(np.linalg.norm(np.cross(ground_m - centre, direction), axis=1))


def published_pixels(m: PushbroomMetadata, ground_m: np.ndarray) -> np.ndarray:
    """Return lines and samples (n, 2) whose rays meet ground points.

    Newton's method starts in the middle and uses difference quotients.
    """

    def off(at: np.ndarray) -> np.ndarray:
        centre, direction = rays(m, *at.T)
        to_point = ground_m - centre
        return to_point / np.linalg.norm(to_point, axis=1, keepdims=True) - direction

    found = np.tile(0.5 * np.array([m.n_lines - 1.0, m.n_samples - 1.0]), (len(ground_m), 1))
    for _ in range(20):
        slopes = np.stack([0.5 * (off(found + h) - off(found - h)) for h in np.eye(2)], axis=2)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slopes), off(found))
        found = found - step
        if np.abs(step).max() < 1e-6:
            return found
    raise AssertionError("no convergence")
