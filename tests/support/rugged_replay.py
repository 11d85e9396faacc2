"""Replay files of Rugged (Apache-2.0): dumps of locations with all that they were computed from.

A *transform* is the state at one time: Earth-fixed from inertial axes (body), and the spacecraft's position, velocity
and acceleration in its own axes, its attitude and rates. Quaternions turn frames, not vectors: the matrix of one, as
``factors.geometry.rotations`` forms it, is the transpose of what is applied.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factors.geometry.rotations import quaternion_matrices
from fg_orient.sensors.metadata import (
    DirectionTable,
    Ephemeris,
    GeneralMetadata,
    LightEffects,
    LineTiming,
    QuaternionList,
)

Array = np.ndarray
#: States are sampled this far around a transform, s: eight of them, as the interpolation takes.
SAMPLES_S = np.linspace(-0.35, 0.35, 8)
#: Spacecraft axes: Z down. Payload axes of convention A: Z up, by half a turn about X.
DOWN = np.diag([1.0, -1.0, -1.0])


def turn(rotation_vector: Array) -> Array:
    """Return the matrix that turns vectors by a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(rotation_vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = rotation_vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


@dataclass(frozen=True)
class Angular:
    """Matrix from a frame to inertial axes; rate and acceleration of the inverse, in inertial axes."""

    matrix: Array
    rate: Array
    acceleration: Array

    def at(self, dt: float) -> Array:
        """Return the matrix ``dt`` seconds later: turned by the rate, then by the acceleration."""
        return turn(-0.5 * dt * dt * self.acceleration) @ turn(-dt * self.rate) @ self.matrix


@dataclass(frozen=True)
class Transform:
    """State at one time, s since 0 h UTC."""

    time_s: float
    earth: Angular  # inertial from Earth-fixed axes
    position: Array  # (3, 3): position, velocity, acceleration of inertial axes' origin to spacecraft, its axes
    spacecraft: Angular  # inertial from spacecraft axes

    def matrices(self, time_s: Array) -> Array:
        """Return the Earth-fixed axes from inertial axes."""
        return np.array([self.earth.at(float(t) - self.time_s).T for t in time_s])

    def rate_rad_s(self, time_s: float) -> float:
        """Return the rate about the pole."""
        return float(np.linalg.norm(self.earth.rate))

    def state(self, dt: float) -> tuple[Array, Array, Array]:
        """Return the position and velocity (inertial axes), and inertial from spacecraft axes, ``dt`` seconds later."""
        p, v, a = self.position
        here, speed = p + dt * v + 0.5 * dt * dt * a, v + dt * a
        matrix = self.spacecraft.at(dt)
        rate = turn(-0.5 * dt * dt * self.spacecraft.acceleration) @ self.spacecraft.rate
        rate = rate + dt * self.spacecraft.acceleration
        return matrix @ here, matrix @ speed - np.cross(rate, matrix @ here), matrix


@dataclass
class Location:
    """A direct location: line of sight in spacecraft axes, its options, the point found (lon, lat rad, height)."""

    time_s: float
    position: Array
    los: Array
    effects: LightEffects
    result: Array = field(default_factory=lambda: np.full(3, np.nan))


@dataclass
class Replay:
    """The content of a file."""

    path: Path
    epoch: np.datetime64
    first_s: float = np.nan
    step_s: float = np.nan
    transforms: dict[int, Transform] = field(default_factory=dict)
    locations: list[Location] = field(default_factory=list)
    tiles: list[SparseDem] = field(default_factory=list)
    pixels: dict[int, Array] = field(default_factory=dict)
    datation: list[tuple[float, float]] = field(default_factory=list)  # line, time
    rate: float = np.nan  # lines per second
    inverse: list[tuple[Array, LightEffects, Array]] = field(default_factory=list)  # lon lat h; result: line, pixel

    def transform_of(self, time_s: float) -> Transform:
        """Return the nearest one of the table, as Rugged takes it."""
        return self.transforms[round((time_s - self.first_s) / self.step_s)]


class SparseDem:
    """The cells of a tile that the location asked for; ground between others is taken as far below.

    Rugged skips what its tree of least and greatest heights excludes, so cells that are not in the file cannot be hit.
    """

    UNKNOWN_M = -20_000.0

    def __init__(self, path: str, numbers: dict[str, float]) -> None:
        self.path, self._n = path, numbers
        # one row and column more: the search steps onto the border between two tiles
        self.heights = np.full((int(numbers["latRows"]) + 1, int(numbers["lonCols"]) + 1), np.nan)

    @property
    def range_m(self) -> tuple[float, float]:
        return float(np.nanmin(self.heights)), float(np.nanmax(self.heights))

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        row = (np.radians(lat_deg) - self._n["latMin"]) / self._n["latStep"]
        return row, (np.radians(lon_deg) - self._n["lonMin"]) / self._n["lonStep"]

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        row, column = (np.nan_to_num(a, nan=-1.0) for a in self.cell(lon_deg, lat_deg))
        rows, columns = self.heights.shape
        r = np.clip(np.floor(row).astype(int), 0, rows - 2)
        c = np.clip(np.floor(column).astype(int), 0, columns - 2)
        fr, fc, z = row - r, column - c, self.heights
        south = z[r, c] * (1 - fc) + z[r, c + 1] * fc
        north = z[r + 1, c] * (1 - fc) + z[r + 1, c + 1] * fc
        found = south * (1 - fr) + north * fr
        inside = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
        return np.where(inside & np.isfinite(found), found, self.UNKNOWN_M)


def _seconds(text: str, epoch: np.datetime64) -> float:
    """Return the seconds since 0 h of the epoch; fourteen decimals, so not through datetime64."""
    day, clock = text.rstrip("Z").split("T")
    h, m, s = clock.split(":")
    days = (np.datetime64(day) - epoch) / np.timedelta64(1, "D")
    return float(days * 86400.0 + int(h) * 3600.0 + int(m) * 60.0 + float(s))


def _numbers(words: list[str], *names: str) -> Array:
    """Return the numbers that follow names, three each but four after "r"."""
    out = []
    for name in names:
        k = words.index(name) + 1
        out.append(np.array([float(w) for w in words[k : k + (4 if name == "r" else 3)]]))
    return np.array(out)


def _angular(words: list[str]) -> Angular:
    q = _numbers(words, "r")[0]
    return Angular(quaternion_matrices(q[None])[0].T, *_numbers(words, "Ω", "ΩDot"))


def _effects(words: list[str]) -> LightEffects:
    flag = {name: words[words.index(name) + 1] == "true" for name in ("lightTime", "aberration", "refraction")}
    return LightEffects(flag["lightTime"], flag["aberration"], flag["refraction"])


def _value(words: list[str], name: str) -> float:
    return float(words[words.index(name) + 1])


def read_replay(path: Path) -> Replay:
    """Read a replay file."""
    lines = path.read_text("utf-8").splitlines()
    day = next(w for line in lines if line.startswith("span") for w in line.split() if "T" in w and w.endswith("Z"))
    out, tiles = Replay(path, np.datetime64(day[:10])), {}
    for line in lines:
        head, words = line.split(":")[0], line.split()
        if head == "span":
            out.first_s, out.step_s = _seconds(words[2], out.epoch), _value(words, "tStep")
        elif head == "transform":
            number = int(_value(words, "index"))
            out.transforms[number] = _transform(words, out.first_s + number * out.step_s)
        elif head == "direct location":
            p, los = _numbers(words, "position", "los")
            out.locations.append(Location(_seconds(words[3], out.epoch), p, los, _effects(words)))
        elif head == "direct location result":
            names = ("longitude", "latitude", "elevation")
            out.locations[-1].result = np.array([_value(words, name) for name in names])
        elif head == "DEM tile":
            numbers = {name: float(words[k + 1]) for k, name in enumerate(words) if name[:3] in ("lat", "lon")}
            tiles[words[2]] = SparseDem(f"{path.name} {words[2]}", numbers)
        elif head == "DEM cell":
            row, column = int(_value(words, "latIndex")), int(_value(words, "lonIndex"))
            tiles[words[2]].heights[row, column] = _value(words, "elevation")
        elif head == "sensor datation":
            out.datation.append((_value(words, "lineNumber"), _seconds(words[-1], out.epoch)))
        elif head == "sensor rate":
            out.rate = _value(words, "rate")
        elif head == "sensor":
            out.position = _numbers(words, "position")[0]
        elif head == "sensor LOS":
            out.pixels[int(_value(words, "pixelNumber"))] = _numbers(words, "los")[0]
        elif head == "inverse location":
            point = np.array([_value(words, name) for name in ("longitude", "latitude", "elevation")])
            out.inverse.append((point, _effects(words), np.full(2, np.nan)))
        elif head == "inverse location result":
            out.inverse[-1][2][:] = _value(words, "lineNumber"), _value(words, "pixelNumber")
    out.tiles = [t for t in tiles.values() if np.isfinite(t.heights).any()]
    return out


def _transform(words: list[str], time_s: float) -> Transform:
    k = words.index("spacecraft")
    return Transform(time_s, _angular(words[:k]), _numbers(words[k:], "p", "v", "a"), _angular(words[k:]))


def orbit_and_attitude(t: Transform) -> tuple[Ephemeris, QuaternionList]:
    """Return the states around a transform, as a sensor description has them: inertial axes, quaternions."""
    states = [t.state(float(dt)) for dt in SAMPLES_S]
    times = t.time_s + SAMPLES_S
    orbit = Ephemeris(times, np.array([s[0] for s in states]), np.array([s[1] for s in states]), "EME2000")
    # dense where locations are: with 2e-4 rad/s2, 5 ms between nodes would cost 0.5 mm
    fine = np.union1d(np.linspace(SAMPLES_S[0], SAMPLES_S[-1], 141), np.linspace(-1e-3, 1e-3, 81))
    q = np.array([quaternion_of(t.spacecraft.at(float(dt)) @ DOWN) for dt in fine])
    q *= np.where(np.einsum("ij,j->i", q, q[0]) < 0.0, -1.0, 1.0)[:, None]
    return orbit, QuaternionList(t.time_s + fine, q, "EME2000")


def quaternion_of(m: Array) -> Array:
    """Return the quaternion, scalar first, of a rotation matrix: the largest component first, then the others by it."""
    k = np.array([
        [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [0.0, m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [0.0, 0.0, m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
        [0.0, 0.0, 0.0, m[2, 2] - m[0, 0] - m[1, 1]],
    ])  # fmt: skip
    return np.linalg.eigh(k.T)[1][:, -1]


def sensor_metadata(
    replay: Replay, t: Transform, times_s: Array, los: Array, samples: Array, effects: LightEffects, position: Array,
    line_period_s: float, reference_line: float = 0.0, n_lines: int = 2,
) -> GeneralMetadata:  # fmt: skip
    """Describe a sensor: lines at ``times_s[0]`` + period, lines of sight ``los`` (n, 3) of ``samples`` (n,)."""
    camera = los @ DOWN
    table = DirectionTable(samples.astype(float), -camera[:, 0] / camera[:, 2], -camera[:, 1] / camera[:, 2])
    orbit, attitude = orbit_and_attitude(t)
    return GeneralMetadata(
        file=replay.path.name, mission="replay", instrument="", epoch=replay.epoch, n_lines=n_lines,
        n_samples=int(samples[-1]) + 1, timing=LineTiming(reference_line, float(times_s[0]), line_period_s),
        look=table, offset_m=DOWN @ position, mounting=np.eye(3), ephemeris=orbit, attitude=attitude, earth=t,
        effects=effects,
    )  # fmt: skip
