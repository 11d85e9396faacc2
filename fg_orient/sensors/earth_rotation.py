"""Rotation from inertial axes to Earth-fixed axes: IAU 2006/2000A with pyerfa, and IERS C04 values.

The rotation is ``x_ITRS = W(t) Rz(ERA(t)) C(t) x_GCRS`` (IERS Conventions 2010, chapter
5). Precession, nutation and polar motion are computed at both ends of the image and
interpolated linearly. The Earth rotation angle is exact. Tidal variations of UT1 and
polar motion with periods below one day are neglected. They are 0.1 ms and 1 mas, up to 5
cm on the ground. Only this module imports pyerfa.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from factors.arrays import Array
from factors.geometry import interpolation
from factors.geometry.light import EARTH_RATE_RAD_S
from fg_orient.model.errors import Finding, InputError, finding

InertialFrame = Literal["GCRS", "EME2000"]

DAY_S: Final = 86_400.0
_MJD: Final = 2_400_000.5
_UNIX_MJD: Final = 40_587
#: Mean angular rate of the Earth, revolutions per day, from the definition of UT1 (IERS Conventions 2010, eq. 5.15).
_TURNS_PER_DAY: Final = 1.00273781191135448
#: Maximum neglected UT1 - UTC if there is no C04 file, s; it follows from the definition of UTC.
MOST_UT1_S: Final = 0.9
#: Maximum neglected polar motion, observed since 1962, rad.
MOST_POLE_RAD: Final = np.radians(0.6 / 3600.0)
_EARTH_RADIUS_M: Final = 6_378_137.0


@dataclass(frozen=True, eq=False)
class EarthOrientation:
    """Daily values of an IERS series at 0 h UTC.

    Parameters
    ----------
    file : str
    mjd : (n,) array
        Modified Julian dates in steps of one day.
    pole_rad : (n, 2) array
        Coordinates x, y of the pole, rad.
    ut1_utc_s : (n,) array
    offset_rad : (n, 2) array
        Celestial pole offsets dX, dY relative to IAU 2006/2000A, rad.
    notes : tuple of Finding
    """

    file: str
    mjd: Array
    pole_rad: Array
    ut1_utc_s: Array
    offset_rad: Array
    notes: tuple[Finding, ...] = ()

    def at(self, mjd: float) -> tuple[Array, float, Array]:
        """Interpolate pole (2,), UT1 - UTC (s) and offsets (2,) at one time by a cubic through the four nearest days.

        InputError: the series does not cover the time.
        """
        if not self.mjd[0] <= mjd <= self.mjd[-1]:
            first, last = self.mjd[[0, -1]]
            raise InputError.of("earth.span", file=self.file, place="MJD", value=f"{mjd:.5f}", first=first, last=last)
        first = int(np.clip(np.searchsorted(self.mjd, mjd) - 2, 0, max(len(self.mjd) - 4, 0)))
        near = slice(first, first + 4)
        ut1_tai = self.ut1_utc_s[near] - [_tai_utc(day) for day in self.mjd[near]]  # UT1 - TAI has no leap seconds
        daily = np.column_stack([self.pole_rad[near], ut1_tai, self.offset_rad[near]])
        values = interpolation.lagrange(self.mjd[near], np.ascontiguousarray(daily), np.array([mjd]))[0]
        return values[:2], float(values[2]) + _tai_utc(mjd), values[3:]


class EarthRotation:
    """Orientation of the Earth while an image is acquired.

    Parameters
    ----------
    epoch : datetime64[D]
        Day; times are seconds since its 0 h UTC.
    span_s : tuple of 2 floats
        First and last time for which the orientation is needed.
    frame : str
        Inertial axes: "GCRS" or "EME2000" (mean equator and equinox of J2000).
    orientation : EarthOrientation, optional
        None: UT1 = UTC, and there is no polar motion.

    Raises
    ------
    InputError
        ``orientation`` does not cover the span.
    """

    def __init__(
        self, epoch: np.datetime64, span_s: tuple[float, float], frame: InertialFrame = "GCRS",
        orientation: EarthOrientation | None = None,
    ) -> None:  # fmt: skip
        self._day = float(_UNIX_MJD + epoch.astype("datetime64[D]").astype(int))
        self.orientation = orientation
        self._ends = np.array([span_s[0], max(span_s[1], span_s[0] + 1.0)])
        if orientation is not None and self._day + self._ends[1] / DAY_S > orientation.mjd[-1]:
            self._ends = np.array([span_s[0] - 1.0, span_s[0]])
        nodes = [self._slow(float(t), frame) for t in self._ends]
        self._celestial, self._polar = (np.array([node[k] for node in nodes]) for k in (0, 1))
        self._ut1_utc_s = np.array([node[2] for node in nodes])

    def _slow(self, time_s: float, frame: InertialFrame) -> tuple[Array, Array, float]:
        """Compute the celestial matrix, the polar motion and UT1 - UTC at one time."""
        import erfa

        day, part = self._day, time_s / DAY_S
        pole, ut1_utc_s, offset = np.zeros(2), 0.0, np.zeros(2)
        if self.orientation is not None:
            pole, ut1_utc_s, offset = self.orientation.at(day + part)
        tt = (_MJD + day, part + (_tai_utc(day + part) + 32.184) / DAY_S)
        x, y, s = erfa.xys06a(*tt)
        celestial = erfa.c2ixys(x + offset[0], y + offset[1], s)
        if frame == "EME2000":
            celestial = celestial @ erfa.bp06(*tt)[0].T  # frame bias: mean axes of J2000 to GCRS
        return celestial, erfa.pom00(pole[0], pole[1], erfa.sp00(*tt)), ut1_utc_s

    def _part(self, time_s: Array) -> Array:
        return np.asarray((time_s - self._ends[0]) / (self._ends[1] - self._ends[0]))

    def matrices(self, time_s: Array) -> Array:
        """Return the rotations (N, 3, 3) from inertial to Earth-fixed axes at N times, s since 0 h UTC of the epoch."""
        import erfa

        time_s = np.atleast_1d(np.asarray(time_s, float))
        f = self._part(time_s)
        ut1 = time_s + self._ut1_utc_s[0] + f * np.diff(self._ut1_utc_s)
        angle = erfa.era00(_MJD + self._day, ut1 / DAY_S)
        turn = np.zeros((len(f), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
        f = f[:, None, None]
        celestial, polar = ((1.0 - f) * ends[0] + f * ends[1] for ends in (self._celestial, self._polar))
        return np.asarray(polar @ turn @ celestial)

    def rate_rad_s(self, time_s: float) -> float:
        """Return the rate of the rotation, rad/s; its relative change with time is below 1e-15."""
        ut1_rate = 1.0 + float(np.diff(self._ut1_utc_s)[0] / np.diff(self._ends)[0])
        return 2.0 * np.pi * _TURNS_PER_DAY / DAY_S * ut1_rate


def neglected(position_m: Array) -> Finding:
    """Return a note on the largest error on the ground, below a position (3,), m, if no C04 file is given."""
    cosine = float(np.hypot(position_m[0], position_m[1]) / np.linalg.norm(position_m))
    turn = MOST_UT1_S * EARTH_RATE_RAD_S * _EARTH_RADIUS_M * cosine
    pole = MOST_POLE_RAD * _EARTH_RADIUS_M
    return finding("image.no_earth_orientation", turn_m=turn, most_s=MOST_UT1_S, pole_m=pole)


def _tai_utc(mjd: float) -> float:
    """Return TAI - UTC (s) at a UTC day from pyerfa's table.

    It is valid until the next announced leap second.
    """
    import erfa

    year, month, day, part = erfa.jd2cal(_MJD, mjd)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # pyerfa warns of years after its table was issued
        return float(erfa.dat(year, month, day, part))
