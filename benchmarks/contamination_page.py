"""The module makes the study in docs/robust.md and its figure from results/contamination.json alone.

python -m benchmarks.contamination_page
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.contamination import METHODS, PLAIN, RESULTS, SNOOPING
from benchmarks.page import markdown

PAGE: Final = Path(__file__).parents[1] / "docs" / "robust.md"
FIGURE: Final = PAGE.parent / "robust.svg"
BEGIN: Final = "<!-- study: made by benchmarks.contamination_page -->"
END: Final = "<!-- end of the study -->"
#: A method withstands gross errors if its mean RMSE is at most this number times the mean RMSE of least
#: squares without gross errors.
LIMIT: Final = 1.2
CASES: Final = {
    "twin": "Image points of control points, SPOT-5 pair",
    "block": "Control and points of 4 rays or more, 20 images",
}
Entry = dict[str, Any]
Key = tuple[str, float, str]


def _of(entries: list[Entry]) -> dict[Key, Entry]:
    return {(e["case"], e["share"], e["method"]): e for e in entries}


def ratios(entries: list[Entry]) -> dict[Key, float]:
    """Return the mean RMSE divided by the mean RMSE of least squares on the clean blocks of the same seeds."""
    known = _of(entries)
    out = {}
    for (case, share, method), entry in known.items():
        clean = known["block" if case == "everywhere" else case, 0.0, PLAIN]
        reference = [rmse for seed, rmse in zip(clean["seed"], clean["rmse_m"], strict=True) if seed in entry["seed"]]
        out[case, share, method] = float(np.mean(entry["rmse_m"]) / np.mean(reference))
    return out


def _share(entry: Entry, part: str, whole: str) -> str:
    total = sum(entry[whole])
    return f"{100.0 * sum(entry[part]) / total:.1f} %" if total else "-"


def _method(method: str, entries: list[Entry]) -> str:
    """Return the name of a method, with its number of seeds if it did not run on all seeds."""
    most = max(len(e["seed"]) for e in entries)
    seeds = max((len(e["seed"]) for e in entries if e["method"] == method), default=0)
    return method if seeds == most else f"{method} ({seeds} seed{'s' if seeds > 1 else ''})"


def case_table(case: str, entries: list[Entry]) -> str:
    """Return the table of the ratios by share, and of the errors found at 20 %."""
    mine = [e for e in entries if e["case"] == case]
    known, found = _of(mine), ratios(entries)
    shares = sorted({e["share"] for e in mine})
    head = ["method", *(f"{100 * share:.0f} %" for share in shares), "missed at 20 %", "false alarms at 20 %"]
    rows = [head]
    for method in METHODS:
        cells = [f"{found[case, s, method]:.2f}" if (case, s, method) in found else "-" for s in shares]
        at = known.get((case, 0.2, method))
        if at is None and set(cells) == {"-"}:
            continue
        tail = ["-", "-"] if at is None else [_share(at, "missed", "checkable"), _share(at, "false", "good")]
        rows.append([_method(method, mine), *cells, *tail])
    return markdown(rows)


def everywhere_table(entries: list[Entry]) -> str:
    """Return the table of the case in which some errors are not checkable."""
    mine = [e for e in entries if e["case"] == "everywhere"]
    found = ratios(entries)
    rows = [["method", "RMSE", "missed of the checkable", "false alarms"]]
    rows += [
        [e["method"], f"{found['everywhere', e['share'], e['method']]:.2f}", _share(e, "missed", "checkable"),
         _share(e, "false", "good")]
        for e in mine
    ]  # fmt: skip
    return markdown(rows)


def _everywhere(entries: list[Entry]) -> list[str]:
    """Return the text about errors that are not checkable."""
    first = next(e for e in entries if e["case"] == "everywhere")
    no, yes = sum(first["not_checkable"]), sum(first["checkable"])
    return [
        "### Errors everywhere, 20 images",
        "20 % of the image points of all points except check points have gross errors, and 20 % of the control "
        f"coordinates. {no} of {no + yes} errors ({100.0 * no / (no + yes):.0f} %) are **not checkable**: they are in "
        "points with only two rays, or the residuals contain less than 4.13 sigmas of the error. No method can find "
        "these errors. They falsify their points with every method.",
        everywhere_table(entries),
    ]


def study(results: dict[str, Any]) -> str:
    """Return the text between the marks of the page."""
    entries = results["entries"]
    found, seeds = ratios(entries), results["head"]["seeds"]
    plain = {case: found[case, 0.2, PLAIN] for case in CASES}
    whole = {m for m in METHODS if all(len(e["seed"]) == seeds for e in entries if e["method"] == m)}
    keep = [m for m in METHODS if m in whole and all(found.get((c, 0.2, m), np.inf) <= LIMIT for c in CASES)]
    parts = [
        f"The tables show the mean RMSE of the check points over {seeds} seeds, divided by the mean RMSE of least "
        f"squares without gross errors. At 20 % least squares has {plain['twin']:.1f} and {plain['block']:.1f} times "
        "the clean RMSE. Of the methods that ran on all seeds, these have at most "
        f"{LIMIT} times the clean RMSE in both cases: {'; '.join(keep)}.",
        "![Check points under gross errors](robust.svg)",
    ]
    for case, title in CASES.items():
        parts += [f"### {title}", case_table(case, entries)]
    if any(e["case"] == "everywhere" for e in entries):
        parts += _everywhere(entries)
    return "\n\n".join(parts)


def with_study(text: str, results: dict[str, Any]) -> str:
    """Return the page with the study between its marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{study(results)}\n\n{END}{after}"


def figure(results: dict[str, Any], digest: str) -> None:
    """Draw the ratios by share, with one panel for each case."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "robust"
    from matplotlib import pyplot as plt

    drawn = (PLAIN, SNOOPING, "huber", "hampel", "tukey", "tukey, start least squares", "tukey, start LTS", "GNC, tls",
             "danish_original", "lad")  # fmt: skip
    found = ratios(results["entries"])
    panels, axes = plt.subplots(1, 2, figsize=(9.0, 4.4), sharey=True, layout="constrained")
    for axis, (case, title) in zip(axes, CASES.items(), strict=True):
        for k, method in enumerate(drawn):
            points = sorted((100.0 * s, r) for (c, s, m), r in found.items() if (c, m) == (case, method))
            if not points:
                continue
            axis.plot(*zip(*points, strict=True), marker="os*v^D<>Px"[k], markersize=4, linewidth=1, label=method)
        axis.axhline(LIMIT, color="grey", linewidth=0.8, linestyle="--")
        axis.set(title=title, xlabel="gross errors, %", yscale="log")
        axis.title.set_fontsize(9)
    axes[0].set_ylabel("RMSE of check points / clean")
    panels.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    panels.savefig(FIGURE, metadata={"Date": None, "Description": f"results {digest}"})
    plt.close(panels)


def main() -> None:
    """Write the page and the figure."""
    text = RESULTS.read_text("utf-8")
    results = json.loads(text)
    PAGE.write_text(with_study(PAGE.read_text("utf-8"), results), encoding="utf-8")
    figure(results, hashlib.sha256(text.encode()).hexdigest()[:16])
    sys.stdout.write(f"{PAGE}\n{FIGURE}\n")


if __name__ == "__main__":
    main()
