"""Read sensor descriptions, which are TOML files of pushbroom images; a new sensor then needs no code.

``docs/sensor-description.md`` describes the format. Tables of states and directions are CSV files.
"""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from factors.arrays import Array
from factors.geometry import orbital
from factors.geometry.interpolation import sign_aligned
from fg_orient.formats.columns import finite
from fg_orient.formats.registry import Format
from fg_orient.formats.schema import FilePath, Number, Positive, Switch, Table, Text, read_toml
from fg_orient.formats.tables import read_numbers
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.earth_rotation import DAY_S, EarthOrientation, EarthRotation, neglected
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.metadata import (
    AngleAttitude,
    AttitudeFrame,
    Camera,
    DirectionTable,
    Ephemeris,
    Frame,
    GeneralMetadata,
    LightEffects,
    LineCamera,
    LineTiming,
    OrbitalFrame,
    QuaternionList,
)

Three = tuple[Number, Number, Number]
Coefficients = Annotated[tuple[Number, ...], Field(min_length=1, max_length=12)]
Count = Annotated[int, Field(strict=True, ge=2, le=10_000_000)]

#: Range of possible distances of a platform from the Earth's centre, m; range of its possible speeds, m/s.
RADIUS_M: Final = (6.40e6, 5.0e7)
SPEED_M_S: Final = (1.0, 1.2e4)
#: Maximum tangent of a viewing direction.
WIDEST_TANGENT: Final = 5.0
_STATE: Final = ("time_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")
_ANGLES: Final = ("time_s", "roll_deg", "pitch_deg", "yaw_deg")
_QUATERNION: Final = ("time_s", "q0", "q1", "q2", "q3")
_DIRECTIONS: Final = ("sample", "tan_forward", "tan_left")
_KIND: Final = re.compile(r"""^[^\S\n]*+kind\s*=(?!\s*["']pushbroom["'])""", re.MULTILINE)
_ARC_SECOND: Final = np.pi / 180.0 / 3600.0
_RECORD: Final = re.compile(r"^\s*\d{4}\s+\d{1,2}\s+\d{1,2}\s")
#: Maximum pole coordinates x, y (arc seconds) and UT1 - UTC (s).
_LIMITS: Final = (1.0, 1.0, 1.0)


class ImageTable(Table):
    """The ``[image]`` table."""

    lines: Count = Field(description="the number of lines, at least 2")
    samples: Count = Field(description="the number of samples, at least 2")


class TimeTable(Table):
    """The ``[time]`` table."""

    day: Text = Field(description='the UTC day that times count from, such as "2012-01-01"')
    reference_line: Number = Field(default=0.0, description="a line, 0 is the first one")
    reference_time_s: Number = Field(description="the time of the reference line, s since 0 h UTC")
    line_period_s: Number = Field(description="seconds from one line to the next")


class CameraTable(Table):
    """The ``[camera]`` table: either a lens, or the file of a table of directions."""

    focal_length_m: Positive | None = Field(default=None, description="the focal length in m, above 0")
    pitch_m: Number | None = Field(default=None, description="metres per sample along camera Y; below 0 to the right")
    principal_sample: Number | None = Field(default=None, description="the sample of the principal point")
    forward_m: Number = Field(default=0.0, description="the place of the line along camera X, m")
    delta_forward_m: Coefficients = Field(default=(0.0,), description="coefficients in brackets, m")
    delta_left_m: Coefficients = Field(default=(0.0,), description="coefficients in brackets, m")
    directions: FilePath | None = Field(default=None, description="the path of the table of directions in quotes")


class MountingTable(Table):
    """The ``[mounting]`` table."""

    offset_m: Three = Field(default=(0.0, 0.0, 0.0), description="three numbers, m")
    angles_deg: Three = Field(default=(0.0, 0.0, 0.0), description="roll, pitch, yaw, degrees")
    matrix: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")


class OrbitTable(Table):
    """The ``[orbit]`` table."""

    frame: Frame = Field(description='"ITRF", "GCRS" or "EME2000"')
    file: FilePath = Field(description="the path of the table of states in quotes")


class AttitudeTable(Table):
    """The ``[attitude]`` table."""

    frame: AttitudeFrame = Field(description='"orbital", "ITRF", "GCRS" or "EME2000"')
    file: FilePath = Field(description="the path of the table of attitudes in quotes")
    orbital_frame: OrbitalFrame = Field(
        default="earth-fixed velocity", description='"earth-fixed velocity", "inertial velocity" or "kepler"'
    )


class EarthTable(Table):
    """The ``[earth]`` table."""

    orientation: FilePath = Field(description="the path of an IERS C04 file in quotes")


class LightTable(Table):
    """The ``[light]`` table."""

    light_time: Switch = Field(default=False, description="true or false")
    aberration: Switch = Field(default=False, description="true or false")
    refraction: Switch = Field(default=False, description="true or false")


