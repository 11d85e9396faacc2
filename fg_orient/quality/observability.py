"""Observability: directions of the unknowns that the observations do not determine, found before the adjustment.

A whitened Jacobian with respect to unknowns in prior sigmas is decomposed by SVD. A direction of singular value s is

- **unobservable** if s <= 1e-5: the observations contain no information;
- **held by the prior** if 1e-5 < s < 1: the prior contains more information than the observations;
- **determined** if s >= 1.

Each image is analysed with fixed ground points. This is the most favourable case: a direction that is
unobservable with fixed ground points is unobservable in every adjustment. The whole block is analysed with
the ground points eliminated (``fg_orient.quality.elimination``).

Unobservable directions of an image are matched with the physical candidates of its model (``silent_directions``).
Directions of the block are matched with its motions (``fg_orient.quality.motions``).
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from factors.arrays import Array
from fg_orient.adjustment.border import border_of
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.model.errors import Finding, finding
from fg_orient.model.parameters import ImageParameters
from fg_orient.quality.elimination import UNOBSERVABLE, reduced_rows, spectrum
from fg_orient.quality.motions import SHIFT_M, Effect, FreeMotions, free_motions, held_on_board, without
from fg_orient.quality.structure import Structure, analyse_structure, named
from fg_orient.quality.weakest import Weakest, weakest
from fg_orient.sensors.base import ImageModel
from fg_orient.sensors.latitudinal import observed_by_angles

#: Smallest singular value of directions that the observations determine better than the prior does.
DETERMINED: Final = 1.0
#: A candidate explains an unobservable direction if at least this share of its length lies in the null space.
MATCH: Final = 0.9
#: Condition number of a Jacobian above which its normal equations, with the squared condition number, have no correct
#: digit.
NEEDS_SCALING: Final = float(np.finfo(float).eps ** -0.5)


@dataclass(frozen=True)
class ImageObservability:
    """Directions of the unknowns of one image.

    Parameters
    ----------
    image : str
        Image id.
    singular_values : (k,) array, descending; k unknowns, in sigmas of the data per prior sigma
    rank_defect : int
        Number of unobservable directions.
    weak : int
        Number of directions held by the prior.
    sentences : tuple of str
        One sentence per unobservable direction.
    held : tuple of str
        Largest unknown of each direction held by the prior, by descending singular value.
    condition, raw_condition : float or None
        Condition number of the Jacobian with unknowns in prior sigmas, and with unknowns in raw units (coefficients per
        line, as in publications). None without full rank.
    summary : str
        Summary in one sentence.
    """

    image: str
    singular_values: Array
    rank_defect: int
    weak: int
    sentences: tuple[str, ...]
    held: tuple[str, ...] = ()
    condition: float | None = None
    raw_condition: float | None = None
    summary: str = ""

    @property
    def determined(self) -> int:
        """Number of directions that the observations determine better than the prior."""
        return len(self.singular_values) - self.rank_defect - self.weak

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``result.json`` (docs/results.md)."""
        return {
            "image": self.image, "rank_defect": self.rank_defect, "weak": self.weak, "determined": self.determined,
            "held_by_the_prior": list(self.held), "condition": self.condition, "raw_condition": self.raw_condition,
            "summary": self.summary, "singular_values": self.singular_values.tolist(),
            "sentences": list(self.sentences),
        }  # fmt: skip


def analyse(image: str, jacobian: Array, model: ImageModel) -> ImageObservability:
    """Analyse the unknowns of one image, without unknowns that other images share.

    Parameters
    ----------
    image : str
        Image id.
    jacobian : (2n, k) array
        Whitened, with respect to the unknowns in prior sigmas.
    model : ImageModel
        Model that names the unknowns and the physically unobservable directions.
    """
    own = model.parameters.own
    parameters, jacobian = model.parameters.take(own), jacobian[:, own]
    k = len(parameters)
    if not k:
        return ImageObservability(image, np.zeros(0), 0, 0, (), summary=f"image {image}: held")
    s, vt = spectrum(jacobian)
    dead, weak = s <= UNOBSERVABLE, (s > UNOBSERVABLE) & (s < DETERMINED)
    candidates = [(text, direction[own]) for text, direction in model.silent_directions()]
    texts = _name_directions(vt[dead].T, parameters, candidates) if dead.any() else []
    held = _name_by_unknowns(vt[weak], parameters.words)
    condition, raw = (None, None) if dead.any() else (float(s[0] / s[-1]), _raw_condition(s, vt, model))
    return ImageObservability(
        image, s, int(dead.sum()), int(weak.sum()), tuple(f"image {image}: {t}" for t in texts), held, condition,
        raw, f"image {image}: {_summary(texts, len(held), k, condition, raw)}",
    )  # fmt: skip


