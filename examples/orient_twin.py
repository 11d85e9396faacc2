"""Adjust the simulated SPOT-5 stereo pair of Zonguldak in twenty lines.

    python examples/orient_twin.py [FOLDER]

The script writes the synthetic block (37 control and 10 check points, 0.3 px) to FOLDER (default: a
temporary folder) and reads its project file. It adjusts the block with three EOP sets and prints
sigma0, the accuracy at check points, unobservable directions, and standard deviations of one image.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import fg_orient as fg
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak


def main() -> None:
    """Simulate, read, adjust, print."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary) / "zonguldak"
        block = fg.read_project(simulate_zonguldak(folder, ZonguldakOptions(seed=1)))
        print(f"{len(block.images)} images, {len(block.points.ids)} points, {len(block.observations)} image points")
        for eop_set in ("PUA0", "PUA", "PUVA"):
            solution = fg.adjust(block, eop_set=eop_set)
            check = solution.accuracy.check.statistics()
            rmse = " / ".join(f"{check[f'rmse_{axis}_m']:.2f}" for axis in ("east", "north", "up"))
            print(f"set {eop_set:<5} {solution.status.value}: {solution.iterations} iterations", end=", ")
            print(f"sigma0 {solution.sigma0:.2f}, check points E/N/U {rmse} m", end=", ")
            print(f"{len(solution.unobservable)} directions not observable")
        for sentence in solution.unobservable[:3]:
            print(f"  {sentence}")
        covariance = solution.covariance("image:left")
        sigmas = np.sqrt(np.diag(covariance.values))
        for name, unit, sigma in zip(covariance.names[:3], covariance.units[:3], sigmas[:3], strict=True):
            print(f"  {name}: standard deviation {sigma:.2f} {unit}")


if __name__ == "__main__":
    main()
