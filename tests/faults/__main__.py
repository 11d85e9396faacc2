"""Faults at writing calls of commands; figures and failures as JSON.

``python -m tests.faults --command adjust --errors ENOSPC,EIO,EROFS,KILL`` lets every call of ``adjust`` fail by each
error; ``--most N`` takes a sample of the calls. ``--kills N`` kills the command at random times instead.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from tests.faults.harness import ERRORS, Faults, sample
from tests.faults.scenarios import SCENARIOS, made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--command", choices=sorted(SCENARIOS), action="append")
    parser.add_argument("--errors", default=",".join(ERRORS))
    parser.add_argument("--sticky", action="store_true", help="all later calls fail, too")
    parser.add_argument("--most", type=int)
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    reports = []
    for name in given.command or SCENARIOS:
        with tempfile.TemporaryDirectory(prefix="faults-") as folder:
            begin = time.monotonic()
            faults = Faults(made(name, Path(folder).resolve()), Path(folder).resolve())
            if given.kills:
                random_times(faults, given.kills, given.seed)
            else:
                for error in given.errors.split(","):
                    for nth in sample(faults.good.count, given.most, given.seed):
                        faults.fail(nth, error, sticky=given.sticky)
            reports.append(asdict(faults.report) | {"seconds": time.monotonic() - begin})
            print(json.dumps(reports[-1]), file=sys.stderr, flush=True)
    print(json.dumps(reports))
    return int(any(report["failures"] for report in reports))


def random_times(faults: Faults, kills: int, seed: int) -> None:
    """Kill a command at random times of its duration."""
    from tests.faults.harness import command, run

    faults._copy()
    begin = time.monotonic()
    run(command(*faults.scenario.words(faults.root)), faults.root, count=False)
    duration, rng, done = time.monotonic() - begin, random.Random(seed), 0
    while done < kills:
        done += faults.kill_after(rng.uniform(0.0, duration))


if __name__ == "__main__":
    sys.exit(main())
