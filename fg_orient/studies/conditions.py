"""Condition equations of the published procedure, computed by the kernel in ``factors``.

Each image point has two conditions ``F = 0`` with derivatives ``A`` (EOP coefficients),
``G`` (ground point) and ``B`` (look angles), Terlemezoğlu 2019, eqs. 2.66-2.67 as
corrected. Units are raw, as published: metre, m/s, rad, each **per line** of the image
line x. The kernel (``factors.cameras.pushbroom``) is the kernel of the graph with other
constants: tau is the line number, the whitening is the identity, prior sigmas are one.

Some switches of the authors' program (:mod:`fg_orient.studies.switches`) change the
equations. x counts from the scene-centre line. The EOPs of the records are degree-2
polynomials, or interpolated at the line. The across-track axis ``V/|V| x Z`` is not
normalised, and the attitude is a small-angle matrix; both matrices are inverted by
transposing. The length of the short axis follows the corrections, or stays as in the
metadata. A change of this length has only cos(V, Z) = 1e-3 of the effect of a change of
direction. But a velocity along the radius has no other effect. If V is an unknown, the length therefore
determines ranks and solutions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factors.arrays import Array, Index
from factors.cameras import look, pushbroom
from factors.cameras.pushbroom_record import CORRECTION, N_EOP, RECORD, corrections
from factors.geometry import polynomials, rotations
from fg_orient.model.block import Image, ImagePoints
from fg_orient.sensors.correction import metadata_eop
from fg_orient.sensors.pushbroom import require_pushbroom
from fg_orient.studies.switches import TEXT, States, Switches, derivatives, mounting

#: Codes of the constant terms of psi_x and psi_y in ``factors.cameras.pushbroom``; B is the Jacobian by them.
LOOK_CODES = (N_EOP, N_EOP + 1)


@dataclass(frozen=True)
class Linearised:
    """Conditions of n image points, and their derivatives; each point has the rows (F_psi_y, F_psi_x).

    Parameters
    ----------
    value : (n, 2) array
        F, as tangents of look angles.
    eop : (n, 2, k) array
        A.
    ground : (n, 2, 3) array
        G, per metre ECEF.
    look : (n, 2) array
        Diagonal of B: derivatives by psi_y and psi_x.
    """

    value: Array
    eop: Array
    ground: Array
    look: Array

    @property
    def is_finite(self) -> bool:
        """True unless large corrections have caused an overflow."""
        return all(bool(np.isfinite(part).all()) for part in (self.value, self.eop, self.ground, self.look))


@dataclass(frozen=True)
class Conditions:
    """Constants of the conditions for all image points of a block.

    Parameters
    ----------
    records : (n, 34) array
        Constants of the kernel. Columns 19 and 20 are psi_x and psi_y. Columns 28-30 are
        zero, because ground corrections count from each point's own approximation.
    approximate_m : (n, 3) array
        Ground coordinates to which the records refer, ECEF.
    image, point : (n,) int arrays
        Image and ground point of each row.
    switches : Switches
        Switches that change values and derivatives. If the short axis follows the
        corrections, the records contain the mounting of the sensor.
    """

    records: Array
    approximate_m: Array
    image: Index
    point: Index
    switches: Switches = TEXT

    @property
    def _axis_follows(self) -> bool:
        return self.switches.short_axis and self.switches.length_follows

    @property
    def look_rad(self) -> Array:
        """Look angles psi_x, psi_y (n, 2)."""
        return self.records[:, RECORD.look].copy()

    def with_look(self, look_rad: Array) -> Conditions:
        """Return the conditions at other look angles (n, 2) psi_x, psi_y."""
        records = self.records.copy()
        records[:, RECORD.look] = look_rad
        return replace(self, records=records)

    def with_ground(self, ground_m: Array) -> Conditions:
        """Return the conditions at other ground coordinates (n, 3), one row per image point."""
        records = self.records.copy()
        records[:, RECORD.from_position] += ground_m - self.approximate_m
        return replace(self, records=records, approximate_m=ground_m.copy())

    def take(self, rows: Index) -> Conditions:
        """Return the conditions of the selected rows."""
        return replace(
            self,
            records=self.records[rows],
            approximate_m=self.approximate_m[rows],
            image=self.image[rows],
            point=self.point[rows],
        )

    def with_orbit(self, other: Conditions) -> Conditions:
        """Return the conditions with the EOPs of other conditions, row by row.

        Points and look angles are unchanged.
        """
        return other.with_look(self.look_rad).with_ground(self.approximate_m)

    @np.errstate(all="ignore")  # large corrections overflow: see Linearised.is_finite
    def linearise(self, codes: tuple[int, ...], eop: Array) -> Linearised:
        """Evaluate the conditions and their derivatives.

        Parameters
        ----------
        codes : tuple of k int
            EOP coefficients that are unknowns (``fg_orient.model.parameters``).
        eop : (M, k) array
            Corrections of these coefficients for each image: m, m/s, rad, per line and per line squared.
        """
        k, n = len(codes), len(self.records)
        setup = np.ascontiguousarray(np.stack([np.array(codes + LOOK_CODES, float), np.ones(k + 2)]))
        out, zero = np.empty((n, 2, k + 6)), np.zeros(3)
        unknowns = [np.append(x, [0.0, 0.0]) for x in eop]
        records, states = self.records, None
        if self._axis_follows or self.switches.look_quotients:
            states = self._states(codes, eop)
            records = records.copy()
            records[:, RECORD.mounting] = states.mounting
        for i in range(n):
            pushbroom.fill(records, i, setup, unknowns[self.image[i]], zero, out[i], True)
        design, b = out[:, :, 1 : k + 1].copy(), np.stack([out[:, 0, k + 2], out[:, 1, k + 1]], axis=1)
        if states is not None and k:
            design = self._program_derivatives(codes, states)
        return Linearised(out[:, :, 0].copy(), design, out[:, :, k + 3 :].copy(), b)

    def _states(self, codes: tuple[int, ...], eop: Array) -> States:
        """Return the corrected EOPs of each row."""
        setup = np.ascontiguousarray(np.stack([np.array(codes, float), np.ones(len(codes))]))
        d = np.array([corrections(r, setup, eop[i]) for r, i in zip(self.records, self.image, strict=True)])
        given, speed = self.approximate_m - self.records[:, RECORD.from_position], self.records[:, RECORD.velocity]
        p = given + d[:, CORRECTION.position]
        angles = np.ascontiguousarray(self.records[:, RECORD.angles] + d[:, CORRECTION.angles])
        follows = self.records[:, RECORD.follows] > 0.5
        frame_p = np.ascontiguousarray(np.where(follows[:, None], p, given))
        frame_v = np.ascontiguousarray(np.where(follows[:, None], speed + d[:, CORRECTION.velocity], speed))
        held, small = self.records[:, RECORD.mounting], bool(self.records[0, RECORD.small_angle] > 0.5)
        if self._axis_follows:
            held = mounting(frame_p, frame_v, angles, held, small)
        return States(given, p, frame_p, frame_v, angles, held, small, follows)

    def _program_derivatives(self, codes: tuple[int, ...], at: States) -> Array:
        """Return A (n, 2, k) as the authors' program computes it."""
        used, place = np.unique(np.array(codes) // 3, return_inverse=True)
        look = np.tan(self.look_rad[:, ::-1]) * np.array([1.0, -1.0])
        # the mounting of the records already contains a short axis of constant length
        by_eop = derivatives(
            at,
            self.records[:, RECORD.mounting],
            self.approximate_m - at.position_m,
            [int(k) for k in used],
            short=self._axis_follows,
            tangents=look if self.switches.look_quotients else None,
        )
        powers = self.records[:, RECORD.tau][:, None] ** (np.array(codes) % 3)
        return np.asarray(by_eop[:, :, place] * powers[:, None, :])

    def rays(
        self, codes: tuple[int, ...], eop: Array, *, metadata_position: bool = False, look_sign: float = -1.0
    ) -> tuple[Array, Array]:
        """Return the projection centres and directions (n, 3), ECEF, at the present look angles.

        Parameters
        ----------
        codes, eop
            As in :meth:`linearise`.
        metadata_position : bool
            True if projection centres come from the metadata and only rotations are corrected (``as_run``).
        look_sign : float
            Third component of the viewing direction: -1, or +1 as in the printed equations.
        """
        at = self._states(codes, eop)
        body = rotations.attitude_matrices(at.angles_rad, at.small) @ at.mounting.reshape(-1, 3, 3)
        u1 = look.direction(self.records[:, RECORD.psi_x], self.records[:, RECORD.psi_y])
        u1[:, 2] = look_sign
        frames = rotations.orbital_frames(at.frame_position_m, at.frame_velocity_m_s)
        u = np.einsum("nij,nj->ni", frames @ body, u1)
        centre = at.metadata_position_m if metadata_position else at.position_m
        return centre, u / np.linalg.norm(u, axis=1, keepdims=True)


def build(
    images: tuple[Image, ...],
    observations: ImagePoints,
    ground_m: Array,
    *,
    switches: Switches = TEXT,
    line_exact: bool = False,
) -> Conditions:
    """Return the constants of the conditions of a block.

    Parameters
    ----------
    images, observations
        Images and image points of the block.
    ground_m : (N, 3) array
        Approximate ground coordinates, ECEF.
    switches : Switches
        Switches of the equations; see the module docstring.
    line_exact : bool
        True to interpolate EOPs at the line, False to use polynomials of the line.
    """
    reference = ground_m[observations.point]
    records = np.empty((len(observations), RECORD.size))
    for k, image in enumerate(images):
        rows = np.flatnonzero(observations.image == k)
        if len(rows):
            line, sample = observations.line[rows], observations.sample[rows]
            sensor = require_pushbroom(image.sensor, image.id)
            records[rows] = sensor.records(line, sample, reference[rows], small_angle=switches.small_angles)
            if sensor.follows_orbit and not line_exact:
                records[rows, : RECORD.angles.stop] = _eop_polynomials(metadata_eop(sensor, line), line, sensor.n_lines)
            records[rows, RECORD.tau] = line - (sensor.n_lines // 2 if switches.centred_lines else 0)
    records[:, RECORD.from_position] = reference - records[:, RECORD.position]
    records[:, RECORD.reference] = 0.0
    if switches.short_axis and not switches.length_follows:
        records[:, RECORD.mounting] = mounting(
            records[:, RECORD.position],
            records[:, RECORD.velocity],
            records[:, RECORD.angles],
            records[:, RECORD.mounting],
            switches.small_angles,
        )
    return Conditions(records, reference.copy(), observations.image, observations.point, switches)


def _eop_polynomials(values: Array, line: Array, n_lines: int) -> Array:
    """Return the nine EOPs (n, 9) from degree-2 polynomials through the lines of the points (T-Table 4.1)."""
    tau = polynomials.normalised(line, n_lines)
    coefficients, _ = polynomials.fit(tau, values, min(2, len(np.unique(line)) - 1))
    return polynomials.evaluate(coefficients, tau)
