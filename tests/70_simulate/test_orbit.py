"""The states of the circular pass are consistent, and the sensor sees its point on the stated side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.simulate.scene import EARTH_RATE_RAD_S, GM_M3_S2, HEIGHT_M, MEAN_EARTH_RADIUS_M, CircularPass, find_pass

TARGET = geodetic_to_ecef(31.85, 41.3, 0.0)[0]


@pytest.mark.oracle
@pytest.mark.parametrize("radial_velocity", [0.0, 8.0])
def test_velocity_is_the_derivative_of_the_position(radial_velocity: float) -> None:
    orbit = find_pass(TARGET, math.radians(-18.0), radial_velocity_m_s=radial_velocity)
    t, h = np.array([-120.0, -3.0, 0.0, 4.0, 120.0]), 0.1
    _, velocity = orbit.states(t)
    difference = (orbit.states(t + h)[0] - orbit.states(t - h)[0]) / (2.0 * h)
    # truncation h^2/6 V n^2 = 1.3e-5 m/s; rounding of the positions 1e-9 m / 0.2 s is far below
    np.testing.assert_allclose(velocity, difference, rtol=0.0, atol=3e-5)


@pytest.mark.truth
def test_inertial_motion_is_the_circle_of_the_elements() -> None:
    """The inertial orbit is a circle with Kepler's speed and an inclination of 98.7 degrees, descending."""
    orbit = find_pass(TARGET, math.radians(20.0))
    t = np.linspace(-120.0, 120.0, 9)
    position, velocity = orbit.states(t)
    moving = velocity + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)
    radius = MEAN_EARTH_RADIUS_M + HEIGHT_M
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), radius, rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(moving, axis=1), math.sqrt(GM_M3_S2 / radius), rtol=1e-13)
    normal = np.cross(position, moving)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(normal[:, 2], math.cos(math.radians(98.7)), rtol=0.0, atol=1e-13)
    longitude = np.arctan2(normal[:, 1], normal[:, 0]) + EARTH_RATE_RAD_S * t
    np.testing.assert_allclose(longitude, longitude[4], rtol=0.0, atol=1e-13)
    assert (velocity[:, 2] < 0.0).all(), "descending"


@pytest.mark.truth
def test_radial_velocity_changes_the_distance_only() -> None:
    t = np.array([-100.0, 0.0, 100.0])
    fixed, rising = (CircularPass(7.2e6, 1.7, 0.3, 2.4, v) for v in (0.0, 8.0))
    (p0, v0), (p1, v1) = fixed.states(t), rising.states(t)
    np.testing.assert_allclose(np.linalg.norm(p1, axis=1) - np.linalg.norm(p0, axis=1), 8.0 * t, atol=1e-6)
    radial = np.einsum("ij,ij->i", v1, p1) / np.linalg.norm(p1, axis=1)
    np.testing.assert_allclose(radial, 8.0, atol=1e-9)
    np.testing.assert_allclose(np.einsum("ij,ij->i", v0, p0), 0.0, atol=1e-2)  # eps |P| |V| = 1e-5 m^2/s


@pytest.mark.oracle
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (-1.6e-4, -7.2e-4, 9e-4)])
@pytest.mark.parametrize("roll_deg", [-25.0, 0.0, 20.0])
def test_the_pass_sees_the_point(roll_deg: float, attitude: tuple[float, float, float]) -> None:
    """The look direction of the pass leads through its target within 1e-5 m, and an attitude rotates the ray."""
    orbit = find_pass(TARGET, math.radians(roll_deg), attitude_rad=attitude, radial_velocity_m_s=8.0)
    (position,), (velocity,) = orbit.states(0.0)
    radial = position / np.linalg.norm(position)
    right = np.cross(velocity, radial) / np.linalg.norm(np.cross(velocity, radial))
    along = np.cross(radial, right)
    look = -math.tan(math.radians(roll_deg)) * right - radial
    if attitude == (0.0, 0.0, 0.0):
        miss = np.linalg.norm(np.cross(TARGET - position, look)) / np.linalg.norm(look)
        assert miss < 1e-5  # Newton ends at 1e-13 rad, 0.7 micrometre; rounding of 7e6 m: 1e-9 m
    else:
        to_point = TARGET - position
        turn = np.linalg.norm(np.cross(to_point, look)) / np.linalg.norm(look) / np.linalg.norm(to_point)
        assert 1e-4 < turn < 1.5e-3, "the attitude turns the ray"
        forward = (to_point @ along) / -(to_point @ radial)
        # active rotation about X (right) by the pitch lifts -Z forward; yaw turns the side look -tan(psi_y) X;
        # second-order terms: 1e-6
        expected = attitude[1] - math.tan(math.radians(roll_deg)) * attitude[2]
        assert forward == pytest.approx(expected, abs=2e-6)


@pytest.mark.truth
def test_positive_angles_look_left_to_the_east() -> None:
    west, _, _ = ecef_to_geodetic(find_pass(TARGET, math.radians(20.0)).states(0.0)[0])
    east, _, _ = ecef_to_geodetic(find_pass(TARGET, math.radians(-18.0)).states(0.0)[0])
    assert west[0] < 31.85 < east[0]


@pytest.mark.behaviour
def test_no_pass() -> None:
    with pytest.raises(ValueError, match="latitudes"):
        find_pass(geodetic_to_ecef(10.0, 89.0, 0.0)[0], 0.0)
    with pytest.raises(ValueError, match="no descending pass"):
        find_pass(TARGET, math.radians(75.0))  # the horizon is at 62 degrees
