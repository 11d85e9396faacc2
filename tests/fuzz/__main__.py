"""``python -m tests.fuzz --minutes N --reader NAME --seed S``: change files until the time is over; a line per reader.

Each reader runs in a process of its own: a reader that hangs, or dies, is found, too. So is one that refuses the files
it begins with. What is found is written to the folder ``--keep``.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from tests.fuzz.harness import Session
from tests.fuzz.readers import READERS

#: A process without a finished case for these seconds is ended, because code in C does not notice the alarm.
STUCK: Final = 150.0
#: Least number of cases of a reader, and the exit code of a reader that refuses its first files.
FEWEST: Final = 20
REFUSED: Final = 5


def _child(name: str, seed: int, cases: int, share: float, keep: Path, pulse: Path) -> None:
    """Run the cases of a reader and write its figures; imports and compilation do not count in its share, seconds."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        session = Session(READERS[name], Path(folder, "files"), seed, keep, guided=True)
        first = session.begin()
        if first:
            print(f"{name}: the files themselves: {first}", file=sys.stderr)
        count, until = 0, time.time() + share
        while count < cases and (count < FEWEST or time.time() < until):
            session.case()
            count += 1
            if count % 20 == 0:
                pulse.write_text(json.dumps({**_figures(session), "spent": time.time() - until + share}), "utf-8")
        pulse.write_text(json.dumps({**_figures(session), "spent": time.time() - until + share}), "utf-8")
        session.close()
        if first:
            os._exit(REFUSED)


def _figures(session: Session) -> dict[str, object]:
    tally = session.tally
    return {"cases": tally.cases, "read": tally.read, "refused": sum(tally.codes.values()), "codes": len(tally.codes),
            "new": tally.grown, "broken": tally.broken_cases, "kinds": sorted(tally.broken)}  # fmt: skip


def _watched(name: str, seed: int, cases: int, share: float, keep: Path) -> dict[str, object]:
    """Run a reader in a process; start it again after a case at which it hangs or dies."""
    total: dict[str, object] = {}
    for attempt in range(20):
        pulse = keep / f"{name}.figures"
        pulse.write_text("{}", "utf-8")
        now = keep / f"{name}.now"
        now.unlink(missing_ok=True)
        left = cases - int(str(total.get("cases", 0)))
        pid = os.fork()
        if pid == 0:
            try:
                _child(name, seed + 1000 * attempt, left, share, keep, pulse)
            except BaseException as error:
                import traceback

                traceback.print_exception(error)
                os._exit(1)
            os._exit(0)
        stuck = _wait(pid, now)
        figures = json.loads(pulse.read_text("utf-8"))
        share -= figures.pop("spent", share if stuck else 0.0)
        total = _sum(total, figures)
        pulse.unlink()
        if not stuck:
            now.unlink(missing_ok=True)
            return total
        total["broken"] = int(str(total.get("broken", 0))) + 1
        total["kinds"] = [*list(total.get("kinds", [])), stuck]  # type: ignore[call-overload]
        if stuck == "refused":
            return total
        if now.exists():
            now.rename(keep / f"{name}-{stuck}-{seed + 1000 * attempt}.bin")
    return total


def _wait(pid: int, now: Path) -> str:
    """Wait for a process; return "" if it ended well, else a word for its end."""
    last = time.time()
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return {0: "", REFUSED: "refused"}.get(os.waitstatus_to_exitcode(status), f"died{status}")
        if now.exists():
            last = max(last, now.stat().st_mtime)
        if time.time() - last > STUCK:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return "stuck"
        time.sleep(0.05)


def _sum(one: dict[str, object], other: dict[str, object]) -> dict[str, object]:
    if not one:
        return other
    return {key: one[key] + other[key] if key != "codes" else max(one[key], other[key])  # type: ignore[operator, type-var]
            for key in one if key in other}  # fmt: skip


def main() -> int:
    """Run the readers one after the other; 1 if anything is broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0, help="in all")
    parser.add_argument("--reader", action="append", choices=sorted(READERS), help="default: all")
    parser.add_argument("--cases", type=int, default=10**9, help="most cases of a reader")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-found"), help="folder of what is found")
    given = parser.parse_args()
    names = given.reader or sorted(READERS)
    given.keep.mkdir(parents=True, exist_ok=True)
    end, broken = time.time() + 60.0 * given.minutes, 0
    for k, name in enumerate(names):
        begin = time.time()
        share = max(end - begin, 0.0) / (len(names) - k)
        figures = _watched(name, given.seed, given.cases, share, given.keep)
        broken += int(str(figures.get("broken", 0)))
        print(json.dumps({"reader": name, "seconds": round(time.time() - begin, 1), **figures}), flush=True)
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
