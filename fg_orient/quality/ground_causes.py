"""Likely causes of a doubt in measured coordinates: heights, units, datum, ids (``fg_orient.quality.causes``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import lgamma
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.problem import Problem, State
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.geodesy.crs import DatumShift, known_shifts
from fg_orient.geodesy.geoid import world_undulation_m
from fg_orient.geodesy.heights import undulation_m
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError
from fg_orient.model.names import Role
from fg_orient.quality import hypotheses, mended
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.cause import PAIRED, Cause, Mend, penalty_of, without_parameter
from fg_orient.quality.cofactors import PointCofactors
from fg_orient.quality.image_causes import ImageErrors

#: Maximum number of check points used.
MOST: Final = 300
#: Maximum length in metres of a height offset that can be a geoid undulation, and of a constant vector that can be a
#: datum shift.
UNDULATION_M, DATUM_M = 110.0, 1000.0
#: Number of standard deviations within which a constant vector agrees with the shift of a known datum.
AGREES: Final = 3.0
#: Factors to metres from other units of heights.
UNITS: Final = {"feet": 0.3048, "US survey feet": 1200.0 / 3937.0, "kilometres": 1000.0}
#: Minimum number of points with a mistake in a part of a table, and maximum size of a group in which parts are
#: searched.
SOME: Final = 3
MOST_SOME: Final = 100
#: Name of the group of all measured points.
ALL: Final = "control and check points"
_EGM96: Final = "EPSG:4326+5773"
#: Roles of the groups of points that may have a common mistake.
_ROLES: Final = {
    "control points": (Role.CONTROL,), "check points": (Role.CHECK,),
    ALL: (Role.CONTROL, Role.CHECK),
}  # fmt: skip


@dataclass(frozen=True)
class GroundErrors:
    """Residuals and innovations of control and check points with their cofactors, whitened.

    Parameters
    ----------
    problem : Problem
    ids : tuple of str
    index : (n,) int array
        Ground points.
    given_m : (n, 3) array
        Measured coordinates, ECEF or local, control points first.
    n_control : int
    whitening : (n, 3, 3) array
        Factors from metres to sigmas.
    v, k : (3 c,), (3 (n - c),) arrays
        Residuals of control points, innovations of check points.
    free, gain, inverse : arrays
        R, H_kc and S^-1.
    """

    problem: Problem
    ids: tuple[str, ...]
    index: Index
    given_m: Array
    n_control: int
    whitening: Array
    v: Array
    k: Array
    free: Array
    gain: Array
    inverse: Array

    @classmethod
    def of(
        cls, problem: Problem, state: State, cofactors: PointCofactors, check: PointDifferences
    ) -> GroundErrors | None:
        """Return the system of a solution; None without measured points that are unknowns."""
        control = np.flatnonzero(problem.observed)
        usable = problem.active[check.index] & (np.nan_to_num(check.own_sigma_enu_m) > 0.0).all(axis=1)
        rows = np.flatnonzero(usable)[:: -(-max(int(usable.sum()), 1) // MOST)]
        index = np.concatenate([control, check.index[rows]])
        if not len(index):
            return None
        adjusted = state.ground[index] + problem.origin_m
        c, own = len(control), check.own_sigma_enu_m[rows]
        whitening = np.concatenate([problem.control_weights(control), problem.axes(adjusted[c:]) / own[:, :, None]])
        away = np.concatenate([
            np.linalg.solve(whitening[:c], problem.control_residuals(state, control)[:, :, None])[:, :, 0],
            check.ecef_m[rows],
        ])  # fmt: skip
        q = cofactors.joint((), tuple(index.tolist())).reshape(len(index), 3, len(index), 3)
        h = np.einsum("aij,ajbk,blk->aibl", whitening, q, whitening).reshape(3 * len(index), -1)
        w, m = np.einsum("aij,aj->ai", whitening, away).ravel(), 3 * c
        ids = tuple(problem.block.points.ids[j] for j in index)
        return cls(
            problem,
            ids,
            index,
            adjusted - away,
            c,
            whitening,
            w[:m],
            w[m:],
            np.eye(m) - h[:m, :m],
            h[m:, :m],
            np.linalg.inv(np.eye(len(w) - m) + h[m:, m:]),
        )

    def normal(self, error_m: Array) -> tuple[Array, Array]:
        """Compute G (p,) and M (p, p) of errors (n, 3, p) of the measured coordinates in metres."""
        e = np.einsum("aij,ajp->aip", self.whitening, error_m).reshape(-1, error_m.shape[2])
        m = 3 * self.n_control
        seen = self.gain @ e[:m] - e[m:]
        weighted = self.inverse @ seen
        return weighted.T @ self.k - e[:m].T @ self.v, e[:m].T @ self.free @ e[:m] + weighted.T @ seen

    def _fitted(self, error_m: Array) -> tuple[float, int, Array, Array]:
        """Estimate free parameters; return T, p, estimates and standard deviations. p is 0 if this is impossible."""
        g, normal = self.normal(error_m)
        whitened = np.einsum("aij,ajp->aip", self.whitening, error_m)
        length = np.maximum(np.sqrt(np.einsum("aip,aip->p", whitened, whitened)), np.finfo(float).tiny)
        t, rank, theta = hypotheses.quadratic(g / length, normal / np.outer(length, length))
        if int(rank) < len(g):
            return 0.0, 0, g, g
        return float(t), len(g), theta / length, np.sqrt(np.diag(np.linalg.inv(normal)))

    def causes(self) -> Iterator[Cause]:
        """Yield all mistakes in ground coordinates, and the errors of single points."""
        n, c = len(self.ids), self.n_control
        penalty = penalty_of(self.problem)
        axes = np.swapaxes(self.problem.axes(self.given_m), 1, 2)  # columns are East, North, Up
        groups = {"control points": np.arange(n) < c, "check points": np.arange(n) >= c}
        if 0 < c < n:
            groups[ALL] = np.ones(n, bool)
        for name, members in groups.items():
            if members.sum() >= 2:
                part = axes * members[:, None, None]
                yield from self._offsets(name, members, part, penalty)
                yield from self._units(name, members)
                yield from self._datums(name, members, part)
        single, parts = [], []
        for a in range(n):
            g, normal = self.normal(axes * (np.arange(n) == a)[:, None, None])
            length = np.linalg.norm(self.whitening[a] @ axes[a], axis=0)
            t, rank, _ = hypotheses.quadratic(g / length, normal / np.outer(length, length))
            parts.append((g, normal))
            single.append(float(t))
            if rank:
                group = "control points" if a < c else "check points"
                yield Cause(group, "", float(t), int(rank), float(t - rank * penalty), "single", point=self.ids[a])
        worst = sorted(np.argsort(single[:c])[::-1][:PAIRED].tolist())
        for a, b in combinations(worst, 2):
            error = np.zeros((n, 3, 1))
            error[a, :, 0], error[b, :, 0] = self.given_m[a] - self.given_m[b], self.given_m[b] - self.given_m[a]
            yield self._fixed(
                f"ids of the control points {self.ids[a]} and {self.ids[b]} exchanged",
                error,
                "exchange the two ids in the table of points",
                "ids",
                partial(mended.with_coordinates_of, points={self.ids[a]: self.ids[b], self.ids[b]: self.ids[a]}),
            )
        for a in worst:
            yield from self._second_ids(a, axes[a], *parts[a])

    def _second_ids(self, a: int, axes: Array, g: Array, normal: Array) -> Iterator[Cause]:
        """Yield causes in which the image points of a control point show the place of another control point."""
        error = (self.given_m[a] - self.given_m[: self.n_control]) @ axes
        gain = 2.0 * error @ g - np.einsum("ni,ij,nj->n", error, normal, error)
        name = self.ids[a]
        for b in range(self.n_control):
            if b != a:
                yield without_parameter(
                    f"one control point under two ids: the image points of {name} show the place of {self.ids[b]}",
                    float(gain[b]),
                    "give these image points the right id, or leave one of the two points out",
                    "second id",
                    partial(mended.with_coordinates_of, points={name: self.ids[b]}),
                    name,
                )

    def _offsets(self, name: str, members: Mask, axes: Array, penalty: float) -> Iterator[Cause]:
        """Yield the constant offsets of a group: of the heights, and of all coordinates."""
        t, p, theta, sigma = self._fitted(axes[:, :, 2:])
        roles, flat = _ROLES[name], np.array([0.0, 0.0, 1.0])
        if p and self.problem.block.georeferenced and abs(theta[0]) <= UNDULATION_M:
            # a height that is smaller than the ellipsoidal height by the undulation is orthometric
            text = (
                f"heights of the {name} look orthometric: ellipsoidal heights are {-theta[0]:+.2f} +- "
                f"{sigma[0]:.2f} m above them"
            )
            cure = "give the zero level of the table: crs such as EPSG:32636+EGM96, a geoid file, or undulation_m"
            yield Cause(
                text,
                cure,
                t,
                1,
                t - penalty,
                name,
                partial(mended.shifted, roles=roles, error_m=theta[0] * flat),
                detail=partial(self._geoid, members),
            )
        elif p:
            text = f"a constant error of {theta[0]:+.2f} +- {sigma[0]:.2f} m in the heights of the {name}"
            yield Cause(
                text,
                "look at the vertical datum of the table",
                t,
                1,
                t - penalty,
                name,
                partial(mended.shifted, roles=roles, error_m=theta[0] * flat),
            )
        t, p, theta, sigma = self._fitted(axes)
        if p and np.linalg.norm(theta) <= DATUM_M:
            size = ", ".join(f"{a:+.2f} +- {s:.2f}" for a, s in zip(theta, sigma, strict=True))
            text = (
                f"a constant shift of the {name}, as from another datum: {size} m {', '.join(self.problem.axis_names)}"
            )
            yield Cause(
                text,
                "look at the coordinate reference system of the table",
                t,
                3,
                t - 3 * penalty,
                name,
                partial(mended.shifted, roles=roles, error_m=theta),
                detail=partial(self._datum, theta, sigma),
            )

    def _datum(self, error_m: Array, sigma_m: Array) -> str:
        """Name the known datum whose coordinates differ by a constant vector; "" if there is none."""
        nearest = (AGREES, "")
        for one in self._known_shifts():
            away = error_m[:2] - (one.east_m, one.north_m)
            distance = float(np.max(np.abs(away) / np.hypot(sigma_m[:2], one.accuracy_m)))
            text = f"; {one.name} gives {one.east_m:+.2f}, {one.north_m:+.2f} m East, North"
            nearest = min(nearest, (distance, text))
        return nearest[1]

    def _known_shifts(self) -> tuple[DatumShift, ...]:
        """Return the shifts of the datums that are in use in this area."""
        if not self.problem.block.georeferenced:
            return ()
        lon, lat, _ = ecef_to_geodetic(self.problem.origin_m)
        return known_shifts(round(float(lon[0]), 1), round(float(lat[0]), 1))

    def _units(self, name: str, members: Mask) -> Iterator[Cause]:
        """Yield the heights of a group, or of some of its points, in another unit that was read as metres."""
        height = self._geodetic()[2]
        up = np.swapaxes(self.problem.axes(self.given_m), 1, 2)[:, :, 2] * members[:, None]
        for unit, factor in UNITS.items():
            error = up * (height * (1.0 - factor))[:, None]
            cure = f"multiply the heights of the table by {factor:.8g}"
            mend = partial(mended.heights_times, roles=_ROLES[name], factor=factor)
            yield self._fixed(f"heights of the {name} in {unit}", error[:, :, None], cure, f"{name} in {unit}", mend)
            yield from self._of_some(
                f"heights of {{}} {name} in {unit}", members, error, cure, f"{name} in {unit}", mend
            )

    def _datums(self, name: str, members: Mask, axes: Array) -> Iterator[Cause]:
        """Yield transformations of some points of a group to another datum; for all points see :meth:`_offsets`."""
        for one in self._known_shifts():
            shift = np.array([one.east_m, one.north_m, 0.0])
            yield from self._of_some(
                f"coordinates of {{}} {name} in {one.name}",
                members,
                axes @ shift,
                "look at the coordinate reference system of these points",
                f"{name} in {one.name}",
                partial(mended.shifted, roles=_ROLES[name], error_m=shift),
            )

    def _of_some(
        self, what: str, members: Mask, error_m: Array, cure: str, kind: str, mend: Callable[..., Block]
    ) -> Iterator[Cause]:
        """Yield causes in which a known error (n, 3) affects some points of a group.

        The points are found step by step. Each choice of points counts as a separate mistake.
        """
        rows = np.flatnonzero(members)
        m = len(rows)
        if not 2 * SOME <= m <= MOST_SOME:
            return
        each = np.zeros((len(self.ids), 3, m))
        each[rows, :, np.arange(m)] = error_m[rows]
        g, normal = self.normal(each)
        chosen, gain = _best_part(g, normal)
        s = int(chosen.sum())
        if SOME <= s < m:
            penalty = 2.0 * (lgamma(m + 1) - lgamma(s + 1) - lgamma(m - s + 1))
            only = tuple(self.ids[k] for k in rows[chosen])
            yield without_parameter(what.format(f"{s} of {m}"), gain - penalty, cure, kind, partial(mend, only=only))

    def image_normal(self, errors: ImageErrors, error: Array) -> tuple[Array, Array]:
        """Compute G (p,) and M (p, p) of whitened errors (q, p) of image points."""
        c = self.n_control
        g, normal, moved = errors.normal(error, self.index[c:])
        seen = np.einsum("aij,ajp->aip", self.whitening[c:], moved).reshape(-1, error.shape[1])
        weighted = self.inverse @ seen
        return g + weighted.T @ self.k, normal + weighted.T @ seen

    def _fixed(self, what: str, error_m: Array, cure: str, kind: str, mend: Mend) -> Cause:
        """Return a cause without free parameter, from its error (n, 3, 1) in metres."""
        g, normal = self.normal(error_m)
        return without_parameter(what, float(2.0 * g[0] - normal[0, 0]), cure, kind, mend)

    def _geodetic(self) -> tuple[Array, Array, Array]:
        """Return longitude and latitude in degrees and height in metres; local coordinates are returned unchanged."""
        if not self.problem.block.georeferenced:
            return self.given_m[:, 0], self.given_m[:, 1], self.given_m[:, 2]
        return ecef_to_geodetic(self.given_m)

    def _geoid(self, members: Mask) -> str:
        """Describe the mean undulation at a group's points: of EGM96, or of a coarse model if the grid is missing."""
        lon, lat, _ = self._geodetic()
        try:
            return f", EGM96 gives {np.mean(undulation_m(_EGM96, lon[members], lat[members])):+.1f} m"
        except FgOrientError:
            world_m = np.mean(world_undulation_m(lon[members], lat[members]))
            return f", the Earth's geoid is there at about {world_m:+.0f} m"


def _best_part(g: Array, normal: Array) -> tuple[Mask, float]:
    """Return the members (m,) with the largest joint gain ``2 sum(g) - sum(M)`` for errors of size 1, and the gain.

    Members are added to an empty set, and removed from the full set, one by one; the better result is used.
    """
    best = np.zeros(len(g), bool), 0.0
    for begin in (False, True):
        chosen = np.full(len(g), begin)
        gain = float(2.0 * g[chosen].sum() - normal[np.ix_(chosen, chosen)].sum())
        while True:
            sign = np.where(chosen, -1.0, 1.0)
            change = sign * 2.0 * (g - normal @ chosen) - np.diag(normal)
            k = int(np.argmax(change))
            if not change[k] > 0.0:
                break
            chosen[k] = not chosen[k]
            gain += float(change[k])
        if gain > best[1]:
            best = chosen, gain
    return best
