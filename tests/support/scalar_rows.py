"""The scalar kernel of an equation computes rows of image points without the batches of the package."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors._contract import evaluate
from fg_orient.adjustment.problem import Problem, State

Array = npt.NDArray[np.float64]


def scalar_rows(problem: Problem, state: State) -> tuple[Array, list[Array], list[Array]]:
    """Return whitened residuals (n, 2) of all image points, and Jacobians (2, k) and (2, 3) of each."""
    o, values, d_image, d_ground = problem.observations, [], [], []
    for row, (k, j) in enumerate(zip(o.image.tolist(), o.point.tolist(), strict=True)):
        model, ground = problem.models[k], np.ascontiguousarray(state.ground[j : j + 1])
        value, (by_image, by_ground) = evaluate(
            model.equation, problem.records[row : row + 1], [model.parameters.setup], [problem.unknowns(state, k)],
            ground,
        )  # fmt: skip
        values.append(value.reshape(2))
        d_image += by_image
        d_ground += by_ground
    return np.array(values), d_image, d_ground