class SensorFile(Table):
    """Whole sensor description."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    kind: Literal["pushbroom"] = Field(description='kind = "pushbroom"')
    mission: Text = Field(description="the name of the satellite in quotes")
    instrument: str = Field(default="", description="the name of the instrument in quotes")
    image: ImageTable = Field(description="a table [image] with lines and samples")
    time: TimeTable = Field(description="a table [time]")
    camera: CameraTable = Field(description="a table [camera]")
    mounting: MountingTable = Field(default_factory=MountingTable, description="a table [mounting]")
    orbit: OrbitTable = Field(description="a table [orbit] with frame and file")
    attitude: AttitudeTable = Field(description="a table [attitude] with frame and file")
    earth: EarthTable | None = Field(default=None, description="a table [earth] with orientation")
    light: LightTable = Field(default_factory=LightTable, description="a table [light]")


def read_sensor_file(path: str | Path) -> GeneralMetadata:
    """Read a sensor description and the tables that it names; their paths are relative to the description.

    Raises
    ------
    InputError
        The description or a table has faults; all faults of this file are listed.
    """
    path = Path(path)
    read = read_toml(path, SensorFile)
    epoch, timing = _timing(read.time, path)
    orbit, attitude = _orbit(read.orbit, path), _attitude(read.attitude, path)
    earth, notes = _earth(read, epoch, orbit, path)
    return GeneralMetadata(
        file=str(path), mission=read.mission, instrument=read.instrument, epoch=epoch, n_lines=read.image.lines,
        n_samples=read.image.samples, timing=timing, look=_camera(read, path),
        offset_m=np.array(read.mounting.offset_m), mounting=_mounting(read.mounting, path), ephemeris=orbit,
        attitude=attitude, orbital_frame=read.attitude.orbital_frame, earth=earth,
        effects=LightEffects(**dict(read.light)), notes=notes,
    )  # fmt: skip


def _timing(table: TimeTable, path: Path) -> tuple[np.datetime64, LineTiming]:
    try:
        epoch = np.datetime64(datetime.date.fromisoformat(table.day), "D")
    except ValueError:
        raise InputError.of("earth.day", file=path, place="time.day", value=table.day) from None
    if table.line_period_s == 0.0:
        raise InputError.of("earth.period", file=path, place="time.line_period_s", value=table.line_period_s)
    return epoch, LineTiming(table.reference_line, table.reference_time_s, table.line_period_s)


def _camera(read: SensorFile, path: Path) -> Camera:
    """Return the lens or the table of directions; exactly one of them must be complete."""
    c, n = read.camera, read.image.samples
    lens = (c.focal_length_m, c.pitch_m, c.principal_sample)
    if (c.directions is None) == (None in lens) or (c.directions is not None and lens != (None,) * 3):
        raise InputError.of("earth.camera", file=path, place="camera")
    camera: Camera
    if c.directions is None:
        delta = (np.array(c.delta_forward_m), np.array(c.delta_left_m))
        camera = LineCamera(*lens, c.forward_m, n, *delta)  # type: ignore[arg-type]    # all are present
    else:
        path = path.parent / c.directions
        sample, forward, left = _increasing(path, _DIRECTIONS).T
        if sample[0] > 0.0 or sample[-1] < n - 1:
            value = f"{sample[0]:g} .. {sample[-1]:g}"
            raise InputError.of("earth.directions", file=path, place="column sample", value=value, last=n - 1)
        camera = DirectionTable(sample, forward, left)
    widest = float(np.abs(camera.tangents(np.linspace(0.0, n - 1.0, 101))).max())
    if widest > WIDEST_TANGENT:
        raise InputError.of("earth.wide", file=path, place="camera", value=f"tangent {widest:.3g}", most=WIDEST_TANGENT)
    return camera


def _mounting(table: MountingTable, path: Path) -> Array:
    """Return the rotation from camera axes to payload axes: the stated matrix, or the matrix of the angles."""
    if table.matrix is None:
        return np.asarray(orbital.attitude_matrices(np.radians([table.angles_deg]))[0])
    m = np.array(table.matrix)
    away = float(away_from_rotation(m))
    if any(table.angles_deg) or away > ORTHONORMAL:
        value = not_a_rotation(away) if away > ORTHONORMAL else "angles and a matrix"
        raise InputError.of("earth.matrix", file=path, place="mounting.matrix", value=value)
    return m


def _increasing(file: Path, columns: tuple[str, ...]) -> Array:
    """Read a table (n, k) with at least two records; its first column must increase."""
    values = read_numbers(file, [columns])[0]
    if len(values) < 2 or (np.diff(values[:, 0]) <= 0.0).any():
        raise InputError.of("earth.order", file=file, place=f"column {columns[0]}", value=f"{len(values)} records")
    return values


def _orbit(table: OrbitTable, path: Path) -> Ephemeris:
    file = path.parent / table.file
    values = _increasing(file, _STATE)
    p, v = np.ascontiguousarray(values[:, 1:4]), np.ascontiguousarray(values[:, 4:7])
    for what, size, (low, high) in (("distance from the Earth's centre", p, RADIUS_M), ("speed", v, SPEED_M_S)):
        length = np.linalg.norm(size, axis=1)
        bad = np.flatnonzero((length < low) | (length > high))
        if len(bad):
            place = f"record {bad[0] + 1}"
            raise InputError.of("earth.state", file=file, place=place, value=f"{length[bad[0]]:g}", what=what, low=low,
                                high=high)  # fmt: skip
    return Ephemeris(np.ascontiguousarray(values[:, 0]), p, v, table.frame)


def _attitude(table: AttitudeTable, path: Path) -> AngleAttitude | QuaternionList:
    file = path.parent / table.file
    values = _increasing(file, _ANGLES if table.frame == "orbital" else _QUATERNION)
    time_s = np.ascontiguousarray(values[:, 0])
    if table.frame == "orbital":
        return AngleAttitude(time_s, np.radians(values[:, 1:]))
    away = np.abs(np.linalg.norm(values[:, 1:], axis=1) - 1.0)
    if away.max() > 1e-4:
        place = f"record {int(away.argmax()) + 1}"
        raise InputError.of("earth.quaternion", file=file, place=place, value=f"{away.max():.2g} off 1")
    return QuaternionList(time_s, sign_aligned(values[:, 1:]), table.frame)


def _earth(
    read: SensorFile, epoch: np.datetime64, orbit: Ephemeris, path: Path
) -> tuple[EarthRotation | None, tuple[Finding, ...]]:
    """Return the Earth orientation if a reference frame needs it, and notes."""
    inertial = {f for f in (read.orbit.frame, read.attitude.frame) if f in ("GCRS", "EME2000")}
    if not inertial:
        return None, () if read.earth is None else (finding("image.earth_not_needed"),)
    if len(inertial) > 1:
        raise InputError.of("earth.two_frames", file=path, place="attitude.frame", value=", ".join(sorted(inertial)))
    span = (float(orbit.time_s[0]), float(orbit.time_s[-1]))
    if span[0] < -DAY_S or span[1] > 2.0 * DAY_S:
        raise InputError.of("earth.seconds", file=path, place="orbit.file", value=f"{span[0]:g} .. {span[1]:g} s")
    frame: Literal["GCRS", "EME2000"] = "GCRS" if "GCRS" in inertial else "EME2000"
    if read.earth is None:
        ground_side = orbit.position_m[len(orbit.position_m) // 2]
        return EarthRotation(epoch, span, frame), (neglected(ground_side),)
    series = read_earth_orientation(path.parent / read.earth.orientation)
    return EarthRotation(epoch, span, frame, series), series.notes


# --- IERS C04 ------------------------------------------------------------------------------------


def read_earth_orientation(path: str | Path) -> EarthOrientation:
    """Read a C04 file of the IERS, or a part of it with at least two days.

    Celestial pole offsets that refer to the equinox (columns dPsi, dEps, relative to IAU
    1980) are not used, and a note reports this. The offsets relative to IAU 2006/2000A
    are below 1 mas, which is 3 cm on the ground.

    Raises
    ------
    InputError
        The file cannot be read, contains no records of this kind, has gaps, or has an impossible value.
    """
    try:
        text = Path(path).read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError.of("earth.unreadable", file=path, value=error.strerror) from None
    lines = text.replace("\r\n", "\n").split("\n")
    records = [(n, line.split()) for n, line in enumerate(lines, 1) if _RECORD.match(line)]
    if len(records) < 2:
        raise InputError.of("earth.no_records", file=path, value=f"{len(records)} records")
    # columns: year, month, day (, hour), MJD, x, y, UT1 - UTC; then LOD, dX, dY; since C04 20 only dX, dY
    hour = finite(records[0][1][3:4])
    columns = (4, 5, 6, 7, 8, 9) if hour is not None and (hour < 100.0).all() else (3, 4, 5, 6, 8, 9)
    values = [finite([words[k] for k in columns if k < len(words)]) for _, words in records]
    for (n, words), row in zip(records, values, strict=True):
        if row is None or len(row) < len(columns):
            raise InputError.of("earth.record", file=path, place=f"line {n}", value=" ".join(words)[:60])
    table = np.array(values, float)
    gaps = np.flatnonzero(np.abs(np.diff(table[:, 0]) - 1.0) > 1e-9) + 1
    bad = np.flatnonzero((np.abs(table[:, 1:4]) > _LIMITS).any(axis=1))
    for code, rows, cells in (("earth.gap", gaps, 0), ("earth.value", bad, slice(1, 4))):
        if len(rows):
            raise InputError.of(code, file=path, place=f"line {records[rows[0]][0]}", value=table[rows[0], cells])
    offset, notes = table[:, 4:6] * _ARC_SECOND, tuple[Finding, ...]()
    if "dpsi" in text[:5000].lower():
        offset, notes = 0.0 * offset, (finding("image.pole_offsets"),)
    return EarthOrientation(str(path), table[:, 0], table[:, 1:3] * _ARC_SECOND, table[:, 3], offset, notes)


FORMAT = Format(
    name="pushbroom", title='sensor description (TOML, kind = "pushbroom")', suffixes=(".toml",),
    sniff=lambda path, head: path.suffix.lower() == ".toml" and _KIND.search(head) is None,
    read_image=lambda path: GeneralPushbroom(read_sensor_file(path)),
)  # fmt: skip
