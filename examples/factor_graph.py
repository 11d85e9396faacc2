"""A factor of GTSAM in a satellite block, and GTSAM's own optimiser on the graph.

    python examples/factor_graph.py

A GNSS baseline between two check points of the synthetic pair is a BetweenFactorPoint3. It joins the block as an extra
observation. Then the graph is solved twice: by fg_orient, and by GTSAM's Levenberg-Marquardt called here.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

import fg_orient as fg
from fg_orient.simulate import ZonguldakOptions, zonguldak_block

#: Standard deviation of each component of the baseline, m.
SIGMA_M = 0.01


def optimised(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """GTSAM's Levenberg-Marquardt, and one step of Gauss-Newton without damping at the end."""
    damped = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    last = gtsam.GaussNewtonOptimizer(graph, damped)
    last.iterate()
    return gtsam.Values(last.values())  # a copy: the optimiser owns its values


def main() -> None:
    """Add the baseline, print the graph and what the baseline changes."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    first, second = block.points.where(fg.Role.CHECK)[:2]
    names = [f"point:{block.points.ids[j]}" for j in (first, second)]
    a, b = (fg.factor_graph(block, "explicit").key(name) for name in names)
    baseline_m = truth.ecef_m[second] - truth.ecef_m[first]  # axes of the ground points: parallel to ECEF
    noise = gtsam.noiseModel.Isotropic.Sigma(3, SIGMA_M)
    extended = replace(block, extra=(gtsam.BetweenFactorPoint3(a, b, baseline_m, noise),))

    graph = fg.factor_graph(extended)
    print("variables:", ", ".join(sorted(graph.name(key) for key in graph.values.keys())))
    before, after = fg.adjust(block), fg.adjust(extended)
    own = fg.adjust(extended, optimizer=optimised)
    print(f"redundancy {before.redundancy} -> {after.redundancy}")
    for name, solution in (("without", before), ("with", after)):
        error = solution.ground_m[second] - solution.ground_m[first] - baseline_m
        print(f"error of the baseline {name} the factor: {np.linalg.norm(error):.3f} m")
    agree = np.nanmax(np.abs(own.ground_m - after.ground_m)) < 1e-6
    print(f"GTSAM called here: {own.status}, the same points: {agree}")


if __name__ == "__main__":
    main()
