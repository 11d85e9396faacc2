"""States, steps and linearisations of a block in parts.

The sum of the reduced systems of all parts, with the priors, is solved in this process or in fronts. Then each part
moves its points according to the step of the images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.fronts import Partial
from fg_orient.adjustment.parts.multifrontal import Multifrontal
from fg_orient.adjustment.parts.tasks import Sums
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.reduced_cofactors import SummedSystem
from fg_orient.adjustment.schur_reduced import Reduced
from fg_orient.adjustment.schur_stages import ImageExtras

if TYPE_CHECKING:
    from fg_orient.adjustment.parts.backend import PartedBackend


class PartedState(State):
    """State with ground points in the files of the parts; ``gather`` reads the points with this name."""

    name: str
    _gather: Callable[[str], Array]

    def __init__(self, image: Array, name: str, gather: Callable[[str], Array]) -> None:
        for key, value in (("image", image), ("name", name), ("_gather", gather)):
            object.__setattr__(self, key, value)

    @property
    def ground(self) -> Array:
        """Ground points (N, 3), m in the local frame."""
        return self._gather(self.name)


@dataclass(frozen=True)
class PartedStep:
    """A step; see ``loop.Step``. ``base`` and ``target`` are the names of the states before and after it."""

    image: Array
    base: str
    target: str
    length: float
    predicted_error: float
    norm: float


class PartedSystem:
    """One linearisation; see ``loop.System``."""

    def __init__(self, backend: PartedBackend, state: PartedState) -> None:
        self._backend, self.state = backend, state
        self._extras = ImageExtras(backend.problem, state)
        self._prior_gradient = backend.prior * backend.problem.image_vector(state) + self._extras.gradient
        self._newton: PartedStep | None = None
        self._known = backend.known_error(state)
        self._least = backend.problem.least_damping
        self._partial: Partial | Multifrontal | None = None

    @property
    def error(self) -> float:
        """Half the weighted sum of squares, or the cost under a loss."""
        if self._known is None:
            self._eliminated(self._least)  # the next Gauss-Newton step requires the elimination
        assert self._known is not None
        return self._known

    def _eliminated(self, damping: float) -> Partial | Multifrontal:
        """Return the sum of all parts, or their factor in fronts."""
        if damping == self._least and self._partial is not None:
            return self._partial
        partial = self._factor(damping) if self._backend.in_fronts else self._sum(damping)
        self._known = partial.error + self._backend.image_error(self.state)
        if damping == self._least:
            self._partial = partial
        return partial

    def _factor(self, damping: float) -> Partial | Multifrontal:
        return self._backend.multifrontal(self.state, damping, self._extras, self._prior_gradient)

    def _sum(self, damping: float) -> Partial:
        partial: Partial = self._backend.total(tasks.eliminate, self.state, damping)
        own = np.flatnonzero(partial.row == partial.column)
        self._extras.add_blocks(dict(zip(partial.row[own].tolist(), own.tolist(), strict=True)), partial.blocks)
        return partial

    def solve(self, damping: float) -> PartedStep:
        """Eliminate the points of all parts, solve for the images, substitute back; see ``SchurSystem.solve``."""
        damping = max(damping, self._least)
        if damping == self._least and self._newton is not None:
            return self._newton
        partial, target = self._eliminated(damping), self._backend.new_name()
        if isinstance(partial, Multifrontal):
            image = partial.step()
            if partial is not self._partial:
                partial.remove()
        else:
            image = self._backend.reduced(partial, damping, self._extras.matrix).solve(
                partial.gradient + self._prior_gradient
            )
        step = self._step(image, target, self._backend.total(tasks.substitute, self.state, damping, image, target))
        if damping == self._least:
            self._newton = step
        return step

    def dogleg(self, radius: float) -> PartedStep:
        """Return a blend of the steepest-descent and the Gauss-Newton step."""
        newton, backend = self.solve(0.0), self._backend
        if newton.norm <= radius:
            return newton
        image, of_points = backend.total(tasks.gradient, self.state)
        image = image + self._prior_gradient
        squares = float(np.sum(image**2)) + of_points
        curvature, product = backend.total(tasks.bend, self.state, self._least, image, newton.image)
        own = backend.prior * float(np.sum(image**2)) + self._extras.squares_along(image, 0.0)
        factor = -squares / (curvature + own)
        length = abs(factor) * float(np.sqrt(squares))
        along_slope, along_newton = factor * min(1.0, radius / length), 0.0
        if length < radius:
            product = factor * (product + float(np.sum(image * newton.image)))
            across = max(newton.norm**2 - 2.0 * product + length**2, 0.0)
            along_newton = share_at_radius(across, product - length**2, length, radius)
            along_slope = factor * (1.0 - along_newton)
        target = backend.new_name()
        moved = backend.total(
            tasks.blend, self.state, self._least, image, newton.image, (along_slope, along_newton), target
        )
        return self._step(along_slope * image + along_newton * newton.image, target, moved)

    def _step(self, image: Array, target: str, moved: Sums) -> PartedStep:
        backend, (largest, squares, predicted) = self._backend, moved
        moved_image = self.state.image + backend.problem.image_matrix(image)
        error = predicted + backend.prior_error(moved_image) + 0.5 * self._extras.squares_along(image, 1.0)
        length, norm = max(float(np.abs(image).max()), float(largest)), float(np.sqrt(np.sum(image**2) + squares))
        return PartedStep(image, self.state.name, target, length, error, norm)

    def summed(self) -> SummedSystem:
        """Return the reduced system for the covariance, without the parts.

        If the system is singular, the error is raised when it is used.
        """
        partial: Partial | Multifrontal | RuntimeError
        try:
            partial = self._eliminated(0.0)
        except RuntimeError as error:
            partial = error
        state, choice = State(self.state.image, self.state.ground), self._backend.choice
        if isinstance(partial, Multifrontal):
            kept = partial.keep(self._backend.folder.parents[1])
            return SummedSystem(state, lambda damping: kept, choice)

        def reduced(damping: float) -> Reduced:
            if isinstance(partial, RuntimeError):
                raise partial
            return self._backend.reduced(partial, damping, self._extras.matrix)

        return SummedSystem(state, reduced, choice)