def _name_directions(null: Array, parameters: ImageParameters, candidates: list[tuple[str, Array]]) -> list[str]:
    """Describe unobservable directions: by the best matching candidates, then by combinations of unknowns."""
    matched, rest = list[int](), null
    while rest.shape[1]:
        shares = [0.0 if k in matched else float(np.linalg.norm(rest.T @ d)) for k, (_, d) in enumerate(candidates)]
        if not shares or max(shares) < MATCH:
            break
        matched.append(int(np.argmax(shares)))
        rest = without(rest, candidates[matched[-1]][1][:, None])
    texts = [candidates[k][0] for k in sorted(matched)]
    lead = "this combination is not observable (in prior sigmas): "
    return texts + [lead + _combination(d, list(parameters.words), 3, 0.05) for d in rest.T]


def _combination(direction: Array, words: list[str], most: int, least: float) -> str:
    """Describe at most ``most`` largest components of a direction, of size ``least`` or more; the first is positive."""
    order = np.argsort(-np.abs(direction))[:most]
    d = direction * np.sign(direction[order[0]])
    return " ".join(f"{d[j]:+.2f} {words[j]}" for j in order if abs(d[j]) > least)


def _name_by_unknowns(directions: Array, words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the largest unknown of each direction (d, k), no unknown twice, in the order of the directions."""
    shares = directions**2
    largest = shares == shares.max(axis=1, keepdims=True)
    if largest.sum(axis=1).max(initial=0) <= 1 and largest.sum(axis=0).max(initial=0) <= 1:
        # usual case: no two directions have the same largest unknown
        return tuple(words[j] for j in shares.argmax(axis=1))
    # scipy.optimize has the same function, but takes 0.1 s to load
    rows, places = csgraph.min_weight_full_bipartite_matching(sparse.csr_array(2.0 - shares))
    return tuple(words[j] for j in places[np.argsort(rows)])


def _raw_condition(s: Array, vt: Array, model: ImageModel) -> float:
    """Return the condition number with the unknowns in physical units per line, if the model has such coefficients.

    The condition number is the product of two norms, ``|J D| |D^-1 J^+|``, with ``J = U S V^T``. The inverse is
    computed in prior sigmas, where it is accurate, so that condition numbers far above 1 / eps are correct.
    """
    unit = model.raw_sigma[model.parameters.own]
    return float(np.linalg.norm(s[:, None] * vt / unit, 2) * np.linalg.norm(unit[:, None] * vt.T / s, 2))


#: Beginning of a sentence on velocity, and its word in a summary.
_VELOCITY: Final = (("velocity along track", "along track"), ("velocity across track", "across track"),
                    ("radial velocity", "radial"))  # fmt: skip


def _summary(texts: list[str], held: int, k: int, condition: float | None, raw: float | None) -> str:
    """Return one line: unobservable directions, directions held by the prior, and whether raw units need scaling."""
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
    """Directions of the unknowns of all images in an adjustment without priors, with free ground points.

    Parameters
    ----------
    singular_values : (u,) array, descending
        u unknowns of all images, shared ones once; empty for a large block.
    sentences : tuple of str
        One sentence per unobservable direction: motions of the block by name, other directions by their largest
        components.
    weak : int
        Number of directions determined 100 times worse than their prior sigma, without unobservable ones.
    datum : tuple of str
        One text per common shift, rotation or change of scale of all images that no control point fixes.
    motions : tuple of FreeMotions
        Free motions of each part of the block with such motions.
    structure : Structure
        Parts of the block, and unknowns with too few observations.
    unexplained : int
        Number of unobservable directions that are not motions of the block.
    on_board : tuple of str
        One text per shift, drift, lever arm or boresight of the navigation that the priors hold.
    null : (z, d) array or None
        Unobservable directions of the unknowns of all images (shared ones once); None if they were not computed.
    """

    singular_values: Array
    sentences: tuple[str, ...]
    weak: int
    datum: tuple[str, ...]
    motions: tuple[FreeMotions, ...]
    structure: Structure
    unexplained: int = 0
    on_board: tuple[str, ...] = ()
    null: Array | None = None

    @property
    def counts(self) -> dict[str, int] | None:
        """Return the number of directions of the three classes; None for a block that is too large."""
        s = self.singular_values
        if not len(s):
            return None
        dead, held = int((s <= UNOBSERVABLE).sum()), int((s < DETERMINED).sum())
        return {"unobservable": dead, "held_by_the_prior": held - dead, "determined": len(s) - held}

    @property
    def n_free_motions(self) -> int:
        """Number of motions of the block that no control point fixes."""
        return sum(len(m) for m in self.motions)

    @property
    def relative(self) -> bool:
        """True if only the priors determine the position of the block: it has free motions and no control."""
        uncontrolled = not any(m.control or m.features for m in self.motions)
        return uncontrolled and 0 < len(self.motions) == self.structure.n_parts

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``result.json`` (docs/results.md)."""
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
        """Return one finding per part with free motions, and a finding that lists the parts."""
        options, structure = problem.block.options, self.structure
        code = "solution.motions_inner" if options.datum == "inner" else "solution.motions"
        out = [
            finding(code, direction=part_sentence(m, priors=options.priors), remedy=m.remedy, images=m.images,
                    control=m.control, motions=m.words)
            for m in self.motions
        ]  # fmt: skip
        with_control = structure.point_part[problem.observed | ~problem.active]
        each = len(np.unique(with_control[with_control >= 0])) == structure.n_parts
        if structure.n_parts > 1 and (self.motions or not each):
            out.append(_parts(problem, structure))
        return tuple(out)


#: Without priors, directions below this singular value are reported.
WEAK_WITHOUT_PRIORS: Final = 1e-2
#: Maximum of rows times squared unknowns for the analysis of a whole block with priors.
WORK_LIMIT: Final = 2e9


def affordable(problem: Problem) -> bool:
    """Return whether the decomposition of the whole block is fast compared with its adjustment."""
    return 2.0 * len(problem.observations) * problem.n_image_unknowns**2 <= WORK_LIMIT


def _least(problem: Problem, parts: int) -> Weakest | None:
    """Return the weakest directions at the start.

    None if the border of the normal equations does not determine the points.
    """
    with contextlib.suppress(Singular):
        border = border_of(problem, problem.start)
        return None if border is None else weakest(border, WEAK_WITHOUT_PRIORS, parts)
    return None


def analyse_block(problem: Problem, structure: Structure | None = None, *, whole: bool = True) -> BlockObservability:
    """Analyse the block without priors, with the unknown ground points eliminated.

    Large blocks are analysed by the border of their normal equations (``fg_orient.quality.weakest``), without the
    singular values of well-determined directions.

    Parameters
    ----------
    problem : Problem
    structure : Structure, optional
        Structure of the block, if it is known.
    whole : bool
        If False, only the motions of the parts are computed, without singular values. The time is then
        proportional to the number of observations.
    """
    structure = structure or analyse_structure(problem)
    rows = linearised(problem, problem.start)
    extra = bool(problem.block.extra)
    quick = whole and (not affordable(problem) or (extra and problem.n_unknowns > MAX_UNKNOWNS))
    least = _least(problem, structure.n_parts) if quick else None
    reduced = None
    effect_of: Effect | None = None if least is None else least.border.effect_of
    if whole and least is None:
        extra = extra and problem.n_unknowns <= MAX_UNKNOWNS
        reduced = reduced_rows(problem, rows, problem.start if extra else None)

        def effect(moves: Array, ground: Array) -> Array:
            return np.asarray(reduced @ moves)

        effect_of = effect
    parts = [np.flatnonzero(structure.part == p) for p in range(structure.n_parts)]
    motions = tuple(m for m in (free_motions(problem, rows, effect_of, p) for p in parts) if len(m))
    texts = [_motion_sentences(m, problem, alone=structure.n_parts == 1) for m in motions]
    datum = tuple(text for part in texts for text in part)
    if least is not None:
        dead = least.values <= UNOBSERVABLE
        null = least.border.images_of(least.directions[:, dead])
        sentences, unexplained = _unobservable_sentences(problem, null, motions, texts)
        weak = int((~dead).sum())
        return BlockObservability(np.zeros(0), sentences, weak, datum, motions, structure, unexplained, null=null)
    if reduced is None:
        return BlockObservability(np.zeros(0), (), 0, datum, motions, structure)
    s, vt = spectrum(reduced)
    dead = s <= UNOBSERVABLE
    sentences, unexplained = _unobservable_sentences(problem, vt[dead].T, motions, texts)
    weak = int(((s < WEAK_WITHOUT_PRIORS) & ~dead).sum())
    on_board = held_on_board(problem, s, vt, DETERMINED)
    return BlockObservability(s, sentences, weak, datum, motions, structure, unexplained, on_board, vt[dead].T)


def _unobservable_sentences(
    problem: Problem, null: Array, motions: tuple[FreeMotions, ...], texts: list[list[str]]
) -> tuple[tuple[str, ...], int]:
    """Return one sentence per unobservable direction (u, d), motions first, and the number of other directions."""
    out, rest = list[str](), null
    for m, sentences in zip(motions, texts, strict=True):
        inside = m.unobservable
        out += [text for text, yes in zip(sentences, inside, strict=True) if yes]
        if inside.any() and rest.shape[1]:
            moves = m.moves[:, inside]
            rest = without(rest, moves / np.linalg.norm(moves, axis=0))
    out = out[: null.shape[1]]
    others = null.shape[1] - len(out)
    wide = [
        f"{p.shared[j] if p.shared and p.shared[j] else image.id} {p.words[j]}"
        for image, p in zip(problem.block.images, problem.parameters, strict=True) for j in range(len(p))
    ]  # fmt: skip
    words = wide if problem.ties is None else [wide[j] for j in problem.ties.place]
    who = "the control points do not fix" if problem.has_control else "no control point fixes"
    lead = f"block: {who} this combination (in prior sigmas): "
    out += [lead + _combination(rest[:, k], words, 4, 0.1) for k in range(min(others, rest.shape[1]))]
    return tuple(out), others


def _motion_sentences(m: FreeMotions, problem: Problem, *, alone: bool) -> list[str]:
    """Return one sentence per free motion of a part of the block."""
    who = "block: the images" if alone else f"block: images {named(m.images)}"
    options = problem.block.options
    holder = "the priors alone hold it" if options.priors else "the regularisation alone holds it"
    otherwise = holder if options.holds_unknowns else "nothing else holds it"
    return [
        f"{who} may be {words}: {_control_words(m)}; {SHIFT_M:g} m change the residuals by {felt:.1g} of their sigma "
        f"(root mean square), "
        f"{'the curvature of the models alone holds it' if strength >= DETERMINED else otherwise}"
        for words, felt, strength in zip(m.words, m.felt, m.strength, strict=True)
    ]


def _control_words(m: FreeMotions) -> str:
    """Describe number and ids of the control points, or of the control features, of a part."""
    if m.features and not m.control:
        return f"control feature{'s' if len(m.features) > 1 else ''} {named(m.features)} only"
    if not m.control:
        return "no control point"
    return f"{len(m.control)} control point{'s' if len(m.control) > 1 else ''} only, {named(m.control)}"


def part_sentence(m: FreeMotions, *, priors: bool) -> str:
    """Describe the number and the names of the free motions of a part of the block."""
    by = "held by the priors alone" if priors else "free"
    many = f"{len(m)} motions are" if len(m) > 1 else "1 motion is"
    return f"images {named(m.images)}, {_control_words(m)}: {many} {by} ({', '.join(m.words)})"


def _parts(problem: Problem, structure: Structure) -> Finding:
    """Report the parts of the block, which have no common ground points."""
    ids = problem.block.points.ids
    parts = []
    for p in range(structure.n_parts):
        images = [problem.block.images[k].id for k in np.flatnonzero(structure.part == p)]
        points = np.flatnonzero(structure.point_part == p)
        control = [
            ids[j] for j in points[(problem.observed | observed_by_angles(problem.block) | ~problem.active)[points]]
        ]
        known = f"control points {named(control)}" if control else "no control point"
        parts.append(f"images {named(images)} ({len(points)} points, {known})")
    return finding("solution.parts", n=structure.n_parts, parts=parts)
