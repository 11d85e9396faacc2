"""Equations as GTSAM factors: checked shapes, types and values, named in every message.

GTSAM 4.3.0 takes a Jacobian of the wrong width, nan and sigma 0 without a word
(ecosystem.md 6.2). Every callback here checks what its kernel returned and raises a
ValueError that names equation, image and point; GTSAM passes it on unchanged.
The only module of ``factors`` that imports gtsam.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np

from factors._contract import Array, Equation, check_blocks, finite2

ErrorFunction = Callable[[Any, Any, Any], Array]


def factor(
    equation: Equation,
    unknowns: Sequence[int | Array],
    sizes: Sequence[int],
    record: Array,
    setup: Array,
    *,
    label: str,
    n_residuals: int = 2,
    loss: Any = None,
) -> gtsam.CustomFactor:
    """Wrap one observation of an equation into a GTSAM factor.

    Parameters
    ----------
    equation : Equation
        Its kernel gives the whitened residual and Jacobians.
    unknowns : one GTSAM key (int), or a constant vector, per argument of the equation
        A constant argument (a fixed control point) is no unknown of the factor.
    sizes : size of each argument, in order
        Keys of arguments marked ``is_point`` are read as ``Point3``, others as vectors.
    record, setup : arrays
        Constants of the observation, see ``factors._contract``.
    label : str
        "image ..., point ...": named in every message.
    loss : gtsam.noiseModel.mEstimator, optional
        Robust loss on the whitened norm.

    Raises
    ------
    ValueError
        At creation if nothing is unknown; at evaluation if the kernel returns arrays of wrong
        number, shape or type, or values that are not finite.
    """
    keys = [int(u) for u in unknowns if not isinstance(u, np.ndarray)]
    if not keys:
        raise ValueError(f"equation {equation.name!r}, {label}: no unknown, nothing to adjust")
    noise: Any = gtsam.noiseModel.Unit.Create(n_residuals)
    if loss is not None:
        noise = gtsam.noiseModel.Robust.Create(loss, noise)
    if [a.is_point for a in equation.arguments] == [False, True] and len(keys) == 2:
        function = _image_and_point(equation, keys, sizes, record, setup, label, n_residuals)
    else:
        function = _general(equation, unknowns, sizes, record, setup, label, n_residuals)
    return gtsam.CustomFactor(noise, keys, function)


def _image_and_point(
    equation: Equation, keys: list[int], sizes: Sequence[int], record: Array, setup: Array, label: str, m: int
) -> ErrorFunction:
    """Build the common case, an image vector and a ground point, with little overhead per call."""
    kernel, name = equation.kernel, equation.name
    image, point = keys
    shape_value, shape_image, shape_point = (m,), (m, sizes[0]), (m, sizes[1])

    def error(_this: Any, values: Any, jacobians: Any) -> Array:
        x, ground = values.atVector(image), values.atPoint3(point)
        if jacobians is None:
            value: Array = kernel(record, setup, x, ground, False)[0]
            if value.shape != shape_value or not np.isfinite(value.sum()):
                check_blocks(name, label, (value,), (), m)
            return value
        blocks = kernel(record, setup, x, ground, True)
        value, j_image, j_point = blocks
        if (
            value.shape != shape_value
            or j_image.shape != shape_image
            or j_point.shape != shape_point
            or not finite2(value, j_image, j_point)
        ):
            check_blocks(name, label, blocks, tuple(sizes), m)
        jacobians[0], jacobians[1] = j_image, j_point
        return value

    return error


def _general(
    equation: Equation,
    unknowns: Sequence[int | Array],
    sizes: Sequence[int],
    record: Array,
    setup: Array,
    label: str,
    m: int,
) -> ErrorFunction:
    """Build the case of any number of arguments, constants among them."""
    kernel, name, widths = equation.kernel, equation.name, tuple(sizes)
    free = [k for k, u in enumerate(unknowns) if not isinstance(u, np.ndarray)]

    def error(_this: Any, values: Any, jacobians: Any) -> Array:
        x: list[Any] = [
            u if isinstance(u, np.ndarray) else values.atPoint3(u) if argument.is_point else values.atVector(u)
            for u, argument in zip(unknowns, equation.arguments, strict=True)
        ]
        want = jacobians is not None
        blocks = kernel(record, setup, *x, want)
        check_blocks(name, label, blocks if want else blocks[:1], widths if want else (), m)
        if want:
            for slot, k in enumerate(free):
                jacobians[slot] = blocks[1 + k]
        value: Array = blocks[0]
        return value

    return error
