"""``python -m tests.golden keep FOLDER [CASE ...]`` and ``python -m tests.golden compare BEFORE AFTER``."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from fnmatch import fnmatchcase
from pathlib import Path

from .compare import Signs, compare
from .keep import fresh, keep


def main() -> int:
    """Keep the outputs or compare them; return 0 if nothing differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    actions = parser.add_subparsers(dest="action", required=True)
    kept = actions.add_parser("keep", help="run the cases and keep what they give")
    kept.add_argument("folder", type=Path)
    kept.add_argument("cases", nargs="*", default=["*"], help="patterns of names; default: all")
    kept.add_argument("--overwrite", action="store_true")
    held = actions.add_parser("compare", help="compare two folders")
    held.add_argument("before", type=Path)
    held.add_argument("after", type=Path)
    held.add_argument("--within", type=float, default=0.0, help="relative to the largest value of a column; default 0")
    held.add_argument(
        "--signs",
        type=Path,
        help="lines of case, file, column (patterns) and what changes on purpose: turns, amount, redrawn",
    )
    held.add_argument("--shown", type=int, default=40, help="differences that are printed")
    given = parser.parse_args()
    if given.action == "keep":
        fresh(given.folder, given.overwrite)
        done = keep(
            given.folder.resolve(), lambda name: any(fnmatchcase(name, p) for p in given.cases),
            lambda name: print(name, file=sys.stderr, flush=True),
        )  # fmt: skip
        print(f"{done} cases kept in {given.folder}")
        return 0
    found = list(compare(given.before, given.after, given.within, Signs.read(given.signs)))
    for difference in found[: given.shown]:
        print(difference)
    files = Counter((difference.case, difference.file) for difference in found)
    print(f"{len(found)} values in {len(files)} files differ")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
