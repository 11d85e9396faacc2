"""Equations as GTSAM factors; shapes, types and values are checked, and every message names the factor.

GTSAM 4.3.0 accepts a Jacobian of the wrong width, nan and sigma 0 without an error (docs/equations.md 9). Therefore
every callback checks the results of its kernel and raises a ValueError that names equation, image and point; GTSAM
passes it on unchanged. No other module of ``factors`` imports gtsam.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np

from factors._contract import Array, Equation, check_blocks
from factors.split import Split

Unknown = int | Array | Split
Rows = tuple[Array, Array | None]


def factor(
    equation: Equation,
    unknowns: Sequence[Unknown],
    sizes: Sequence[int],
    record: Array,
    setup: Array,
    *,
    label: str,
    n_residuals: int = 2,
    loss: Any = None,
    hard: bool = False,
) -> gtsam.CustomFactor:
    """Return a GTSAM factor for one observation of an equation.

    Parameters
    ----------
    equation : Equation
        Its kernel gives the whitened residual and Jacobians.
    unknowns : one GTSAM key (int), a constant vector or a :class:`Split`, per argument of the equation
        A constant argument (such as a fixed control point) is not an unknown of the factor.
    sizes : size of each argument, in order
        Keys of arguments marked ``is_point`` are read as ``Point3``, others as vectors.
    record, setup : arrays
        Constants of the observation; see ``factors._contract``.
    label : str
        "image ..., point ...", shown in every message.
    loss : gtsam.noiseModel.mEstimator, optional
        Robust loss of the whitened norm.
    hard : bool
        True if the residual must vanish (sigma 0); GTSAM then eliminates by QR.

    Raises ValueError at creation if nothing is unknown; at evaluation for arrays of wrong number, shape or type, and
    for values that are not finite.
    """
    parts = [u.keys if isinstance(u, Split) else (int(u),) for u in unknowns if not isinstance(u, np.ndarray)]
    keys = list(itertools.chain(*parts))
    if not keys:
        raise ValueError(f"equation {equation.name!r}, {label}: no unknown, nothing to adjust")
    if (
        equation.fill
        and [a.is_point for a in equation.arguments] == [False, True]
        and not (any(not isinstance(u, int) for u in unknowns))
    ):
        one = np.ascontiguousarray(record[None])
        make = image_point_factors(equation, sizes[0], one, setup, lambda _: label, n_residuals=n_residuals, loss=loss)
        return make(keys[0], keys[1], 0)
    function = _general(equation, unknowns, sizes, record, setup, label, n_residuals)
    noise = gtsam.noiseModel.Constrained.All(n_residuals) if hard else _noise(n_residuals, loss)
    return gtsam.CustomFactor(noise, keys, function)


def eliminated_factor(
    keys: Sequence[int], sizes: Sequence[int], evaluate: Callable[[Any, bool], Rows], *, label: str
) -> gtsam.CustomFactor:
    """Return a factor that connects only image vectors (n unknowns): eliminated ground points with all their rays.

    Parameters
    ----------
    evaluate : callable
        Function that returns, from GTSAM's values, the error e (n + 1,) and on request its Jacobian J (n + 1, n).
        ``J^T J``, ``J^T e``, ``|e|^2 / 2`` are the reduced normal matrix, its gradient and the cost.
    label : str
        Name shown in every message.
    """
    ends, n = list(itertools.accumulate(sizes, initial=0)), sum(sizes)

    def error(_this: Any, values: Any, jacobians: Any) -> Array:
        value, jacobian = evaluate(values, jacobians is not None)
        if value.shape != (n + 1,) or not np.isfinite(value).all():
            raise ValueError(f"{label}: error {value.shape} of {n} unknowns, or nan")
        if jacobians is not None:
            assert jacobian is not None and jacobian.shape == (n + 1, n), label
            for k, (lo, hi) in enumerate(itertools.pairwise(ends)):
                jacobians[k] = jacobian[:, lo:hi]
        return value

    return gtsam.CustomFactor(_noise(n + 1, None), list(keys), error)


def _noise(n_residuals: int, loss: Any) -> Any:
    """Return a noise model of unit weight, because the residual is whitened, with the robust loss if there is one."""
    unit = gtsam.noiseModel.Unit.Create(n_residuals)
    return unit if loss is None else gtsam.noiseModel.Robust.Create(loss, unit)


def image_point_factors(
    equation: Equation,
    size: int,
    records: Array,
    setup: Array,
    label: Callable[[int], str],
    *,
    n_residuals: int = 2,
    loss: Any = None,
) -> Callable[[int, int, int], gtsam.CustomFactor]:
    """Return a function that makes factors between image vector and ground point, one per row of ``records``.

    ``make(image_key, point_key, row)`` returns the factor; ``label(row)`` names it in messages. All factors
    share buffers (GTSAM copies what it receives), records, setup and noise model. Each factor has only three
    own numbers, so that the data of thousands of callbacks stay in the processor's cache.
    """
    fill, noise, m = equation.fill, _noise(n_residuals, loss), n_residuals
    assert fill is not None, f"equation {equation.name!r} has no fill function"
    out = np.zeros((m, size + 4))
    value, j_image, j_point = out[:, 0], out[:, 1 : 1 + size], out[:, 1 + size :]

    def complain(row: int, x: Array, ground: Array) -> None:
        _require_size(equation.name, label(row), x, size)
        blocks = equation.kernel(records[row], setup, x, ground, True)
        check_blocks(equation.name, label(row), blocks, (size, 3), m)
        raise ValueError(f"equation {equation.name!r}, {label(row)}: the setup does not fit {size} unknowns")

    def make(image: int, point: int, row: int) -> gtsam.CustomFactor:
        def error(
            _this: Any, values: Any, jacobians: Any, image: int = image, point: int = point, row: int = row
        ) -> Array:
            x, ground = values.atVector(image), values.atPoint3(point)
            want = jacobians is not None
            if not fill(records, row, setup, x, ground, out, want):
                complain(row, x, ground)
            if want:
                jacobians[0], jacobians[1] = j_image, j_point
            return value

        return gtsam.CustomFactor(noise, [image, point], error)

    return make


def _require_size(name: str, label: str, x: Array, size: int) -> None:
    if x.shape != (size,):
        raise ValueError(f"equation {name!r}, {label}: {size} unknowns expected, the values hold {x.size}")


def _value(u: Unknown, values: Any, is_point: bool, size: int) -> Any:
    """Return the value of one argument."""
    if isinstance(u, np.ndarray):
        return u
    if isinstance(u, Split):
        return u.gathered(values, size)
    return values.atPoint3(u) if is_point else values.atVector(u)


def _general(
    equation: Equation,
    unknowns: Sequence[Unknown],
    sizes: Sequence[int],
    record: Array,
    setup: Array,
    label: str,
    m: int,
) -> Callable[[Any, Any, Any], Array]:
    """Return the callback of a factor with any number of arguments, some of which may be constants."""
    kernel, name, widths = equation.kernel, equation.name, tuple(sizes)
    free = [k for k, u in enumerate(unknowns) if not isinstance(u, np.ndarray)]

    def error(_this: Any, values: Any, jacobians: Any) -> Array:
        x: list[Any] = [
            _value(u, values, argument.is_point, size)
            for u, argument, size in zip(unknowns, equation.arguments, widths, strict=True)
        ]
        for vector, size in zip(x, widths, strict=True):
            _require_size(name, label, vector, size)
        want = jacobians is not None
        blocks = kernel(record, setup, *x, want)
        check_blocks(name, label, blocks if want else blocks[:1], widths if want else (), m)
        if want:
            slot = 0
            for k in free:
                u = unknowns[k]
                for block in u.scattered(blocks[1 + k]) if isinstance(u, Split) else (blocks[1 + k],):
                    jacobians[slot] = block
                    slot += 1
        value: Array = blocks[0]
        return value

    return error
