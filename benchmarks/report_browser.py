"""The benchmark opens the report of a large block in a browser: size of the file, seconds to the map, ms per frame.

    python -m benchmarks.report_browser RESULTDIR [--runs 5] [--every 50] [--hovered 0]

RESULTDIR is a result folder of ``adjust``; without it a block of 16 images with 1e5 image
points is simulated and adjusted. The time of a frame ends at the second animation frame after
a pan or zoom, when the new picture is visible.
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
import tempfile
from pathlib import Path
from typing import Any

from fg_orient.orientation.run import run_project
from fg_orient.report import write_report
from fg_orient.simulate.block import BlockOptions, simulate_block
from tests.support.browser import Page, executable, open_browser

#: This block has 3.2 image points per ground point.
BLOCK = BlockOptions(rows=4, columns=4, points=31_200, seed=1)
#: This number of pans and zooms is timed.
STEPS = 40
_FRAMES = """new Promise((done) => {
  const canvas = document.querySelector('#live-map canvas');
  const keys = ['+', 'ArrowLeft', 'ArrowUp', '-', 'ArrowRight', 'ArrowDown', '-', '+'];
  const times = [];
  const step = (k) => {
    if (k === %d) return done(times);
    const began = performance.now();
    canvas.dispatchEvent(new KeyboardEvent('keydown', {key: keys[k %% keys.length], cancelable: true}));
    requestAnimationFrame(() => requestAnimationFrame(() => { times.push(performance.now() - began); step(k + 1); }));
  };
  step(0);
})"""
#: The script searches a point by its id, deselects it, and returns the middle of the map,
#: where the point is, and its text.
_GO = """(() => {
  const box = document.querySelector('#live-map input[type=search]');
  const canvas = document.querySelector('#live-map canvas');
  box.value = %s;
  box.dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'}));
  canvas.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}));
  const b = canvas.getBoundingClientRect();
  return [b.x + b.width / 2, b.y + b.height / 2, document.querySelector('#live-map .tip').textContent];
})()"""
#: One call searches this number of ids, so that the browser answers after seconds, not minutes.
CHUNK = 200
#: The script searches every n-th id, or some of these, and counts the tips that name the id.
_SEARCH = """(() => {
  window.sought ??= JSON.parse(document.getElementById('report-data').textContent).points.id;
  const some = window.sought.filter((_, k) => k %% %d === 0).slice(%d, %d);
  const box = document.querySelector('#live-map input[type=search]');
  const tip = document.querySelector('#live-map .tip');
  return [window.sought.length, some.length, some.filter((id) => {
    box.value = id;
    box.dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'}));
    return tip.textContent.split('\\n')[0].endsWith(' ' + id);
  }).length];
})()"""


def search(page: Page, every: int) -> tuple[int, int, int]:
    """Return the numbers of all points, of the points searched, and of the points found."""
    points, sought, found, start = 0, 0, 0, 0
    while start == sought:
        points, tried, right = page.value(_SEARCH % (every, start, start + CHUNK))
        sought, found, start = sought + tried, found + right, start + CHUNK
    return points, sought, found


def hover(page: Page, number: int, seed: int = 1) -> int:
    """Return how many points of a random sample show their text when the mouse is moved to them."""
    ids = page.value("JSON.parse(document.getElementById('report-data').textContent).points.id")
    page.value("document.querySelector('#live-map canvas').scrollIntoView({block: 'center'})")
    told = 0
    for name in random.Random(seed).sample(ids, number):
        page.mouse("mouseMoved", 1, 1)
        x, y, before = page.value(_GO % json.dumps(name))
        page.mouse("mouseMoved", x, y)
        tip = page.value("document.querySelector('#live-map .tip').textContent")
        told += before == "" and tip.split("\n")[0].endswith(f" {name}")
    return told


def measure(page: Page, report: Path, runs: int, every: int = 50, hovered: int = 0) -> dict[str, Any]:
    """Open a report several times and measure the times.

    Parameters
    ----------
    page : Page
    report : Path
        The HTML file.
    runs : int
        Number of loads; the result has the medians.
    every : int
        Every n-th id is searched, where n is this number.
    hovered : int
        The mouse is moved to this number of points, drawn at random with a seed.
    """
    page.size(1100, 900)
    loads, frames = [], []
    for _ in range(runs):
        page.open(report, wait="performance.getEntriesByName('drawn').length > 0")
        loads.append(page.value("performance.getEntriesByName('map')[0].startTime"))
        frames += page.value(_FRAMES % STEPS)
    points, sought, found = search(page, every)
    told = hover(page, hovered)
    return {
        "bytes": report.stat().st_size, "runs": runs, "seconds_to_the_map": [load / 1e3 for load in loads],
        "median_seconds_to_the_map": statistics.median(loads) / 1e3, "median_frame_ms": statistics.median(frames),
        "frame_ms_95": sorted(frames)[int(0.95 * len(frames))], "points": points, "sought": sought, "found": found,
        "hovered": hovered, "told": told, "troubles": page.troubles,
    }  # fmt: skip


def large_result(folder: Path) -> Path:
    """Simulate and adjust the block; return its result folder."""
    project = simulate_block(folder / "block", BLOCK)
    run_project(project, folder / "result")
    return folder / "result"


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", nargs="?", type=Path, help="result folder of adjust")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--every", type=int, default=50)
    parser.add_argument("--hovered", type=int, default=0)
    given = parser.parse_args()
    program = executable()
    if program is None:
        parser.error("no browser found")
    with tempfile.TemporaryDirectory() as folder, open_browser(program, Path(folder) / "profile") as browser:
        report, _ = write_report(given.result or large_result(Path(folder)))
        print(json.dumps(measure(browser.page(), report, given.runs, given.every, given.hovered), indent=1))


if __name__ == "__main__":
    main()
