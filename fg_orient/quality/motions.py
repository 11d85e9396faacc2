"""Motions of the whole block that no observation fixes.

Connected images and their ground points may be shifted, rotated and scaled together: seven motions. Control
points fix some of them. Sensors fix others: an image with only position unknowns cannot follow a rotation.
The images *follow* a motion if some values of their unknowns give the moved ground points nearly the same
image coordinates. The effect of such a motion on all observations is tested, with the ground points free.

The module also finds navigation unknowns that only their priors determine: shifts and drifts of strips, lever
arm and boresight. A direction is held by the priors if the block without priors determines it worse than the
prior sigma. An unknown is named if its share in such directions is at least :data:`HELD`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import Rows
from fg_orient.quality.elimination import UNOBSERVABLE
from fg_orient.quality.structure import named, of_ids
from fg_orient.sensors.frame_unknowns import NAVIGATION
from fg_orient.sensors.latitudinal import observed_by_angles

Effect = Callable[[Array, Array], Array]

#: The images follow a motion if at most this share of its effect on the image coordinates remains.
FOLLOWED: Final = 0.1
#: A named motion is free if at least this share of its length lies in the space of free motions.
MATCH: Final = 0.9
#: A motion is named only if at least this share of it is independent of the motions named before.
NEW: Final = 0.1
#: Size of a motion, m, that sentences describe: half of the points move by this distance or more.
SHIFT_M: Final = 10.0
_TINY: Final = 1e-10
#: Features are parallel if the ratio of the second to the first singular value of their directions is at most this.
PARALLEL: Final = 0.05


@dataclass(frozen=True)
class FreeMotions:
    """Motions of one part of a block that no observation fixes.

    Parameters
    ----------
    images, control, features : tuple of str
        Ids of the images, of the control points and of the control features of the part.
    words : tuple of str
        One text per free motion: "shifted together East".
    felt : (d,) array
        Root mean square of the residuals, in sigmas, after each motion by 10 m.
    strength : (d,) array
        The same effect as a singular value: root of the sum of squares per unit of the image unknowns in prior sigmas.
    moves : (z, d) array
        Motions in the unknowns of all images (shared ones once), prior sigmas.
    remedy : str
    """

    images: tuple[str, ...]
    control: tuple[str, ...]
    features: tuple[str, ...]
    words: tuple[str, ...]
    felt: Array
    strength: Array
    moves: Array
    remedy: str

    def __len__(self) -> int:
        return len(self.words)

    @property
    def unobservable(self) -> Mask:
        """Motions (d,) without effect on the observations."""
        return np.asarray(self.strength <= UNOBSERVABLE)


@dataclass(frozen=True)
class _Part:
    """Seven motions of connected images, and their effects.

    ``images``, ``rows`` (of the image points), ``points`` and ``control`` are indices; ``chords`` (3,) m by the id of
    each control feature; ``axes`` (3, 3), ``middle`` (3,) m: axes and centre of rotation; ``shift`` (N, 3, 7) m:
    movement of the points; ``moves`` (u, 7): change of the unknowns of all images; ``whole``, ``left`` (n, 7),
    compressed by QR: effect on the image points without and with the images following.
    """

    images: Index
    rows: Index
    points: Index
    control: Index
    chords: dict[str, Array]
    axes: Array
    middle: Array
    shift: Array
    moves: Array
    left: Array
    whole: Array

    @classmethod
    def of(cls, problem: Problem, rows: Rows, images: Index) -> _Part:
        """Compute motions about the median of the points; the image unknowns follow them as closely as possible."""
        ground, image, point = problem.start.ground, problem.observations.image, problem.observations.point
        mine = np.flatnonzero(np.isin(image, images))
        points = np.unique(point[mine])
        control = points[(problem.observed | observed_by_angles(problem.block) | ~problem.active)[points]]
        ids, on = problem.block.points.ids, problem.on_features
        chords = dict(on[ids[j]] for j in points if ids[j] in on) if on else {}
        axes, middle = problem.axes(problem.origin_m[None])[0], np.zeros(3)
        shift, moves = np.zeros((len(ground), 3, 7)), np.zeros((problem.n_image_unknowns, 7))
        left, whole = [np.zeros((0, 7))], [np.zeros((0, 7))]
        if len(points):
            middle = np.median(ground[points], axis=0)
            arm = ground[points] - middle
            shift[points, :, :3], shift[points, :, 6] = axes.T, arm
            for k, axis in enumerate(axes):
                shift[points, :, 3 + k] = np.cross(axis, arm)
        for k in images:
            own, p = mine[image[mine] == k], problem.parameters[k]
            if len(own):
                # the parameters of a camera that several images share stay unchanged
                a = np.where(p.own, rows.image[own, :, : len(p)], 0.0).reshape(2 * len(own), len(p))
                b = np.einsum("nij,njd->nid", rows.ground[own], shift[point[own]]).reshape(-1, 7)
                # QR compresses the two rows per image point to a few rows
                r = np.asarray(np.linalg.qr(np.hstack([a, b]), mode="r"))
                a, b = r[:, : len(p)], r[:, len(p) :]
                x = -np.linalg.lstsq(a, b, rcond=None)[0]
                moves[problem.first[k] : problem.first[k + 1]] = x
                left.append(a @ x + b)
                whole.append(b)
        return cls(images, mine, points, control, chords, axes, middle, shift, moves, np.vstack(left), np.vstack(whole))

    def effect(self, problem: Problem, rows: Rows, effect_of: Effect | None) -> Array:
        """Return the effect (q, 7) of each motion on the observations, in sigmas."""
        if effect_of is not None:
            return effect_of(problem.free(self.moves), self.shift)
        observed = self.control[problem.observed[self.control]]
        w = problem.control_weights(observed)
        at_control = np.einsum("nij,njd->nid", w, self.shift[observed]).reshape(-1, 7)
        fixed = self.rows[~problem.active[problem.observations.point[self.rows]]]
        padded = np.vstack([self.moves, np.zeros((1, 7))])[problem.columns[problem.observations.image[fixed]]]
        return np.vstack([self.left, at_control, (rows.image[fixed] @ padded).reshape(-1, 7)])

    def candidates(self, problem: Problem) -> list[tuple[str, Array]]:
        """Return named motions as coefficients (7,); motions that do not move the control points come first."""
        axes = problem.axis_names
        own = [(f"shifted together {n}", e) for n, e in zip(axes, np.eye(7), strict=False)]
        own += [(f"turned together about {n}", e) for n, e in zip(axes, np.eye(7)[3:], strict=False)]
        own.append(("scaled together", np.eye(7)[6]))
        if self.chords:
            unit = np.array([chord / np.linalg.norm(chord) for chord in self.chords.values()])
            _, spread, along = np.linalg.svd(unit)
            if len(unit) < 2 or spread[1] <= PARALLEL * spread[0]:
                direction = np.concatenate([self.axes @ along[0], np.zeros(4)])
                own.insert(0, ("shifted together along the control features, which are parallel", direction))
        if not len(self.control):
            return own
        ground, ids = problem.start.ground[self.control], [problem.block.points.ids[j] for j in self.control]
        middle, first = ground.mean(axis=0), []
        if len(ids) > 1:
            along = np.linalg.svd(ground - middle, full_matrices=False)[2][0]
            first.append((f"turned about the line through control points {named(ids)}", self._rotation(along, middle)))
        where = of_ids("control point", ids)
        first += [
            (f"turned about {n} through {where}", self._rotation(a, middle))
            for n, a in zip(axes, self.axes, strict=True)
        ]
        apart = np.concatenate([self.axes @ (self.middle - middle), np.zeros(3), np.ones(1)])
        return [*first, (f"scaled from {where}", apart), *own]

    def _rotation(self, axis: Array, through: Array) -> Array:
        """Return the coefficients (7,) of a rotation about an axis through a point."""
        return np.concatenate([self.axes @ np.cross(axis, self.middle - through), self.axes @ axis, np.zeros(1)])

    def scaled(self, c: Array) -> Array:
        """Scale the coefficients of a motion so that half of the points move 10 m or more."""
        far = np.linalg.norm(self.shift[self.points] @ c, axis=1)
        typical = float(np.median(far))
        return np.asarray(c * SHIFT_M / (typical if typical > NEW * far.max() else float(far.max())))


def free_motions(problem: Problem, rows: Rows, effect_of: Effect | None, images: Index) -> FreeMotions:
    """Find the motions of a part of the block that its observations do not fix.

    Without control points a followed motion by 10 m is free if it changes the residuals by less than their sigma (root
    mean square). Only the nonlinearity of the models then acts against it. With control it is free if its effect on all
    observations together is less than one sigma: the observations do not determine it to 10 m.

    Parameters
    ----------
    problem : Problem
    rows : Rows
        At the start.
    effect_of : callable or None
        Function that returns the effect (q, d) on all observations of movements of the images (z, d), shared unknowns
        once, and of named points (N, 3, d); the other points follow. None: the points follow the motion unchanged.
    images : int array
        Images of the part.
    """
    part = _Part.of(problem, rows, images)
    ids = tuple(problem.block.images[k].id for k in images)
    control = tuple(problem.block.points.ids[j] for j in part.control)
    names: list[tuple[str, Array]] = []
    effect = part.effect(problem, rows, effect_of)
    if len(part.points):
        size = np.asarray(np.linalg.qr(part.shift[part.points].reshape(-1, 7), mode="r"))
        followed = _weakest(part.left, part.whole, FOLLOWED)
        sigmas = 1.0 if len(control) or part.chords else np.sqrt(2 * len(part.rows))
        limit = sigmas / (SHIFT_M * np.sqrt(len(part.points)))
        names = _named(part.candidates(problem), followed @ _weakest(effect @ followed, size @ followed, limit), size)
    c = np.array([part.scaled(c) for _, c in names]).reshape(-1, 7).T
    moves, change = problem.free(part.moves @ c), np.linalg.norm(effect @ c, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        strength = change / np.linalg.norm(moves, axis=0)
    words = tuple(w for w, _ in names)
    felt = change / np.sqrt(max(2 * len(part.rows), 1))
    features = tuple(part.chords)
    remedy = _remedy(words, ids, control, features)
    return FreeMotions(ids, control, features, words, felt, strength, moves, remedy)


def _weakest(effect: Array, measure: Array, limit: float) -> Array:
    """Return coefficients (k, d) of the combinations whose effect is below ``limit`` times their measure."""
    k = measure.shape[1]
    if not k:
        return np.zeros((0, 0))
    scale = np.linalg.norm(measure, axis=0)
    scale[scale == 0.0] = 1.0
    _, s, vt = np.linalg.svd(measure / scale, full_matrices=False)
    seen = s > _TINY * max(float(s[0]), _TINY)
    unit = (vt[seen].T / s[seen]) / scale[:, None]
    _, value, direction = np.linalg.svd(np.vstack([effect @ unit, np.zeros((unit.shape[1],) * 2)]), full_matrices=False)
    return np.asarray(unit @ direction[value < limit].T)


def without(space: Array, directions: Array) -> Array:
    """Return an orthonormal basis of a space (n, d) without the projections of unit vectors (n, k) onto it."""
    along, s, _ = np.linalg.svd(space @ (space.T @ directions), full_matrices=False)
    along = along[:, s > UNOBSERVABLE]
    basis, s, _ = np.linalg.svd(space - along @ (along.T @ space), full_matrices=False)
    return np.asarray(basis[:, s > 0.5])


def _named(candidates: list[tuple[str, Array]], free: Array, size: Array) -> list[tuple[str, Array]]:
    """Return names and coefficients of motions that span the free motions (7, d)."""
    if not free.shape[1]:
        return []
    space = rest = np.linalg.qr(size @ free)[0]
    out: list[tuple[str, Array]] = []
    for words, c in candidates:
        z = size @ c
        length = float(np.linalg.norm(z))
        if not rest.shape[1] or length <= _TINY or np.linalg.norm(space.T @ z) < MATCH * length:
            continue
        if np.linalg.norm(rest.T @ z) >= NEW * length:
            out.append((words, c))
            rest = without(rest, z[:, None] / length)
    inverse = np.linalg.pinv(size)
    return out + [("moved together in another way", inverse @ rest[:, k]) for k in range(rest.shape[1])]


def _remedy(
    words: tuple[str, ...], images: tuple[str, ...], control: tuple[str, ...], features: tuple[str, ...]
) -> str:
    """Describe the measurements that fix these motions."""
    if not words:
        return ""
    if len(control) == 1:
        what = f"at least two more control points, not on a line with {control[0]},"
    elif control:
        on_line = "line" in words[0]
        what = f"at least one control point off the line of {named(control)}," if on_line else ""
        what = what or "more control points, or give those smaller sigmas,"
    elif features:
        what = "control features of other directions, or a control point,"
    elif all(w.startswith("shifted") for w in words):
        what = "a control point"
    else:
        what = "three control points or more, not on one line,"
    return f"measure {what} in {of_ids('image', images)}"


# --- navigation unknowns --------------------------------------------------------------------------

#: An unknown is named if its share of the directions that only the priors determine is at least
#: this. If two strips shift together, each has a share of one half.
HELD: Final = 0.4
#: Term, reason and remedy for each kind of unknown; the key is the beginning of the names of the unknowns.
_KINDS: Final = (
    ("gnss_shift", "shift of the receiver", "the whole block moves with it", "measure control points"),
    (
        "gnss_drift",
        "drift of the receiver",
        "the block is stretched or turned with it",
        "measure control points at both ends of the strip, or fly a cross strip",
    ),
    (
        "ins_shift",
        "shift of the attitude",
        "the boresight, or a turn of the block, looks the same",
        "fly strips to and fro, or measure control points",
    ),
    (
        "ins_drift",
        "drift of the attitude",
        "the block bends or turns with it",
        "measure control points at both ends of the strip, or more tie points between strips",
    ),
    (
        "lever",
        "lever arm",
        "a shift of the receiver or of the block looks the same",
        "measure it on the ground, or fly to and fro with control points",
    ),
    (
        "boresight",
        "boresight",
        "the shift of the attitude, or a turn of the block, looks the same",
        "fly strips to and fro, or measure control points",
    ),
)


def held_on_board(problem: Problem, values: Array, directions: Array, limit: float) -> tuple[str, ...]:
    """Return sentences on navigation unknowns that only the priors determine: one per strip and kind.

    Parameters
    ----------
    problem : Problem
    values : (k,) array
        Singular values of the block without priors, in prior sigmas.
    directions : (k, u) array
        Directions (rows) of these values, shared unknowns once.
    limit : float
        Limit below which the priors hold a direction.
    """
    ties = problem.ties
    share = np.sum(directions[values < limit] ** 2, axis=0)
    held: dict[tuple[str, str], list[str]] = {}
    for k, (image, p) in enumerate(zip(problem.block.images, problem.parameters, strict=True)):
        for j, name in enumerate(p.names):
            wide = int(problem.first[k]) + j
            free = wide if ties is None else int(ties.of[wide])
            if name not in NAVIGATION or share[free] < HELD:
                continue
            kind, _, axis = name.rpartition("_")
            axes = held.setdefault((p.shared[j] if p.shared and p.shared[j] else f"image {image.id}", kind), [])
            if axis not in axes:
                axes.append(axis)
    words = {kind: rest for kind, *rest in _KINDS}
    return tuple(
        f"{who}: {words[kind][0]} ({', '.join(axes)}) is held by its prior: {words[kind][1]}; {words[kind][2]}"
        for (who, kind), axes in held.items()
    )
