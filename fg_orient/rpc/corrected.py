"""A compensated RPC as an RPC again: exact where the form allows it, else with the error stated.

    line = off + c0 + scale (f1 (1 + c2/scale))/f2 + c4 f3/f4

Shifts go into the offsets, the drift of a coordinate with itself into its numerator. The rest needs f3 f2/f4, which is
a cubic polynomial only if both denominators are equal; else one is fitted. Denominators stay: no new pole can arise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.rfm import terms
from factors.cameras.rfm_project import COMPENSATION, RANGE
from fg_orient.model.errors import finding
from fg_orient.rpc.points import statistics
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution

Array = npt.NDArray[np.float64]

#: Values per axis of normalised coordinates to which a product is fitted: Chebyshev nodes.
NODES: Final = 9
#: Independent points at which the written model is compared with the compensated one.
N_CHECK: Final = 2000


@dataclass(frozen=True)
class Corrected:
    """A model with its compensation put in.

    Parameters
    ----------
    model : RpcModel
        Without the vendor's error estimates, which hold no more.
    exact : bool
        Nothing was fitted.
    errors : dict
        Statistics (px) of compensated minus written at independent points.
    """

    model: RpcModel
    exact: bool
    errors: dict[str, Any]


def corrected(model: RpcModel, values: Array, *, seed: int = 1) -> Corrected:
    """Put a compensation into a model.

    Parameters
    ----------
    model : RpcModel
    values : (6,) array
        Pixels, see ``factors.cameras.rfm_project``.
    seed : int
        Of the independent points.
    """
    scale_l, scale_s = model.scales[RANGE.image]
    offsets, c = model.offsets.copy(), model.coefficients.copy()
    offsets[RANGE.image] += values[[COMPENSATION.line, COMPENSATION.sample]]
    common = bool(np.array_equal(c[1], c[3]))
    f = model.coefficients
    c[0] = f[0] * (1.0 + values[COMPENSATION.line_l] / scale_l)
    c[2] = f[2] * (1.0 + values[COMPENSATION.sample_s] / scale_s)
    if values[COMPENSATION.line_s] != 0.0:
        c[0] += values[COMPENSATION.line_s] / scale_l * (f[2] if common else _product(f[2], f[1], f[3]))
    if values[COMPENSATION.sample_l] != 0.0:
        c[2] += values[COMPENSATION.sample_l] / scale_s * (f[0] if common else _product(f[0], f[3], f[1]))
    direct = None if model.direct is None else _direct(model, values)
    new = replace(
        model, offsets=offsets, coefficients=c, direct=direct, err_bias_m=None, err_rand_m=None,
        notes=(*model.notes, finding("rpc.compensated")),
    )  # fmt: skip
    exact = common or not values[[COMPENSATION.sample_l, COMPENSATION.line_s]].any()
    return Corrected(new, exact, _errors(model, values, new, seed))


def corrected_models(solution: Solution) -> dict[str, Corrected]:
    """Model of every RPC image of a solution with its compensation put in, by image id."""
    sensors = {image.id: image.sensor for image in solution.block.images if isinstance(image.sensor, RpcSensor)}
    return {name: corrected(sensor.model, solution.correction(name)) for name, sensor in sensors.items()}


def _nodes(count: int) -> Array:
    """Points of the cube of normalised coordinates: (count^3, 3)."""
    axis = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.stack([a.ravel() for a in np.meshgrid(axis, axis, axis)], axis=1)


def _product(f: Array, above: Array, below: Array) -> Array:
    """Cubic polynomial p (20,) with p/above closest to f/below over the cube."""
    m = terms(_nodes(NODES))
    weight = 1.0 / (m @ above)
    return np.asarray(np.linalg.lstsq(m * weight[:, None], (m @ f) / (m @ below), rcond=None)[0])


def _direct(model: RpcModel, values: Array) -> Array:
    """Coefficients from image to ground for compensated pixels: exact, as the map of the pixels is affine."""
    assert model.direct is not None
    scale_l, scale_s = model.scales[RANGE.image]
    matrix = np.array([
        [scale_l + values[COMPENSATION.line_l], values[COMPENSATION.line_s]],
        [values[COMPENSATION.sample_l], scale_s + values[COMPENSATION.sample_s]],
    ])  # fmt: skip
    new = _nodes(4)  # sample, line, height in the new normalised coordinates
    l, s = np.linalg.solve(matrix, np.stack([new[:, 1] * scale_l, new[:, 0] * scale_s]))  # noqa: E741
    old = terms(np.column_stack([s, l, new[:, 2]]))
    rows = np.linalg.lstsq(terms(new), old @ model.direct.T, rcond=None)[0].T
    for k in (0, 2):
        rows[k : k + 2] /= rows[k + 1, 0]
        rows[k + 1, 0] = 1.0
    return np.ascontiguousarray(rows)


def _errors(model: RpcModel, values: Array, new: RpcModel, seed: int) -> dict[str, Any]:
    """Statistics of compensated minus written pixels at random pixels and heights of the image."""
    v, rng = model.validity, np.random.default_rng(seed)
    line, sample, height = (rng.uniform(low, high, N_CHECK) for low, high in (v.line, v.sample, v.height_m))
    lon, lat = model.locate(line, sample, height)
    seen = np.isfinite(lon)
    ground = lon[seen], lat[seen], height[seen]
    d = np.stack(model.project(*ground, values), axis=1) - np.stack(new.project(*ground), axis=1)
    found = statistics(d)
    assert found is not None
    return found
