"""What a pushbroom sensor needs from a metadata file, free of any file format.

Readers (``fg_orient.formats.dimap1``, ``dimap2``) produce these immutable records; the sensor
(``fg_orient.sensors.pushbroom``) consumes them. Conventions: times are seconds since
``epoch`` (0 h UTC of the day of the image), positions and velocities are Earth-fixed
(ECEF, WGS84) in m and m/s, angles rad, pixels (line, sample) with (0, 0) = centre of the
first pixel. Attitudes are body to orbital frame of convention B (X = V x Z right of
flight, Y = Z x X forward, Z = radial outward) or body to ECEF quaternions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import Finding

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LineTiming:
    """``t(line) = reference_time_s + line_period_s * (line - reference_line)``."""

    reference_line: float  # 0-based
    reference_time_s: float
    line_period_s: float


@dataclass(frozen=True)
class Ephemeris:
    """State vectors: ``time_s`` (n,), ``position_m`` (n, 3), ``velocity_m_s`` (n, 3), ECEF."""

    time_s: Array
    position_m: Array
    velocity_m_s: Array


@dataclass(frozen=True)
class AngleAttitude:
    """Sampled angles, linear in time: ``time_s`` (n,), ``angles_rad`` (n, 3) = roll, pitch, yaw.

    The sign step is already done: roll and pitch are the negated DIMAP v1 values, yaw is kept
    (docs/equations.md 2).
    """

    time_s: Array
    angles_rad: Array


@dataclass(frozen=True)
class QuaternionList:
    """Sampled quaternions body to ECEF, scalar part first: ``time_s`` (n,), ``quaternion`` (n, 4).

    Signs are aligned (``factors.geometry.interpolation.sign_aligned``): neighbours have a positive product.
    """

    time_s: Array
    quaternion: Array


@dataclass(frozen=True)
class QuaternionPolynomial:
    """``Q_j(t) = sum_i coefficients[j, i] ((t - offset_s) / scale_s)^i``, body to ECEF; (4, k)."""

    offset_s: float
    scale_s: float
    coefficients: Array


@dataclass(frozen=True)
class LookAngleTable:
    """Look angles per detector, tangents linear in the sample.

    ``sample`` (n,) 0-based detector numbers, increasing; ``psi_x_rad`` and ``psi_y_rad`` (n,).
    """

    sample: Array
    psi_x_rad: Array
    psi_y_rad: Array


@dataclass(frozen=True)
class LookAnglePolynomial:
    """Tangents of the look angles as polynomials of ``sample - origin_sample``.

    ``tan_psi_x`` (k,) along track and ``tan_psi_y`` (k,) across track, constant term first.
    """

    origin_sample: float
    tan_psi_x: Array
    tan_psi_y: Array


@dataclass(frozen=True)
class FramePoint:
    """A point whose ground position the file states itself; ``height_m`` None if not given."""

    id: str
    line: float
    sample: float
    lon_deg: float
    lat_deg: float
    height_m: float | None


@dataclass(frozen=True)
class PushbroomMetadata:
    """Everything the rigorous model of one pushbroom image needs."""

    file: str
    mission: str  # "SPOT 5", "SPOT 6", "PHR 1A", ...
    instrument: str
    format: str  # "DIMAP 1.1", "DIMAP 2.0", ...
    epoch: np.datetime64  # 0 h UTC, datetime64[D]
    n_lines: int
    n_samples: int
    timing: LineTiming
    ephemeris: Ephemeris
    attitude: AngleAttitude | QuaternionList | QuaternionPolynomial
    look: LookAngleTable | LookAnglePolynomial
    frame_points: tuple[FramePoint, ...] = ()
    notes: tuple[Finding, ...] = field(default=())
    frame_note: Finding | None = None  # why the frame points need not agree with the model; among the notes, too
