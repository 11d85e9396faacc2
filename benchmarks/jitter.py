"""Evidence for jitter on simulated pairs: false finds, amplitude, coverage of bands, accuracy at check points.

    python -m benchmarks.jitter [--runs N] [--minutes N]

writes results/jitter.json and prints the tables of docs/jitter.md. Runs that the file has are not repeated. Each pair
has the geometry of the Zonguldak twin, 60 to 300 tie points, 10 to 30 control points, 30 check points, heights up to
100 to 1800 m, noise of 0.3 to 0.5 px, and metadata errors of the prior sigmas. Jitter is in one image or in both, in
roll, pitch or both, each with its own amplitude (0.2 to 3 px, logarithmic), frequency (0.5 to 8 cycles per image) and
phase.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import fg_orient as fg
from fg_orient.formats.atomic import write_bytes
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.distributions import INSIDE_95, beta_quantile
from fg_orient.model.names import COMPONENTS, Role
from fg_orient.orientation.jitter import adjust_with_jitter
from fg_orient.orientation.solution import Solution
from fg_orient.quality.jitter_system import without_quadratic
from fg_orient.sensors.correction import Correction, Wave
from fg_orient.simulate import zonguldak
from fg_orient.simulate.jitter import PITCH, PIXEL_RAD, ROLL
from fg_orient.simulate.options import ZonguldakOptions
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, Scene, as_read
from fg_orient.simulate.simulation import (
    QuickProjection,
    Simulation,
    draw_errors,
    ground_points,
    numbered,
    observe,
    roles_in_order,
)

Array = npt.NDArray[np.float64]
RESULTS: Final = Path(__file__).parent / "results" / "jitter.json"
RUNS: Final = 1000
#: Runs between two writings of the file.
STEP: Final = 25
CHECK: Final = 30
GROUND_NOISE_M: Final = (0.05, 0.05, 0.05)
AMPLITUDE_PX: Final = (0.2, 3.0)
CYCLES: Final = (0.5, 8.0)


@cache
def _scenes() -> tuple[Scene, ...]:
    return tuple(replace(scene, full_look_table=False) for scene in zonguldak._scenes(ZonguldakOptions()))


@cache
def _cameras() -> tuple[QuickProjection, ...]:
    top = zonguldak.HEIGHT_RANGE_M[1]
    return tuple(QuickProjection(as_read(scene.metadata()), Correction(), top) for scene in _scenes())


def _points(n: int, top_m: float, rng: np.random.Generator) -> Array:
    """Draw points in both images: longitude, latitude (degrees), height (m), (n, 3)."""
    out, size = np.empty((0, 3)), np.array([N_LINES, N_SAMPLES])
    while len(out) < n:
        unit = rng.random((2 * n, 3))
        lon_lat = np.array(zonguldak.CENTRE_LON_LAT_DEG) + (2.0 * unit[:, :2] - 1.0) * zonguldak._BOX_DEG
        drawn = np.column_stack([lon_lat, top_m * unit[:, 2]])
        ecef, margin = geodetic_to_ecef(*drawn.T), zonguldak.MARGIN_PX
        seen = np.stack([camera.estimate(ecef, drawn[:, 2]) for camera in _cameras()])
        out = np.vstack([out, drawn[((seen >= margin) & (seen <= size - 1 - margin)).all(axis=(0, 2))]])
    return out[:n]


def pair(seed: int, jitter: bool) -> Simulation:
    """Return the simulated pair of a seed."""
    rng = np.random.default_rng([seed, int(jitter)])
    n_tie, n_control = int(rng.integers(60, 301)), int(rng.integers(10, 31))
    noise, n = float(rng.uniform(0.3, 0.5)), n_tie + n_control + CHECK
    points = _points(n, float(rng.uniform(100.0, zonguldak.HEIGHT_RANGE_M[1])), rng)
    roles = roles_in_order(np.arange(n), n_control, CHECK)
    ground = ground_points(numbered(n), roles, points, GROUND_NOISE_M, rng)
    waves: list[tuple[Wave, ...]] = [(), ()]
    if jitter:
        for image in ((0,), (1,), (0, 1))[rng.integers(3)]:
            waves[image] = tuple(_wave(axis, rng) for axis in ((ROLL,), (PITCH,), (ROLL, PITCH))[rng.integers(3)])
    return observe(
        f"pair {seed}", _scenes(), ground, np.ones((2, n), bool), draw_errors("prior", rng, 2), np.zeros((2, 0)),
        noise, rng, zonguldak.HEIGHT_RANGE_M[1], waves=waves,
    )  # fmt: skip


def _wave(axis: int, rng: np.random.Generator) -> Wave:
    amplitude_px = math.exp(rng.uniform(*np.log(AMPLITUDE_PX)))
    return Wave(axis, PIXEL_RAD * amplitude_px, float(rng.uniform(*CYCLES)), float(rng.uniform(-math.pi, math.pi)))


def run(seed: int, jitter: bool) -> dict[str, Any]:
    """Adjust the pair of a seed without jitter and with jitter by evidence, and compare with the truth."""
    simulation, solutions = pair(seed, jitter), list[Solution]()
    block = simulation.block()

    def adjust(one: Block) -> Solution:
        solutions.append(fg.adjust(one))
        return solutions[-1]

    end = adjust_with_jitter(replace(block, options=replace(block.options, jitter="auto")), adjust)
    assert end.jitter is not None
    truth = simulation.truth
    waves = {(k, COMPONENTS[w.component]): w for k, c in enumerate(truth.corrections) for w in c.waves}
    ids = [image.id for image in block.images]
    tau, angles = np.linspace(-1.0, 1.0, 201), []
    for angle in end.jitter.angles:
        wave = waves.get((ids.index(angle.image), angle.angle))
        if wave is None and angle.band is None:
            continue
        true = np.zeros(len(tau)) if wave is None else without_quadratic(tau, wave.at(tau)) * angle.px_per_rad
        covered = None
        if angle.band is not None:
            covered = float(np.mean(np.abs(angle.band.value - true) <= INSIDE_95 * angle.band.sd))
        angles.append({
            "angle": f"{angle.angle} of {angle.image}", "verdict": angle.verdict,
            "cycles": None if wave is None else wave.cycles,
            "true_px": float(np.sqrt(2.0 * np.mean(true**2))), "covered": covered,
            "amplitude_px": None if angle.band is None else angle.amplitude_px,
            "bound_px": None if angle.band is not None or math.isnan(angle.bound_px) else angle.bound_px,
            "resolved_cycles": angle.resolved_cycles,
        })  # fmt: skip
    roles = np.array(block.points.roles)
    rows = {"check": roles == Role.CHECK, "free": roles != Role.CONTROL}
    errors = {
        name: [_rms(one.ground_m[rows[name]] - truth.ecef_m[rows[name]]) for one in (solutions[0], end)]
        for name in rows
    }
    noise, (n_tie, n_control) = (
        float(np.max(simulation.sigma_px)),
        (int(np.sum(roles == r)) for r in ("tie", "control")),
    )
    return _short({
        "seed": seed, "noise_px": noise, "tie": n_tie, "control": n_control, "angles": angles, "rms_m": errors,
    })  # fmt: skip


def _short(value: Any) -> Any:
    """Return a record with five digits of its numbers."""
    if isinstance(value, dict):
        return {key: _short(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def upper_bound(events: int, runs: int, level: float = 0.95) -> float:
    """Return the one-sided upper confidence bound of a probability (Clopper & Pearson 1934)."""
    return 1.0 if events >= runs else float(beta_quantile(events + 1.0, float(runs - events), level))


def figures(without: Sequence[dict[str, Any]], jittered: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of runs without and with jitter."""
    false = sum(any(a["verdict"] == "found" for a in one["angles"]) for one in without)
    every = [a for one in jittered for a in one["angles"]]
    true = [a for a in every if a["cycles"] is not None]
    found, missed = ([a for a in true if (a["verdict"] == "found") is kind] for kind in (True, False))
    coverage = np.array(
        [np.mean(own) for one in jittered if (own := [a["covered"] for a in one["angles"] if a["covered"] is not None])]
    )
    bounded = [a["true_px"] <= a["bound_px"] for a in missed if a["bound_px"] is not None]
    return {
        "pairs_without": len(without), "false_finds": false,
        "false_upper_bound": upper_bound(false, len(without)) if without else None,
        "pairs_with": len(jittered), "angles_with_jitter": len(true), "found": len(found),
        "found_in_another_angle": sum(a["verdict"] == "found" and a["cycles"] is None for a in every),
        "amplitude": _amplitudes(found),
        "amplitude_in_range": _amplitudes([a for a in found if a["true_px"] >= AMPLITUDE_PX[0]]),
        "amplitude_resolved": _amplitudes([a for a in found if a["cycles"] <= a["resolved_cycles"]]),
        "coverage": float(coverage.mean()), "coverage_se": float(coverage.std() / np.sqrt(len(coverage))),
        "missed_below_bound": [int(np.sum(bounded)), len(bounded)],
        "accuracy": {name: _accuracy(jittered, name) for name in ("check", "free")},
        "accuracy_without": {name: _accuracy(without, name) for name in ("check", "free")},
        "by_amplitude": _strata(found, missed, "true_px", (0.0, 0.2, 0.4, 0.7, 1.2, 4.0)),
        "by_cycles": _strata(found, missed, "cycles", (0.5, 2.0, 4.0, 6.0, 8.0)),
        "accuracy_by_amplitude": _accuracy_strata(jittered, (0.0, 0.2, 0.4, 0.7, 1.2, 4.0)),
    }  # fmt: skip


