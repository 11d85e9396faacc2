"""The study of gross errors compares methods by check points, found errors, missed errors and false alarms.

    python -m benchmarks.contamination [--seeds N] [--cases ...] [--shares ...] [--methods ...] [--workers N]
        [--missing]

writes results/contamination.json. ``python -m benchmarks.contamination_page`` writes the
study of docs/robust.md from this file.

Each case is simulated with the seeds 1 to 20:

* twin: the Zonguldak pair (47 points, H-10) has errors in image points of its 37 control points;
* block: 20 images in 4 rows of 5 show 250 points, of which 40 are control and 50 check
  points. The errors are in image points of control points and of tie points with 4 rays or
  more, and in coordinates of control points;
* everywhere: the same block has errors in image points of all points except check points, and
  in coordinates of control points.

A random share of these observations is moved by 5 to 100 sigmas in a random direction (2 or 3
dimensions). Check points have no gross errors. They are compared with their true coordinates,
and the RMSE refers to the 3-D distance. With ``--missing`` only the runs that the file of results does
not contain are made, and they are added to the file after each seed.

An error of s sigmas in the direction e is *checkable* if the trace that it leaves in the
residuals, ``s sqrt(e^T R e)`` with the redundancy R of the clean block, exceeds 4.13: a test
with the level 0.1 % finds this trace with a power of 80 % (Baarda 1968). Errors in points
with only two rays are not checkable, because the data cannot show which of the two rays is
wrong. For all methods except snooping, an error counts as found if the whitened residual
exceeds its 99.9 % quantile. For snooping an error counts as found if its observation was
rejected.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.irls import norms_at
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.robust import CONTROL, IMAGE, inlier_limit
from fg_orient.adjustment.solve import solve
from fg_orient.cli.checks import self_test
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints
from fg_orient.model.names import Role
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.simulation import Truth
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

RESULTS: Final = Path(__file__).parent / "results" / "contamination.json"
CASES: Final = ("twin", "block", "everywhere")
SHARES: Final = (0.0, 0.05, 0.1, 0.2, 0.3)
SEEDS: Final = 20
SIZES_SIGMA: Final = (5.0, 100.0)
#: A test with the level 0.1 % finds an error with a power of 80 % if the square root of the
#: non-centrality has this value.
TRACE: Final = 4.13
FOUND: Final = 0.999
MAX_ITERATIONS: Final = 300
SNOOPING: Final = "snooping"
PLAIN: Final = "least squares"
#: Options of each method. All losses except Huber's start from the result of Huber's loss
#: unless the options state another start.
METHODS: Final[dict[str, dict[str, Any]]] = {
    PLAIN: {},
    SNOOPING: {},
    "huber": {"loss": "huber"},
    "cauchy": {"loss": "cauchy"},
    "hampel": {"loss": "hampel"},
    "tukey": {"loss": "tukey"},
    "andrews": {"loss": "andrews"},
    "danish": {"loss": "danish"},
    "geman_mcclure": {"loss": "geman_mcclure"},
    "welsch": {"loss": "welsch"},
    "tukey, start least squares": {"loss": "tukey", "robust_start": "none"},
    "tukey, start LMS": {"loss": "tukey", "robust_start": "lms"},
    "tukey, start LTS": {"loss": "tukey", "robust_start": "lts"},
    "tukey, scale MAD": {"loss": "tukey", "robust_scale": "mad"},
    "GNC, tls": {"loss": "tls", "gnc": True},
    "danish_original": {"loss": "danish_original"},
    "lad": {"loss": "lad"},
}
#: Shares of gross errors in the case in which some errors are not checkable.
EVERYWHERE_SHARES: Final = (0.2,)


@dataclass(frozen=True)
class Spoiled:
    """A spoiled block contains gross errors.

    Parameters
    ----------
    block : Block
    truth : Truth
    image, control : (n,), (N,) bool arrays
        They state which image points and which control points have a gross error.
    checkable_image, checkable_control : the same
        They state which of these errors are checkable.
    """

    block: Block
    truth: Truth
    image: Mask
    control: Mask
    checkable_image: Mask
    checkable_control: Mask


@dataclass(frozen=True)
class Clean:
    """The clean block is stored with its truth and the redundancy of its observations."""

    block: Block
    truth: Truth
    problem: Problem
    image: Array
    control: Array


@lru_cache(maxsize=1)
def clean(case: str, seed: int) -> Clean:
    """Simulate the block of a case and adjust it by least squares."""
    if case == "twin":
        block, truth = zonguldak_block(ZonguldakOptions(seed=seed))
    else:
        block, truth = grid_block(
            BlockOptions(rows=4, columns=5, points=250, seed=seed, control_share=0.16, check_share=0.2)
        )
    solution = fg.adjust(block)
    assert solution.cofactors is not None
    q = ResidualCofactors(solution.problem, solution.state, solution.cofactors)
    control = np.zeros((len(block.points.ids), 3, 3))
    control[solution.problem.observed] = q.control
    return Clean(block, truth, solution.problem, q.image, control)


def eligible(case: str, block: Block) -> tuple[Mask, Mask]:
    """Return the image points (n,) and control points (N,) that may get an error."""
    point = block.observations.point
    n = len(block.points.ids)
    rays = np.bincount(point, minlength=n)
    is_control, is_check = (np.isin(np.arange(n), block.points.where(role)) for role in (Role.CONTROL, Role.CHECK))
    if case == "twin":
        return is_control[point], np.zeros(n, bool)
    if case == "block":
        return (is_control | (~is_check & (rays >= 4)))[point], is_control
    return ~is_check[point], is_control


def spoil(case: str, seed: int, share: float) -> Spoiled:
    """Draw the gross errors of a case."""
    found = clean(case, seed)
    rng = np.random.default_rng([CASES.index(case), seed, round(1000 * share)])
    image, control = eligible(case, found.block)
    places = np.concatenate([np.flatnonzero(image), len(image) + np.flatnonzero(control)])
    bad = rng.choice(places, round(share * len(places)), replace=False)
    rows, points = np.sort(bad[bad < len(image)]), np.sort(bad[bad >= len(image)]) - len(image)
    moved_image, moved_control = (_errors(rng, len(at), d) for at, d in ((rows, 2), (points, 3)))
    rays = np.bincount(found.block.observations.point, minlength=len(control))
    alone = (rays == 2) & ~found.problem.observed
    w = found.problem.control_records[points, POINT.whitening].reshape(-1, 3, 3)
    enu = moved_control * found.block.points.known.sigma_enu_m[points]
    ecef = np.einsum("nji,nj->ni", found.problem.axes(found.truth.ecef_m[points]), enu)
    traced = _trace(moved_image, found.image[rows]) & ~alone[found.block.observations.point[rows]]
    block = _move_points(_move_rays(found.block, rows, moved_image), points, ecef)
    return Spoiled(
        block, found.truth, _mask(len(image), rows), _mask(len(control), points),
        _mask(len(image), rows[traced]),
        _mask(len(control), points[_trace(np.einsum("nij,nj->ni", w, ecef), found.control[points])]),
    )  # fmt: skip


def _mask(n: int, rows: Index) -> Mask:
    return np.isin(np.arange(n), rows)


def _errors(rng: np.random.Generator, n: int, dimension: int) -> Array:
    """Return errors (n, dimension) in sigmas; their size and their direction have uniform distributions."""
    direction = rng.standard_normal((n, dimension))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction * rng.uniform(*SIZES_SIGMA, n)[:, None])


def _trace(error: Array, q: Array) -> Mask:
    """Return whether a whitened error is checkable, from the cofactors of its residuals."""
    return np.asarray(np.einsum("ni,nij,nj->n", error, q, error) > TRACE**2)


def _move_rays(block: Block, rows: Index, error: Array) -> Block:
    o = block.observations
    line, sample = o.line.copy(), o.sample.copy()
    line[rows] += error[:, 0] * o.sigma_line_px[rows]
    sample[rows] += error[:, 1] * o.sigma_sample_px[rows]
    return replace(block, observations=ImagePoints(o.image, o.point, line, sample, o.sigma_line_px, o.sigma_sample_px))


def _move_points(block: Block, points: Index, ecef_m: Array) -> Block:
    known = block.points.known
    moved = known.ecef_m.copy()
    moved[points] += ecef_m
    return replace(block, points=GroundPoints(
        block.points.ids, block.points.roles, Coordinates(moved, known.sigma_enu_m, known.fixed),
    ))  # fmt: skip


def measure(spoiled: Spoiled, method: str) -> dict[str, Any]:
    """Return the RMSE at the check points, m, and the numbers of errors that were found and missed."""
    start = time.perf_counter()
    run = _snooped if method == SNOOPING else partial(_adjusted, options=METHODS[method])
    ground_m, image, control, ended = run(spoiled.block)
    seconds = time.perf_counter() - start
    check = spoiled.block.points.where(Role.CHECK)
    rmse = math.sqrt(float(np.mean(np.sum((ground_m[check] - spoiled.truth.ecef_m[check]) ** 2, axis=1))))
    flagged, bad = np.concatenate([image, control]), np.concatenate([spoiled.image, spoiled.control])
    checkable = np.concatenate([spoiled.checkable_image, spoiled.checkable_control])
    observed = np.isin(np.arange(len(control)), spoiled.block.points.where(Role.CONTROL))
    good = ~bad & np.concatenate([np.ones(len(image), bool), observed])
    return {
        "rmse_m": round(rmse, 4), "good": int(good.sum()), "false": int((flagged & good).sum()),
        "checkable": int(checkable.sum()), "missed": int((checkable & ~flagged).sum()),
        "not_checkable": int((bad & ~checkable).sum()), "ended": bool(ended), "seconds": round(seconds, 3),
    }  # fmt: skip


def _adjusted(block: Block, options: dict[str, Any]) -> tuple[Array, Mask, Mask, bool]:
    """Return the ground points (N, 3) ECEF m, the found errors, and whether the run converged."""
    problem = compile_problem(replace(block, options=replace(block.options, max_iterations=MAX_ITERATIONS, **options)))
    end = solve(problem)
    return _judged(problem, end.state, end.converged)


def _judged(problem: Problem, state: State, ended: bool) -> tuple[Array, Mask, Mask, bool]:
    image, observed = norms_at(problem, state)
    control = np.zeros(len(problem.observed), bool)
    control[problem.observed] = observed > inlier_limit(FOUND, CONTROL)
    return state.ground + problem.origin_m, image > inlier_limit(FOUND, IMAGE), control, ended


def _snooped(block: Block) -> tuple[Array, Mask, Mask, bool]:
    solution = fg.adjust(block, snoop=True)
    ids = {name: k for k, name in enumerate(block.points.ids)}
    images = {image.id: k for k, image in enumerate(block.images)}
    o = block.observations
    image, control = np.zeros(len(o), bool), np.zeros(len(ids), bool)
    for test in solution.snooping.tests:
        if test.image:
            image |= (o.image == images[test.image]) & (o.point == ids[test.point])
        else:
            control[ids[test.point]] = True
    return solution.ground_m, image, control, solution.snooping.complete


def wanted(case: str, share: float) -> bool:
    """Return whether a share of a case belongs to the study."""
    return case != "everywhere" or share in EVERYWHERE_SHARES


Key = tuple[str, int, float, str]


def runs(
    case: str, seed: int, shares: Iterable[float], methods: Iterable[str], known: Collection[Key] = ()
) -> list[dict[str, Any]]:  # fmt: skip
    """Run one seed of a case without the known runs. The result does not depend on the number of workers."""
    out = []
    for share in shares:
        asked = [m for m in methods if wanted(case, share) and (case, seed, share, m) not in known]
        spoiled = spoil(case, seed, share) if asked else None
        for method in asked:
            assert spoiled is not None
            out.append({"case": case, "seed": seed, "share": share, "method": method, **measure(spoiled, method)})
    return out


def study(
    seeds: int, cases: Iterable[str], workers: int, *, shares: Iterable[float] = SHARES,
    methods: Iterable[str] = tuple(METHODS), known: Collection[Key] = (),
    tell: Callable[[str, list[dict[str, Any]]], object] = lambda text, records: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return all runs except the known ones, sorted. ``tell`` is called with the runs of each seed."""
    tasks = list(product(cases, range(1, seeds + 1)))
    one = partial(_task, shares=tuple(shares), methods=tuple(methods), known=frozenset(known))
    out: list[dict[str, Any]] = []

    def note(task: tuple[str, int], records: list[dict[str, Any]]) -> None:
        out.extend(records)
        tell(f"{task[0]} seed {task[1]}: {sum(r['seconds'] for r in records):.0f} s", records)

    if workers == 1:
        for task in tasks:
            note(task, one(task))
        return out
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=self_test) as pool:
        for task, records in zip(tasks, pool.map(one, tasks), strict=True):
            note(task, records)
    return out


