"""Effects on light and orbital frames are compared with other ways of computing them."""

from __future__ import annotations

import erfa
import numpy as np
import pytest

from factors.geometry import light, orbital
from fg_orient.model.errors import InputError
from fg_orient.sensors.earth_rotation import EarthOrientation, EarthRotation, neglected

RADIUS = 7.2e6


def orbit(n: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities of a whole turn on an orbit of 98.7 degrees; velocity is partly radial."""
    w, i, node = np.linspace(0.1, 2.0 * np.pi, n, endpoint=False), np.radians(98.7), 1.1
    m = np.array([[np.cos(node), -np.sin(node) * np.cos(i)], [np.sin(node), np.cos(node) * np.cos(i)], [0, np.sin(i)]])
    p = RADIUS * (m @ np.array([np.cos(w), np.sin(w)])).T
    return p, 7400.0 * (m @ np.array([-np.sin(w), np.cos(w)])).T + 8.0 * p / RADIUS


@pytest.mark.oracle
def test_kepler_angles_give_the_frame_of_position_and_velocity() -> None:
    p, v = orbit()
    angles = orbital.kepler_angles(p, v)
    z = p / np.linalg.norm(p, axis=1, keepdims=True)
    y = np.cross(z, v) / np.linalg.norm(np.cross(z, v), axis=1, keepdims=True)
    frame = orbital.frames_from_state(p, v)
    assert np.abs(frame - np.stack([np.cross(y, z), y, z], axis=2)).max() < 1e-13
    assert (np.einsum("ni,ni->n", frame[:, :, 0], v) > 7000.0).all()
    assert np.abs(orbital.frames_from_kepler(angles) - frame).max() < 1e-13
    assert np.degrees(angles[:, 0]) == pytest.approx(98.7, abs=1e-10)


@pytest.mark.oracle
def test_attitude_is_the_product_of_elementary_turns() -> None:
    roll, pitch, yaw = 0.3, -0.2, 0.5
    x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    assert orbital.attitude_matrices(np.array([[roll, pitch, yaw]]))[0] == pytest.approx(x @ y @ z, abs=1e-15)


@pytest.mark.oracle
def test_aberration_against_the_relativistic_formula() -> None:
    """The aberration equals the relativistic formula within 4e-10 rad, 0.2 mm on the ground.

    The angle to the velocity is cos a' = (cos a + b)/(1 + b cos a).
    """
    rng = np.random.default_rng(4)
    seen, v = light.unit(rng.normal(size=(50, 3))), 7500.0 * light.unit(rng.normal(size=(50, 3)))
    true, beta = light.without_aberration(seen, v), 7500.0 / light.C_M_S
    cosine = np.einsum("ni,ni->n", true, v) / 7500.0
    expected = np.arccos((cosine + beta) / (1.0 + beta * cosine))
    got = np.arccos(np.einsum("ni,ni->n", seen, v) / 7500.0)
    assert np.abs(got - expected).max() < 4e-10
    assert np.arccos(np.clip(np.einsum("ni,ni->n", seen, true), -1, 1)).max() > 2e-5
    assert np.abs(np.cross(light.C_M_S * true + v, seen)).max() < 1e-4  # c u + v lies along what is seen


@pytest.mark.oracle
def test_light_time_is_the_earth_at_emission() -> None:
    """The shift by light time is the rotation of the Earth while the light travels, iterated in inertial axes."""
    p, ground = np.array([7.0e6, 3.0e5, 1.0e6]), np.array([6.3e6, 2.5e5, 9.0e5])
    distance = np.linalg.norm(ground - p)
    for _ in range(5):
        angle = light.EARTH_RATE_RAD_S * distance / light.C_M_S
        c, s = np.cos(angle), np.sin(angle)
        then = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ ground  # eastwards turn undone
        distance = np.linalg.norm(then - p)
    shift = light.earth_turn(then[None], np.array([distance]))[0]
    assert np.linalg.norm(then + shift - ground) < 1e-9
    assert 1.0 < np.linalg.norm(shift) < 1.5


def traced_shift_m(zenith_deg: float, ground_m: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Trace the ray through spherical shells of the standard atmosphere: n r sin z is constant (Snell's law).

    Return the distance on the ground from the end of the straight line of sight to the end of the bent one, and the
    direction (2,) and vertical (2,) at the end of the straight line.
    """
    h = np.linspace(ground_m, 85_000.0, 17_001)
    t = np.where(h < 11_000.0, 288.15 - 0.0065 * h, 216.65)
    pressure = np.where(h < 11_000.0, 101_325.0 * (t / 288.15) ** 5.25588,
                        22_632.0 * np.exp(-(h - 11_000.0) / 6341.6))  # fmt: skip
    n = 1.0 + light.REFRACTIVITY * pressure / 101_325.0 * 288.15 / t
    r = 6_371_000.0 + h
    z = np.radians(zenith_deg)  # at the ground
    sine = n[0] * r[0] * np.sin(z) / (n * r)
    angle = np.trapezoid(sine / np.sqrt(1.0 - sine**2) / r, r)  # at the centre, ground to 85 km
    top = r[-1] * np.array([np.sin(angle), np.cos(angle)])
    out = angle + np.arcsin(r[0] * n[0] * np.sin(z) / (n[-1] * r[-1]))  # direction of the ray in space
    u = -np.array([np.sin(out), np.cos(out)])
    # where the straight sight meets the ground, and where the bent one does: (0, r0)
    b, c = u @ top, top @ top - r[0] ** 2
    straight = top + (-b - np.sqrt(b * b - c)) * u
    return float(np.arctan2(straight[0], straight[1]) * r[0]), u, straight / r[0]


@pytest.mark.oracle
@pytest.mark.parametrize("ground_m", [0.0, 2000.0, 4000.0])
@pytest.mark.parametrize("zenith_deg", [5.0, 15.0, 30.0, 45.0, 60.0])
def test_refraction_against_a_traced_ray(zenith_deg: float, ground_m: float) -> None:
    expected, u, up = traced_shift_m(zenith_deg, ground_m)
    direction, vertical = np.array([[u[0], 0.0, u[1]]]), np.array([[up[0], 0.0, up[1]]])
    shift = light.refraction_shift(direction, vertical, np.array([ground_m]))[0]
    assert -shift[0] == pytest.approx(expected, rel=0.01)
    assert abs(expected) > 0.05
    nadir = light.refraction_shift(-vertical, vertical, np.array([ground_m]))
    assert np.abs(nadir).max() < 1e-12


def series(days: int = 6) -> EarthOrientation:
    """Return the days around the leap second of 1 January 2017 (MJD 57754)."""
    mjd = 57751.0 + np.arange(days)
    ut1 = -0.40 - 0.001 * np.arange(days) + np.where(mjd >= 57754.0, 1.0, 0.0)
    pole = np.radians(np.column_stack([0.1 + 0.001 * np.arange(days), 0.3 - 0.002 * np.arange(days)]) / 3600.0)
    return EarthOrientation("C04", mjd, pole, ut1, np.radians(np.full((days, 2), 2e-4) / 3600.0))


@pytest.mark.oracle
def test_earth_rotation_is_that_of_the_standard_routine() -> None:
    """The Earth rotation between the ends of a minute equals erfa's whole chain at that time within 2e-14.

    Nutation is interpolated linearly.
    """
    s = series()
    rotation = EarthRotation(np.datetime64("2016-12-30"), (40_000.0, 40_060.0), "GCRS", s)
    t = 40_023.4
    pole, dut, offset = s.at(57752.0 + t / 86400.0)
    tt = 57752.0 + (t + 36.0 + 32.184) / 86400.0
    x, y, cio = erfa.xys06a(2400000.5, tt)
    whole = erfa.c2tcio(
        erfa.c2ixys(x + offset[0], y + offset[1], cio), erfa.era00(2400000.5 + 57752.0, (t + dut) / 86400.0),
        erfa.pom00(*pole, erfa.sp00(2400000.5, tt)),
    )  # fmt: skip
    assert np.abs(rotation.matrices(np.array([t]))[0] - whole).max() < 2e-14


@pytest.mark.truth
def test_a_leap_second_does_not_bend_ut1() -> None:
    s = series()
    before, after = s.at(57753.9999)[1], s.at(57754.0001)[1]
    assert after - before == pytest.approx(1.0, abs=1e-5)
    assert before == pytest.approx(-0.4029999, abs=1e-7)


@pytest.mark.behaviour
def test_outside_the_series_is_refused_and_its_end_is_not() -> None:
    with pytest.raises(InputError, match=r"57751 \.\. 57756"):
        EarthRotation(np.datetime64("2017-01-05"), (0.0, 10.0), "GCRS", series())
    EarthRotation(np.datetime64("2017-01-01"), (86_390.0, 86_400.0), "GCRS", series())


@pytest.mark.behaviour
def test_what_is_neglected_is_said_in_metres() -> None:
    assert "419 m" in str(neglected(np.array([7e6, 0.0, 0.0]))) and "19 m" in str(neglected(np.array([7e6, 0.0, 0.0])))
    assert " 0 m east-west" in str(neglected(np.array([0.0, 0.0, 7e6])))
