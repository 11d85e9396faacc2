"""Convert a lattice of lines of sight to a pushbroom sensor.

A lattice contains viewing directions at a grid of pixels, and positions of the satellite.
A pushbroom has the same camera all the time. Therefore the direction of row r and column
c is ``R_r k_c``. The rotations R_r of the rows and the directions k_c of the columns are
fitted to the lattice by least squares, and the largest difference is stated. Cubic
splines interpolate between rows and between columns. The image is then a general
pushbroom with the usual unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array
from factors.geometry import light
from factors.geometry.interpolation import sign_aligned
from fg_orient.model.errors import InputError, finding
from fg_orient.sensors.metadata import (
    DirectionTable,
    Ephemeris,
    GeneralMetadata,
    LightEffects,
    LineTiming,
    QuaternionList,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

#: Maximum difference between the lattice and the fitted camera, pixels.
MOST_PX: Final = 0.5
#: Minimum numbers of rows and columns, because the splines are cubic.
LEAST: Final = 4
#: Number of states between two rows. The splines are tabulated, and the sensor interpolates in the table.
DENSE: Final = 40
_ROUNDS: Final = 3


@dataclass(frozen=True, eq=False)
class Lattice:
    """Lines of sight of an image at a grid of pixels.

    Parameters
    ----------
    file, mission, instrument, format : str
    n_lines, n_samples : int
    line, sample : (r,), (c,) arrays
        Pixels of rows and columns in increasing order; 0 is the centre of the first
        pixel. They cover the image.
    direction : (r, c, 3) array
        Directions to the ground in Earth-fixed axes.
    position_m : (r, 3) array
        Positions of the satellite in Earth-fixed axes, m.
    line_period_s : float
        Line period, s. Only the velocities depend on it.
    """

    file: str
    mission: str
    instrument: str
    format: str
    n_lines: int
    n_samples: int
    line: Array
    sample: Array
    direction: Array
    position_m: Array
    line_period_s: float

    def metadata(self, effects: LightEffects) -> GeneralMetadata:
        """Return the metadata of the pushbroom that has these lines of sight.

        Raises
        ------
        InputError
            The lattice is too small or does not cover the image, or one camera cannot
            have these lines of sight.
        """
        self._require_cover()
        from scipy.interpolate import CubicSpline

        rows_s = self.line_period_s * self.line
        orbit = CubicSpline(rows_s, self.position_m)
        turns, camera, worst_px = self._factors(orbit(rows_s[len(rows_s) // 2], 1))
        quaternion = CubicSpline(rows_s, sign_aligned(turns.as_quat()[:, [3, 0, 1, 2]]))
        time_s = np.linspace(rows_s[0], rows_s[-1], DENSE * (len(rows_s) - 1) + 1)
        sample = np.arange(self.n_samples, dtype=float)
        tangents = CubicSpline(self.sample, camera[:, :2] / -camera[:, 2:])(sample)
        return GeneralMetadata(
            file=self.file, mission=self.mission, instrument=self.instrument, format=self.format,
            epoch=np.datetime64("1970-01-01", "D"), n_lines=self.n_lines, n_samples=self.n_samples,
            timing=LineTiming(0.0, 0.0, self.line_period_s),
            ephemeris=Ephemeris(time_s, orbit(time_s), orbit(time_s, 1)),
            attitude=QuaternionList(time_s, sign_aligned(quaternion(time_s)), scheme="lagrange"),
            look=DirectionTable(sample, *np.ascontiguousarray(tangents.T)), offset_m=np.zeros(3),
            mounting=np.eye(3), effects=effects,
            notes=(finding("lattice.fit (note): the lattice of {rows} x {columns} lines of sight is the lattice of one "
                           "camera to {worst_px:.4f} px", rows=len(self.line), columns=len(self.sample),
                           worst_px=worst_px),),
        )  # fmt: skip

    def _require_cover(self) -> None:
        """Refuse a lattice that is too small or does not cover the image."""
        for name, at, first, last in (("line", self.line, -0.5, self.n_lines - 0.5),
                                      ("sample", self.sample, 0.0, self.n_samples - 1.0)):  # fmt: skip
            if len(at) < LEAST or at[0] > first or at[-1] < last:
                value = f"{len(at)} from {at[0]:g} to {at[-1]:g}" if len(at) else "none"
                raise InputError.of(
                    "lattice.cover (failure): rows and columns of a lattice must cover the image, {least} or more each "
                    "-> needed: {name} {first:g} to {last:g}", file=self.file, place=f"{name}s of the lattice",
                    value=value, name=name, least=LEAST, first=first, last=last,
                )  # fmt: skip

    def _factors(self, velocity: Array) -> tuple[Rotation, Array, float]:
        """Return the rotations of the r rows, camera directions (c, 3) with Z up, and the largest difference, px."""
        from scipy.spatial.transform import Rotation

        direction = self.direction / np.linalg.norm(self.direction, axis=2, keepdims=True)
        middle = len(self.line) // 2
        up = -light.unit(direction[middle].mean(axis=0)[None])[0]
        forward = velocity - (velocity @ up) * up
        forward /= np.linalg.norm(forward)
        camera = direction[middle] @ np.stack([forward, np.cross(up, forward), up], axis=1)
        for _ in range(_ROUNDS):
            turns = Rotation.concatenate([Rotation.align_vectors(row, camera)[0] for row in direction])
            matrices = turns.as_matrix()
            camera = light.unit(np.einsum("rij,rci->cj", matrices, direction))
        apart = np.linalg.norm(np.einsum("rij,cj->rci", matrices, camera) - direction, axis=2)
        pixel = np.linalg.norm(np.diff(camera, axis=0), axis=1) / np.diff(self.sample)
        worst = float(apart.max() / pixel.mean())
        if not worst <= MOST_PX:
            raise InputError.of(
                "lattice.camera (failure): the lines of sight do not belong to one rotating camera; the largest "
                "difference must be below {most} px -> check order and axes of the lattice, or use an RPC",
                file=self.file, place="directions", value=f"{worst:.3g} px", most=MOST_PX,
            )  # fmt: skip
        return turns, camera, worst
