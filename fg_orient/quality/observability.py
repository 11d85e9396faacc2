"""Observability: what the image observations cannot tell, in the user's terms, before anything is solved.

A whitened Jacobian with respect to unknowns in prior sigmas is decomposed by SVD. A direction of singular value s is

- **unobservable** if s <= 1e-5: the data say nothing,
- **held by the prior** if 1e-5 < s < 1: the prior says more than the data,
- **determined** if s >= 1.

It is done for each image at fixed ground points, which is the optimistic case: what is unobservable there is so in
every adjustment of the image. It is done for the block, too, with the ground points eliminated, where all observations
together have their say.

Unobservable directions of an image are named by matching them with physical candidates, which its model gives
(``silent_directions``); those of the block by the motions of the block as a whole (``fg_orient.quality.motions``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import linearised
from fg_orient.model.errors import Finding, finding
from fg_orient.model.parameters import ImageParameters
from fg_orient.quality.elimination import eliminated, eliminated_with_own
from fg_orient.quality.motions import SHIFT_M, UNOBSERVABLE, FreeMotions, free_motions, held_on_board
from fg_orient.quality.structure import Structure, analyse_structure, named
from fg_orient.sensors.base import ImageModel

Array = npt.NDArray[np.float64]

#: Singular values from this on: the data say more than the prior.
DETERMINED: Final = 1.0
#: A candidate explains an unobservable direction when this share of its length lies in the null space.
MATCH: Final = 0.9
#: Condition of a Jacobian above which its normal equations, whose condition is the square, have no digit left.
NEEDS_SCALING: Final = float(np.finfo(float).eps ** -0.5)


@dataclass(frozen=True)
class ImageObservability:
    """What the data say about one image.

    Parameters
    ----------
    image : str
        Image id.
    singular_values : (k,) array, descending; k unknowns, in sigmas of the data per prior sigma
    rank_defect : int
        Unobservable directions.
    weak : int
        Directions held by the prior.
    null_space : (k, rank_defect) array
        Orthonormal unobservable directions in prior sigmas.
    sentences : tuple of str
        One per unobservable direction.
    held : tuple of str
        One per direction held by the prior, by falling singular value: the unknown that it is mostly made of.
    condition, raw_condition : float or None
        Condition of the Jacobian with unknowns in prior sigmas, and with unknowns in raw units (coefficients per
        line, as publications write them); None without full rank.
    summary : str
        All of it in one sentence.
    """

    image: str
    singular_values: Array
    rank_defect: int
    weak: int
    null_space: Array
    sentences: tuple[str, ...]
    held: tuple[str, ...] = ()
    condition: float | None = None
    raw_condition: float | None = None
    summary: str = ""

    @property
    def determined(self) -> int:
        """Directions that the data determine better than the prior."""
        return len(self.singular_values) - self.rank_defect - self.weak

    def as_dict(self) -> dict[str, Any]:
        """For ``result.json`` (docs/results.md)."""
        return {
            "image": self.image, "rank_defect": self.rank_defect, "weak": self.weak, "determined": self.determined,
            "held_by_the_prior": list(self.held), "condition": self.condition, "raw_condition": self.raw_condition,
            "summary": self.summary, "singular_values": self.singular_values.tolist(),
            "sentences": list(self.sentences),
        }  # fmt: skip


def analyse(image: str, jacobian: Array, model: ImageModel) -> ImageObservability:
    """Judge one image by the unknowns that no other image shares: of the others it says no last word.

    Parameters
    ----------
    image : str
        Image id.
    jacobian : (2n, k) array
        Whitened, with respect to the unknowns in prior sigmas.
    model : ImageModel
        Names the unknowns and the directions that physics hides.
    """
    own = model.parameters.own
    parameters, jacobian = model.parameters.take(own), jacobian[:, own]
    k = len(parameters)
    if not k:
        none = np.zeros((0, 0))
        return ImageObservability(image, np.zeros(0), 0, 0, none, (), summary=f"image {image}: held")
    short = np.asarray(np.linalg.qr(jacobian, mode="r")) if len(jacobian) > k else jacobian
    full = np.vstack([short, np.zeros((max(0, k - len(short)), k))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    dead, weak = s <= UNOBSERVABLE, (s > UNOBSERVABLE) & (s < DETERMINED)
    null = vt[dead].T
    candidates = [(text, direction[own]) for text, direction in model.silent_directions()]
    texts = _name_directions(null, parameters, candidates) if dead.any() else []
    held = _name_by_unknowns(vt[weak], parameters.words)
    condition, raw = (None, None) if dead.any() else (float(s[0] / s[-1]), _raw_condition(full, model))
    return ImageObservability(
        image, s, int(dead.sum()), int(weak.sum()), null, tuple(f"image {image}: {t}" for t in texts), held, condition,
        raw, f"image {image}: {_summary(texts, len(held), k, condition, raw)}",
    )  # fmt: skip


def _name_directions(null: Array, parameters: ImageParameters, candidates: list[tuple[str, Array]]) -> list[str]:
    """Words per unobservable direction: greedy match with the candidates, the rest by components."""
    found, rest = [], null
    while rest.shape[1]:
        shares = [0.0 if k in found else float(np.linalg.norm(rest.T @ d)) for k, (_, d) in enumerate(candidates)]
        if not shares or max(shares) < MATCH:
            break
        found.append(int(np.argmax(shares)))
        direction = candidates[found[-1]][1]
        explained = rest @ (rest.T @ direction)
        explained /= np.linalg.norm(explained)
        u, s, _ = np.linalg.svd(rest - np.outer(explained, explained @ rest), full_matrices=False)
        rest = u[:, s > 0.5]
    texts = [candidates[k][0] for k in sorted(found)]
    return texts + [_by_components(rest[:, j], parameters) for j in range(rest.shape[1])]


def _by_components(direction: Array, parameters: ImageParameters) -> str:
    """Describe a direction by its three largest components, in prior sigmas."""
    order = np.argsort(-np.abs(direction))[:3]
    parts = [f"{direction[j]:+.2f} {parameters.words[j]}" for j in order if abs(direction[j]) > 0.05]
    return "this combination is not observable (in prior sigmas): " + " ".join(parts)


def _name_by_unknowns(directions: Array, words: tuple[str, ...]) -> tuple[str, ...]:
    """Unknown that each direction (d, k) is mostly made of, no unknown twice, in the order of the directions."""
    shares = directions**2
    largest = shares == shares.max(axis=1, keepdims=True)
    if largest.sum(axis=1).max(initial=0) <= 1 and largest.sum(axis=0).max(initial=0) <= 1:
        return tuple(words[j] for j in shares.argmax(axis=1))  # the rule: no two directions ask for the same unknown
    from scipy.optimize import linear_sum_assignment

    return tuple(words[j] for j in linear_sum_assignment(-shares)[1])


def _raw_condition(triangle: Array, model: ImageModel) -> float:
    """Condition with the unknowns in physical units per line, where the model has such coefficients.

    As a product of two norms, ``|R D| |D^-1 R^-1|``: the inverse is taken in prior sigmas, where it is accurate, so
    conditions far beyond 1 / eps are right, too.
    """
    factors, own = model.per_line()[0], model.parameters.own
    unit = (model.parameters.sigma * np.where(np.isfinite(factors), factors, 1.0))[own]
    return float(np.linalg.norm(triangle / unit, 2) * np.linalg.norm(unit[:, None] * np.linalg.inv(triangle), 2))


#: Beginning of a sentence on velocity, and its word in a summary.
_VELOCITY: Final = (("velocity along track", "along track"), ("velocity across track", "across track"),
                    ("radial velocity", "radial"))  # fmt: skip


def _summary(texts: list[str], held: int, k: int, condition: float | None, raw: float | None) -> str:
    """Say in one line what is unobservable, how much the prior holds, and whether units need scaling."""
    silent = [t for t in texts if t.endswith("acts on nothing")]
    yaw = [t for t in texts if "acts as yaw" in t]
    names = [short for long, short in _VELOCITY if any(t.startswith(long) for t in silent)]
    parts = [] if texts else ["full rank"]
    if names:
        parts.append(f"velocity {' and '.join(filter(None, [', '.join(names[:-1]), names[-1]]))} "
                     f"act{'s' if len(names) == 1 else ''} on nothing")  # fmt: skip
    if yaw:
        parts.append("across-track velocity equals yaw")
    others = len(texts) - len(silent) - len(yaw)
    if others:
        parts.append(f"{others} other direction{'s' if others > 1 else ''} not observable")
    parts.append(f"{held} of {k} held by the prior")
    if condition is not None and raw is not None and raw > NEEDS_SCALING:
        parts.append(f"raw units need scaling (condition {raw:.0e}, in prior sigmas {condition:.0e})")
    return "; ".join(parts)


@dataclass(frozen=True)
class BlockObservability:
    """What all observations together say about all images, ground points free, no priors.

    Parameters
    ----------
    singular_values : (u,) array, descending
        u unknowns of all images, shared ones once; empty for a block that is too large.
    sentences : tuple of str
        One per unobservable direction: motions of the block by name, others by their largest components.
    weak : int
        Directions determined 100 times worse than their prior sigma, unobservable ones not counted.
    datum : tuple of str
        One per common shift, turn or change of scale of all images that no control point fixes.
    motions : tuple of FreeMotions
        The motions of each part of the block that has free ones.
    structure : Structure
        Parts of the block, and what lacks observations.
    unexplained : int
        Unobservable directions that are no motions of the block.
    on_board : tuple of str
        One per shift, drift, lever arm or boresight of what was observed on board that the priors hold.
    """

    singular_values: Array
    sentences: tuple[str, ...]
    weak: int
    datum: tuple[str, ...]
    motions: tuple[FreeMotions, ...]
    structure: Structure
    unexplained: int = 0
    on_board: tuple[str, ...] = ()

    @property
    def counts(self) -> dict[str, int] | None:
        """Directions of the three classes; None for a block that is too large."""
        s = self.singular_values
        if not len(s):
            return None
        dead, held = int((s <= UNOBSERVABLE).sum()), int((s < DETERMINED).sum())
        return {"unobservable": dead, "held_by_the_prior": held - dead, "determined": len(s) - held}

    @property
    def n_free_motions(self) -> int:
        """Motions of the block that no control point fixes."""
        return sum(len(m) for m in self.motions)

    @property
    def relative(self) -> bool:
        """Nothing but the priors tells where the block lies: it has free motions and no control point."""
        return bool(self.motions) and not any(m.control for m in self.motions) and self.structure.n_parts == len(
            self.motions
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """For ``result.json`` (docs/results.md)."""
        counts = self.counts or dict.fromkeys(("unobservable", "held_by_the_prior", "determined"))
        motions = [
            {"images": list(m.images), "control": list(m.control), "words": list(m.words),
             "rms_in_sigmas": m.felt.tolist(), "remedy": m.remedy}
            for m in self.motions
        ]  # fmt: skip
        return {
            **counts, "structural_defect": self.structure.defect, "parts": self.structure.n_parts,
            "free_motions": self.n_free_motions, "motions": motions, "sentences": list(self.sentences),
        }  # fmt: skip

    def deficiencies(self, problem: Problem) -> tuple[Finding, ...]:
        """One per part with free motions, and one that names the parts."""
        options = problem.block.options
        code = "solution.motions_inner" if options.datum == "inner" else "solution.motions"
        out = [
            finding(code, direction=part_sentence(m, priors=options.priors), remedy=m.remedy, images=m.images,
                    control=m.control, motions=m.words)
            for m in self.motions
        ]  # fmt: skip
        if self.structure.n_parts > 1 and (self.motions or not self._each_part_has_control(problem)):
            out.append(_parts(problem, self.structure))
        return tuple(out)

    def _each_part_has_control(self, problem: Problem) -> bool:
        known = self.structure.point_part[problem.observed | ~problem.active]
        return len(np.unique(known[known >= 0])) == self.structure.n_parts


#: Without priors, directions below this singular value are pointed out.
WEAK_WITHOUT_PRIORS: Final = 1e-2
#: Rows times squared unknowns up to which a block with priors is judged as a whole (some 0.3 s).
WORK_LIMIT: Final = 2e9


def affordable(problem: Problem) -> bool:
    """Tell whether the whole block can be decomposed in no time beside its adjustment."""
    return 2.0 * len(problem.observations) * problem.n_image_unknowns**2 <= WORK_LIMIT


def analyse_block(problem: Problem, structure: Structure | None = None, *, whole: bool = True) -> BlockObservability:
    """Judge the block without priors: unknown ground points are eliminated point by point (QR).

    Own observations take part up to 2000 unknowns, beyond them only in the structure.

    Parameters
    ----------
    problem : Problem
    structure : Structure, optional
        Of the block, if it is known.
    whole : bool
        False: no singular values, only the motions of its parts, at a cost linear in the observations.
    """
    structure = structure or analyse_structure(problem)
    rows, u = linearised(problem, problem.start), problem.n_free_unknowns
    own = bool(problem.block.extra) and problem.n_unknowns <= MAX_UNKNOWNS
    rest = None if not whole else eliminated_with_own(problem) if own else eliminated(problem, rows)
    parts = [np.flatnonzero(structure.part == p) for p in range(structure.n_parts)]
    motions = tuple(m for m in (free_motions(problem, rows, rest, p) for p in parts) if len(m))
    datum = tuple(t for m in motions for t in _motion_sentences(m, problem, alone=structure.n_parts == 1))
    if rest is None:
        return BlockObservability(np.zeros(0), (), 0, datum, motions, structure)
    free = rest if problem.ties is None else problem.ties.columns(rest)
    full = np.vstack([free, np.zeros((max(0, u - len(free)), u))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    dead = s <= UNOBSERVABLE
    sentences, unexplained = _dead_sentences(problem, vt[dead].T, motions, structure)
    weak = int(((s < WEAK_WITHOUT_PRIORS) & ~dead).sum())
    on_board = held_on_board(problem, s, vt, DETERMINED)
    return BlockObservability(s, sentences, weak, datum, motions, structure, unexplained, on_board)


def _dead_sentences(
    problem: Problem, null: Array, motions: tuple[FreeMotions, ...], structure: Structure
) -> tuple[tuple[str, ...], int]:
    """One sentence per unobservable direction (u, d) of the block, motions first; and how many are no motions."""
    told, rest = [], null
    for m in motions:
        texts = _motion_sentences(m, problem, alone=structure.n_parts == 1)
        inside = m.unobservable
        told += [t for t, yes in zip(texts, inside, strict=True) if yes]
        if inside.any() and rest.shape[1]:
            moves = m.moves[:, inside] if problem.ties is None else m.moves[problem.ties.place][:, inside]
            moved, s, _ = np.linalg.svd(rest @ (rest.T @ _unit(moves)), full_matrices=False)
            known = moved[:, s > UNOBSERVABLE]
            u, s, _ = np.linalg.svd(rest - known @ (known.T @ rest), full_matrices=False)
            rest = u[:, s > 0.5]
    told = told[: null.shape[1]]
    left = null.shape[1] - len(told)
    names = _names(problem)
    shown, control = min(left, rest.shape[1]), problem.has_control
    told += [_block_sentence(rest[:, k], names, control=control) for k in range(shown)]
    return tuple(told), left


def _names(problem: Problem) -> list[tuple[str, str]]:
    """Image, or id under which images share it, and words of each unknown."""
    wide = [
        (p.shared[j] if p.shared and p.shared[j] else image.id, p.words[j])
        for image, p in zip(problem.block.images, problem.parameters, strict=True)
        for j in range(len(p))
    ]
    return wide if problem.ties is None else [wide[j] for j in problem.ties.place]


def _unit(columns: Array) -> Array:
    """Columns of length 1."""
    return np.asarray(columns / np.linalg.norm(columns, axis=0))


def _motion_sentences(m: FreeMotions, problem: Problem, *, alone: bool) -> list[str]:
    """One sentence per free motion of a part of the block."""
    who = "block: the images" if alone else f"block: images {named(m.images)}"
    out = []
    for words, felt, strength in zip(m.words, m.felt, m.strength, strict=True):
        told = f"{who} may be {words}: {_control_words(m)}; {SHIFT_M:g} m change the residuals by {felt:.1g} of their "
        out.append(f"{told}sigma (root mean square), {_holder(strength, problem.block.options.priors)}")
    return out


def _holder(strength: float, priors: bool) -> str:
    """What holds a motion."""
    if strength >= DETERMINED:
        return "the curvature of the models alone holds it"
    if not priors:
        return "nothing else holds it"
    return "the priors alone hold it"


def _control_words(m: FreeMotions) -> str:
    """Control points of a part."""
    if not m.control:
        return "no control point"
    return f"{len(m.control)} control point{'s' if len(m.control) > 1 else ''} only, {named(m.control)}"


def part_sentence(m: FreeMotions, *, priors: bool) -> str:
    """Say how many motions of a part of the block are free, and which."""
    by = "held by the priors alone" if priors else "free"
    many = f"{len(m)} motions are" if len(m) > 1 else "1 motion is"
    return f"images {named(m.images)}, {_control_words(m)}: {many} {by} ({', '.join(m.words)})"


def _parts(problem: Problem, structure: Structure) -> Finding:
    """Parts of the block that no ground point links."""
    ids = problem.block.points.ids
    parts = []
    for p in range(structure.n_parts):
        images = [problem.block.images[k].id for k in np.flatnonzero(structure.part == p)]
        points = np.flatnonzero(structure.point_part == p)
        control = [ids[j] for j in points[problem.observed[points] | ~problem.active[points]]]
        known = f"control points {named(control)}" if control else "no control point"
        parts.append(f"images {named(images)} ({len(points)} points, {known})")
    return finding("solution.parts", n=structure.n_parts, parts=parts)


def _block_sentence(direction: Array, names: list[tuple[str, str]], *, control: bool) -> str:
    order = np.argsort(-np.abs(direction))[:4]
    parts = [f"{direction[j]:+.2f} {names[j][0]} {names[j][1]}" for j in order if abs(direction[j]) > 0.1]
    who = "the control points do not fix" if control else "no control point fixes"
    return f"block: {who} this combination (in prior sigmas): " + " ".join(parts)
