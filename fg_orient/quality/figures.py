"""Constraints in the result: their misclosures, and the figures (planes, circles and others) with their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.constraint_rows import fitted_figures
from fg_orient.adjustment.constraints import misclosures
from fg_orient.adjustment.problem import Problem, State
from fg_orient.quality.cofactors import Cofactors


@dataclass(frozen=True, eq=False)
class AdjustedFigure:
    """Plane, line, circle, sphere or spheroid of a constraint.

    Parameters
    ----------
    label : str
        Kind and points.
    names : tuple of str
        Parameters, m; ``tilt`` and ``slope`` have no unit and refer to the figure of the adjusted points.
    values : (k,) array
        Parameters of the figure. Centres are relative to the local origin of the block, along its axes or, in a
        georeferenced block, East, North, Up at the points.
    covariance : (k, k) array
    """

    label: str
    names: tuple[str, ...]
    values: Array
    covariance: Array

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        sigma = np.sqrt(self.covariance.diagonal()).tolist()
        numbers = zip(self.names, self.values.tolist(), sigma, strict=True)
        return {
            "figure": self.label,
            "numbers": [{"name": n, "value": v, "sigma": s} for n, v, s in numbers],
            "covariance": self.covariance.tolist(),
        }


def adjusted_figures(problem: Problem, state: State, cofactors: Cofactors, scale: float) -> tuple[AdjustedFigure, ...]:
    """Compute the figures of a solution's constraints; ``scale`` converts roots of cofactors to standard deviations."""
    out = []
    for figure in fitted_figures(problem, state):
        free = tuple(j for j in figure.points if problem.active[j])
        places = [i for i, j in enumerate(figure.points) if problem.active[j]]
        by = figure.by.reshape(len(figure.names), -1, 3)[:, places].reshape(len(figure.names), -1)
        q = figure.own + by @ cofactors.joint((), free) @ by.T
        out.append(AdjustedFigure(figure.label, figure.names, figure.values, scale**2 * q))
    return tuple(out)


def constraint_records(problem: Problem, state: State) -> list[dict[str, Any]]:
    """Return constraints for JSON: sigma (None: hard), RMS and largest size of their misclosures."""
    return [
        {
            "constraint": e.label,
            "sigma": e.constraint.sigma,
            "rms": float(np.sqrt(np.mean(c**2))),
            "largest": float(np.abs(c).max()),
        }
        for e, c in misclosures(problem, state)
    ]
