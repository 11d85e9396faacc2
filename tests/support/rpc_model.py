"""A synthetic RPC of a metre-resolution scene has an evaluation without code of the package."""

from __future__ import annotations

from typing import Any

import numpy as np

from fg_orient.sensors.rpc import RpcModel

#: RPC00B, written as words: L longitude, P latitude, H height.
TERMS = "1 L P H LP LH PH LL PP HH PLH LLL LPP LHH LLP PPP PHH LLH PPH HHH".split()


def synthetic_model(seed: int = 1, **fields: Any) -> RpcModel:
    """Return an RPC with lines to the south, samples to the east, 80 coefficients and pixels of 0.5 m."""
    rng = np.random.default_rng(seed)
    c = rng.normal(scale=1e-4, size=(4, 20))
    c[1::2, 0] = 1.0
    c[0, 1:4] += 0.05, -1.0, 0.02
    c[2, 1:4] += 1.0, 0.05, -0.03
    offsets, scales = [10000.0, 12000.0, 31.8, 41.4, 500.0], [10000.0, 12000.0, 0.072, 0.045, 500.0]
    given = {"offsets": offsets, "scales": scales, "coefficients": c, "file": "synthetic"} | fields
    return RpcModel(**{k: np.array(v) if k in ("offsets", "scales") else v for k, v in given.items()})


def ground_points(model: RpcModel, n: int = 200, seed: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the longitudes, latitudes and heights inside the model's cube."""
    u = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, n))
    lon, lat, h = model.offsets[2:, None] + model.scales[2:, None] * u
    return lon, lat, h


def reference_project(
    model: RpcModel, lon: np.ndarray, lat: np.ndarray, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the line and sample, term by term in extended precision."""
    ld = np.longdouble
    names = dict(zip("LPH", (lon, lat, h), strict=True))
    n = {
        k: (v.astype(ld) - ld(model.offsets[2 + j])) / ld(model.scales[2 + j]) for j, (k, v) in enumerate(names.items())
    }
    terms = np.stack([np.prod([n[f] for f in term if f != "1"] + [np.ones(len(lon), ld)], axis=0) for term in TERMS])
    f = model.coefficients.astype(ld) @ terms
    line = ld(model.offsets[0]) + ld(model.scales[0]) * f[0] / f[1]
    return line, ld(model.offsets[1]) + ld(model.scales[1]) * f[2] / f[3]
