"""Fixtures are a synthetic pair or triple of photos in a room, and the printed numbers of Ayhan 1996."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from fg_orient.closerange.bundle import BundlePhoto
from fg_orient.closerange.photo import Photo, PhotoInterior, corrections_of, rotation_from_ayhan
from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import load

Array = npt.NDArray[np.float64]
SIGMA = 0.002


@dataclass
class Scene:
    """Truth and measurements: photos, points, and image coordinates sorted by photo, then by point."""

    interior: PhotoInterior
    rotations: list[Array]
    centres: list[Array]
    points: Array
    image: Array

    @property
    def n(self) -> int:
        return len(self.points)

    @property
    def ids(self) -> list[str]:
        return [f"p{k}" for k in range(self.n)]

    @property
    def which(self) -> npt.NDArray[np.intp]:
        return np.repeat(np.arange(len(self.centres)), self.n)

    @property
    def of(self) -> npt.NDArray[np.intp]:
        return np.tile(np.arange(self.n), len(self.centres))

    def photos(self, **more: object) -> list[BundlePhoto]:
        """Return the photos with start values off by a milliradian and some centimetres."""
        shift = rotation_from_ayhan(1e-3, -1e-3, 1e-3) @ rotation_from_ayhan(0.0, 0.0, 0.0).T
        return [
            BundlePhoto(f"ph{k}", self.interior, shift @ r, c + 0.02 * (k + 1), **more)  # type: ignore[arg-type]
            for k, (r, c) in enumerate(zip(self.rotations, self.centres, strict=True))
        ]


def make(seed: int, n: int = 20, n_photos: int = 3, *, noise: float = SIGMA, points: Array | None = None) -> Scene:
    rng = np.random.default_rng(seed)
    interior = PhotoInterior(60.0, np.array([0.3, -0.2]), corrections_of(("k1", "p1"), [2e-5, 1e-5]))
    rotations = [rotation_from_ayhan(*rng.normal(scale=0.1, size=3)) for _ in range(n_photos)]
    centres = [np.array([1000.0 + k, 2000.0 + 0.2 * k * k, 50.0 + 0.3 * k]) for k in range(n_photos)]
    if points is None:
        points = np.array([1001.0, 2005.0, 50.0]) + rng.uniform(-1.0, 1.0, (n, 3))
    every = [Photo.of("", interior, r, c).project(points) for r, c in zip(rotations, centres, strict=True)]
    image = np.concatenate(every)
    return Scene(interior, rotations, centres, points, image + rng.normal(scale=noise, size=image.shape))


@pytest.fixture(scope="session")
def values() -> dict[CellKey, float]:
    return {cell.key: cell.value for cell in load("ayhan1996").cells}
