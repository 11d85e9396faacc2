"""Motions of a block as a whole, and whether anything but the priors holds it in the world.

Images that hang together may be shifted, turned and scaled with their ground points: seven motions, of which the
control points hold some and the sensors others (an image whose orientation may only be shifted cannot follow a turn).
A motion is one of the block if its images can *follow*: with the unknowns that suit best they see the moved ground
where they saw it before. Followed motions are judged by what the observations then feel of them, ground points
free to give way.

Observations on board: shifts and drifts of strips, lever arm and boresight that only their priors determine.
Directions of the block without priors that are determined worse than their prior sigma are held by the priors. An
unknown is named if its share in such directions is at least :data:`HELD`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import Rows
from fg_orient.quality.structure import named
from fg_orient.sensors.frame import NAVIGATION

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Singular values of whitened Jacobians in prior sigmas up to this: the data say nothing.
UNOBSERVABLE: Final = 1e-5
#: Images follow a motion if less than this share of what it does to their pixels is left.
FOLLOWED: Final = 0.1
#: A named motion is free if this share of its length lies among the free ones.
MATCH: Final = 0.9
#: What of a named motion must be new beside those named before.
NEW: Final = 0.1
#: Size of a motion in sentences: half of the points go as far or farther.
SHIFT_M: Final = 10.0
_TINY: Final = 1e-10


@dataclass(frozen=True)
class FreeMotions:
    """What no observation holds of one part of a block.

    Parameters
    ----------
    images, control : tuple of str
        Ids of the images and of the control points of the part.
    words : tuple of str
        One per free motion: "shifted together East".
    felt : (d,) array
        Root mean square of the residuals, in sigmas, after each motion by 10 m.
    strength : (d,) array
        The same as a singular value: root of the sum of squares per unit of the image unknowns in prior sigmas.
    moves : (u, d) array
        The motions in the unknowns of all images, prior sigmas.
    remedy : str
    """

    images: tuple[str, ...]
    control: tuple[str, ...]
    words: tuple[str, ...]
    felt: Array
    strength: Array
    moves: Array
    remedy: str

    def __len__(self) -> int:
        return len(self.words)

    @property
    def unobservable(self) -> npt.NDArray[np.bool_]:
        """Motions that the observations do not feel at all (d,)."""
        return np.asarray(self.strength <= UNOBSERVABLE)


@dataclass(frozen=True)
class _Part:
    """Images that hang together, their image points, ground points and control points, by number."""

    images: Index
    rows: Index
    points: Index
    control: Index

    @classmethod
    def of(cls, problem: Problem, images: Index) -> _Part:
        rows = np.flatnonzero(np.isin(problem.observations.image, images))
        points = np.unique(problem.observations.point[rows])
        control = points[problem.observed[points] | ~problem.active[points]]
        return cls(images, rows, points, control)


@dataclass(frozen=True)
class _Motions:
    """The seven motions and what they do: movement of the points (N, 3, 7) m, of the images (u, 7), pixels left."""

    names: tuple[str, ...]
    axes: Array
    middle: Array
    shift: Array
    moves: Array
    left: Array
    whole: Array

    def candidates(self, problem: Problem, control: Index) -> list[tuple[str, Array]]:
        """Motions with names, as coefficients (7,): first those that leave the control points where they are."""
        own = [(f"shifted together {n}", e) for n, e in zip(self.names, np.eye(7), strict=False)]
        own += [(f"turned together about {n}", e) for n, e in zip(self.names, np.eye(7)[3:], strict=False)]
        own.append(("scaled together", np.eye(7)[6]))
        if not len(control):
            return own
        ground, ids = problem.start.ground[control], [problem.block.points.ids[j] for j in control]
        middle, first = ground.mean(axis=0), []
        if len(control) > 1:
            along = np.linalg.svd(ground - middle)[2][0]
            first.append((f"turned about the line through control points {named(ids)}", self._turn(along, middle)))
        where = f"control point{'s' if len(ids) > 1 else ''} {named(ids)}"
        first += [(f"turned about {n} through {where}", self._turn(a, middle))
                  for n, a in zip(self.names, self.axes, strict=True)]  # fmt: skip
        apart = np.concatenate([self.axes @ (self.middle - middle), np.zeros(3), np.ones(1)])
        return [*first, (f"scaled from {where}", apart), *own]

    def _turn(self, axis: Array, through: Array) -> Array:
        """Coefficients of a turn about an axis through a point."""
        return np.concatenate([self.axes @ np.cross(axis, self.middle - through), self.axes @ axis, np.zeros(1)])


def free_motions(problem: Problem, rows: Rows, rest: Array | None, images: Index) -> FreeMotions:
    """Find the motions of a part of the block that its observations do not hold.

    Without control points a followed motion by 10 m is free if it changes the residuals by less than their sigma (root
    mean square): what holds it then is the curvature of the models, not a datum. With control points it is free if
    all observations together feel it by less than one sigma: they determine it to no better than 10 m.

    Parameters
    ----------
    problem : Problem
    rows : Rows
        At the start.
    rest : (q, u) array or None
        Rows of all images with the ground points eliminated; None: the points follow a motion as it is.
    images : int array
        The images of the part.
    """
    part = _Part.of(problem, images)
    ids = tuple(problem.block.images[k].id for k in images)
    control = tuple(problem.block.points.ids[j] for j in part.control)
    if not len(part.points):
        none = np.zeros(0)
        return FreeMotions(ids, control, (), none, none, np.zeros((problem.n_image_unknowns, 0)), "")
    motions = _motions(problem, rows, part)
    felt = _felt(problem, rows, rest, part, motions)
    size = np.asarray(np.linalg.qr(motions.shift[part.points].reshape(-1, 7), mode="r"))
    free = _free(motions, felt, size, part)
    found = _named(motions.candidates(problem, part.control), free, size)
    c = np.array([_scaled(motions, part, c) for _, c in found]).reshape(-1, 7).T
    moves, change = motions.moves @ c, np.linalg.norm(felt @ c, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        strength = change / np.linalg.norm(moves, axis=0)
    words = tuple(w for w, _ in found)
    return FreeMotions(
        ids, control, words, change / np.sqrt(2 * len(part.rows)), strength, moves, _remedy(problem, part, words)
    )


def _motions(problem: Problem, rows: Rows, part: _Part) -> _Motions:
    """Seven motions about the middle of the points; the images of the part take the unknowns that follow best."""
    ground = problem.start.ground
    axes, middle = problem.axes(problem.origin_m[None])[0], np.median(ground[part.points], axis=0)
    arm = ground[part.points] - middle
    shift = np.zeros((len(ground), 3, 7))
    shift[part.points, :, :3], shift[part.points, :, 6] = axes.T, arm
    for k, axis in enumerate(axes):
        shift[part.points, :, 3 + k] = np.cross(axis, arm)
    moves, left, whole = np.zeros((problem.n_image_unknowns, 7)), [], []
    image, point = problem.observations.image[part.rows], problem.observations.point
    for k in part.images:
        own, u = part.rows[image == k], len(problem.parameters[k])
        if not len(own):
            continue
        # a camera that several images have in common stays as it is
        a = np.where(problem.parameters[k].own, rows.image[own, :, :u], 0.0).reshape(-1, u)
        b = np.einsum("nij,njd->nid", rows.ground[own], shift[point[own]]).reshape(-1, 7)
        x = -np.linalg.lstsq(a, b, rcond=None)[0]
        moves[problem.first[k] : problem.first[k + 1]] = x
        left.append(a @ x + b)
        whole.append(b)
    return _Motions(problem.axis_names, axes, middle, shift, moves, np.vstack(left), np.vstack(whole))


def _felt(problem: Problem, rows: Rows, rest: Array | None, part: _Part, motions: _Motions) -> Array:
    """What the observations feel of each motion (q, 7), in sigmas."""
    if rest is not None:
        return np.asarray(rest @ motions.moves)
    observed = part.control[problem.observed[part.control]]
    w = problem.control_weights(observed)
    at_control = np.einsum("nij,njd->nid", w, motions.shift[observed]).reshape(-1, 7)
    held = part.rows[~problem.active[problem.observations.point[part.rows]]]
    at_fixed = [
        rows.image[r, :, : len(problem.parameters[k])] @ motions.moves[problem.first[k] : problem.first[k + 1]]
        for r in held for k in [int(problem.observations.image[r])]
    ]  # fmt: skip
    return np.vstack([motions.left, at_control, *at_fixed])


def _free(motions: _Motions, felt: Array, size: Array, part: _Part) -> Array:
    """Coefficients (7, d) that span the free motions."""
    followed = _weakest(motions.left, motions.whole, FOLLOWED)
    sigmas = 1.0 if len(part.control) else np.sqrt(2 * len(part.rows))
    limit = sigmas / (SHIFT_M * np.sqrt(len(part.points)))
    return followed @ _weakest(felt @ followed, size @ followed, limit)


def _weakest(effect: Array, measure: Array, limit: float) -> Array:
    """Coefficients (k, d) of the combinations whose effect is below ``limit`` times their measure."""
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


def _named(candidates: list[tuple[str, Array]], free: Array, size: Array) -> list[tuple[str, Array]]:
    """Names and coefficients that span the free motions."""
    if not free.shape[1]:
        return []
    space = np.linalg.qr(size @ free)[0]
    found: list[tuple[str, Array]] = []
    rest = space
    for words, c in candidates:
        z = size @ c
        length = float(np.linalg.norm(z))
        if not rest.shape[1] or length <= _TINY or np.linalg.norm(space.T @ z) < MATCH * length:
            continue
        new = rest @ (rest.T @ z) / length
        if np.linalg.norm(new) < NEW:
            continue
        found.append((words, c))
        new /= np.linalg.norm(new)
        u, s, _ = np.linalg.svd(rest - np.outer(new, new @ rest), full_matrices=False)
        rest = u[:, s > 0.5]
    inverse = np.linalg.pinv(size)
    return found + [("moved together in another way", inverse @ rest[:, k]) for k in range(rest.shape[1])]


def _scaled(motions: _Motions, part: _Part, c: Array) -> Array:
    """The motion at which half of the points go 10 m or farther."""
    far = np.linalg.norm(motions.shift[part.points] @ c, axis=1)
    typical = float(np.median(far))
    return np.asarray(c * SHIFT_M / (typical if typical > NEW * far.max() else float(far.max())))


def _remedy(problem: Problem, part: _Part, words: tuple[str, ...]) -> str:
    """What to measure."""
    if not words:
        return ""
    ids = [problem.block.images[k].id for k in part.images]
    where = f"in image{'s' if len(ids) > 1 else ''} {named(ids)}"
    control = [problem.block.points.ids[j] for j in part.control]
    if all(w.startswith("shifted") for w in words) and not control:
        return f"measure a control point {where}"
    if not control:
        return f"measure three control points or more, not on one line, {where}"
    if len(control) == 1:
        return f"measure at least two more control points, not on a line with {control[0]}, {where}"
    if "line" in words[0]:
        return f"measure at least one control point off the line of {named(control)}, {where}"
    return f"measure more control points, or give those smaller sigmas, {where}"


# --- observations on board ------------------------------------------------------------------------

#: Share of an unknown in the directions that the priors hold: two strips that shift together have a half each.
HELD: Final = 0.4
#: Beginning of the names of what belongs together, in words, why it is held, and what helps.
_KINDS: Final = (
    ("gnss_shift", "shift of the receiver", "the whole block moves with it", "measure control points"),
    ("gnss_drift", "drift of the receiver", "the block is stretched or turned with it",
     "measure control points at both ends of the strip, or fly a cross strip"),
    ("ins_shift", "shift of the attitude", "the boresight, or a turn of the block, looks the same",
     "fly strips to and fro, or measure control points"),
    ("ins_drift", "drift of the attitude", "the block bends or turns with it",
     "measure control points at both ends of the strip, or more tie points between strips"),
    ("lever", "lever arm", "a shift of the receiver or of the block looks the same",
     "measure it on the ground, or fly to and fro with control points"),
    ("boresight", "boresight", "the shift of the attitude, or a turn of the block, looks the same",
     "fly strips to and fro, or measure control points"),
)  # fmt: skip


def held_on_board(problem: Problem, values: Array, directions: Array, limit: float) -> tuple[str, ...]:
    """One sentence per strip and kind of unknown that the priors hold.

    Parameters
    ----------
    problem : Problem
    values : (k,) array
        Singular values of the block without priors, prior sigmas.
    directions : (k, u) array
        Rows: their directions of the free image unknowns.
    limit : float
        Directions below it are held by the priors.
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
