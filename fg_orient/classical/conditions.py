"""The condition equations of the published procedure, by the kernel of the factors.

Per image point two conditions ``F = 0`` and their derivatives ``A`` (EOP coefficients), ``G``
(ground point) and ``B`` (look angles), Terlemezoğlu 2019, eqs. 2.66-2.67 as corrected; raw units as
published: metre, m/s, rad, **per line** of the image line x counted from the first one. The kernel
(``factors.pushbroom``) is the one of the graph, only its constants differ: tau is the line number, the
whitening is the identity, prior sigmas are one.

``as_run`` repeats what the authors' program does: the across-track axis ``V/|V| x Z`` is not
renormalised (then ``Y = Z x X`` is short, too) and attitudes are small-angle matrices; both rotations
are inverted by transposing. With ``D = diag(s, s, 1)``, s the shortening, and U the attitude matrix the
ray is ``R D U u1`` and the conditions use ``U^T D R^T``. The kernel's constant mounting ``M = U^-1 D U``
gives both, as ``U M = D U``. M stays at the metadata, also where corrections are unknowns: what is
left out is the change of s itself, cos(V, Z) = 1e-3 of the effect of a change of direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from factors import look, polynomials, pushbroom, rotations
from fg_orient.block import Image, ImagePoints
from fg_orient.sensors.eop import metadata_eop
from fg_orient.sensors.kinds import require_pushbroom

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Codes of the constant terms of psi_x and psi_y in ``factors.pushbroom``: their Jacobian is B.
LOOK_CODES = (pushbroom.N_EOP, pushbroom.N_EOP + 1)


@dataclass(frozen=True)
class Linearised:
    """Conditions of n image points and their derivatives, rows (F_psi_y, F_psi_x) per point.

    Parameters
    ----------
    value : (n, 2) array
        F, tangents of look angles.
    eop : (n, 2, k) array
        A.
    ground : (n, 2, 3) array
        G, per metre ECEF.
    look : (n, 2) array
        Diagonal of B: derivatives with respect to psi_y and psi_x.
    """

    value: Array
    eop: Array
    ground: Array
    look: Array

    @property
    def is_finite(self) -> bool:
        """False where corrections are too wild for numbers."""
        return all(bool(np.isfinite(part).all()) for part in (self.value, self.eop, self.ground, self.look))


@dataclass(frozen=True)
class Conditions:
    """Constants of the conditions of all image points of a block.

    Parameters
    ----------
    records : (n, 34) array
        Constants of the kernel; columns 19 and 20 are psi_x and psi_y, columns 28-30 zero: ground
        corrections count from each point's own approximation.
    approximate_m : (n, 3) array
        Ground coordinates the records refer to, ECEF.
    image, point : (n,) int arrays
        Image and ground point of each row.
    """

    records: Array
    approximate_m: Array
    image: Index
    point: Index

    @property
    def look_rad(self) -> Array:
        """Look angles psi_x, psi_y (n, 2)."""
        return self.records[:, 19:21].copy()

    def with_look(self, look_rad: Array) -> Conditions:
        """Conditions at other look angles (n, 2) psi_x, psi_y."""
        records = self.records.copy()
        records[:, 19:21] = look_rad
        return replace(self, records=records)

    def with_ground(self, ground_m: Array) -> Conditions:
        """Conditions at other ground coordinates (n, 3), one row per image point."""
        records = self.records.copy()
        records[:, 31:34] += ground_m - self.approximate_m
        return replace(self, records=records, approximate_m=ground_m.copy())

    def take(self, rows: Index) -> Conditions:
        """Some of the rows."""
        return Conditions(self.records[rows], self.approximate_m[rows], self.image[rows], self.point[rows])

    def linearise(self, codes: tuple[int, ...], eop: Array) -> Linearised:
        """Evaluate the conditions and their derivatives.

        Parameters
        ----------
        codes : tuple of k int
            EOP coefficients that are unknowns (``fg_orient.parameters``).
        eop : (M, k) array
            Their corrections per image: m, m/s, rad, per line and per line squared.
        """
        k, n = len(codes), len(self.records)
        setup = np.ascontiguousarray(np.stack([np.array(codes + LOOK_CODES, float), np.ones(k + 2)]))
        out, zero = np.empty((n, 2, k + 6)), np.zeros(3)
        unknowns = [np.append(x, [0.0, 0.0]) for x in eop]
        for i in range(n):
            pushbroom.fill(self.records, i, setup, unknowns[self.image[i]], zero, out[i], True)
        b = np.stack([out[:, 0, k + 2], out[:, 1, k + 1]], axis=1)
        return Linearised(out[:, :, 0].copy(), out[:, :, 1 : k + 1].copy(), out[:, :, k + 3 :].copy(), b)

    def rays(
        self, codes: tuple[int, ...], eop: Array, *, metadata_position: bool = False, look_sign: float = -1.0
    ) -> tuple[Array, Array]:
        """Projection centres and directions (n, 3), ECEF, at the present look angles.

        Parameters
        ----------
        codes, eop
            As in :meth:`linearise`.
        metadata_position : bool
            Centres from the metadata, only the rotations corrected (``as_run``).
        look_sign : float
            Third component of the viewing direction: -1, or the +1 of the printed equations.
        """
        setup = np.ascontiguousarray(np.stack([np.array(codes, float), np.ones(len(codes))]))
        d = np.array([pushbroom.corrections(r, setup, eop[i]) for r, i in zip(self.records, self.image, strict=True)])
        given = self.approximate_m - self.records[:, 31:34]
        p = given + d[:, 0:3]
        v = np.ascontiguousarray(self.records[:, 3:6] + d[:, 3:6])
        follows = self.records[:, 26] > 0.5
        frame_p = np.ascontiguousarray(np.where(follows[:, None], p, given))
        frame_v = np.ascontiguousarray(np.where(follows[:, None], v, self.records[:, 3:6]))
        angles = np.ascontiguousarray(self.records[:, 6:9] + d[:, 6:9])
        body = rotations.attitude_matrices(angles, bool(self.records[0, 27] > 0.5)) @ self.records[:, 9:18].reshape(
            -1, 3, 3
        )
        u1 = look.direction(self.records[:, 19], self.records[:, 20])
        u1[:, 2] = look_sign
        u = np.einsum("nij,nj->ni", rotations.orbital_frames(frame_p, frame_v) @ body, u1)
        return (given if metadata_position else p), u / np.linalg.norm(u, axis=1, keepdims=True)


def build(images: tuple[Image, ...], observations: ImagePoints, ground_m: Array, *, as_run: bool = False) -> Conditions:
    """Constants of the conditions of a block.

    Parameters
    ----------
    images, observations
        Of the block.
    ground_m : (N, 3) array
        Approximate ground coordinates, ECEF.
    as_run : bool
        See the module docstring.
    """
    reference = ground_m[observations.point]
    records = np.empty((len(observations), pushbroom.RECORD_SIZE))
    for k, image in enumerate(images):
        rows = np.flatnonzero(observations.image == k)
        if len(rows):
            line, sample = observations.line[rows], observations.sample[rows]
            sensor = require_pushbroom(image.sensor, image.id)
            records[rows] = sensor.records(line, sample, reference[rows], small_angle=as_run)
            if sensor.follows_orbit:
                records[rows, 0:9] = _eop_polynomials(metadata_eop(sensor, line), line, sensor.n_lines)
            records[rows, 18] = line
    records[:, 31:34] = reference - records[:, 0:3]
    records[:, 28:31] = 0.0
    if as_run:
        records[:, 9:18] = _as_run_mount(records)
    return Conditions(records, reference.copy(), observations.image, observations.point)


def _eop_polynomials(values: Array, line: Array, n_lines: int) -> Array:
    """The nine EOPs (n, 9) as degree-2 polynomials through the lines of the points (T-Table 4.1)."""
    tau = polynomials.normalised(line, n_lines)
    coefficients, _ = polynomials.fit(tau, values, min(2, len(np.unique(line)) - 1))
    return polynomials.evaluate(coefficients, tau)


def _as_run_mount(records: Array) -> Array:
    """``U^-1 D U M`` of each record, (n, 9): the unnormalised frame as a mounting."""
    p, v = records[:, 0:3], records[:, 3:6]
    shortening = np.linalg.norm(np.cross(v, p), axis=1) / (np.linalg.norm(v, axis=1) * np.linalg.norm(p, axis=1))
    d = np.zeros((len(records), 3, 3))
    d[:, 0, 0] = d[:, 1, 1] = shortening
    d[:, 2, 2] = 1.0
    u = rotations.attitude_matrices(np.ascontiguousarray(records[:, 6:9]), True)
    mount = records[:, 9:18].reshape(-1, 3, 3)
    return np.asarray((np.linalg.solve(u, d @ u) @ mount).reshape(-1, 9))
