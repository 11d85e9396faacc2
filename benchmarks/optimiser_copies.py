"""The benchmark counts how often GTSAM's optimisers copy all values for the Python factors of the image points.

    python -m benchmarks.optimiser_copies    # writes results/optimiser_copies.json; run python docs/scale.py afterwards

Each row has the processor seconds of one call by Python (linearise, error, elimination), of
one copy of
``gtsam.Values``, and of one ``iterate()`` of GTSAM's Gauss-Newton on the same graph. ``iterate()``
linearises, eliminates and evaluates the error once. Its time without these parts, divided by
the time of a copy and by the number of factors, is the number of copies for each factor. Each
time is the least of some repetitions.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import gtsam

from fg_orient.adjustment.explicit_optimisers import ExplicitRun
from fg_orient.adjustment.optimisers import native
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.installation import version_of
from fg_orient.model.machine import processor_name
from fg_orient.studies.comparison.scale import block_of

RESULTS: Final = Path(__file__).parent / "results" / "optimiser_copies.json"
SIZES: Final = (100, 200, 500, 1000, 2000, 5000, 10_000)


def seconds(call: Callable[[], Any], repeats: int) -> float:
    """Return the least processor seconds of some calls."""
    found = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        found.append(time.process_time() - start)
    return min(found)


def row_of(size: int) -> dict[str, Any]:
    """Return the times of a block with this number of image points."""
    problem = compile_problem(block_of(size))
    run = ExplicitRun(problem, "gauss-newton")
    graph, values = run.graph, run.values
    linear = graph.linearize(values)
    optimizer = native("gauss-newton", run, 0.0, 0.0)
    optimizer.iterate()
    return {
        "image_points": len(problem.observations), "factors": graph.size(), "variables": values.size(),
        "linearise_s": seconds(lambda: graph.linearize(values), 3), "error_s": seconds(lambda: graph.error(values), 3),
        "eliminate_s": seconds(lambda: linear.optimize(run.ordering), 3),
        "copy_s": seconds(lambda: [gtsam.Values(values) for _ in range(20)], 5) / 20.0,
        "iterate_s": seconds(optimizer.iterate, 3),
    }  # fmt: skip


def main() -> None:
    """Measure all sizes and write the record."""
    with one_blas_thread():
        rows = [row_of(size) for size in SIZES]
    record = {"date": datetime.now(UTC).date().isoformat(), "processor": processor_name(),
              "gtsam": version_of("gtsam"), "rows": rows}  # fmt: skip
    RESULTS.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