def _amplitudes(found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return mean ratio of estimated to true amplitude, its standard error, and the ratio of the sums."""
    if not found:
        return {"n": 0}
    estimated, true = (np.array([a[name] for a in found]) for name in ("amplitude_px", "true_px"))
    ratio = estimated / true
    return {
        "n": len(found), "mean_ratio": float(ratio.mean()), "se": float(ratio.std() / np.sqrt(len(ratio))),
        "median_ratio": float(np.median(ratio)), "ratio_of_sums": float(estimated.sum() / true.sum()),
    }  # fmt: skip


def _accuracy(runs: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    """Return the pooled ratio of RMS errors with and without the choice, and the pairs that it makes worse."""
    before, after = np.array([one["rms_m"][name] for one in runs]).T
    ratio = after / before
    worst = int(np.argmax(ratio))
    return {
        "pooled_ratio": float(np.sqrt(np.mean(after**2) / np.mean(before**2))), "mean_ratio": float(ratio.mean()),
        "worse_by_2_percent": int(np.sum(ratio > 1.02)), "worst_ratio": float(ratio[worst]),
        "worst_seed": runs[worst]["seed"], "n": len(runs),
    }  # fmt: skip


def _strata(
    found: Sequence[dict[str, Any]], missed: Sequence[dict[str, Any]], key: str, edges: Sequence[float]
) -> list[dict[str, Any]]:
    def within(rows: Sequence[dict[str, Any]], low: float, high: float) -> list[dict[str, Any]]:
        return [a for a in rows if low <= a[key] < high]

    return [
        {"from": low, "to": high, "missed": len(within(missed, low, high)), **_amplitudes(within(found, low, high))}
        for low, high in pairwise(edges)
    ]


def _accuracy_strata(runs: Sequence[dict[str, Any]], edges: Sequence[float]) -> list[dict[str, Any]]:
    """Return the accuracy by the largest true amplitude of a pair."""
    largest = [max((a["true_px"] for a in one["angles"]), default=0.0) for one in runs]
    out = []
    for low, high in pairwise(edges):
        own = [one for one, px in zip(runs, largest, strict=True) if low <= px < high]
        if own:
            out.append({"from": low, "to": high, **_accuracy(own, "free")})
    return out


def tables(found: dict[str, Any]) -> str:
    """Return the tables of docs/jitter.md."""
    every, large, resolved = (found[k] for k in ("amplitude", "amplitude_in_range", "amplitude_resolved"))
    check, free, without = found["accuracy"]["check"], found["accuracy"]["free"], found["accuracy_without"]["check"]
    below, bounded = found["missed_below_bound"]
    rows = [
        ("figure", "value"), ("---", "---"),
        (f"{found['pairs_without']} pairs without jitter: pairs with a find, 95 % upper bound of the probability",
         f"{found['false_finds']}, {100 * found['false_upper_bound']:.1f} %"),
        (f"{found['pairs_with']} pairs with jitter: angles with jitter, found, found in a wrong angle",
         f"{found['angles_with_jitter']}, {found['found']}, {found['found_in_another_angle']}"),
        ("estimated over true amplitude of all found: mean ± standard error, median, ratio of the sums", _ratio(every)),
        (f"the same for true amplitudes of {AMPLITUDE_PX[0]} px or more ({large['n']})", _ratio(large)),
        (f"the same for frequencies that the points resolve ({resolved['n']})", _ratio(resolved)),
        ("share of lines within the 95 % band, mean of the pairs ± standard error",
         f"{100 * found['coverage']:.1f} ± {100 * found['coverage_se']:.1f} %"),
        ("angles with jitter that was not found: true amplitude below the bound", f"{below} of {bounded}"),
        ("RMSE at check points over RMSE without the option: all pairs with jitter together, worst pair, pairs more "
         "than 2 % worse", _worse(check)),
        ("the same at check and tie points", _worse(free)),
        ("the same at check points of pairs without jitter", _worse(without)),
    ]  # fmt: skip
    strata = [("true amplitude, px", "found", "missed", "estimated over true", "RMSE over RMSE without"), ("---",) * 5]
    accuracy = {(one["from"], one["to"]): one for one in found["accuracy_by_amplitude"]}
    for one in found["by_amplitude"]:
        ratio = f"{one['mean_ratio']:.2f} ± {one['se']:.2f}" if one["n"] else "–"
        own = accuracy.get((one["from"], one["to"]))
        after = "–" if own is None else f"{own['pooled_ratio']:.2f}"
        strata.append((f"{one['from']} to {one['to']}", str(one["n"]), str(one["missed"]), ratio, after))
    return "\n\n".join("\n".join(f"| {' | '.join(row)} |" for row in part) for part in (rows, strata)) + "\n"


def _ratio(one: dict[str, Any]) -> str:
    return f"{one['mean_ratio']:.3f} ± {one['se']:.3f}, {one['median_ratio']:.3f}, {one['ratio_of_sums']:.3f}"


def _worse(one: dict[str, Any]) -> str:
    return f"{one['pooled_ratio']:.3f}, {one['worst_ratio']:.2f}, {one['worse_by_2_percent']} of {one['n']}"


def some_runs(runs: int, minutes: float = math.inf, report: Callable[[str], None] = print) -> dict[str, Any]:
    """Add missing runs to the file and return its content."""
    stored = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {"without": [], "with": []}
    end, since = time.monotonic() + 60.0 * minutes, time.monotonic()
    for number in range(runs):
        for name in ("without", "with"):
            if number >= len(stored[name]) and time.monotonic() < end:
                stored[name].append(run(number, name == "with"))
        if (number + 1) % STEP == 0 and len(stored["with"]) == number + 1:
            write_bytes(RESULTS, json.dumps(stored).encode("utf-8"))
            report(f"{number + 1} pairs of each kind, {time.monotonic() - since:.0f} s")
    return stored


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--minutes", type=float, default=math.inf)
    given = parser.parse_args(arguments)
    stored = some_runs(given.runs, given.minutes, lambda text: print(text, flush=True))
    print(tables(figures(stored["without"], stored["with"])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
