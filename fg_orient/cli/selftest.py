"""A tiny synthetic block in memory, adjusted in about a second to see that the installation computes.

Two pushbroom images from circular passes over the equator, nine error-free control points
and four check points. A sound installation finds sigma0 near 0 and the check points to a
micrometre; a wrong Jacobian, a broken compiler cache or a foreign GTSAM does not.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints, WithheldCoordinates
from fg_orient.model.names import Role
from fg_orient.sensors.metadata import AngleAttitude, Ephemeris, LineTiming, LookAngleTable, PushbroomMetadata
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

N_PIXELS = 1000
LINE_PERIOD_S = 0.01
RADIUS_M = 7.2e6
EQUATOR_M = 6378137.0
SPEED_M_S = 7500.0
#: Largest error of the check points: rounding of ECEF coordinates is 1e-9 m, one step leaves 1e-7 m.
TOLERANCE_M = 1e-6


def synthetic_sensor(name: str, longitude_offset_deg: float) -> PushbroomSensor:
    """Sensor of a northward pass near the prime meridian, tilted towards it."""
    t = np.linspace(-40.0, 50.0, 19)
    angle = SPEED_M_S / RADIUS_M * (t - 5.0)
    lon = np.radians(longitude_offset_deg)
    east, up = np.array([-np.sin(lon), np.cos(lon), 0.0]), np.array([np.cos(lon), np.sin(lon), 0.0])
    north = np.cross(up, east)
    position = RADIUS_M * (np.cos(angle)[:, None] * up + np.sin(angle)[:, None] * north)
    velocity = SPEED_M_S * (-np.sin(angle)[:, None] * up + np.cos(angle)[:, None] * north)
    tilt = np.arctan2(EQUATOR_M * np.sin(lon), RADIUS_M - EQUATOR_M * np.cos(lon))
    sample = np.arange(N_PIXELS, dtype=float)
    psi_y = tilt + 1e-5 * (sample - (N_PIXELS - 1) / 2.0)
    metadata = PushbroomMetadata(
        file=name, mission="synthetic", instrument="self-test", format="memory", epoch=np.datetime64("2026-01-01"),
        n_lines=N_PIXELS, n_samples=N_PIXELS, timing=LineTiming(0.0, 0.0, LINE_PERIOD_S),
        ephemeris=Ephemeris(t, position, velocity), attitude=AngleAttitude(t, np.zeros((len(t), 3))),
        look=LookAngleTable(sample, np.zeros(N_PIXELS), psi_y),
    )  # fmt: skip
    return PushbroomSensor(metadata)


def synthetic_block() -> tuple[Block, Array]:
    """Block of two images with error-free observations, and the true points (n, 3) ECEF m."""
    images = tuple(Image(name, synthetic_sensor(name, offset)) for name, offset in (("west", -3.0), ("east", 3.0)))
    grid = np.array([(x, y) for y in (-0.02, 0.0, 0.02) for x in (-0.02, 0.0, 0.02)])
    inner = 0.5 * np.array([(x, y) for y in (-0.02, 0.02) for x in (-0.02, 0.02)])
    place = np.vstack([grid, inner])
    n = len(place)
    truth = geodetic_to_ecef(place[:, 0], place[:, 1], 100.0 + 50.0 * np.cos(np.arange(n)))
    pixels = [np.stack(image.sensor.project(truth), axis=1) for image in images]
    roles = (Role.CONTROL,) * len(grid) + (Role.CHECK,) * len(inner)
    control = np.arange(n)[:, None] < len(grid)
    sigma = np.full((n, 3), 0.1)
    ids = tuple(str(k + 1) for k in range(n))
    known = Coordinates(np.where(control, truth, np.nan), np.where(control, sigma, np.nan), np.zeros(n, bool))
    hidden = Coordinates(truth[len(grid) :], sigma[len(grid) :], np.zeros(len(inner), bool))
    line, sample = np.vstack(pixels).T.copy()
    noise = np.full(2 * n, 0.3)
    observations = ImagePoints(np.repeat([0, 1], n), np.tile(np.arange(n), 2), line, sample, noise, noise)
    withheld = WithheldCoordinates(ids[len(grid) :], lambda: hidden)
    return Block("self-test", images, GroundPoints(ids, roles, known), observations, withheld), truth


def self_test() -> tuple[bool, str]:
    """Adjust the synthetic block.

    Returns
    -------
    good : bool
        Check points are met within a micrometre.
    detail : str
        Iterations and largest error, in words.
    """
    from fg_orient.orientation.orient import adjust

    block, _ = synthetic_block()
    solution = adjust(block)
    error = float(np.abs(solution.accuracy.check.ecef_m).max())
    good = solution.status == "converged" and error < TOLERANCE_M
    return good, f"{solution.status} after {solution.iterations} iterations, check points within {error:.1e} m"
