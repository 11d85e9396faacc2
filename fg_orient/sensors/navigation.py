"""Use positions of a receiver and attitudes of an inertial unit on board as observations of frame images.

Direct georeferencing holds positions and attitudes fixed. Here they are observations.
Shift and drift of each strip, lever arm and boresight are unknowns if they have a prior
sigma (``factors.conditions.navigation``). Body axes are X forward, Y right, Z down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.conditions.navigation import ANTENNA_POSITION, ATTITUDE, INERTIAL_ATTITUDE, POSITION
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import NAVIGATION

Three = tuple[float, float, float]

#: Rotates body axes to camera axes (X right, Y down the lines, Z along the view) if the top of the image is forward.
TOP_FORWARD: Final = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
#: Shared id of the lever arm and boresight, which are common to all images.
MOUNTING: Final = "mounting"


@dataclass(frozen=True, eq=False)
class Fix:
    """Observations on board at the exposure time of one image.

    Parameters
    ----------
    image, strip : str
    time_s : float
        Time in any scale; all images of a strip must have the same scale.
    position_m : (3,) array
        Position of the receiver, ECEF m.
    position_sigma_m : (3,) array
        Standard deviations East, North, Up, m.
    ground_from_body : (3, 3) array, optional
        Attitude: rotates body axes to ECEF axes; None if it was not observed.
    attitude_sigma_rad : (3,) array, optional
        Standard deviations of rotations about the body's X (roll), Y (pitch) and Z (heading), rad.
    """

    image: str
    strip: str
    time_s: float
    position_m: Array
    position_sigma_m: Array
    ground_from_body: Array | None = None
    attitude_sigma_rad: Array | None = None


@dataclass(frozen=True, eq=False)
class Mounting:
    """Mounting of receiver, inertial unit and camera, with the prior sigmas of its unknowns.

    A prior sigma of None means that the value is held fixed, or that the error is zero.

    Parameters
    ----------
    lever_m : (3,) array
        Vector from the receiver to the projection centre in body axes, m.
    camera_from_body : (3, 3) array
        Boresight: rotates body axes to camera axes.
    shift_sigma_m, drift_sigma_m : three floats or None
        Prior sigmas of the errors of a strip's positions, East, North, Up, m: constant
        part, and drift at the ends of the strip.
    turn_sigma_rad, turn_drift_sigma_rad : three floats or None
        Prior sigmas of the errors of a strip's attitudes, roll, pitch, heading, rad: constant part, and drift.
    lever_sigma_m, boresight_sigma_rad : three floats or None
        Prior sigmas of the lever arm (body axes) and of the boresight (rotations about
        the camera's axes). Both are common to all images.
    """

    lever_m: Array = field(default_factory=lambda: np.zeros(3))
    camera_from_body: Array = field(default_factory=lambda: TOP_FORWARD)
    shift_sigma_m: Three | None = None
    drift_sigma_m: Three | None = None
    turn_sigma_rad: Three | None = None
    turn_drift_sigma_rad: Three | None = None
    lever_sigma_m: Three | None = None
    boresight_sigma_rad: Three | None = None

    @property
    def sigmas(self) -> dict[str, float]:
        """Return the prior sigmas of the unknowns by name."""
        given = (self.shift_sigma_m, self.drift_sigma_m, self.turn_sigma_rad, self.turn_drift_sigma_rad,
                 self.lever_sigma_m, self.boresight_sigma_rad)  # fmt: skip
        pairs = zip(NAVIGATION, (value for three in given for value in (three or (None,) * 3)), strict=True)
        return {name: float(value) for name, value in pairs if value is not None}


def body_attitude(roll_rad: float, pitch_rad: float, heading_rad: float, place_m: Array) -> Array:
    """Compute the rotation (3, 3) from body axes to ECEF axes from roll, pitch and heading at a place (3,), ECEF m.

    The heading is counted from North. ``Rz(heading) Ry(pitch) Rx(roll)`` converts body
    axes to North, East, Down.
    """
    (sr, cr), (sp, cp), (sh, ch) = ((np.sin(a), np.cos(a)) for a in (roll_rad, pitch_rad, heading_rad))
    rx = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    ry = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    rz = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]])
    east, north, up = enu_axes(place_m)
    return np.asarray(np.column_stack([north, east, -up]) @ rz @ ry @ rx)


def with_navigation(block: Block, fixes: Sequence[Fix], mounting: Mounting) -> Block:
    """Add the observations on board to a block as extra observations, together with their unknowns.

    Parameters
    ----------
    block : Block
    fixes : sequence of Fix
        At most one record for each image. Images without a record have only their priors.
    mounting : Mounting

    Raises
    ------
    InputError
        An image does not exist, is not a georeferenced frame image, or has two records.
    """
    images, extra = list(block.images), list(block.extra)
    seen: set[str] = set()
    for fix, tau, axes in _in_strips(fixes):
        place = block.find(f"image:{fix.image}")
        if place is None or fix.image in seen:
            code = "navigation.image" if place is None else "navigation.twice"
            raise InputError.of(code, place="image", value=fix.image)
        seen.add(fix.image)
        image = images[place[1]]
        sensor = image.sensor
        if not (isinstance(sensor, FrameSensor) and sensor.georeferenced):
            raise InputError.of("navigation.kind", place=f"image {fix.image}", value=type(sensor).__name__)
        images[place[1]] = replace(image, sensor=_with_unknowns(sensor, fix, mounting))
        extra += _observations(fix, tau, axes, sensor.camera, mounting)
    return replace(block, images=tuple(images), extra=tuple(extra))


def _in_strips(fixes: Sequence[Fix]) -> list[tuple[Fix, float, Array]]:
    """Return each record with its time tau in [-1, 1] and the axes East, North, Up (3, 3) of its strip."""
    out = []
    for fix in fixes:
        strip = [other for other in fixes if other.strip == fix.strip]
        first, last = min(f.time_s for f in strip), max(f.time_s for f in strip)
        tau = 2.0 * (fix.time_s - first) / (last - first) - 1.0 if last > first else 0.0
        out.append((fix, tau, enu_axes(np.mean([f.position_m for f in strip], axis=0))))
    return out


def _with_unknowns(sensor: FrameSensor, fix: Fix, mounting: Mounting) -> FrameSensor:
    """Return the sensor with those unknowns of strip and mounting on which its observations depend."""
    camera, known = sensor.camera, mounting.sigmas
    names = [n for n in known if fix.ground_from_body is not None or not n.startswith(("ins_", "boresight"))]
    sigma = {**camera.sigma, **{name: known[name] for name in names}}
    of_strip = {name: f"strip {fix.strip}" for name in names if name.startswith(("gnss_", "ins_"))}
    of_all = {name: MOUNTING for name in names if name not in of_strip}
    camera = replace(camera, sigma=sigma, shared={**camera.shared, **of_strip, **of_all})
    return sensor.with_camera(camera, sensor.file)


def _observations(fix: Fix, tau: float, axes: Array, camera: FrameCamera, mounting: Mounting) -> list[ExtraObservation]:
    """Return the observations of the position, and of the attitude if it was observed.

    ``factors.conditions.navigation`` describes the records.
    """
    common = {"rotation": camera.rotation.ravel(), "mounting": mounting.camera_from_body.ravel(), "tau": tau}
    weight, image = axes / fix.position_sigma_m[:, None], (f"image:{fix.image}",)
    offset, arm, strip = fix.position_m - camera.centre_m, mounting.lever_m, axes.T.ravel()
    record = POSITION.pack(whitening=weight.ravel(), **common, offset=offset, arm=arm, strip=strip)
    out = [ExtraObservation(ANTENNA_POSITION, image, record, None, 3, f"position of the receiver, image {fix.image}")]
    if fix.ground_from_body is not None and fix.attitude_sigma_rad is not None:
        weight, observed = np.diag(1.0 / fix.attitude_sigma_rad), fix.ground_from_body.T
        record = ATTITUDE.pack(whitening=weight.ravel(), **common, observed=observed.ravel())
        out.append(ExtraObservation(INERTIAL_ATTITUDE, image, record, None, 3, f"attitude on board, image {fix.image}"))
    return out


def enu_axes(place_m: Array) -> Array:
    """Return the axes East, North, Up as rows of a matrix (3, 3), at a place (3,), ECEF m."""
    lon, lat, _ = ecef_to_geodetic(place_m[None])
    return np.asarray(enu_from_ecef(lon, lat)[0])
