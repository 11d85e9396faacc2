"""Observability: what the image observations of each image cannot tell, in the user's terms.

The whitened Jacobian of an image's observations with respect to its own unknowns, in prior
sigmas, at fixed ground points, is decomposed by SVD. A direction with a singular value
below 1e-5 is **dead** (the data say nothing); below 1 it is **weak** (the prior says more
than the data). Fixing the ground points is the optimistic case: what is dead here is dead
in every adjustment of the image.

Dead directions are named by matching them with physical candidates: velocity enters the
conditions only through V x P (docs/equations.md 3), so velocity along track and radial act
on nothing, and velocity across track turns the orbital frame like a yaw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem
from fg_orient.parameters import ATTITUDE, N_EOP, POSITION, UNITS, VELOCITY, ImageParameters, parameter_name

Array = npt.NDArray[np.float64]

DEAD = 1e-5
WEAK = 1.0
#: A candidate explains a dead direction when this share of its length lies in the null space.
MATCH = 0.9

_DEGREE = ("constant", "linear in time", "quadratic in time")
_YAW = 8


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


def analyse(
    image: str, jacobian: Array, parameters: ImageParameters, ecef_from_orbital: Array, speed_m_s: float | None
) -> ImageObservability:
    """Judge one image.

    Parameters
    ----------
    jacobian : (2n, k) array
        Whitened, with respect to the unknowns in prior sigmas.
    ecef_from_orbital : (3, 3) array
        Orbital frame at the image centre: columns across track, along track, radial.
    speed_m_s : float or None
        Speed along track there, which turns a velocity across track into an angle; None for
        Earth-fixed attitudes (DIMAP v2), which the velocity does not turn at all.
    """
    k = len(parameters)
    full = np.vstack([jacobian, np.zeros((max(0, k - len(jacobian)), k))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    dead = s < DEAD
    null = vt[dead].T
    candidates = _candidates(parameters, ecef_from_orbital, speed_m_s)
    sentences = _name_directions(image, null, parameters, candidates)
    return ImageObservability(image, s, int(dead.sum()), int(((s < WEAK) & ~dead).sum()), null, tuple(sentences))


def _candidates(parameters: ImageParameters, frame: Array, speed_m_s: float | None) -> list[tuple[str, Array]]:
    """Physical directions (unit vectors in prior sigmas) with the sentence each one stands for."""
    out: list[tuple[str, Array]] = []
    index = {code: j for j, code in enumerate(parameters.codes)}
    for degree in range(3):
        triple = [index.get(3 * c + degree) for c in VELOCITY]
        if any(j is None for j in triple):
            continue
        rows = [j for j in triple if j is not None]
        for axis, text in (
            (1, "velocity along track ({}) acts on nothing"),
            (2, "radial velocity ({}) acts on nothing"),
        ):
            direction = np.zeros(len(parameters))
            direction[rows] = frame[:, axis]
            out.append((text.format(_DEGREE[degree]), direction))
        direction = np.zeros(len(parameters))
        direction[rows] = frame[:, 0] / parameters.sigma[rows]
        yaw = index.get(3 * _YAW + degree)
        if yaw is not None and speed_m_s is not None:
            direction[yaw] = 1.0 / speed_m_s / parameters.sigma[yaw]
            text = "velocity across track acts as yaw ({}): only their sum is observable"
        else:
            text = "velocity across track ({}) acts on nothing"
        out.append((text.format(_DEGREE[degree]), direction / np.linalg.norm(direction)))
    return out


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
    parts = [f"{direction[j]:+.2f} {describe(parameters.codes[j])}" for j in order if abs(direction[j]) > 0.05]
    return "this combination is not observable (in prior sigmas): " + " ".join(parts)


@dataclass(frozen=True)
class BlockObservability:
    """What all observations together say about all images, ground points free, no priors.

    Parameters
    ----------
    singular_values : (M k,) array, descending
    sentences : tuple of str
        One per direction below the dead limit, by its largest components.
    weak : int
        Directions determined 100 times worse than their prior sigma, dead ones not counted.
    """

    singular_values: Array
    sentences: tuple[str, ...]
    weak: int


#: Without priors, directions below this singular value are pointed out.
WEAK_WITHOUT_PRIORS = 1e-2


def analyse_block(problem: Problem) -> BlockObservability:
    """Judge the block without priors: unknown ground points are eliminated point by point (QR)."""
    parameters, width, m = problem.parameters, len(problem.parameters), problem.n_images
    _, j_image, j_ground = problem.image_residuals(problem.start, jacobian=True)
    rest = np.zeros((0, m * width))
    for j, rows in problem.rows_by_point():
        b = np.zeros((2 * len(rows), m * width))
        for r, row in enumerate(rows):
            at = width * int(problem.observations.image[row])
            b[2 * r : 2 * r + 2, at : at + width] = j_image[row]
        if problem.active[j]:
            a = np.vstack([j_ground[row] for row in rows])
            if problem.observed[j]:
                a = np.vstack([a, problem.control_records[j, :9].reshape(3, 3)])
                b = np.vstack([b, np.zeros((3, m * width))])
            b = np.linalg.qr(a, mode="complete")[0][:, 3:].T @ b
        rest = np.vstack([rest, b])
        if len(rest) > 4 * m * width + 100:
            rest = np.linalg.qr(rest).R
    full = np.vstack([rest, np.zeros((max(0, m * width - len(rest)), m * width))])
    _, s, vt = np.linalg.svd(full, full_matrices=False)
    names = [(image.id, code) for image in problem.block.images for code in parameters.codes]
    sentences = tuple(_block_sentence(vt[k], names) for k in np.flatnonzero(s < DEAD))
    return BlockObservability(s, sentences, int(((s < WEAK_WITHOUT_PRIORS) & (s >= DEAD)).sum()))


def _block_sentence(direction: Array, names: list[tuple[str, int]]) -> str:
    order = np.argsort(-np.abs(direction))[:4]
    parts = [f"{direction[j]:+.2f} {names[j][0]} {describe(names[j][1])}" for j in order if abs(direction[j]) > 0.1]
    return "block: the control points do not fix this combination (in prior sigmas): " + " ".join(parts)


def describe(code: int) -> str:
    """Name a coefficient in words: "velocity Y (constant)", "psi_x (s^1)"."""
    if code >= N_EOP:
        return f"look angle {parameter_name(code)}"
    component, degree = code // 3, code % 3
    if component in POSITION:
        name = f"position {'XYZ'[component]}"
    elif component in VELOCITY:
        name = f"velocity {'XYZ'[component - 3]}"
    else:
        name = ("roll", "pitch", "yaw")[component - ATTITUDE[0]]
    return f"{name} ({_DEGREE[degree]}, {UNITS[component]})"
