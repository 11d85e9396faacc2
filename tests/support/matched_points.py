"""Image points of a matching run are compared with their true places in rendered images."""

from __future__ import annotations

import csv
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.support.rendered_pair import Scene, View


class Errors(NamedTuple):
    """Errors of the rays of all pairs (first, other image of a point): px, their standard deviations, visibility."""

    error_px: np.ndarray
    sigma_px: np.ndarray
    visible: np.ndarray

    def is_wrong(self, limit_px: float = 1.0) -> np.ndarray:
        """Return whether a ray belongs to another point."""
        return np.asarray(~(np.linalg.norm(self.error_px, axis=1) <= limit_px))

    def rms_px(self) -> float:
        """Return the root mean square of a coordinate of the right rays."""
        return float(np.sqrt(np.mean(self.error_px[~self.is_wrong()] ** 2)))

    def nees(self) -> float:
        """Return the mean square of the errors in their standard deviations, of the right rays."""
        good = ~self.is_wrong()
        return float(np.mean((self.error_px[good] / self.sigma_px[good]) ** 2))


def table(path: Path) -> list[dict[str, str]]:
    """Return the records of a CSV table."""
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def rays(folder: Path) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return pixels and sigmas by point and image."""
    out: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for row in table(folder / "observations.csv"):
        pixel = np.array([float(row["line"]), float(row["sample"])])
        sigma = np.array([float(row["sigma_line_px"]), float(row["sigma_sample_px"])])
        out.setdefault(row["id"], {})[row["image"]] = pixel, sigma
    return out


def errors(folder: Path, scene: Scene, views: tuple[View, ...]) -> Errors:
    """Compare all rays with the true places of the pixel of the first image of their point."""
    by_point, parts = rays(folder), []
    for first, second in combinations(views, 2):
        both = [r for r in by_point.values() if first.name in r and second.name in r and next(iter(r)) == first.name]
        if not both:
            continue
        (p, s), (q, u) = (tuple(np.array([r[v.name][k] for r in both]) for k in (0, 1)) for v in (first, second))
        there, visible = scene.seen(first, second, p)
        parts.append((q - there, np.sqrt(s**2 + u**2), visible))
    return Errors(*(np.concatenate(part) for part in zip(*parts, strict=True)))
