"""Likely causes of a doubt: mistakes in tables and metadata that explain the residuals better than "no mistake".

Mistakes that move points by thousands of pixels are found from the start values: the control points are projected with
the orientation of the metadata, and another reading of the tables must fit ten times better (:func:`mix_ups`). An
adjustment with such a mistake ends far from the solution, where a linearised test has no meaning.

Mistakes in ground coordinates are tested at the solution (:func:`of_solution`). With e = W E theta the whitened error
of measured coordinates (control c, check k), the residuals v_c, the innovations k (adjusted minus measured at check
points, which are no observations), ``H = W Q W^T``, ``R = I - H_cc`` and ``S = I + H_kk``::

    v_c ~ -R e_c,   k ~ H_kc e_c - e_k = G theta,   cov(v_c) = R,  cov(k) = S,  cov(v_c, k) = 0
    M = e_c^T R e_c + G^T S^-1 G,   g = G^T S^-1 k - e_c^T v_c,   T = g^T M^+ g ~ chi2(p)

(score test; Rao 1973, 6e). A mistake without free parameter (feet, exchanged ids) has theta = 1; its twofold logarithm
of the likelihood ratio is ``2 g - M``, which exceeds ``2 ln(n / alpha)`` for any of n such mistakes with probability
alpha at most if there is none (Markov's inequality).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.solve import Estimate
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef, undulation_m
from fg_orient.model.block import Block
from fg_orient.model.distributions import chi_square_tail, sidak
from fg_orient.model.errors import DECISIVE, FgOrientError, Finding, finding
from fg_orient.quality import hypotheses
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.covariance import PointCofactors
from fg_orient.quality.stated_sigmas import StatedSigma

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Probability that a cause is named although there is no mistake, where causes are tried.
ALPHA: Final = 0.001
#: Twofold logarithm of the likelihood ratio below which two causes cannot be told apart: 1 to 100.
APART: Final = 2.0 * np.log(100.0)
#: Number of control points above which nothing is tested, number of check points used, causes named together.
MOST: Final = 300
NAMED: Final = 3
#: Control points with the largest errors, among which exchanged ids are looked for.
PAIRED: Final = 12
#: Length in metres up to which a height offset can be a geoid undulation, and a constant vector a datum shift.
UNDULATION_M, DATUM_M = 110.0, 1000.0
#: Factors from units in which heights may be given to metres.
UNITS: Final = {"feet": 0.3048, "US survey feet": 1200.0 / 3937.0, "kilometres": 1000.0}
_EGM96: Final = "EPSG:4326+5773"


@dataclass(frozen=True)
class Cause:
    """A mistake that was tried.

    Parameters
    ----------
    what, cure : str
        Description with its estimated size, and remedy.
    gain : float
        Decrease of the weighted sum of squares, or twofold logarithm of the likelihood ratio.
    free : int
        Estimated parameters; 0 if the mistake has none.
    score : float
        ``gain`` less the penalty of the free parameters (BIC), by which causes are ranked.
    kind : str
        Causes of one kind contain each other; the best of them is kept. "single": an error of one point, named
        elsewhere.
    """

    what: str
    cure: str
    gain: float
    free: int
    score: float
    kind: str


def added(
    ordered: tuple[Finding, ...], problem: Problem, estimate: Estimate, cofactors: PointCofactors | None,
    sigmas: Sequence[StatedSigma], check: PointDifferences,
) -> tuple[Finding, ...]:  # fmt: skip
    """Findings of a result that is not trustworthy with its likely causes; others: see :func:`of_solution`."""
    # a mix-up moves points by thousands of pixels, which more than the sigmas of a group shows
    doubted = {f.code for f in ordered if f.severity in DECISIVE}
    mixed = mix_ups(problem.block) if not estimate.converged or doubted != {"verdict.sigmas"} else ()
    ordered = (*ordered[:1], *mixed, *ordered[1:])
    if not estimate.converged or mixed or not any(f.severity in DECISIVE for f in ordered):
        return ordered
    return ordered + of_solution(problem, estimate, cofactors, sigmas, check)


def of_solution(
    problem: Problem, estimate: Estimate, cofactors: PointCofactors | None, sigmas: Sequence[StatedSigma],
    check: PointDifferences,
) -> tuple[Finding, ...]:  # fmt: skip
    """Note on the most likely cause and those like it; empty if an error of one point explains more.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
        Of a least-squares adjustment; nothing is tested under a loss.
    cofactors : PointCofactors or None
    sigmas : sequence of StatedSigma
        Stated and estimated sigmas of groups of observations.
    check : PointDifferences
        Of the check points.
    """
    n = int(problem.observed.sum())
    if cofactors is None or estimate.weights is not None or problem.block.options.datum == "inner" or n > MOST:
        return ()
    system = _System.of(problem, estimate.state, cofactors, check)
    tried = [*(() if system is None else system.causes()), *_factors(sigmas)]
    named = [c for c in tried if c.kind != "single"]
    fixed, free = sum(c.free == 0 for c in named), sum(c.free > 0 for c in named)
    best: dict[str, Cause] = {}
    for c in sorted(named, key=lambda c: -c.score):
        tail = chi_square_tail(c.free, c.gain) if c.free else 0.0
        beyond = tail <= sidak(ALPHA / 2, free) if c.free else c.gain >= 2.0 * np.log(2 * fixed / ALPHA)
        if beyond and c.kind not in best:
            best[c.kind] = c
    single = max((c.score for c in tried if c.kind == "single"), default=-np.inf)
    first = next(iter(best.values()), None)
    if first is None or first.score <= single + APART:
        return ()
    alike = [c.what for c in list(best.values())[1:NAMED] if c.score > first.score - APART]
    return (finding("verdict.cause", what=first.what, gain=first.gain, also=alike, cure=first.cure),)


def _factors(sigmas: Sequence[StatedSigma]) -> Iterator[Cause]:
    """Sigmas of a group that are wrong by a factor f: likelihood of its residuals with the redundancy r.

    ``r (f^2 - 1 - ln f^2)`` is the twofold logarithm of the likelihood ratio of r independent normal residuals.
    """
    for one in sigmas:
        r, q = one.redundancy, max(one.factor, 1e-6) ** 2
        gain, size = r * (q - 1.0 - np.log(q)), "small" if q > 1 else "large"
        text = f"sigmas of {one.group} too {size}: factor {one.factor:.2f} +- {one.sd:.2f}"
        yield Cause(
            text, "let option variance_components estimate the sigmas", gain, 1, gain - np.log(r), f"sigma {one.group}"
        )


@dataclass(frozen=True)
class _System:
    """Residuals and innovations of control and check points with their cofactors, whitened.

    Parameters
    ----------
    problem : Problem
    ids : tuple of str
    given_m : (n, 3) array
        Measured coordinates, ECEF or local, control points first.
    n_control : int
    whitening : (n, 3, 3) array
        From metres to sigmas.
    v, k : (3 c,), (3 (n - c),) arrays
        Residuals of control points, innovations of check points.
    free, gain, inverse : arrays
        R, H_kc and S^-1.
    """

    problem: Problem
    ids: tuple[str, ...]
    given_m: Array
    n_control: int
    whitening: Array
    v: Array
    k: Array
    free: Array
    gain: Array
    inverse: Array

    @classmethod
    def of(cls, problem: Problem, state: State, cofactors: PointCofactors, check: PointDifferences) -> _System | None:
        """System of a solution; None without measured points that are unknowns."""
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
        return cls(problem, ids, adjusted - away, c, whitening, w[:m], w[m:], np.eye(m) - h[:m, :m], h[m:, :m],
                   np.linalg.inv(np.eye(len(w) - m) + h[m:, m:]))  # fmt: skip

    def normal(self, error_m: Array) -> tuple[Array, Array]:
        """G (p,) and M (p, p) of errors (n, 3, p) of the measured coordinates in metres."""
        e = np.einsum("aij,ajp->aip", self.whitening, error_m).reshape(-1, error_m.shape[2])
        m = 3 * self.n_control
        seen = self.gain @ e[:m] - e[m:]
        weighted = self.inverse @ seen
        return weighted.T @ self.k - e[:m].T @ self.v, e[:m].T @ self.free @ e[:m] + weighted.T @ seen

    def _fitted(self, error_m: Array) -> tuple[float, int, Array, Array]:
        """T, p, estimates and their standard deviations of free parameters; p = 0 if they cannot be estimated."""
        g, normal = self.normal(error_m)
        whitened = np.einsum("aij,ajp->aip", self.whitening, error_m)
        length = np.maximum(np.sqrt(np.einsum("aip,aip->p", whitened, whitened)), np.finfo(float).tiny)
        t, rank, theta = hypotheses.quadratic(g / length, normal / np.outer(length, length))
        if int(rank) < len(g):
            return 0.0, 0, g, g
        return float(t), len(g), theta / length, np.sqrt(np.diag(np.linalg.inv(normal)))

    def causes(self) -> Iterator[Cause]:
        """All mistakes in ground coordinates, and the errors of single points."""
        n, c = len(self.ids), self.n_control
        penalty = float(np.log(3 * n))
        axes = np.swapaxes(self.problem.axes(self.given_m), 1, 2)  # columns are East, North, Up
        groups = {"control points": np.arange(n) < c, "check points": np.arange(n) >= c}
        if 0 < c < n:
            groups["control and check points"] = np.ones(n, bool)
        for name, members in groups.items():
            if members.sum() >= 2:
                part = axes * members[:, None, None]
                yield from self._offsets(name, members, part, penalty)
                yield from self._units(name, members)
        single = []
        for a in range(n):
            error = np.zeros((n, 3, 3))
            error[a] = axes[a]
            t, p, _, _ = self._fitted(error)
            single.append(t)
            if p:
                yield Cause(self.ids[a], "", t, p, t - p * penalty, "single")
        for a, b in combinations(sorted(np.argsort(single[:c])[::-1][:PAIRED].tolist()), 2):
            error = np.zeros((n, 3, 1))
            error[a, :, 0], error[b, :, 0] = self.given_m[a] - self.given_m[b], self.given_m[b] - self.given_m[a]
            yield self._fixed(f"ids of the control points {self.ids[a]} and {self.ids[b]} exchanged", error,
                              "exchange the two ids in the table of points", "ids")  # fmt: skip

    def _offsets(self, name: str, members: npt.NDArray[np.bool_], axes: Array, penalty: float) -> Iterator[Cause]:
        """Constant offsets of a group: of the heights, and of all coordinates."""
        t, p, theta, sigma = self._fitted(axes[:, :, 2:])
        if p and self.problem.block.georeferenced and abs(theta[0]) <= UNDULATION_M:
            # a measured height that is too small by the undulation is orthometric
            known = self._undulation(members)
            model = "" if known is None else f", EGM96 gives {known:+.1f} m"
            text = f"heights of the {name} look orthometric: ellipsoidal heights are {-theta[0]:+.2f} +- " \
                   f"{sigma[0]:.2f} m above them{model}"  # fmt: skip
            yield Cause(
                text, "give the vertical datum of the table by crs, such as EPSG:4326+5773", t, 1, t - penalty, name
            )
        elif p:
            text = f"a constant error of {theta[0]:+.2f} +- {sigma[0]:.2f} m in the heights of the {name}"
            yield Cause(text, "look at the vertical datum of the table", t, 1, t - penalty, name)
        t, p, theta, sigma = self._fitted(axes)
        if p and np.linalg.norm(theta) <= DATUM_M:
            size = ", ".join(f"{a:+.2f} +- {s:.2f}" for a, s in zip(theta, sigma, strict=True))
            text = (
                f"a constant shift of the {name}, as from another datum: {size} m {', '.join(self.problem.axis_names)}"
            )
            yield Cause(text, "look at the coordinate reference system of the table", t, 3, t - 3 * penalty, name)

    def _units(self, name: str, members: npt.NDArray[np.bool_]) -> Iterator[Cause]:
        """Heights of a group in another unit, read as metres."""
        height = self._geodetic()[2]
        up = np.swapaxes(self.problem.axes(self.given_m), 1, 2)[:, :, 2] * members[:, None]
        for unit, factor in UNITS.items():
            error = up * (height * (1.0 - factor))[:, None]
            yield self._fixed(f"heights of the {name} in {unit}", error[:, :, None],
                              f"multiply the heights of the table by {factor:.8g}", f"{name} in {unit}")  # fmt: skip

    def _fixed(self, what: str, error_m: Array, cure: str, kind: str) -> Cause:
        """Cause without free parameter, from its error (n, 3, 1) in metres."""
        g, normal = self.normal(error_m)
        gain = float(2.0 * g[0] - normal[0, 0])
        return Cause(what, cure, gain, 0, gain, kind)

    def _geodetic(self) -> tuple[Array, Array, Array]:
        """Longitude and latitude in degrees, height in metres; local coordinates as they are."""
        if not self.problem.block.georeferenced:
            return self.given_m[:, 0], self.given_m[:, 1], self.given_m[:, 2]
        return ecef_to_geodetic(self.given_m)

    def _undulation(self, members: npt.NDArray[np.bool_]) -> float | None:
        """Mean undulation of EGM96 at the points of a group, None if its grid is not installed."""
        lon, lat, _ = self._geodetic()
        try:
            return float(np.mean(undulation_m(_EGM96, lon[members], lat[members])))
        except FgOrientError:
            return None


# --- mistakes that are seen at the start ----------------------------------------------------------

#: Minimum number of points of an image, factor by which another reading must fit better, most images compared.
LEAST_POINTS: Final = 3
BETTER: Final = 10.0
MOST_IMAGES: Final = 30

Reading = Callable[[Array, Array, Any], tuple[Array, Array]]

#: Other readings of line and sample, by their description.
READINGS: Final[dict[str, Reading]] = {
    "line and sample exchanged": lambda line, sample, sensor: (sample, line),
    "lines counted from the last one": lambda line, sample, sensor: (
        sensor.first_line + sensor.last_line - line, sample
    ),
    "samples counted from the last one": lambda line, sample, sensor: (
        line, sensor.first_sample + sensor.last_sample - sample
    ),
}  # fmt: skip


def _unpacked(angle: Array) -> Array:
    """Degrees of an angle in which the first two decimals are minutes."""
    degrees = np.trunc(angle)
    return np.asarray(degrees + (angle - degrees) * 100.0 / 60.0)


#: Other readings of longitude and latitude, by their description.
GROUND_READINGS: Final[dict[str, Callable[[Array, Array], tuple[Array, Array]]]] = {
    "longitude and latitude exchanged": lambda lon, lat: (lat, lon),
    "longitude and latitude in gon": lambda lon, lat: (0.9 * lon, 0.9 * lat),
    "longitude and latitude in radians": lambda lon, lat: (np.degrees(lon), np.degrees(lat)),
    "longitude and latitude in degrees and minutes": lambda lon, lat: (_unpacked(lon), _unpacked(lat)),
}


def mix_ups(block: Block) -> tuple[Finding, ...]:
    """Images whose control points fit far better with another reading of their coordinates, or other metadata.

    Parameters
    ----------
    block : Block

    Returns
    -------
    tuple of Finding
        One per image, with median distances between measured image points and points projected with the orientation of
        the metadata, in pixels.
    """
    out = []
    for k, image in enumerate(block.images):
        distances = _distances(block, k)
        given = distances.pop("", np.nan)
        if not distances or np.isnan(given):
            continue
        name, best = min(distances.items(), key=lambda item: item[1])
        if BETTER * best < given:
            out.append(finding("solution.mix_up", image=image.id, best_px=best, given_px=given, reading=name))
    return tuple(out)


def _distances(block: Block, k: int) -> dict[str, float]:
    """Median distance in pixels for each reading, "" as given; empty if it cannot be computed."""
    o, known, sensor = block.observations, block.points.known, block.images[k].sensor
    row = np.flatnonzero((o.image == k) & np.isfinite(known.ecef_m[o.point]).all(axis=1))
    if len(row) < LEAST_POINTS:
        return {}
    ground, line, sample = known.ecef_m[o.point[row]], o.line[row], o.sample[row]
    seen = _away(sensor, ground, line, sample)
    out = {"": seen}
    if np.isnan(seen):
        return out
    for name, reading in READINGS.items():
        try:
            out[name] = _away(sensor, ground, *reading(line, sample, sensor))
        except AttributeError:  # no size of the image
            continue
    if block.georeferenced:
        lon, lat, height = ecef_to_geodetic(ground)
        for name, turned in GROUND_READINGS.items():
            other = turned(lon, lat)
            if (np.abs(other[1]) <= 90.0).all():
                out[name] = _away(sensor, geodetic_to_ecef(*other, height), line, sample)
    if len(block.images) <= MOST_IMAGES:
        for image in block.images[:k] + block.images[k + 1 :]:
            out[f"the metadata of image {image.id}"] = _away(image.sensor, ground, line, sample)
    return {name: d for name, d in out.items() if np.isfinite(d)}


def _away(sensor: Any, ground: Array, line: Array, sample: Array) -> float:
    """Median distance in pixels of projected from measured image points; nan if too few can be projected."""
    try:
        projected = [np.asarray(x, np.float64) for x in sensor.project(ground)]
    except (FgOrientError, AttributeError):
        return float("nan")
    d = np.hypot(line - projected[0], sample - projected[1])
    return float(np.median(d[np.isfinite(d)])) if np.isfinite(d).sum() >= LEAST_POINTS else float("nan")
