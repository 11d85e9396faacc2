"""The benchmark compares the RPC projection with rasterio's RPCTransformer (GDAL); each uses one core.

    OPENBLAS_NUM_THREADS=1 GDAL_NUM_THREADS=1 python benchmarks/rpc_projection.py [--points 1000000] [--repeats 5]

Both get the same longitudes, latitudes and heights as arrays. They alternate in one run, and
the smallest time of each counts. With ``op=np.positive`` rasterio returns fractions without a
Python call per point. It places the centre of the first pixel at (0.5, 0.5); therefore half a
pixel is subtracted before the results are compared. Targets: ratio >= 8, difference <= 1e-6
pixels.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor


def model() -> RpcModel:
    """Return a model of a scene with a resolution of a metre; no coefficient of the 80 is zero."""
    rng = np.random.default_rng(1)
    c = rng.normal(scale=1e-3, size=(4, 20))
    c[1::2, 0] = 1.0
    c[0, 1:4] += 0.05, -1.0, 0.02
    c[2, 1:4] += 1.0, 0.05, -0.03
    return RpcModel(np.array([1e4, 1.2e4, 31.8, 41.4, 500.0]), np.array([1e4, 1.2e4, 0.12, 0.09, 500.0]), c)


def transformer(rpc: RpcModel) -> RPCTransformer:
    """Return rasterio's transformer with the same model."""
    values: dict[str, Any] = {"err_bias": None, "err_rand": None}
    for k, axis in enumerate(("line", "samp", "long", "lat", "height")):
        values |= {f"{axis}_off": rpc.offsets[k], f"{axis}_scale": rpc.scales[k]}
    for name, row in zip(("line_num", "line_den", "samp_num", "samp_den"), rpc.coefficients, strict=True):
        values[f"{name}_coeff"] = list(row)
    return RPCTransformer(RPC(**values))


def best(function: Callable[[], Any], seconds: list[float]) -> Any:
    """Call once, append the time, and return the result."""
    start = time.perf_counter()
    result = function()
    seconds.append(time.perf_counter() - start)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    rpc = model()
    sensor = RpcSensor(rpc)
    u = np.random.default_rng(2).uniform(-1.0, 1.0, (3, options.points))
    lon, lat, h = (np.ascontiguousarray(rpc.offsets[2 + k] + rpc.scales[2 + k] * u[k]) for k in range(3))
    ecef = geodetic_to_ecef(lon, lat, h)
    rpc.project(lon[:2], lat[:2], h[:2])  # the function is compiled or loaded before the time is measured
    sensor.project(ecef[:2])
    ours, theirs, from_ecef = [], [], []
    with transformer(rpc) as peer:
        for _ in range(options.repeats):
            line, sample = best(lambda: rpc.project(lon, lat, h), ours)
            row, column = best(lambda: peer.rowcol(lon, lat, h, op=np.positive), theirs)
            best(lambda: sensor.project(ecef), from_ecef)
    off = max(np.abs(np.asarray(row) - 0.5 - line).max(), np.abs(np.asarray(column) - 0.5 - sample).max())
    us = 1e6 / options.points
    ratio = min(theirs) / min(ours)
    print(f"{options.points} points, best of {options.repeats}, us per point:")
    print(f"  RpcModel.project  (longitude, latitude, height)  {min(ours) * us:8.4f}")
    print(f"  RpcSensor.project (ECEF)                         {min(from_ecef) * us:8.4f}")
    print(f"  rasterio RPCTransformer.rowcol                   {min(theirs) * us:8.4f}")
    print(f"largest difference {off:.1e} px; rasterio / RpcModel.project = {ratio:.1f} (target >= 8)")
    return 0 if ratio >= 8.0 and off <= 1e-6 else 1


if __name__ == "__main__":
    sys.exit(main())
