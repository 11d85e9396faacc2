"""Write scale.md and its figures: ``python docs/scale.py [FOLDER]`` with a folder of ``fg-orient compare --scale``.

Without a folder the page is made from the record that is stored with the figures.
"""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from fg_orient.studies.comparison.scale_page import page

HERE = Path(__file__).parent
FIGURES = HERE / "_static" / "scale"
COPIES = HERE.parent / "benchmarks" / "results" / "optimiser_copies.json"
COPIED = (
    "| {image_points} | {factors} | {variables} | {parts_s:.3g} | {copy_us:.3g} | {iterate_s:.3g} | {copies:.1f} | "
    "{share:.0%} |"
)
WHY = """\
## Why GTSAM's optimisers grow faster on the explicit graph

A factor of this program is a Python function of GTSAM's values. An optimiser of GTSAM stores the values in
C++, and GTSAM's Python interface copies **all** values before each call of the function. There are two calls
for each factor and iteration (linearisation, error). Factors and variables both grow with the block: an
iteration grows with their product. If Python calls `graph.linearize(values)`, it passes its own values and
nothing is copied. Therefore the time of our loop over the same graph grows linearly. Ordering, linearisation
and elimination are not the cause: the column *parts* gives their time.

The table gives processor seconds of one iteration of Gauss-Newton, measured by
`python -m benchmarks.optimiser_copies` on {date}, {processor}, GTSAM {gtsam}:

| image points | factors | variables | parts, s | one copy, µs | iteration, s | copies for each factor | share |
|---|---|---|---|---|---|---|---|
{table}

*share*: of the copies in an iteration, {last[share]:.0%} at {last[image_points]} image points. The exponent
is {small:.2f} in the three smallest of these blocks and {large:.2f} in the four largest. The exponent in
the table above is a mean of both. The copies are made outside this program. Factors that eliminate the ground points
have few calls and few variables: with the same optimisers the default graph grows linearly.
"""


def text() -> str:
    """Return the text of the page from the record that is stored with the figures."""
    record = json.loads((FIGURES / "result.json").read_text("utf-8"))
    head = (
        "<!-- made by docs/scale.py from _static/scale/result.json and benchmarks/results/optimiser_copies.json -->\n\n"
    )
    return head + page(record, "_static/scale/") + "\n" + copies(json.loads(COPIES.read_text("utf-8")))


def copies(record: dict[str, Any]) -> str:
    """Return the section on the optimisers of GTSAM on the explicit graph."""
    cells = []
    for one in record["rows"]:
        parts = one["linearise_s"] + one["error_s"] + one["eliminate_s"]
        left = one["iterate_s"] - parts
        one |= {"parts_s": parts, "share": left / one["iterate_s"], "copies": left / one["copy_s"] / one["factors"]}
        cells.append(COPIED.format(copy_us=1e6 * one["copy_s"], **one))
    points, times = (np.log([one[name] for one in record["rows"]]) for name in ("image_points", "iterate_s"))
    small, large = (np.polyfit(points[own], times[own], 1)[0] for own in (slice(3), slice(-4, None)))
    return WHY.format(table="\n".join(cells), small=small, large=large, last=record["rows"][-1], **record)


def main(folder: Path | None) -> None:
    """Copy the figures and the record of a folder, and write the page."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for path in () if folder is None else (folder / "result.json", *sorted(folder.glob("*.svg"))):
        shutil.copyfile(path, FIGURES / path.name)
    (HERE / "scale.md").write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
