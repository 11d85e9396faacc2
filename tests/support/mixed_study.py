"""Runs over seeds of the mixed block give the global test and the variance component of each sensor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from fg_orient.model.block import Block
from fg_orient.model.names import Status
from fg_orient.orientation.orient import adjust
from fg_orient.simulate.mixed import MixedOptions, mixed_block

#: Groups of "image_by_sensor" in the order of the images, and the images of each.
SENSORS = {
    "image points of SPOT 5 HRG 1": (0, 1), "image points of Rpc": (2, 3), "image points of Frame": (4, 5, 6, 7),
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """One seed: weighted squares and redundancy at the given sigmas; factor of the sigmas of each sensor, its sd.

    ``doubted``: the verdict is not to trust the result.
    """

    chi2: float
    redundancy: int
    factors: np.ndarray
    sds: np.ndarray
    doubted: bool

    @property
    def p_value(self) -> float:
        """Return the p-value of the global test."""
        return float(stats.chi2(self.redundancy).sf(self.chi2))


def weighted(block: Block, factors: dict[str, float]) -> Block:
    """Return the block with the sigmas of some sensors multiplied: wrong weights."""
    o, factor = block.observations, np.ones(len(block.observations))
    for name, value in factors.items():
        factor[np.isin(o.image, SENSORS[name])] = value
    o = replace(o, sigma_line_px=o.sigma_line_px * factor, sigma_sample_px=o.sigma_sample_px * factor)
    return replace(block, observations=o)


def run(seed: int, wrong: dict[str, float] | None = None, *, components: bool = True, points: int = 90) -> Outcome:
    """Adjust one block, then once more with variance components."""
    block = weighted(mixed_block(MixedOptions(seed=seed, points=points))[0], wrong or {})
    solution = adjust(block)
    assert solution.status is not Status.NOT_CONVERGED, solution.reason
    factors = np.full((2, len(SENSORS)), np.nan)
    if components:
        found = adjust(block, variance_components=("image_by_sensor",)).components
        assert found is not None and not any(c.held for c in found.components)
        by_name = {c.group: (c.factor, c.sd) for c in found.components}
        factors = np.array([by_name[name] for name in SENSORS], float).T
    return Outcome(solution.chi2, solution.redundancy, *factors, solution.status is not Status.CONVERGED)


def uniform(outcomes: Iterable[Outcome]) -> float:
    """Return the p-value of Kolmogorov and Smirnov's test that p-values of the global test are uniform."""
    return float(stats.kstest([o.p_value for o in outcomes], "uniform").pvalue)
