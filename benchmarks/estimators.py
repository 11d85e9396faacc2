"""The study compares least-squares, regularised, minimum-norm and prior-based estimates for the 20 EOP sets.

    python -m benchmarks.estimators [--seeds N]   # run, write results/estimators.json and docs/estimators.md
    python -m benchmarks.estimators --page        # the page only, from the rows

The block is the SPOT-5 pair of the published experiments: H-20, 27 control and 20 check
points, image noise 0.5 px. The true parameters are known. The true deviation of each EOP
coefficient from the metadata is normal, with a standard deviation of 0.1, 1 or 3 prior
sigmas. The image points are computed from the true orientation and the true ground points,
with noise. The model is therefore right, and the study judges only the estimator by these
figures:

* share of runs without a result (refused, not converged);
* check points: RMSE of the largest axis of East, North, Up over all seeds, m; length of the mean error (bias), m; share
  of the errors inside the 95 % interval of the stated standard deviation;
* orientation: RMSE in prior sigmas; share of the true deviation that the estimate contains, ``x^T x_true / x_true^T
  x_true`` (1 if the estimate has no bias towards the metadata); coverage of the 95 % interval.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

import fg_orient as fg
from factors.arrays import Array
from fg_orient.adjustment.problem import State, compile_problem
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.distributions import INSIDE_95
from fg_orient.model.names import EOP_SETS
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

NOISE_PX: Final = 0.5
SPREADS: Final = (0.1, 1.0, 3.0)
_FREE: Final[dict[str, Any]] = {"priors": False, "max_iterations": 50}
METHODS: Final[dict[str, dict[str, Any]]] = {
    "priors": {},
    "least squares": _FREE,
    "Tikhonov, GCV": _FREE | {"regularisation": "tikhonov", "kappa_rule": "gcv"},
    "Tikhonov, L-curve": _FREE | {"regularisation": "tikhonov", "kappa_rule": "l_curve"},
    "Tikhonov, HKB": _FREE | {"regularisation": "tikhonov", "kappa_rule": "hkb"},
    "truncated, GCV": _FREE | {"regularisation": "truncated", "kappa_rule": "gcv"},
    "minimum norm, 1e-9": _FREE | {"regularisation": "minimum_norm"},
    "minimum norm, 1e-5": _FREE | {"regularisation": "minimum_norm", "rank_cut": 1e-5},
    "ridge and Stein": _FREE | {"regularisation": "ridge_stein"},
}
RESULTS: Final = Path(__file__).parent / "results" / "estimators.json"
PAGE: Final = Path(__file__).parents[1] / "docs" / "estimators.md"
HEAD: Final = """\
# Which estimator for which defect

<!-- Made by `python -m benchmarks.estimators --page`. Do not edit. -->

This page compares least squares with regularised, minimum-norm and prior-based estimates on simulated blocks with
known true parameters. The blocks are the SPOT-5 pair of the published experiments with point set H-20 (27 control and
20 check points) and an image noise of 0.5 px; each cell has {runs} runs. The true deviation of each EOP coefficient
from the metadata is normal with 0.1, 1 or 3 prior sigmas. The model is right, and only the estimator is judged.

- **Priors** (the default) have a result in every run and nearly the smallest error at the check points. Their
  intervals cover the check points, also where the true deviations are three times the prior sigmas. For the
  orientation itself the stated sigmas are then too small: they cover 58 % instead of 95 %.
- **Least squares** exists for the sets {full} only. It is unbiased, and the errors at the check points are a few per
  cent larger. The orientation has errors of tens of prior sigmas: it is strongly correlated, and the check points do
  not depend on it.
- **Tikhonov with GCV** needs only the ratios of the prior sigmas. It reaches the accuracy of the priors for all kinds
  of sets, with a result in 94 to 100 % of the runs, and covers the orientation in about 90 %. Choose it if you do not
  trust the size of the prior sigmas.
- **Tikhonov with the L-curve** has nearly the same errors at the check points. Its kappa is sometimes too large, and
  the orientation is covered less often (57 to 74 % for deviations of 1 and 3 prior sigmas).
