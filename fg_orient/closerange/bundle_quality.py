"""Quality of a bundle from its cofactors: redundancy numbers, covariances, weak directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.network import NetworkRows
from fg_orient.closerange.bundle_network import Built
from fg_orient.sensors.frame import opk_of_rotation

Array = npt.NDArray[np.float64]

#: Elements of a direction above this share of the largest are named; and how many at most.
_NAMED: Final = 0.3
_FEW: Final = 4


@dataclass(frozen=True, eq=False)
class Quality:
    """Quality of a bundle at its solution; cofactors are for the given sigmas.

    Parameters
    ----------
    redundancy : (m, 2) array
        Redundancy numbers of the image coordinates.
    others, others_whitened, others_redundancy
        Names (k) of other soft observations, element by element; their whitened residuals and redundancy numbers (k,).
    points, angles_deg : (n, 3, 3), (p, 3, 3) arrays
        Cofactors of the points, and of omega, phi, kappa of the photos; 0 for fixed ones.
    orientation, labels : (o, o) array, tuple of str
        Cofactors and names of all unknowns except those of points.
    units : (o,) array
        Accuracy of these from one image point; an unknown that is 1000 times less accurate is not determined.
    history : tuple of IterationRecord
    """

    redundancy: Array
    others: tuple[str, ...]
    others_whitened: Array
    others_redundancy: Array
    points: Array
    angles_deg: Array
    orientation: Array
    labels: tuple[str, ...]
    units: Array
    history: tuple[IterationRecord, ...]

    def correlations(self) -> Array:
        """Correlations (o, o) of the orientation; nan for unknowns that hard conditions fix."""
        root = np.sqrt(np.maximum(self.orientation.diagonal(), 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.clip(self.orientation / np.outer(root, root), -1.0, 1.0))

    def weak_directions(self) -> tuple[Array, Array]:
        """Singular values (o,) of the orientation, weakest first, and their directions as rows, in ``units``.

        A direction with the value s has a standard deviation of 1/s units; s is inf if hard conditions fix it.
        """
        if not len(self.units):
            return np.zeros(0), np.zeros((0, 0))
        values, vectors = np.linalg.eigh(self.orientation / np.outer(self.units, self.units))
        with np.errstate(divide="ignore"):
            singular = np.where(values > 0.0, 1.0 / np.sqrt(np.maximum(values, 0.0)), np.inf)
        return singular[::-1], np.asarray(vectors.T[::-1])

    def describe(self, direction: Array) -> str:
        """Main unknowns of a direction."""
        size = np.abs(direction)
        order = [int(k) for k in np.argsort(-size, kind="stable")[:_FEW] if size[k] >= _NAMED * size.max()]
        sign = np.sign(direction[order[0]]) or 1.0
        return ", ".join(f"{sign * direction[k]:+.2f} {self.labels[k]}".replace("-", "−") for k in order)


def quality_of(
    built: Built, rows: NetworkRows, whole: Array, rotations: list[Array], history: tuple[IterationRecord, ...]
) -> Quality:
    """Quality of a bundle from the cofactors (u, u) of all unknowns and the rows with derivatives at its state."""
    n, network, units = 2 * built.n_images, built.network, built.units(rows)
    redundancy = 1.0 - np.einsum("ij,ij->i", rows.design @ whole, rows.design)
    names = [o.label if o.n_residuals == 1 else f"{o.label}, {element}" for o in network.observations if not o.hard
             for element in ("XYZ" if o.n_residuals == 3 else range(1, o.n_residuals + 1))][n:]  # fmt: skip
    points = np.zeros((len(built.ids), 3, 3))
    for j, k in built.point_variables.items():
        points[j] = whole[network.part(k), network.part(k)]
    angles = np.zeros((len(built.photos), 3, 3))
    for j, (turn, rotation) in enumerate(zip(built.turns, rotations, strict=True)):
        if not isinstance(turn, np.ndarray):
            by = np.degrees(opk_of_rotation(rotation)[1])
            angles[j] = by @ whole[network.part(turn), network.part(turn)] @ by.T
    of_points = set(built.point_variables.values())
    chosen = [k for k in range(len(network.variables)) if k not in of_points]
    where = np.concatenate([np.zeros(0, np.intp), *(np.arange(network.n_unknowns)[network.part(k)] for k in chosen)])
    steps = built.steps[where]
    labels = [f"{network.variables[k].name} {label}" for k in chosen for label in network.variables[k].labels]
    return Quality(
        redundancy[:n].reshape(-1, 2), tuple(names), rows.residual[n:], redundancy[n:], points, angles,
        whole[np.ix_(where, where)] * np.outer(steps, steps), tuple(labels), units[where] * steps, history,
    )  # fmt: skip
