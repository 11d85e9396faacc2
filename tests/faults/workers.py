"""Worker processes killed at random times: ``python -m tests.faults.workers --kills 200``.

Blocks are adjusted on four processes while another thread kills one of them after random pauses, also those that only
start. Each adjustment ends with the bits of one process, or with NoSolutionError (exit code 3). Then the process that
started them is killed: they end, and the next run continues with the same bits.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.parts import watch
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution, opened, work_folder
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.model.errors import NoSolutionError
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.faults.same import contents
from tests.support.parallel_block import block

PARTS = 8


def adjusted(problem: Problem, pool: Pool) -> State:
    """Adjust on a pool."""
    with work_folder(Execution(), pool) as folder:
        backend = PartedBackend(problem, pool, folder, PARTS)
        state = OPTIMIZERS["gauss-newton"](backend, backend.initial(), 50).state
        return State(state.image, state.ground)  # its ground points are read from the folder


def children() -> list[int]:
    """Return the processes that this one started and that are, or become, workers."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            status = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            words = (folder / "cmdline").read_bytes()
            if int(status[1]) == os.getpid() and status[0] != "Z" and b"spawn_main" in words:
                found.append(int(folder.name))
    return sorted(found)


@contextlib.contextmanager
def killer(kills: int, longest_s: float, seed: int) -> Iterator[Counter[str]]:
    """Yield the thread that kills a random worker after random pauses; counts of what it did."""
    rng, counts, stop = random.Random(seed), Counter[str](), threading.Event()

    def work() -> None:
        while counts["kills"] < kills and not stop.wait(rng.uniform(0.0, longest_s)):
            alive = children()
            if alive:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(rng.choice(alive), signal.SIGKILL)
                    counts["kills"] += 1

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield counts
    finally:
        stop.set()
        thread.join()


def trial(problem: Problem, pool: Pool, expected: State) -> str:
    """Adjust once; return "same bits", "exit 3" with its code, or the failure."""
    try:
        found = adjusted(problem, pool)
    except NoSolutionError as error:
        return f"exit 3: {error.problems[0].code}"
    except Exception as error:
        return f"wrong: {type(error).__name__}: {str(error)[:200]}"
    same = np.array_equal(found.image, expected.image) and np.array_equal(found.ground, expected.ground, equal_nan=True)
    return "same bits" if same else "wrong: other bits"


def while_working(kills: int, longest_s: float, seed: int) -> Counter[str]:
    """Return the ends of adjustments while workers are killed.

    The number of replacements is not limited.
    """
    problem = compile_problem(block())
    expected, ends = adjusted(problem, Pool()), Counter[str]()
    watch.REPLACED, limit = 10**6, watch.REPLACED
    try:
        with opened(Execution(workers=4)) as pool, killer(kills, longest_s, seed) as counts:
            while counts["kills"] < kills:
                ends[trial(problem, pool, expected)] += 1
                print(dict(ends), dict(counts), file=sys.stderr, flush=True)
        return ends + Counter({"kills": counts["kills"]})
    finally:
        watch.REPLACED = limit


def while_starting(runs: int, longest_s: float, seed: int) -> Counter[str]:
    """Return the ends of runs in which one worker is killed about the start of the processes.

    The usual limits apply.
    """
    problem = compile_problem(block())
    expected, ends = adjusted(problem, Pool()), Counter[str]()
    for run in range(runs):
        with killer(1, longest_s, seed + run) as counts:
            try:
                with opened(Execution(workers=4)) as pool:
                    ends[trial(problem, pool, expected)] += 1
            except NoSolutionError as error:
                ends[f"exit 3: {error.problems[0].code}"] += 1
        ends["kills"] += counts["kills"]
    return ends


# --- the run itself is killed ---------------------------------------------------------------------------


#: Commands with workers that continue; ``compare`` continues from its finished sets without an option.
RUNS = {
    "adjust": "--parts 6 --checkpoint-every 0 --resume --workers 4",
    "compare": "--eop-sets 1,5,9 --solvers qr --backends dense --workers 2",
}


def run_killed(command: str, kills: int, seed: int) -> Counter[str]:
    """Return the ends of a command with workers after its own process is killed.

    Its workers end, and the next run continues.
    """
    rng, ends = random.Random(seed), Counter[str]()
    with tempfile.TemporaryDirectory(prefix="faults-") as name:
        folder = Path(name)
        project = simulate_zonguldak(folder / "twin", ZonguldakOptions(seed=1))
        words = [command, str(project), "--out", str(folder / "out"), "--quiet", *RUNS[command].split()]
        line = [sys.executable, "-m", "fg_orient", *words]
        begin = time.monotonic()
        subprocess.run(line, check=True)
        duration, expected = time.monotonic() - begin, contents(folder)
        while ends["kills"] < kills:
            shutil.rmtree(folder / "out")
            process = subprocess.Popen(line, start_new_session=True, stderr=subprocess.DEVNULL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(rng.uniform(0.0, duration))
            killed = process.poll() is None
            process.kill()
            process.wait()
            if not _empty(process.pid, 60.0):
                ends["wrong: processes are left"] += 1
                os.killpg(process.pid, signal.SIGKILL)
            if killed:
                ends["kills"] += 1
                again = [] if not (folder / "out").exists() else ["--overwrite"]
                done = subprocess.run(line + again, capture_output=True, text=True)
                resumed = not again and command == "adjust" and "no checkpoint" not in done.stderr
                differ = sorted({path for path, _ in contents(folder).items() ^ expected.items()})
                same = done.returncode == 0 and not differ
                wrong = f"wrong: {done.returncode}, {differ[:5]}, {done.stderr[-300:]}"
                ends[("resumed: " if resumed else "") + "same bits" if same else wrong] += 1
            print(dict(ends), file=sys.stderr, flush=True)
    return ends


def _empty(group: int, longest_s: float) -> bool:
    """Wait until a group has no processes."""
    end = time.monotonic() + longest_s
    while time.monotonic() < end:
        states = []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError, ValueError, IndexError):
                status = (folder / "stat").read_text().rsplit(")", 1)[1].split()
                states += [status[0]] if int(status[2]) == group else []
        if all(state == "Z" for state in states):
            return True
        time.sleep(0.1)
    return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--runs", type=int, default=5, help="kills of the process that started the workers")
    parser.add_argument("--longest", type=float, default=3.0, help="longest pause between two kills, s")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    begin, report = time.monotonic(), dict[str, Any]()
    report |= {f"{command} killed": run_killed(command, given.runs, given.seed) for command in RUNS}
    report["while starting"] = while_starting(given.starts, given.longest, given.seed)
    print(json.dumps(report), file=sys.stderr, flush=True)
    report["while working"] = while_working(given.kills, given.longest, given.seed)
    print(json.dumps(report | {"seconds": time.monotonic() - begin}))
    return int(any(end.startswith("wrong") for ends in report.values() for end in ends))


if __name__ == "__main__":
    sys.exit(main())
