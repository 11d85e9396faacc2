"""Observability: what the image observations of each image cannot tell, in the user's terms.

The whitened Jacobian of an image's observations with respect to its own unknowns, in prior
sigmas, at fixed ground points, is decomposed by SVD. A direction with a singular value
below 1e-5 is **dead** (the data say nothing); below 1 it is **weak** (the prior says more
than the data). Fixing the ground points is the optimistic case: what is dead here is dead
in every adjustment of the image.

Dead directions are named by matching them with physical candidates, which the image's model
gives (``silent_directions``). A block without control points is asked, besides, what holds it
in the world: its images may be shifted, turned or scaled together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.models.contract import ImageModel
from fg_orient.adjustment.problem import Problem
from fg_orient.parameters import ImageParameters

Array = npt.NDArray[np.float64]

DEAD = 1e-5
WEAK = 1.0
#: A candidate explains a dead direction when this share of its length lies in the null space.
MATCH = 0.9


@dataclass(frozen=True)
class ImageObservability:
    """What the data say about one image.

    Parameters
    ----------
    image : str
        Image id.
    singular_values : (k,) array, descending; k unknowns, in sigmas of the data per prior sigma
    rank_defect : int
        Dead directions.
    weak : int
        Directions that the prior determines better than the data, dead ones not counted.
    null_space : (k, rank_defect) array
        Orthonormal dead directions in prior sigmas.
    sentences : tuple of str
        One per dead direction.
    """

    image: str
    singular_values: Array
    rank_defect: int
    weak: int
    null_space: Array
    sentences: tuple[str, ...]


def analyse(image: str, jacobian: Array, model: ImageModel) -> ImageObservability:
    """Judge one image.

    Parameters
    ----------
    image : str
        Image id.
    jacobian : (2n, k) array
        Whitened, with respect to the unknowns in prior sigmas.
    model : ImageModel
        Names the unknowns and the directions that physics hides.
    """
    k = len(model.parameters)
    short = np.asarray(np.linalg.qr(jacobian, mode="r")) if len(jacobian) > k else jacobian
    full = np.vstack([short, np.zeros((max(0, k - len(short)), k))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    dead = s < DEAD
    null = vt[dead].T
    sentences = _name_directions(image, null, model.parameters, model.silent_directions()) if dead.any() else []
    return ImageObservability(image, s, int(dead.sum()), int(((s < WEAK) & ~dead).sum()), null, tuple(sentences))


def _name_directions(
    image: str, null: Array, parameters: ImageParameters, candidates: list[tuple[str, Array]]
) -> list[str]:
    """One sentence per dead direction: greedy match with the candidates, the rest by components."""
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
    sentences = [f"image {image}: {candidates[k][0]}" for k in sorted(found)]
    return sentences + [f"image {image}: {_by_components(rest[:, j], parameters)}" for j in range(rest.shape[1])]


def _by_components(direction: Array, parameters: ImageParameters) -> str:
    """Describe a direction by its three largest components, in prior sigmas."""
    order = np.argsort(-np.abs(direction))[:3]
    parts = [f"{direction[j]:+.2f} {parameters.words[j]}" for j in order if abs(direction[j]) > 0.05]
    return "this combination is not observable (in prior sigmas): " + " ".join(parts)


@dataclass(frozen=True)
class BlockObservability:
    """What all observations together say about all images, ground points free, no priors.

    Parameters
    ----------
    singular_values : (u,) array, descending; u unknowns of all images
    sentences : tuple of str
        One per direction below the dead limit, by its largest components.
    weak : int
        Directions determined 100 times worse than their prior sigma, dead ones not counted.
    datum : tuple of str
        One per common shift, turn or change of scale of all images that no control point fixes.
    """

    singular_values: Array
    sentences: tuple[str, ...]
    weak: int
    datum: tuple[str, ...] = ()


#: Without priors, directions below this singular value are pointed out.
WEAK_WITHOUT_PRIORS = 1e-2
#: A motion of all images by this much shows whether anything but the priors holds them.
DATUM_SHIFT_M = 10.0


def analyse_block(problem: Problem) -> BlockObservability:
    """Judge the block without priors: unknown ground points are eliminated point by point (QR)."""
    _, j_image, j_ground = problem.image_residuals(problem.start, jacobian=True)
    rest = _eliminated(problem, j_image, j_ground)
    u = problem.n_image_unknowns
    full = np.vstack([rest, np.zeros((max(0, u - len(rest)), u))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    names = [
        (image.id, word)
        for image, parameters in zip(problem.block.images, problem.parameters, strict=True)
        for word in parameters.words
    ]
    sentences = tuple(_block_sentence(vt[k], names) for k in np.flatnonzero(s < DEAD))
    weak = int(((s < WEAK_WITHOUT_PRIORS) & (s >= DEAD)).sum())
    datum = (
        ()
        if (~problem.active[problem.observations.point]).any() or problem.observed.any()
        else _datum(problem, rest, j_image, j_ground)
    )
    return BlockObservability(s, sentences, weak, datum)


def _eliminated(problem: Problem, j_image: list[Array], j_ground: list[Array]) -> Array:
    """Rows (q, u) of all image unknowns with the ground points eliminated, compressed by QR on the way."""
    first, u, image = problem.first, problem.n_image_unknowns, problem.observations.image
    parts, height = [np.zeros((0, u))], 0
    for j, rows in problem.rows_by_point():
        b = np.zeros((2 * len(rows), u))
        for r, row in enumerate(rows):
            b[2 * r : 2 * r + 2, first[image[row]] : first[image[row] + 1]] = j_image[row]
        if problem.active[j]:
            a = np.vstack([j_ground[row] for row in rows])
            if problem.observed[j]:
                a = np.vstack([a, problem.control_records[j, :9].reshape(3, 3)])
                b = np.vstack([b, np.zeros((3, u))])
            b = np.linalg.qr(a, mode="complete")[0][:, 3:].T @ b
        parts.append(b)
        height += len(b)
        if height > 4 * u + 100:
            parts = [np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))]
            height = len(parts[0])
    return np.vstack(parts)


def _datum(problem: Problem, rest: Array, j_image: list[Array], j_ground: list[Array]) -> tuple[str, ...]:
    """Common shifts, turns and change of scale that the block itself does not resist.

    For each of them every image takes the unknowns that best follow the moved ground; what the block then
    still feels is the change of its residuals with the ground points free to follow.
    """
    image, point = problem.observations.image, problem.observations.point
    by_image = [np.flatnonzero(image == k) for k in range(problem.n_images)]
    out = []
    for words, shift in _motions(problem):
        move = np.zeros(problem.n_image_unknowns)
        for k, rows in enumerate(by_image):
            a = np.vstack([j_image[r] for r in rows])
            b = np.concatenate([j_ground[r] @ shift[point[r]] for r in rows])
            move[problem.first[k] : problem.first[k + 1]] = -np.linalg.lstsq(a, b, rcond=None)[0]
        felt = float(np.linalg.norm(rest @ move) / np.sqrt(2 * len(problem.observations)))
        if felt < WEAK:
            out.append(
                f"block: the images may be {words}: no control point; {DATUM_SHIFT_M:g} m change the "
                f"residuals by {felt:.1g} of their sigma (root mean square), the priors alone hold it"
            )
    return tuple(out)


def _motions(problem: Problem) -> list[tuple[str, Array]]:
    """The seven motions of a similarity in words, with the shift (N, 3) m of every ground point.

    Turns and change of scale are about the middle of the points, large enough for half of them to go
    :data:`DATUM_SHIFT_M` or more.
    """
    ground, seen = problem.start.ground, np.unique(problem.observations.point)
    arm = ground - np.median(ground[seen], axis=0)
    turn, names = problem.axes(problem.origin_m[None])[0], problem.axis_names
    whole = [(f"shifted together {name}", np.tile(axis, (len(arm), 1))) for name, axis in zip(names, turn, strict=True)]
    whole += [(f"turned together about {name}", np.cross(axis, arm)) for name, axis in zip(names, turn, strict=True)]
    whole.append(("scaled together", arm))
    return [(words, DATUM_SHIFT_M / np.median(np.linalg.norm(d[seen], axis=1)) * d) for words, d in whole]


def _block_sentence(direction: Array, names: list[tuple[str, str]]) -> str:
    order = np.argsort(-np.abs(direction))[:4]
    parts = [f"{direction[j]:+.2f} {names[j][0]} {names[j][1]}" for j in order if abs(direction[j]) > 0.1]
    return "block: the control points do not fix this combination (in prior sigmas): " + " ".join(parts)
