"""The benchmark compares time and memory of orthorectification with rasterio.warp; each uses one thread.

Both fill the same map raster from the same image with the same DEM and kernel. fg_orient uses
the rigorous model. GDAL has no rigorous model and uses the RPC fitted to it. Each runs in a
process of its own after a small run that loads and compiles everything; peak memory is the
increase after this small run. GDAL widens its bilinear kernel if it estimates that the map is
coarser than the image; XSCALE and YSCALE of 1 prevent this. With an RPC and a DEM rasterio
lets GDAL compute the position of every pixel (its ``tolerance`` changes neither a grey value
nor the time); fg_orient interpolates positions. The files are uncompressed, so that the time
of a compressor is not included.

    python -m benchmarks.ortho --size 12000
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

CRS = "EPSG:32636"
RESOLUTION_M = 5.0
WARM = 256
WAYS = ("ours", "gdal")


def prepare(folder: Path) -> None:
    """Write metadata, DEM and an image of smooth noise; the grey values do not influence the time."""
    import rasterio

    from fg_orient.simulate.render import RasterOptions
    from fg_orient.simulate.zonguldak import simulate_zonguldak

    simulate_zonguldak(folder / "twin", rasters=RasterOptions(images=False))
    rng = np.random.default_rng(1)
    tile = np.kron(rng.integers(20, 220, (125, 125), dtype=np.uint8), np.ones((4, 4), np.uint8))
    settings = {"driver": "GTiff", "width": 12000, "height": 12000, "count": 1, "dtype": "uint8", "tiled": True,
                "blockxsize": 512, "blockysize": 512}  # fmt: skip
    with rasterio.open(folder / "image.tif", "w", **settings) as sink:
        sink.write(np.tile(tile, (24, 24)), 1)


def bounds_of(size: int) -> tuple[float, float, float, float]:
    """Return a square of the map around the middle of the scene."""
    left, bottom = 404_000.0 - 0.5 * size * RESOLUTION_M, 4_572_500.0 - 0.5 * size * RESOLUTION_M
    return left, bottom, left + size * RESOLUTION_M, bottom + size * RESOLUTION_M


def ours(folder: Path, size: int, out: Path) -> dict[str, Any]:
    from fg_orient.formats.sensor import read_sensor
    from fg_orient.rectification.options import OrthoOptions
    from fg_orient.rectification.ortho import orthorectify
    from fg_orient.rectification.ortho_models import SensorModel
    from fg_orient.sensors.surface import RasterDem

    dem = RasterDem(folder / "twin/dem.tif")
    model = SensorModel(read_sensor(folder / "twin/left.DIM"), None, CRS, dem.range_m[1])
    found = orthorectify(
        folder / "image.tif", model, dem, out, crs=CRS, resolution=RESOLUTION_M, bounds=bounds_of(size),
        options=OrthoOptions(compress="none"), overwrite=True,
    )  # fmt: skip
    return {"error_px": found["error_px"], "knots": found["knots"], "filled": found["filled"]}


def gdal(folder: Path, size: int, out: Path) -> dict[str, Any]:
    import rasterio
    from rasterio import Affine
    from rasterio.warp import Resampling, reproject

    left, _, _, top = bounds_of(size)
    settings = {
        "driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "uint8", "crs": CRS, "nodata": 0,
        "transform": Affine(RESOLUTION_M, 0.0, left, 0.0, -RESOLUTION_M, top), "tiled": True, "blockxsize": 512,
        "blockysize": 512,
    }  # fmt: skip
    with rasterio.Env(GDAL_CACHEMAX=128 * 2**20, GDAL_NUM_THREADS=1), rasterio.open(folder / "image.tif") as source:
        with rasterio.open(out, "w", **settings) as sink:
            reproject(
                rasterio.band(source, 1), rasterio.band(sink, 1), rpcs=source.rpcs, resampling=Resampling.bilinear,
                num_threads=1, warp_mem_limit=256, XSCALE=1, YSCALE=1, RPC_DEM=str(folder / "twin/dem.tif"),
            )  # fmt: skip
    return {}


def fit_rpc(folder: Path) -> float:
    """Fit the RPC to the model for the heights of the DEM; return the largest error at check points, px."""
    import rasterio
    from rasterio.rpc import RPC

    from fg_orient.formats.sensor import read_sensor
    from fg_orient.rpc.fitting import fit_image
    from fg_orient.rpc.options import FitOptions

    model, record = fit_image(read_sensor(folder / "twin/left.DIM"), (-50.0, 1850.0), FitOptions())
    values: dict[str, Any] = {"err_bias": None, "err_rand": None}
    for k, axis in enumerate(("line", "samp", "long", "lat", "height")):
        values |= {f"{axis}_off": float(model.offsets[k]), f"{axis}_scale": float(model.scales[k])}
    for name, row in zip(("line_num", "line_den", "samp_num", "samp_den"), model.coefficients, strict=True):
        values[f"{name}_coeff"] = row.tolist()
    with rasterio.open(folder / "image.tif", "r+") as image:  # GDAL's warper reads the RPC from the file
        image.rpcs = RPC(**values)
    return max(record["check"]["max_line_px"], record["check"]["max_sample_px"])


def measure(way: str, folder: Path, size: int) -> dict[str, Any]:
    """Make a small and the real run; return the real run's seconds and its increase of peak memory (MB)."""
    _run(way, folder, WARM, folder / "warm.tif")
    held = _peak_kb()
    start = time.perf_counter()
    facts = _run(way, folder, size, raster_of(way, folder))
    seconds = time.perf_counter() - start
    return {**facts, "seconds": seconds, "peak_mb": (_peak_kb() - held) / 1e3}