def _task(
    task: tuple[str, int], shares: tuple[float, ...], methods: tuple[str, ...], known: frozenset[Key]
) -> list[dict[str, Any]]:  # fmt: skip
    return runs(*task, shares, methods, known)


def gathered(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one entry per case, share and method, with lists over the seeds."""
    groups: dict[tuple[str, float, str], list[dict[str, Any]]] = {}
    for record in sorted(records, key=lambda r: r["seed"]):
        groups.setdefault((record["case"], record["share"], record["method"]), []).append(record)
    names = [name for name in records[0] if name not in ("case", "share", "method")]
    return [
        {"case": case, "share": share, "method": method, **{name: [r[name] for r in rows] for name in names}}
        for (case, share, method), rows in groups.items()
    ]


def spread(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Convert the result of :func:`gathered` back to one record per run."""
    single = ("case", "share", "method")
    return [
        {**{name: e[name] for name in single}, **{name: e[name][n] for name in e if name not in single}}
        for e in entries
        for n in range(len(e["seed"]))
    ]


def _ordered(record: dict[str, Any]) -> tuple[int, int, float, int]:
    """Return the sort key of a run in the file."""
    return CASES.index(record["case"]), record["seed"], record["share"], list(METHODS).index(record["method"])


def write(out: Path, records: list[dict[str, Any]], minutes: float) -> None:
    """Write the file of results."""
    records = sorted(records, key=_ordered)
    seeds = max(r["seed"] for r in records)
    head = {"version": fg.__version__, "machine": platform.machine(), "minutes": round(minutes, 1), "seeds": seeds}
    lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in gathered(records))
    write_bytes(out, f'{{"head": {json.dumps(head)},\n"entries": [\n{lines}\n]}}\n'.encode())


def main(arguments: list[str]) -> None:
    """Run the study and write the file of results."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contamination")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--shares", nargs="+", type=float, choices=SHARES, default=SHARES)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=tuple(METHODS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--missing", action="store_true")
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    before = json.loads(given.out.read_text("utf-8")) if given.missing else {"head": {"minutes": 0.0}, "entries": []}
    records, start = spread(before["entries"]), time.perf_counter()

    def tell(text: str, new: list[dict[str, Any]]) -> None:
        records.extend(new)
        if records and (new or not given.missing):
            write(given.out, records, before["head"]["minutes"] + (time.perf_counter() - start) / 60.0)
        sys.stderr.write(text + "\n")

    study(
        given.seeds, given.cases, given.workers, shares=given.shares, methods=given.methods, tell=tell,
        known={(r["case"], r["seed"], r["share"], r["method"]) for r in records},
    )  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
