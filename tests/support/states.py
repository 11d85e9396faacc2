"""The module makes states of a problem away from its solution and measures the distance of two states."""

from __future__ import annotations

import numpy as np

from fg_orient.adjustment.problem import Problem, State


def moved(problem: Problem, seed: int) -> State:
    """Return a state away from the start, the same for all backends."""
    rng = np.random.default_rng(seed)
    image = problem.image_matrix(rng.normal(scale=0.3, size=problem.n_image_unknowns))
    ground = problem.start.ground.copy()
    ground[problem.active] += rng.normal(scale=3.0, size=(int(problem.active.sum()), 3))
    return State(image, ground)


def largest(problem: Problem, a: State, b: State) -> tuple[float, float]:
    """Return the largest differences of two states: image unknowns (sigmas), unknown points (m)."""
    ground = np.abs(a.ground - b.ground)[problem.active]
    return float(np.abs(a.image - b.image).max()), float(ground.max(initial=0.0))