def _peak_kb() -> int:
    """Return the largest resident memory of this process so far; getrusage would include the parent process."""
    found = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text(encoding="ascii"))
    return int(found[1]) if found else 0


def _run(way: str, folder: Path, size: int, out: Path) -> dict[str, Any]:
    return ours(folder, size, out) if way == WAYS[0] else gdal(folder, size, out)


def raster_of(way: str, folder: Path) -> Path:
    """Return the file for the result of a program."""
    return folder / f"{way}.tif"


def differences(folder: Path, way: str) -> float:
    """Return the share of pixels whose grey values differ from the values of fg_orient by more than 3."""
    import rasterio

    different = pixels = 0
    with rasterio.open(raster_of(WAYS[0], folder)) as one, rasterio.open(raster_of(way, folder)) as other:
        for _, window in one.block_windows(1):
            a, b = (source.read(1, window=window).astype(int) for source in (one, other))
            different += int((np.abs(a - b) > 3).sum())
            pixels += a.size
    return different / pixels


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", type=int, default=12000, help="edge of the map raster, pixels")
    parser.add_argument("--repeats", type=int, default=3, help="of each way, in turn; the fastest counts")
    parser.add_argument("--measure", nargs=2, metavar=("WAY", "FOLDER"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", message="Dataset has no geotransform")  # the image is in sensor geometry
    if options.measure:
        sys.stdout.write(json.dumps(measure(options.measure[0], Path(options.measure[1]), options.size)))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        sys.stdout.write(f"RPC fitted to the model: {fit_rpc(folder):.2g} px at worst\n")
        found: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
        for _ in range(options.repeats):
            for way in WAYS:
                command = [
                    sys.executable,
                    "-m",
                    "benchmarks.ortho",
                    "--size",
                    str(options.size),
                    "--measure",
                    way,
                    name,
                ]
                done = subprocess.run(command, capture_output=True, text=True, check=True)
                found[way].append(json.loads(done.stdout))
        for way, runs in found.items():
            best = min(runs, key=lambda run: float(run["seconds"]))
            beside = "" if way == WAYS[0] else f", differs at {100 * differences(folder, way):.2g} % of the pixels"
            sys.stdout.write(f"{way}: {json.dumps(best)}{beside}\n")
        first = min(run["seconds"] for run in found[WAYS[0]])
        for way in WAYS[1:]:
            sys.stdout.write(f"ours/{way}: {first / min(run['seconds'] for run in found[way]):.2f}\n")


if __name__ == "__main__":
    main()
