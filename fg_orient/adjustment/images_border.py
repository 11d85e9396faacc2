"""The border where images are eliminated first: shared unknowns of the images, and all ground points.

See :mod:`fg_orient.adjustment.images_first`; :func:`border_of` chooses between the two kinds of border.
"""

from __future__ import annotations

import contextlib

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.border import Border, small_enough
from fg_orient.adjustment.border_matrix import BorderMatrix, Followed, triangle
from fg_orient.adjustment.images_first import Images, Places, images_first
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.schur_reduced import Singular


class ImagesBorder(BorderMatrix):
    """The border of a problem whose images are eliminated, linearised at a state.

    Parameters
    ----------
    problem : Problem
    state : State
    places : Places, optional
        Of the problem.

    Raises
    ------
    Singular
        An image is not determined by its points.
    """

    def __init__(self, problem: Problem, state: State, places: Places | None = None) -> None:
        self.places = places or Places(problem)
        #: The eliminated images.
        self.images = Images(self.places, state)
        super().__init__(problem, state, self.images.matrix, self.images.border_gradient)

    def at(self, state: State) -> ImagesBorder:
        """See :class:`BorderMatrix`."""
        out = ImagesBorder(self.problem, state, self.places)
        out.moves = self.moves
        return out

    def newton(self) -> State:
        """See :class:`BorderMatrix`."""
        places, step = self.places, -(self.inverse @ self.gradient)
        own = self.images.own_step + self.images.followed(step[:, None])[:, :, 0]
        return places.state(places.own_of(self.state) + own, places.border_of(self.state) + step)

    def images_of(self, moves: Array) -> Array:
        """See :class:`BorderMatrix`."""
        return self.places.joined(self.images.followed(moves), moves[: len(self.places.shared)])

    def follow(self, moves: Array) -> Followed:
        """See :class:`BorderMatrix`."""
        places, problem, d = self.places, self.problem, moves.shape[1]
        s, own = len(places.shared), self.images.followed(moves)
        flat = self.images.along(own, moves)
        gradient, rows = self.images.to_border(flat), [flat]
        ground = self._ground(moves)
        observed = np.flatnonzero(problem.observed)
        if len(observed):
            w = problem.control_weights(observed)
            held = w @ ground[observed]
            at = places.of_point[observed][:, None] + np.arange(3)
            gradient[at] += np.swapaxes(w, 1, 2) @ held
            rows.append(held.reshape(3 * len(held), d))
        for extra in self.images.extras:
            value = extra.border @ moves + (extra.own @ own[extra.image] if extra.image >= 0 else 0.0)
            gradient += extra.border.T @ value
            rows.append(value)
        if problem.block.options.priors:
            gradient[:s] += moves[:s]
            rows.append(places.joined(own, moves[:s]))
        return Followed(ground, triangle(np.vstack(rows)), gradient)

    def movements(self, moves: Array) -> tuple[Array, Array]:
        """See :class:`BorderMatrix`."""
        return self.images_of(moves), self._ground(moves)

    def _ground(self, moves: Array) -> Array:
        """Movements (N, 3, d) of the ground points."""
        active = self.problem.active
        out, points = np.zeros((len(active), 3, moves.shape[1])), int(active.sum())
        out[active] = moves[len(self.places.shared) :].reshape(points, 3, moves.shape[1])
        return out

    def effect_of(self, images: Array, ground: Array) -> Array:
        """See :class:`BorderMatrix`; the own unknowns of the images follow."""
        moves = ground[self.problem.active].reshape(len(self) - len(self.places.shared), images.shape[1])
        return self.follow(np.vstack([images[self.places.shared], moves])).effect


def border_of(problem: Problem, state: State) -> BorderMatrix | None:
    """Border of a problem, of the kind that takes less work; None if it is too large.

    Raises
    ------
    Singular
        The observations do not determine the unknowns that are eliminated.
    """
    if images_first(problem):
        with contextlib.suppress(Singular):
            return ImagesBorder(problem, state)
    return Border(problem, state) if small_enough(problem) else None
