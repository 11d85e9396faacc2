"""The module draws orientation, image points and ground coordinates of blocks from the sigmas of the adjustment.

The given block contains the metadata. The true unknowns of the images are drawn from their
priors, and the sensor's own ``project`` computes the true image points. All observations get
normal noise with their stated sigmas. Such a block is perfect: its model and all its sigmas
are correct.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import State
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, Coordinates, WithheldCoordinates
from fg_orient.model.names import Role
from fg_orient.quality.deficiency import compiled_problem

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drawn:
    """A drawn block has true ground points (N, 3) ECEF m, true corrections of the images, and true pixels (n, 2)."""

    block: Block
    truth_m: Array
    corrections: tuple[Any, ...]
    pixels: Array


class Source:
    """The source draws blocks.

    Parameters
    ----------
    block : Block
        It has the sensors with the metadata, and the sigmas, roles and options.
    truth_m : (N, 3) array
        True ground points, ECEF m.
    """

    def __init__(self, block: Block, truth_m: Array) -> None:
        self.block, self.truth_m = block, truth_m
        self._problem = compiled_problem(block)
        self._check = block.withheld.open() if block.withheld.ids else None
        self._rows = block.points.where(Role.CHECK)

    def draw(self, rng: np.random.Generator, *, noise: float = 1.0) -> Drawn:
        """Return a drawn block; ``noise`` is the factor of all random errors, 0 for the truth."""
        problem, o, block = self._problem, self.block.observations, self.block
        image = problem.image_matrix(noise * rng.standard_normal(problem.n_free_unknowns))
        corrections = tuple(problem.corrections(State(image, problem.start.ground)))
        pixels = np.empty((len(o), 2))
        for k, (one, correction) in enumerate(zip(block.images, corrections, strict=True)):
            rows = o.image == k
            pixels[rows] = np.stack(one.sensor.project(self.truth_m[o.point[rows]], correction), axis=1)
        sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
        seen = pixels + noise * sigma * rng.standard_normal(pixels.shape)
        known = block.points.known
        ecef = self._measured(known, np.arange(len(known.ecef_m)), rng, noise)
        points = replace(block.points, known=replace(known, ecef_m=np.where(np.isnan(known.ecef_m), np.nan, ecef)))
        withheld = block.withheld
        if self._check is not None:
            opened = replace(self._check, ecef_m=self._measured(self._check, self._rows, rng, noise))
            withheld = WithheldCoordinates(withheld.ids, lambda: opened)
        out = replace(block, points=points, withheld=withheld,
                      observations=replace(o, line=seen[:, 0], sample=seen[:, 1]))  # fmt: skip
        return Drawn(out, self.truth_m, corrections, pixels)

    def _measured(
        self, given: Coordinates, index: npt.NDArray[np.intp], rng: np.random.Generator, noise: float
    ) -> Array:
        """Return the true coordinates with errors of the stated sigmas; fixed points have no errors."""
        error = noise * np.nan_to_num(given.sigma_enu_m) * rng.standard_normal(given.sigma_enu_m.shape)
        place = self.truth_m[index]
        if not self.block.georeferenced:
            return np.asarray(place + error)
        lon, lat, _ = ecef_to_geodetic(place)
        return np.asarray(place + np.einsum("nji,nj->ni", enu_from_ecef(lon, lat), error))
