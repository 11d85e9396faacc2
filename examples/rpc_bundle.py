"""Adjust a stereo pair with RPC only: estimate the bias, find a gross error, adjust without control points.

    python examples/rpc_bundle.py [--compensation shift|shift_drift|affine]

The script fits rational functions to the rigorous models of the simulated SPOT-5 pair of Zonguldak, as a vendor does,
and adds a bias of a few pixels to the image coordinates. It adjusts the block by factor graph and by full matrices,
then with one gross error, and then without control points.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import fg_orient as fg
from fg_orient.model.names import Role
from fg_orient.quality.accuracy import rms_px, y_parallaxes
from fg_orient.rpc.virtual_grid import fit_sensor
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

#: True line and sample bias of both images, pixels; the compensation estimates it.
BIAS_PX = np.array([[3.0, -16.0, 0.0, 0.0, 0.0, 0.0], [-5.0, 9.0, 0.0, 0.0, 0.0, 0.0]])
NOISE_PX = 0.3
#: A vendor's location error without control, in pixels of 5 m.
VENDOR_PX = 10.0


def rpc_block() -> fg.Block:
    """Synthetic block with RPC images and biased, noisy pixels."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    images, o = [], block.observations
    pixels, rng = np.empty((len(o), 2)), np.random.default_rng(1)
    for k, image in enumerate(block.images):
        fit = fit_sensor(image.sensor, (-200.0, 2200.0))
        print(f"RPC of image {image.id}: largest error {np.abs(fit.check_px).max():.1e} px")
        images.append(fg.Image(image.id, RpcSensor(fit.model())))
        rows = o.image == k
        seen = images[k].sensor.project(truth.ecef_m[o.point[rows]], BIAS_PX[k])
        pixels[rows] = np.stack(seen, axis=1) + rng.normal(scale=NOISE_PX, size=(rows.sum(), 2))
    observations = replace(o, line=pixels[:, 0], sample=pixels[:, 1])
    return replace(block, images=tuple(images), observations=observations)


def with_gross_error(block: fg.Block, point: str, image: str, size_px: float) -> fg.Block:
    """Add a gross error to one point in one image."""
    o = block.observations
    wrong = (o.point == block.points.ids.index(point)) & (o.image == block.image_index(image))
    return replace(block, observations=replace(o, sample=o.sample + size_px * wrong))


def without_control(block: fg.Block) -> fg.Block:
    """Change all points to tie points."""
    known, n = block.points.known, len(block.points.ids)
    empty = replace(known, ecef_m=np.full((n, 3), np.nan), sigma_enu_m=np.full((n, 3), np.nan))
    points = replace(block.points, roles=(Role.TIE,) * n, known=empty)
    options = replace(block.options, rpc_shift_sigma_px=VENDOR_PX)
    return replace(block, points=points, withheld=replace(block.withheld, ids=()), options=options)


def main() -> None:
    """Fit RPC, adjust the three cases, print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compensation", default="shift", choices=("shift", "shift_drift", "affine"))
    kind = parser.parse_args().compensation
    block = rpc_block()
    solution, dense = (fg.adjust(block, rpc_compensation=kind, backend=name) for name in ("graph", "dense"))
    check = solution.accuracy.check.statistics()
    rmse = " / ".join(f"{check[f'rmse_{axis}_m']:.2f}" for axis in ("east", "north", "up"))
    print(f"{solution.status}: sigma0 {solution.sigma0:.2f}, check points E/N/U {rmse} m")
    for image, true in zip(block.images, BIAS_PX, strict=True):
        sigma = np.sqrt(np.diag(solution.covariance(f"image:{image.id}").values))
        found = solution.correction(image.id)
        print(f"  {image.id}: line {found[0]:+.2f} ({sigma[0]:.2f}), sample {found[1]:+.2f} ({sigma[1]:.2f}) px; "
              f"true {true[0]:+.2f}, {true[1]:+.2f}")  # fmt: skip
    apart = np.abs(dense.state.image - solution.state.image).max()
    print(f"graph and dense backend differ by {apart:.0e} prior sigmas")

    wrong = with_gross_error(block, block.points.ids[5], "right", 8.0)
    for test in fg.adjust(wrong, snoop=True, rpc_compensation=kind, outlier_level=1e-5).snooping.tests:
        print(f"gross error: {test.sentence()}")

    relative = fg.adjust(without_control(block), rpc_compensation=kind)
    parallax = [rms_px(y_parallaxes(relative.problem, s)[1]) for s in (relative.problem.start, relative.state)]
    print(f"without control: y-parallax {parallax[0]:.2f} px before, {parallax[1]:.2f} px after")
    for sentence in relative.unobservable:
        print(f"  {sentence}")


if __name__ == "__main__":
    main()
