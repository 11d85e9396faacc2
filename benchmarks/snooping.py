"""The benchmark measures the search for gross errors: the time of the command, and missed and false rejections.

    python -m benchmarks.snooping [--cases C ...] [--repeats N] [--folder F]

writes results/snooping.json, and ``python -m benchmarks.page`` makes a section of
docs/performance.md from it. The blocks come from ``benchmarks.whole_run``. Gross errors of 5 to 50 px
with random directions are planted in random image points of the table. Processor seconds refer to the
whole command ``adjust --snoop``; the first run is not counted. The search is also made one by one, with
one gross error and one restored observation in each round, and must reject the same observations.

The power to find an error is predicted in the adjustment without errors: with the error e in
sigmas and the cofactors Q of the residuals of its image point, T has the non-centrality
``e^T Q e``, d degrees of freedom and the limit of the last round. An error is missed if its
image point is not rejected. The prediction holds for one error in a point; errors in points
with several errors are counted separately.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import chi2, ncx2, norm

import fg_orient as fg
from benchmarks.coverage import SIZE_PX
from benchmarks.hardware import this_machine
from benchmarks.whole_run import run
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.distributions import sidak
from fg_orient.orientation import outlier_search
from fg_orient.quality.hypotheses import CHECKED

RESULTS: Final = Path(__file__).parent / "results" / "snooping.json"
SEED: Final = 1
#: Runs may end with these exit codes: an error along a line of sight, which no other ray
#: shows, may make a check point contradict the result.
ACCEPTED: Final = (0, 4)
Key = tuple[str, str]


@dataclass(frozen=True)
class Case:
    """A case has a number of ground points, a number or share of gross errors, and a limit in processor seconds.

    ``one_by_one`` cases are also searched with one error in each round.
    """

    points: int
    errors: float
    limit_s: float | None
    one_by_one: bool


CASES: Final = {
    "60 of 1e4": Case(4_000, 60, 6.0, True),
    "2 % of 1e4": Case(4_000, 0.02, None, True),
    "1 % of 1e5": Case(31_300, 0.01, 60.0, False),
}


def planted(table: Path, errors: float) -> dict[Key, tuple[float, float]]:
    """Plant errors in a table of image points; return the errors by image and point."""
    lines = table.read_text("utf-8").splitlines()
    head = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    names, *rows = csv.reader(lines[head:])
    at = {name: names.index(name) for name in ("image", "id", "line", "sample")}
    rng, out = np.random.default_rng(SEED), dict[Key, tuple[float, float]]()
    chosen = rng.choice(len(rows), int(errors if errors >= 1 else errors * len(rows)), replace=False)
    for k in chosen.tolist():
        size, angle = rng.uniform(*SIZE_PX), rng.uniform(0.0, 2.0 * np.pi)
        error = float(size * np.cos(angle)), float(size * np.sin(angle))
        for name, value in zip(("line", "sample"), error, strict=True):
            rows[k][at[name]] = str(float(rows[k][at[name]]) + value)
        out[rows[k][at["image"]], rows[k][at["id"]]] = error
    table.write_text("\n".join([*lines[: head + 1], *map(",".join, rows)]) + "\n", "utf-8")
    return out


def missed_probabilities(
    solution: fg.Solution, errors: dict[Key, tuple[float, float]], level: float
) -> dict[Key, float]:
    """Return the predicted probability that each error passes its test.

    ``solution`` belongs to the block without errors.
    """
    o, block = solution.problem.observations, solution.block
    q = solution.residual_cofactors.image
    row = {(block.images[i].id, block.points.ids[j]): k
           for k, (i, j) in enumerate(zip(o.image.tolist(), o.point.tolist(), strict=True))}  # fmt: skip
    out = {}
    for key, error in errors.items():
        k = row[key]
        size, axes = np.linalg.eigh(q[k])
        checked = size > CHECKED
        along = axes.T @ (np.array(error) / [o.sigma_line_px[k], o.sigma_sample_px[k]])
        d, squares = int(checked.sum()), float(np.sum(size[checked] * along[checked] ** 2))
        out[key] = float(ncx2.cdf(chi2.isf(level, d), d, squares)) if d else 1.0
    return out


def rejections(record: dict[str, Any]) -> list[list[str]]:
    """Return the rejected observations, sorted by part, image and point."""
    return sorted([f["part"], f["image"] or "", f["id"]] for f in record["found"] if f["readmitted"] is None)


def judged(
    clean: Path, record: dict[str, Any], tests: dict[str, Any], errors: dict[Key, tuple[float, float]]
) -> dict[str, Any]:
    """Return the missed errors and false rejections, from the planted errors, and the prediction."""
    named = {(image, point) for part, image, point in rejections(record) if part == "image"}
    words = (text.removeprefix("point ").split(" in image ") for text in record["went_with"])
    partners = {(image, point) for point, image in words}
    whole, out, count = {point for _, point in partners}, named | partners, dict[str, int]()
    for _, point in errors:
        count[point] = count.get(point, 0) + 1
    p = missed_probabilities(fg.adjust(fg.read_project(clean)), errors, sidak(tests["level"], tests["n_tested"]))
    alone = [key for key in errors if count[key[1]] == 1]
    miss = np.array([p[key] for key in alone])
    return {
        "alone": len(alone), "missed": sum(key not in out for key in alone), "predicted": float(miss.sum()),
        "half": float(norm.ppf(0.995) * np.sqrt(np.sum(miss * (1.0 - miss)))),
        "together": len(errors) - len(alone), "missed_together": sum(k not in out and count[k[1]] > 1 for k in errors),
        "false": sum(point not in count for _, point in out),
        "beside": sum(key not in errors and key[1] in count and key[1] not in whole for key in out),
        "whole": sum(key not in errors and key[1] in count and key[1] in whole for key in out),
        "control": sum(part != "image" for part, _, _ in rejections(record)),
    }  # fmt: skip


def measured(name: str, folder: Path, repeats: int) -> dict[str, Any]:
    """Simulate a block, plant errors and search for them; return the medians."""
    case, number = CASES[name], list(CASES).index(name)
    clean, block, out = (folder / f"{kind}-{number}" for kind in ("clean", "block", "result"))
    grid = ["--rows", "4", "--columns", "4", "--points", str(case.points), "--seed", str(SEED), "--quiet"]
    for target in (clean, block):
        run(["simulate", "block", *grid, "--out", str(target)])
    errors = planted(block / "observations.csv", case.errors)
    command = ["adjust", str(block / "project.toml"), "--out", str(out), "--overwrite", "--quiet"]
    runs = [run([*command, "--snoop"], ACCEPTED) for _ in range(repeats + 1)][1:]
    result = json.loads((out / "result.json").read_text("utf-8"))
    plain = [run(command, ACCEPTED) for _ in range(repeats)]
    record, found = result["snooping"], rejections(result["snooping"])
    same = None
    if case.one_by_one:
        outlier_search.ROUND = 1  # type: ignore[misc]
        single = fg.adjust(fg.read_project(block / "project.toml"), snoop=True).snooping
        assert single is not None
        same = found == sorted([f.test.part, f.test.image, f.test.point] for f in single.left_out)
    return {
        "n_image_points": len(fg.read_project(block / "project.toml").observations), "errors": len(errors),
        "repeats": repeats, "rounds": len(record["rounds"]), "left_out": len(found),
        "readmitted": sum(f["readmitted"] is not None for f in record["found"]), "same_as_one_by_one": same,
        "snoop": {key: statistics.median(r[key] for r in runs) for key in runs[0]},
        "plain": {key: statistics.median(r[key] for r in plain) for key in plain[0]},
        **judged(clean / "project.toml", record, result["outlier_tests"], errors),
    }  # fmt: skip


def rows(results: dict[str, Any]) -> list[list[str]]:
    """Return the table of the times as rows of text."""
    out = [
        ["image points", "gross errors", "processor s", "limit", "without `--snoop`", "peak MB", "rounds", "left out",
         "put back", "the same one by one", "verdict"],
    ]  # fmt: skip
    for name, found in results["cases"].items():
        seconds, same = found["snoop"]["processor_s"], found["same_as_one_by_one"]
        limit = CASES[name].limit_s
        met = (limit is None or seconds <= limit) and same is not False
        out.append([
            f"{found['n_image_points']:,}".replace(",", " "), str(found["errors"]), f"{seconds:.1f}",
            "-" if limit is None else f"{limit:g}", f"{found['plain']['processor_s']:.1f}",
            f"{found['snoop']['mb']:.0f}",
            str(found["rounds"]), str(found["left_out"]), str(found["readmitted"]),
            {True: "yes", False: "no", None: "not run"}[same], "met" if met else "missed",
        ])  # fmt: skip
    return out


def truth_rows(results: dict[str, Any]) -> list[list[str]]:
    """Return the table of missed errors and false rejections."""
    out = [
        ["image points", "errors alone in their point", "missed", "predicted", "errors in points with several",
         "missed", "right image points left out: in points without an error", "beside an error",
         "as the point has one ray left", "control coordinates left out"],
    ]  # fmt: skip
    for found in results["cases"].values():
        numbers = ("together", "missed_together", "false", "beside", "whole", "control")
        out.append([
            f"{found['n_image_points']:,}".replace(",", " "), str(found["alone"]), str(found["missed"]),
            f"{found['predicted']:.1f} ± {found['half']:.1f}", *(str(found[key]) for key in numbers),
        ])  # fmt: skip
    return out


def main() -> None:
    """Measure and write the file of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="folder for blocks and results; default: a temporary one")
    given = parser.parse_args()
    results: dict[str, Any] = {"machine": this_machine(), "cases": {}}
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for name in given.cases:
            results["cases"][name] = measured(name, Path(folder), given.repeats)
            write_bytes(RESULTS, (json.dumps(results, indent=1) + "\n").encode())
    for table in (rows(results), truth_rows(results)):
        sys.stdout.write("\n".join(" | ".join(row) for row in table) + "\n")


if __name__ == "__main__":
    main()
