"""The module makes the page docs/detection.md from results/detection.json and results/false_alarms.json alone.

python -m benchmarks.detection_page
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from scipy import stats

from benchmarks.detection import DRAWS, RESULTS
from benchmarks.detection import RUNS as ALL_RUNS
from benchmarks.false_alarms import KINDS
from benchmarks.false_alarms import RESULTS as ALARMS
from benchmarks.false_alarms import RUNS as ALL_ALARMS
from benchmarks.mistakes import BLOCKS, MISTAKES
from benchmarks.page import markdown
from fg_orient.orientation.confirmation import CAUSES
from fg_orient.quality.doubts import BUDGET

PAGE: Final = Path(__file__).parents[1] / "docs" / "detection.md"
#: The first power counts as certain; at the second one the mistake cannot be seen. Then the
#: least shares of runs with a doubt and of right names.
CERTAIN, UNSEEN, WANTED, NAMED = 0.99, 0.2, 0.95, 0.8
#: One run takes this measured processor time, s.
RUN_S: Final = 0.14
#: A cell or a kind deviates by chance with this probability; for the whole table it is 1 %.
TABLE: Final = 0.01
Record = dict[str, Any]


def seen(record: Record) -> int:
    """Return the number of runs that end with a doubt or worse."""
    return sum(code != 0 for code in record["codes"])


def deviates(record: Record, level: float) -> bool:
    """Return whether the number of runs with a doubt contradicts the prediction, which also comes from random draws."""
    n, k, p = len(record["codes"]), seen(record), record["predicted"]
    spread = 3.0 * (max(p * (1.0 - p), 1.0 / DRAWS) / DRAWS) ** 0.5
    low, high = max(p - spread, 0.0), min(p + spread, 1.0)
    return bool(stats.binom.cdf(k, n, low) < 0.5 * level or stats.binom.sf(k - 1, n, high) < 0.5 * level)


def right_names(record: Record) -> tuple[int, int]:
    """Return the number of runs that name the mistake or its class first, and the number of runs with a doubt."""
    doubted = [named for code, named in zip(record["codes"], record["named"], strict=True) if code != 0]
    return sum(doubted), len(doubted)


def shown(record: Record | None) -> str:
    """Return the text of one cell of the table: predicted, measured, named."""
    if record is None or not record["codes"]:
        return "-"
    n, k, p = len(record["codes"]), seen(record), record["predicted"]
    right, doubted = right_names(record)
    name = f", named {right}" if doubted and MISTAKES[record["mistake"]].named else ""
    unseen = " (not seen)" if p < UNSEEN else ""
    return f"{p:.2f}: {k}/{n}{name}{unseen}"


def rows_of(records: dict[tuple[str, int, int], Record]) -> Iterator[list[str]]:
    """Return the rows of the table, one for each mistake and size."""
    for m, mistake in enumerate(MISTAKES):
        for size, value in enumerate(mistake.sizes):
            words = f"{value:g}" if isinstance(value, float) else str(value)
            if mistake.unit.startswith("of "):
                words = f"{100 * float(value):.0f} %"
            unit = mistake.unit
            yield [mistake.what if size == 0 else "", f"{words} {unit}".strip(),
                   *(shown(records.get((block, m, size))) for block in BLOCKS)]  # fmt: skip


def misses(records: list[Record]) -> list[str]:
    """Return texts about the cells that do not meet the requirement."""
    out = []
    for r in records:
        n, k, mistake = len(r["codes"]), seen(r), MISTAKES[r["mistake"]]
        if n and deviates(r, TABLE / len(records)):
            value = mistake.sizes[r["size"]]
            out.append(f"- {mistake.what}, {value} {mistake.unit}, {r['block']}: {k} of {n}, predicted "
                       f"{r['predicted']:.3f}")  # fmt: skip
    return out


def badly_named(records: list[Record]) -> list[str]:
    """Return the cells with a doubt in most runs, of which fewer than 80 % name the mistake or its class first."""
    out = []
    for r in records:
        right, doubted = right_names(r)
        mistake = MISTAKES[r["mistake"]]
        if mistake.named and r["predicted"] >= CERTAIN and doubted and right < NAMED * doubted:
            first = Counter(t for t, code in zip(r["texts"], r["codes"], strict=True) if code).most_common(1)[0][0]
            value = mistake.sizes[r["size"]]
            out.append([mistake.what, f"{value} {mistake.unit}".strip(), r["block"], f"{right}/{doubted}", first[:90]])
    return [] if not out else [markdown([["mistake", "size", "block", "named", "named first instead"], *out])]


def summary(records: list[Record]) -> list[str]:
    """Return the text with the counts over the table."""
    done = [r for r in records if r["codes"]]
    certain = [r for r in done if r["predicted"] >= CERTAIN]
    unseen = [r for r in done if r["predicted"] < UNSEEN]
    between = [r for r in done if UNSEEN <= r["predicted"] < CERTAIN]
    often = sum(seen(r) >= WANTED * len(r["codes"]) for r in certain)
    wanted = [r for r in certain if MISTAKES[r["mistake"]].named and right_names(r)[1]]
    good = sum(right_names(r)[0] >= NAMED * right_names(r)[1] for r in wanted)
    strange = misses(done)

    def runs(some: list[Record]) -> int:
        return sum(len(r["codes"]) for r in some)

    def expected(some: list[Record]) -> float:
        return sum(r["predicted"] * len(r["codes"]) for r in some)

    def away(some: list[Record]) -> float:
        """Return the number found minus the predicted number, in standard deviations of the difference."""
        spread = sum(
            p * (1.0 - p) * n * (1.0 + n / DRAWS) for p, n in ((r["predicted"], len(r["codes"])) for r in some)
        )
        return (sum(map(seen, some)) - expected(some)) / max(spread, 1e-9) ** 0.5

    return [
        f"- In {len(certain)} cells the predicted power is at least {CERTAIN}. Of their {runs(certain)} runs "
        f"{sum(map(seen, certain))} end with a doubt or worse. In {often} of these cells at least {100 * WANTED:.0f} % "
        "of the runs do so.",
        f"- In {len(between)} cells the power is between {UNSEEN} and {CERTAIN}. A doubt is predicted in "
        f"{expected(between):.0f} of {runs(between)} runs and was found in {sum(map(seen, between))} "
        f"({away(between):+.1f} standard deviations).",
        f"- In {len(unseen)} cells the power is below {UNSEEN}, and the mistake cannot be seen. A doubt is predicted "
        f"in {expected(unseen):.0f} of {runs(unseen)} runs and was found in {sum(map(seen, unseen))} "
        f"({away(unseen):+.1f} standard deviations). The linear prediction is slightly low. "
        "[Likely causes](causes.md#what-cannot-be-seen-here) states the assumptions.",
        f"- A further count concerns the {len(wanted)} cells with a power of at least {CERTAIN} and a cause in the "
        f"list. Of these {good} name the mistake or its class first in at least {100 * NAMED:.0f} % of the doubts.",
        f"- {len(strange)} cells contradict their prediction at the level of {100 * TABLE:g} % over the table.",
        *strange,
    ]


def alarm_rows(kinds: dict[str, Any]) -> Iterator[list[str]]:
    """Return the rows of the false alarms, one for each kind."""
    for name, kind in KINDS.items():
        record = kinds.get(name, {"runs": 0, "alarms": {}})
        codes = [code.partition(".")[2] for found in record["alarms"].values() for code in sorted(set(found))]
        n, k = record["runs"], len(record["alarms"])
        upper = stats.beta.ppf(0.95, k + 1, n - k) if n else float("nan")
        counts = Counter(c for c in codes if f"verdict.{c}" not in CAUSES)
        words = ", ".join(
            f"`{c}` {number}" for c, number in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        )
        yield [kind.what, str(n), str(k), f"{100.0 * k / max(n, 1):.2f} %", f"{100.0 * upper:.2f} %", words or "-"]


def budget_rows(kinds: dict[str, Any]) -> Iterator[list[str]]:
    """Return the rows of the doubts: share, most runs expected, runs found, probability of this number."""
    n = sum(r["runs"] for r in kinds.values())
    found = Counter(c.partition(".")[2] for r in kinds.values() for codes in r["alarms"].values() for c in set(codes))
    for code, share in BUDGET.items():
        k = found[code]
        yield [
            f"`{code}`",
            f"{100.0 * share:g} %",
            f"{share * n:.1f}",
            str(k),
            f"{stats.binom.sf(k - 1, n, share):.2g}",
        ]


def page(detection: Record, alarms: Record) -> str:
    """Return the text of the page."""
    records = detection["cells"]
    by_key = {(r["block"], r["mistake"], r["size"]): r for r in records}
    runs = [len(r["codes"]) for r in records]
    kinds = alarms["kinds"]
    cells, done = 3 * len(BLOCKS) * len(MISTAKES), sum(runs)
    least, most = (min(runs), max(runs)) if runs else (0, 0)
    hours = RUN_S * cells * ALL_RUNS / 3600.0
    total, clean = sum(r["runs"] for r in kinds.values()), sum(r["seconds"] for r in kinds.values())
    found = [codes for r in kinds.values() for codes in r["alarms"].values()]
    caused = sum(any(c in CAUSES for c in codes) for codes in found)
    found = [codes for r in kinds.values() for codes in r["alarms"].values()]
    caused = sum(any(c in CAUSES for c in codes) for codes in found)
    parts = [
        "# Detection and false alarms",
        "<!-- Made by `python -m benchmarks.detection_page`. Do not edit. -->",
        "Do mistakes in data end with exit code 4, and are they named? Do perfect data end with exit code 0?",
        "## Detection of mistakes",
        f"{len(MISTAKES)} kinds of mistakes were planted, each in three sizes and in three blocks. This gives {cells} "
        "cells. Blocks, mistakes and sizes (`benchmarks/mistakes.py`) were chosen before the first run. A run draws "
        "orientation, image points and ground coordinates of a perfect block from the sigmas of the adjustment, plants "
        f"the mistake, and adjusts with default options. **{least if least == most else f'{least} to {most}'} runs of "
        f"each cell** were made, {done} adjustments. `python -m benchmarks.detection --workers N` makes only the runs "
        f"that are missing. All {ALL_RUNS} runs of each cell take about {hours:.1f} hours of processor time.",
        markdown([["block", "contents"], *([name, words] for name, words in BLOCKS.items())]),
        "The predicted power is the share of draws with one of the doubts of the [verdict](verdict.md). Separate code "
        f"(`benchmarks/linear_doubts.py`) computes these doubts from {DRAWS} draws in the linear model at the truth. "
        "The residuals are $-R (e + \\delta)$, where $\\delta$ is the error that the mistake makes in the "
        "observations. The power depends on the non-centrality $\\delta^T R\\, \\delta$ and on its shares in the "
        "single tests.",
        "A cell shows the predicted power and the runs that end with exit code 4 or worse. It also shows in how many "
        "of these runs the mistake, or a cause of the same class, is named first. The data cannot distinguish the "
        "causes of a class. The classes are:",
        "- heights of control points that are too low, and heights of check points that are too high;\n"
        "- a shift of the control points, and the opposite shift of the check points;\n"
        "- feet and US survey feet.",
        "Whether a mistake is doubted does not depend on the search for causes. First runs showed mistakes that the "
        "search did not name (a part of a table, radians). The search was extended for these mistakes, and the runs "
        "were repeated with the same random numbers. The counts of right names therefore come from the data for which "
        "the search was extended.",
        "### Summary",
        "\n".join(summary(records)),
        "### Table",
        markdown([["mistake", "size", *BLOCKS], *rows_of(by_key)]),
        "### Not named first",
        f"The table lists the cells with a power of at least {CERTAIN} in which another cause or doubt comes first in "
        "more than a fifth of the doubts. If only a share of a table is wrong, no cause of the list explains the whole "
        "table.",
        *badly_named(records),
        "## False alarms",
        f"Perfect blocks of ten kinds were adjusted, {total} runs in all. The runs took {clean / 60.0:.0f} minutes on "
        f"a machine with other work. `python -m benchmarks.false_alarms` completes the {ALL_ALARMS} runs of each "
        "kind: it makes only the missing runs. Exit code 4 is allowed in 2 % of the runs of each kind; the shares of "
        'all doubts add up to 0.65 %. "At most" is the upper limit of the share: with a larger share only 5 % of such '
        "studies would find so few alarms.",
        markdown([["kind", "runs", "exit 4", "share", "at most", "doubts"], *alarm_rows(kinds)]),
        "The next table compares the runs with each doubt, over all kinds, with the share of the doubt. The last "
        "column is the probability of at least this number of runs if the share is correct. `check_far` and "
        "`check_beyond` need check points, and `beyond_prior` needs priors.",
        markdown([["doubt", "share", "expected at most", "found", "probability"], *budget_rows(kinds)]),
        f"A cause was named in {caused} of these {len(found)} false alarms.",
    ]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Write the page."""
    texts = (json.loads(path.read_text("utf-8")) for path in (RESULTS, ALARMS))
    PAGE.write_text(page(*texts), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")


if __name__ == "__main__":
    main()
