"""Metadata of a simulated SPOT-5 HRG scene: pass, camera, errors of the metadata.

The camera of the twin (SPOT-5 HRG) has 12000 detectors of 6.5 micrometres and a focal length of 1.082 m (field 4.13
degrees, pixel 5 m). The mirror turns the line of sight across track::

    psi_y(sample) = mirror + arctan((sample - 5999.5) 6.5e-6 / 1.082),   psi_x = 0

With u1 = (-tan psi_y, tan psi_x, -1) and X to the right of the flight direction, a negative mirror angle looks to the
right (west on a descending pass), and samples increase from right to left (west to east), as in the real SPOT-5 file.

Errors are polynomials in tau = (line - c)/c, c = (NROWS - 1)/2. The metadata contain *true minus error* at all epochs
of ephemeris and attitude, including those far from the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from factors._contract import Array
from factors.geometry import polynomials
from fg_orient.formats.dimap1 import straight_line
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.sensors.metadata import (
    AngleAttitude,
    Ephemeris,
    FramePoint,
    LineTiming,
    LookAngleTable,
    PushbroomMetadata,
)
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.orbit import CircularPass

N_LINES = 12000
N_SAMPLES = 12000
LINE_PERIOD_S = 0.7521e-3
#: SCENE_CENTER_LINE 6001 of the real file, 0-based.
REFERENCE_LINE = 6000.0
DETECTOR_M = 6.5e-6
FOCAL_LENGTH_M = 1.082
#: Ephemeris on full half minutes: four before, one immediately before, and four after the image.
EPHEMERIS_STEP_S = 30.0
N_EPHEMERIS = 9
ATTITUDE_STEP_S = 0.125
N_ATTITUDES = 233
#: Interval from a full half minute to SCENE_CENTER_TIME: all lines are between the same two epochs.
AFTER_HALF_MINUTE_S = 7.332158


@dataclass(frozen=True)
class Scene:
    """True values of one simulated scene.

    Parameters
    ----------
    id : str
        Image id.
    orbit : CircularPass
    mirror_rad : float
        Look angle psi_y of the middle of the line.
    epoch : np.datetime64
        Day of the image.
    half_minutes : int
        Half minutes of the day; the central line was taken 7.332158 s later.
    attitude_rad : (roll, pitch, yaw)
        True attitude, constant.
    full_look_table : bool
        One look-angle row per detector; otherwise only the first and last row, from which the
        reader computes the others (same camera, small files).
    """

    id: str
    orbit: CircularPass
    mirror_rad: float
    epoch: np.datetime64
    half_minutes: int
    attitude_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    full_look_table: bool = True

    @property
    def centre_time_s(self) -> float:
        """Time of the reference line, seconds of the day."""
        return EPHEMERIS_STEP_S * self.half_minutes + AFTER_HALF_MINUTE_S

    @property
    def file(self) -> str:
        """Name of the metadata file."""
        return f"{self.id}.DIM"

    def metadata(self, error: Array | None = None) -> PushbroomMetadata:
        """Metadata with an error: true minus the polynomials.

        Parameters
        ----------
        error : (9, 3) array, optional
            c0, c1, c2 of tau of position (m), velocity (m/s), attitude (rad); default none.
        """
        coefficients = np.zeros((9, 3)) if error is None else np.ascontiguousarray(error)
        sample = np.arange(float(N_SAMPLES)) if self.full_look_table else np.array([0.0, N_SAMPLES - 1.0])
        metadata = PushbroomMetadata(
            file=self.file, mission="SPOT 5", instrument="HRG 1", format="DIMAP 1.1", epoch=self.epoch,
            n_lines=N_LINES, n_samples=N_SAMPLES,
            timing=LineTiming(REFERENCE_LINE, self.centre_time_s, LINE_PERIOD_S),
            ephemeris=self._ephemeris(coefficients), attitude=self._attitude(coefficients),
            look=LookAngleTable(sample, np.zeros(len(sample)), camera_psi_y(sample, self.mirror_rad)),
        )  # fmt: skip
        return replace(metadata, frame_points=_frame_points(as_read(metadata)))

    def _ephemeris(self, error: Array) -> Ephemeris:
        time_s = EPHEMERIS_STEP_S * (self.half_minutes + np.arange(float(N_EPHEMERIS)) - N_EPHEMERIS // 2)
        position, velocity = self.orbit.states(time_s - self.centre_time_s)
        wrong = polynomials.evaluate(error, self._tau(time_s))
        return Ephemeris(time_s, position - wrong[:, 0:3], velocity - wrong[:, 3:6])

    def _attitude(self, error: Array) -> AngleAttitude:
        time_s = math.floor(self.centre_time_s) + ATTITUDE_STEP_S * (np.arange(float(N_ATTITUDES)) - N_ATTITUDES // 2)
        wrong = polynomials.evaluate(error, self._tau(time_s))
        return AngleAttitude(time_s, np.array(self.attitude_rad) - wrong[:, 6:9])

    def _tau(self, time_s: Array) -> Array:
        line = REFERENCE_LINE + (time_s - self.centre_time_s) / LINE_PERIOD_S
        return polynomials.normalised(line, N_LINES)


def camera_psi_y(sample: Array, mirror_rad: float) -> Array:
    """Look angles across track (rad) of N samples."""
    return mirror_rad + np.arctan((sample - (N_SAMPLES - 1) / 2) * (DETECTOR_M / FOCAL_LENGTH_M))


def as_read(metadata: PushbroomMetadata) -> PushbroomSensor:
    """Sensor as read from the written file: the reader interpolates a look-angle table of two detectors."""
    look = metadata.look
    if isinstance(look, LookAngleTable) and len(look.sample) < metadata.n_samples:
        metadata = replace(metadata, look=straight_line(look.sample, look.psi_x_rad, look.psi_y_rad))
    return PushbroomSensor(metadata)


def _frame_points(sensor: PushbroomSensor) -> tuple[FramePoint, ...]:
    """Four corners and the centre at height 0, computed from the metadata."""
    last_line, last_sample = N_LINES - 1.0, N_SAMPLES - 1.0
    line = [0.0, 0.0, last_line, last_line, REFERENCE_LINE]
    sample = [0.0, last_sample, last_sample, 0.0, REFERENCE_LINE]
    lon, lat, _ = ecef_to_geodetic(sensor.locate(line, sample, height_m=0.0))
    names = [*(f"corner {k}" for k in range(1, 5)), "centre"]
    return tuple(
        FramePoint(name, x, y, float(east), float(north), 0.0)
        for name, x, y, east, north in zip(names, line, sample, lon, lat, strict=True)
    )
