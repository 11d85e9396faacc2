"""Small synthetic metadata of pushbroom images have a circular orbit and 40 lines of 24 samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fg_orient.model.errors import finding
from fg_orient.sensors.metadata import (
    AngleAttitude,
    Ephemeris,
    FramePoint,
    LineTiming,
    LookAnglePolynomial,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

N_LINES, N_SAMPLES = 40, 24
T0_S = 19267.332158
EARTH_RATE_RAD_S = 7.2921151467e-5


def circular_orbit(time_s: np.ndarray) -> Ephemeris:
    """Return the state vectors of a circular orbit, 7200 km, inclination 98.7 degrees, in the rotating frame."""
    radius, rate, inclination = 7.2e6, np.sqrt(3.986004418e14 / 7.2e6**3), np.radians(98.7)
    u, node = rate * (time_s - T0_S), 0.5 - EARTH_RATE_RAD_S * (time_s - T0_S)
    along = np.stack([np.cos(u), np.sin(u) * np.cos(inclination), np.sin(u) * np.sin(inclination)])
    ahead = np.stack([-np.sin(u), np.cos(u) * np.cos(inclination), np.cos(u) * np.sin(inclination)])
    c, s = np.cos(node), np.sin(node)
    x, y, z = (np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]]) for v in (along, ahead, along))
    turning = -EARTH_RATE_RAD_S * radius * np.array([-z[1], z[0], 0 * z[0]])
    return Ephemeris(time_s, (radius * x).T, (radius * rate * y + turning).T)


def spot5() -> PushbroomMetadata:
    """Return the SPOT-5-like metadata: corrected angles, one look angle pair per detector."""
    sample = np.arange(float(N_SAMPLES))
    at = T0_S + 0.125 * np.arange(-6, 7)
    wave = np.stack([1e-4 * np.sin(at), -7e-4 + 1e-5 * np.cos(at), 9e-4 + 0 * at], axis=1)
    frame = [
        FramePoint(f"corner {k}", line, column, 30.0 + k / 7, 41.0 - k / 9, 0.0)
        for k, (line, column) in enumerate([(0, 0), (0, 23), (39, 23), (39, 0)], start=1)
    ]
    return PushbroomMetadata(
        file="", mission="SPOT 5", instrument="HRG 1", format="DIMAP 1.1",
        epoch=np.datetime64("2005-03-13", "D"), n_lines=N_LINES, n_samples=N_SAMPLES,
        timing=LineTiming(20.0, T0_S, 7.5199643612e-4),
        ephemeris=circular_orbit(T0_S + 30.0 * np.arange(-4, 5)),
        attitude=AngleAttitude(at, wave),
        look=LookAngleTable(sample, 8.9e-3 + 1e-7 * sample, -0.0127 + 6e-6 * sample),
        frame_points=(*frame, FramePoint("centre", 20.0, 12.0, 30.5, 40.5, 0.0)),
    )  # fmt: skip


def pleiades() -> PushbroomMetadata:
    """Return the Pléiades-like metadata: quaternion polynomials, look polynomials."""
    half = np.array([[0.5, 1e-3, -1e-5], [0.5, -1e-3, 0.0], [-0.5, 2e-3, 1e-5], [0.5, 2e-3, 0.0]])
    corners = [replace(p, height_m=None) for p in spot5().frame_points]
    return replace(
        spot5(), mission="PHR 1A", instrument="PHR 1A", format="DIMAP 2.0",
        timing=LineTiming(0.0, T0_S, 7.35e-5),
        attitude=QuaternionPolynomial(T0_S, 1.6875, half),
        look=LookAnglePolynomial(0.0, np.array([8e-5]), np.array([-0.014222, 7.113e-7])),
        frame_points=tuple(corners),
        frame_note=finding("image.frame_without_heights"),
    )  # fmt: skip


def spot6() -> PushbroomMetadata:
    """Return the SPOT-6-like metadata: sampled quaternions."""
    at = T0_S + 0.03125 * np.arange(5)
    angle = 0.3 + 1e-3 * (at - T0_S)
    q = np.stack([np.cos(angle), np.sin(angle) * 0.6, np.sin(angle) * 0.8, 0 * angle], axis=1)
    return replace(pleiades(), mission="SPOT 6", instrument="SPOT 6", attitude=QuaternionList(at, q))
