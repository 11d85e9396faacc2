"""Writing calls of commands fail in turn; figures and failures are printed as JSON.

``python -m tests.faults --command adjust --errors ENOSPC,EIO,EROFS,KILL`` lets every call of ``adjust`` fail by each
error; ``--most N`` takes a sample of the calls. ``--kills N`` kills the command at random times instead, and
``--writers`` runs a second one with the same output before each call.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from tests.faults.harness import ERRORS
from tests.faults.scenarios import SCENARIOS, made
from tests.faults.trials import Faults, sample


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--command", choices=sorted(SCENARIOS), action="append")
    parser.add_argument("--errors", default=",".join(ERRORS))
    parser.add_argument("--sticky", action="store_true", help="all later calls fail, too")
    parser.add_argument("--in-turn", action="store_true", help="one of the errors for each call")
    parser.add_argument("--most", type=int, help="largest number of calls, at random")
    parser.add_argument("--alike", type=int, help="of calls of one kind for a file: this number, then each fifth")
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--writers", action="store_true", help="a second writer runs before each call")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    reports = []
    for name in given.command or SCENARIOS:
        with tempfile.TemporaryDirectory(prefix="faults-") as folder:
            begin = time.monotonic()
            faults = Faults(made(name, Path(folder).resolve()), Path(folder).resolve())
            chosen = sample(faults.good, given.most, given.seed, alike=given.alike)
            faults.report.tried = len(chosen)
            if given.kills:
                faults.kill_at_random_times(given.kills, given.seed)
            elif given.writers:
                faults.two_writers(chosen, overwrite=False)
                faults.two_writers(chosen, overwrite=True)
            else:
                errors = given.errors.split(",")
                for k, error in enumerate(errors):
                    for nth in chosen[k :: len(errors)] if given.in_turn else chosen:
                        faults.fail(nth, error, sticky=given.sticky)
            reports.append(asdict(faults.report) | {"seconds": time.monotonic() - begin})
            print(json.dumps(reports[-1]), file=sys.stderr, flush=True)
    print(json.dumps(reports))
    return int(any(report["failures"] for report in reports))


if __name__ == "__main__":
    sys.exit(main())
