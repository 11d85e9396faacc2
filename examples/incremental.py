"""A strip of images, adjusted while it grows: each image is added to the solution of the images before it.

    python examples/incremental.py

Control points are in every tenth image and the last one. Image points with gross errors are removed again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import fg_orient as fg
from fg_orient.simulate.strips import StripOptions, strip_block

IMAGES = 30
block, _ = strip_block(
    StripOptions(seed=1, strips=1, images=IMAGES, points=12 * IMAGES, control=12 * IMAGES, navigation=False)
)
o, ids = block.observations, np.array(block.points.ids)
control = np.zeros(len(ids), bool)
for k in [*range(0, IMAGES, 10), IMAGES - 1]:
    control[o.point[o.image == k][:4]] = True
points = block.points.without_coordinates(~control, fg.Role.TIE)

# a gross error of 40 pixels in image 20, at a point that three images see
wrong = int(np.flatnonzero((o.image == 19) & (np.bincount(o.point)[o.point] == 3))[0])
sample = o.sample + 40.0 * (np.arange(len(o)) == wrong)
o = fg.ImagePoints(o.image, o.point, o.line, sample, o.sigma_line_px, o.sigma_sample_px)

strip = fg.Incremental(replace(block, images=(), points=points, observations=o.take(o.image < 0)))
for k, image in enumerate(block.images):
    strip.add(images=[image], observations=o.take(o.image == k))
    if k in (0, 9, 29):
        print(f"{k + 1} images: {len(strip.waiting)} ground points wait")
        print("\n".join(f"  {one}" for one in strip.waiting[:1]), end="\n" if strip.waiting else "")

solution = strip.solution()
print(f"sigma0 {solution.sigma0:.2f}, {solution.status}")
residuals = solution.to_frame("residuals")
worst = residuals.loc[residuals["w_sample"].abs().idxmax()]
print(f"largest normalised residual {worst['w_sample']:.0f}: image {worst['image']}, point {worst['id']}; removed")
strip.remove([(worst["image"], worst["id"])])
solution = strip.solution()
print(f"sigma0 {solution.sigma0:.2f}, {solution.status}")

batch = fg.adjust(solution.block)
difference = np.abs(solution.state.image - batch.state.image).max()
print(f"differs from the batch adjustment by {difference:.1e} prior sigmas")