- **HKB**, and **ridge with Stein's factor**, start from the minimum norm at the rank of the data. They fail for most
  sets that need a regularisation.
- **Truncation with GCV** is as accurate at the check points. Its sigmas do not include the held directions: they cover
  the orientation in 21 to 64 % of the cases.
- **Minimum norm** needs a suitable cut: at 1e-9 nearly all runs of the sets with velocity fail, at 1e-5 more than
  half.

Columns:

- *check RMSE*: RMSE at the check points, the largest of East, North and Up;
- *bias*: length of the mean error;
- *95 % covers*: share of the errors at the check points inside the stated interval;
- *x RMSE*: RMSE of the orientation in units of the prior sigmas;
- *share of x*: part of the true deviation from the metadata that the estimate contains; it is 1 if there is no bias;
- *95 % covers x*: the same share for the orientation.

All numbers are medians over the sets of a kind, of the runs with a result. The numbers of runs are small, so
differences of a few per cent are not significant.
"""
MEASURES: Final = ("sets", "deviations", "method", "without result", "check RMSE, m", "bias, m", "95 % covers",
                   "x RMSE", "share of x", "95 % covers x")  # fmt: skip


@lru_cache(maxsize=128)
def scene(seed: int, eop_set: int, spread: float) -> tuple[fg.Block, Array, Array]:
    """Return the block, the true deviations (u,) in prior sigmas, and the true points (N, 3)."""
    block, truth = zonguldak_block(ZonguldakOptions(point_set="H-20", seed=seed, image_noise_px=0.0))
    block = replace(block, options=replace(block.options, eop_set=eop_set, statistics="basic"))
    problem, rng = compile_problem(block), np.random.default_rng([seed, eop_set])
    state = State(spread * rng.standard_normal(problem.start.image.shape), truth.ecef_m - problem.origin_m)
    o = block.observations
    exact = np.column_stack([o.line, o.sample]) + problem.pixel_residuals(state)
    line, sample = (exact + NOISE_PX * rng.standard_normal(exact.shape)).T
    sigma = np.full(len(o), NOISE_PX)
    seen = replace(o, line=line, sample=sample, sigma_line_px=sigma, sigma_sample_px=sigma)
    return replace(block, observations=seen), problem.image_vector(state), truth.ecef_m


def run(seed: int, eop_set: int, spread: float, method: str) -> dict[str, Any] | None:
    """Return the errors of one estimate; None without a result."""
    block, true_x, true_m = scene(seed, eop_set, spread)
    try:
        with np.errstate(all="ignore"):
            solution = fg.adjust(replace(block, options=replace(block.options, **METHODS[method])))
    except fg.FgOrientError:
        return None
    if solution.status is fg.Status.NOT_CONVERGED or solution.cofactors is None:
        return None
    points, unknowns = solution.to_frame("points"), solution.to_frame("unknowns")
    unit = np.concatenate([p.sigma for p in solution.problem.parameters])
    check = (points["role"] == "check").to_numpy()
    axes = enu_from_ecef(*ecef_to_geodetic(true_m[check])[:2])
    away = np.einsum("nij,nj->ni", axes, (solution.ground_m - true_m)[check])
    stated = points.loc[check, ["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy(float)
    x = solution.problem.image_vector(solution.state)
    sigma = unknowns["sigma"].to_numpy(float) / unit
    return {
        "squares": np.mean(away**2, axis=0), "mean": away.mean(axis=0),
        "inside": float(np.mean(np.abs(away) <= INSIDE_95 * stated)), "orientation": float(np.mean((x - true_x) ** 2)),
        "share": float(x @ true_x / (true_x @ true_x)),
        "covered": float(np.mean(np.abs(x - true_x) <= INSIDE_95 * sigma)),
    }  # fmt: skip


def study(seeds: int) -> list[dict[str, Any]]:
    """Return one row per EOP set, spread and method."""
    rows = []
    for eop_set, spread, method in product(EOP_SETS, SPREADS, METHODS):
        found = [run(seed, eop_set, spread, method) for seed in range(1, seeds + 1)]  # all methods use the same scenes
        good = [one for one in found if one is not None]
        row: dict[str, Any] = {"eop_set": eop_set, "name": EOP_SETS[eop_set].name, "spread": spread, "method": method,
                               "runs": seeds, "failed": seeds - len(good)}  # fmt: skip
        if good:
            row |= {
                "rmse_m": float(np.sqrt(np.mean([g["squares"] for g in good], axis=0).max())),
                "bias_m": float(np.linalg.norm(np.mean([g["mean"] for g in good], axis=0))),
                "inside": float(np.mean([g["inside"] for g in good])),
                "orientation": float(np.sqrt(np.mean([g["orientation"] for g in good]))),
                "share": float(np.mean([g["share"] for g in good])),
                "covered": float(np.mean([g["covered"] for g in good])),
            }
        rows.append(row)
    return rows


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page: the RMSE at check points by set and method, then all measures by kind of set."""
    by_key = {(r["eop_set"], r["spread"], r["method"]): r for r in rows}
    solved = {n: sum(by_key[n, s, "least squares"]["failed"] for s in SPREADS) for n in EOP_SETS}
    runs = rows[0]["runs"]
    full = [n for n in EOP_SETS if solved[n] < 0.5 * runs * len(SPREADS)]
    kinds = {"least squares exists": full, "least squares refused": [n for n in EOP_SETS if n not in full]}
    lines = [HEAD.format(runs=runs, full=", ".join(map(str, full))), "## All measures", ""]
    lines += ["| " + " | ".join(MEASURES) + " |", "|---" * len(MEASURES) + "|"]
    for words, members in kinds.items():
        for spread, method in product(SPREADS, METHODS):
            lines.append(_summary(words, spread, method, [by_key[n, spread, method] for n in members]))
    lines += [
        "",
        "## RMSE at check points by set, m",
        "",
        "\\*: some runs have no result; –: more than half of the runs have no result.",
        "",
    ]
    for spread in SPREADS:
        lines += [f"### True deviations of {spread:g} prior sigma{'s' if spread != 1 else ''}", ""]
        lines += ["| set | " + " | ".join(METHODS) + " |", "|---|" + "---|" * len(METHODS)]
        for number, of_set in EOP_SETS.items():
            cells = [_cell(by_key[number, spread, method]) for method in METHODS]
            lines.append(f"| {number} {of_set.name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines).strip() + "\n"


def _cell(row: dict[str, Any]) -> str:
    if row["failed"] > 0.5 * row["runs"]:
        return "–"
    text = f"{row['rmse_m']:.3g}" if row["rmse_m"] < 1e4 else f"{row['rmse_m']:.0e}"
    return text + ("*" if row["failed"] else "")


def _summary(words: str, spread: float, method: str, rows: list[dict[str, Any]]) -> str:
    failed = sum(r["failed"] for r in rows) / sum(r["runs"] for r in rows)
    good = [r for r in rows if "rmse_m" in r]
    mean = defaultdict(float, {k: float(np.median([r[k] for r in good])) for k in (
        "rmse_m", "bias_m", "inside", "orientation", "share", "covered")} if good else {})  # fmt: skip
    if not good:
        return f"| {words} | {spread:g} | {method} | {failed:.0%} | – | – | – | – | – | – |"
    head = f"| {words} | {spread:g} | {method} | {failed:.0%} | {mean['rmse_m']:.3g} | {mean['bias_m']:.2g} | "
    tail = f"{mean['inside']:.0%} | {mean['orientation']:.2g} | {mean['share']:.2f} | {mean['covered']:.0%} |"
    return head + tail


def main() -> None:
    """Run the study, and write the rows and the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--page", action="store_true")
    given = parser.parse_args()
    if not given.page:
        lines = ",\n".join(json.dumps(row) for row in study(given.seeds))
        RESULTS.write_text(f"[\n{lines}\n]\n", "utf-8")
    PAGE.write_text(page(json.loads(RESULTS.read_text("utf-8"))), "utf-8")


if __name__ == "__main__":
    main()
