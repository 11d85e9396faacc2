"""The study measures whether the standard deviations are correct after gross errors were rejected by snooping or GNC.

    python -m benchmarks.coverage [--seeds N] [--json FILE]

Two blocks have 200 points each, of which a tenth are control points. The first block has four
SPOT-5 images, and two of the rays of each point with three rays are parallel. The second
block has two strips of frame images. A share of all rays has gross errors of 5 to 50 px with
random directions. The points without control are compared with their true coordinates. Points
that may have unseen errors after the rejection are counted separately; they are called
flagged (``unseen_east_m`` of points.csv, ``fg_orient.quality.reliability.unseen_shifts``):

* points with three or more remaining rays: the number of flagged points, and the number of
  those that only the rejection has made flagged (they are not flagged in the block without
  errors). For the other points the share inside the 95 % region of their three coordinates.
  The mean of ``e^T C^-1 e / 3`` (NEES) for the other points and for all points. The number of
  points without errors that lost a ray or its weight;
* points with two remaining rays, and flagged points: the share inside the 95 % interval
  across the plane of the rays. Along the plane no other observation shows an error. Therefore
  the study counts the points with two rays and such an error that passed the test, and
  compares the number with its prediction from the non-centrality of each error, with a 99 %
  interval.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2, norm

import fg_orient as fg
from factors._contract import Array
from fg_orient.adjustment.robust import DOWN
from fg_orient.adjustment.rows import linearised
from fg_orient.quality.reliability import unseen_shifts
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.strips import StripOptions, strip_block

SHARES: Final = (0.05, 0.1)
METHODS: Final[dict[str, dict[str, Any]]] = {"snooping": {"snoop": True}, "gnc": {"loss": "tls", "gnc": True}}
SIZE_PX: Final = (5.0, 50.0)


def spot(seed: int) -> tuple[fg.Block, Array]:
    block, truth = grid_block(BlockOptions(points=200, control_share=0.1, check_share=0.0, seed=seed))
    return block, truth.ecef_m


def strips(seed: int) -> tuple[fg.Block, Array]:
    block, truth = strip_block(StripOptions(points=200, control=20, seed=seed, navigation=False))
    return block, truth.ground_m


BLOCKS: Final = {"spot": spot, "strips": strips}


def spoiled(seed: int, share: float, kind: str = "spot") -> tuple[fg.Block, fg.Block, Array, Array]:
    """Return the clean block, the block with errors, the true points (N, 3) and the errors (n, 2) of all rays in px."""
    block, true = BLOCKS[kind](seed)
    o, rng = block.observations, np.random.default_rng(seed)
    bad = rng.random(len(o)) < share
    size, angle = np.where(bad, rng.uniform(*SIZE_PX, len(o)), 0.0), rng.uniform(0.0, 2.0 * np.pi, len(o))
    error = np.column_stack([size * np.cos(angle), size * np.sin(angle)])
    moved = replace(o, line=o.line + error[:, 0], sample=o.sample + error[:, 1])
    return block, replace(block, observations=moved), true, error


def kept_rays(block: fg.Block, solution: fg.Solution) -> npt.NDArray[np.bool_]:
    """Return for each ray (n,) of the block whether the solution uses it with full weight."""
    if solution.weights is not None:
        return np.asarray(solution.weights.image > DOWN)
    own, o = solution.problem.observations, block.observations
    have = set(zip(own.image.tolist(), own.point.tolist(), strict=True))
    return np.array([(i, p) in have for i, p in zip(o.image.tolist(), o.point.tolist(), strict=True)])


def counts(seed: int, share: float, method: str, kind: str) -> dict[str, float]:
    """Return the sums of one block."""
    clean, block, true, error = spoiled(seed, share, kind)
    first, solution = fg.adjust(clean), fg.adjust(block, **METHODS[method])
    o, n = block.observations, len(block.points.ids)
    keep, bad = kept_rays(block, solution), error.any(axis=1)
    rays, seen = np.bincount(o.point[keep], minlength=n), np.bincount(o.point, minlength=n)
    is_bad = np.bincount(o.point, bad, n) > 0
    control = np.zeros(n, bool)
    control[block.points.where(fg.Role.CONTROL)] = True
    free = solution.problem.active & ~control & ~solution.problem.observed
    flagged, before = (np.isfinite(unseen_shifts(s.residual_cofactors)[:, 0]) for s in (solution, first))
    away = solution.ground_m - true
    assert solution.cofactors is not None
    many = np.flatnonzero(free & (rays >= 3))
    squares = np.einsum("pi,pij,pj->p", away[many], np.linalg.inv(solution.cofactors.points(many)), away[many])
    judged = squares[~flagged[many]]
    lost = np.bincount(o.point, ~keep, n) > 0
    right = ~control & ~is_bad & (seen >= 3)
    two = np.flatnonzero(free & ((rays == 2) | (flagged & (rays >= 3))))
    own = solution.problem.observations
    lines = np.linalg.svd(linearised(solution.problem, solution.state).ground)[2][:, 2]
    kept = np.isin(own.point * len(block.images) + own.image, (o.point * len(block.images) + o.image)[keep])
    normal = np.array([np.linalg.svd(lines[kept & (own.point == j)])[2][2] for j in two])
    spread = solution.cofactors.points(two)
    across = np.einsum("pi,pi->p", normal, away[two]) / np.sqrt(np.einsum("pi,pij,pj->p", normal, spread, normal))
    expected, variance, survived = _survivors(first, block, solution, error, keep, control)
    return {
        "many": len(many), "flagged": int(flagged[many].sum()), "made": int((flagged & ~before)[many].sum()),
        "inside": int(np.sum(judged <= chi2.ppf(0.95, 3))), "nees": float(judged.sum() / 3.0),
        "nees_all": float(squares.sum() / 3.0), "right": int(right.sum()), "lost": int((right & lost).sum()),
        "two": len(two), "across": int(np.sum(np.abs(across) <= norm.ppf(0.975))), "survived": survived,
        "expected": expected, "variance": variance, "bad_pairs": int(np.sum((seen == 2) & ~control & is_bad)),
    }  # fmt: skip


def _survivors(
    first: fg.Solution,
    block: fg.Block,
    solution: fg.Solution,
    error: Array,
    keep: npt.NDArray[np.bool_],
    control: npt.NDArray[np.bool_],
) -> tuple[float, float, int]:
    """Return the predicted number, its variance, and the number of wrong points with two rays that pass the test."""
    cofactors = first.residual_cofactors.image
    o = block.observations
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    limit = np.sqrt(2.0 * chi2.ppf(0.99, 2))
    if solution.snooping is not None:
        tests = solution.outlier_tests()
        limit = float(norm.isf(0.5 * tests.level_each))
    rows = linearised(first.problem, first.state)
    expected = variance = 0.0
    survived = 0
    for j in np.flatnonzero((np.bincount(o.point, minlength=len(control)) == 2) & ~control).tolist():
        pair = np.flatnonzero(o.point == j)
        if not error[pair].any():
            continue
        # two rays check only one combination of the errors
        left = np.linalg.svd(rows.ground[pair].reshape(4, 3))[0][:, 3]
        share = np.sqrt(max(float(left[:2] @ cofactors[pair[0]] @ left[:2]) / float(left[:2] @ left[:2]) ** 2, 0.0))
        trace = float(left @ (error[pair] / sigma[pair]).ravel()) * share
        p = float(norm.cdf(limit - trace) - norm.cdf(-limit - trace))
        expected, variance = expected + p, variance + p * (1.0 - p)
        survived += int(keep[pair].all())
    return expected, variance, survived


def main() -> int:
    """Print one line per method and share. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--json", type=Path)
    given, out = parser.parse_args(), []
    for kind, method, share in product(BLOCKS, METHODS, SHARES):
        rows = [counts(seed, share, method, kind) for seed in range(given.seeds)]
        s = {key: sum(row[key] for row in rows) for key in rows[0]}
        half, judged = norm.ppf(0.995) * np.sqrt(s["variance"]), s["many"] - s["flagged"]
        out.append({"block": kind, "method": method, "share": share, "seeds": given.seeds, **s})
        print(f"{kind}, {method} {share:.0%}: three rays and more: {s['flagged'] / s['many']:.2%} of {s['many']} "
              f"flagged, {s['made'] / s['many']:.2%} by rejection; others {s['inside'] / judged:.2%} inside, NEES "
              f"{s['nees'] / judged:.2f} (all {s['nees_all'] / s['many']:.2f}); right points that lost a ray "
              f"{s['lost'] / s['right']:.2%}; two rays and flagged: across {s['across'] / s['two']:.2%} of {s['two']}; "
              f"unseen {s['survived']} of {s['bad_pairs']} wrong, predicted {s['expected']:.1f} +- {half:.1f}",
              flush=True)  # fmt: skip
    if given.json:
        given.json.write_text(json.dumps(out, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
