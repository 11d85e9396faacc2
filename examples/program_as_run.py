"""Departures of the authors' program from the published equations: the computation behind docs/program-as-run.md.

    python examples/program_as_run.py [--seed N] [--only D2,D5] [--out FOLDER]

The script switches each departure on alone and off alone in the computation of a synthetic block. It prints the changes
and, with ``--out``, draws them (this needs matplotlib).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fg_orient.studies.switch_effects import MEASURES, effects
from fg_orient.studies.switches import NUMBERED, label, names

#: Measures in the figure, with the titles of their panels.
PANELS = {
    "step_1": "control points after step 1, m", "bundle_15": "type-2 bundle, set 15, m",
    "bundle_14": "type-2 bundle, set 14, m", "cond_1": "|N| |N$^{-1}$|, set 1",
}  # fmt: skip
#: Relative changes up to this value are not reported.
SAME = 0.005
BLUE, RED = "#0072b2", "#d55e00"


def main() -> None:
    """Print the values; draw a figure with ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="labels of switches, with commas")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    chosen = names(arguments.only.split(",")) if arguments.only else names()
    found = effects(arguments.seed, chosen)
    show(found, chosen)
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        draw(arguments.out / "program-as-run.svg", found, chosen)
        print(f"figure: {arguments.out / 'program-as-run.svg'}")


def show(found: dict[str, dict[str, float]], chosen: tuple[str, ...]) -> None:
    """Print the measures of equations and program, and the changes by each switch."""
    text, program = found["text"], found["program"]
    for name, (words, unit) in MEASURES.items():
        print(f"{words}: equations {shown(text[name])}, program {shown(program[name])} {unit}".rstrip())
    for switch in chosen:
        print(shown_name(switch))
        for title, before, after in (
            ("on alone", text, found[f"text + {switch}"]), ("off alone", program, found[f"program - {switch}"]),
        ):  # fmt: skip
            changed = [
                f"{MEASURES[name][0]} {shown(before[name])} -> {shown(after[name])}"
                for name in MEASURES
                if differs(before[name], after[name])
            ]
            print(f"  {title}: {'; '.join(changed) or 'no change'}")


def differs(before: float, after: float) -> bool:
    """Return True if a measure has changed; values up to 1e-9 are rounding errors."""
    if np.isnan(before) or np.isnan(after):
        return np.isnan(before) != np.isnan(after)
    return abs(after - before) > SAME * abs(before) and max(before, after) > 1e-9


def shown_name(switch: str) -> str:
    """Label and name: "D2 midpoint", "short axis"."""
    words = switch.replace("_", " ")
    return f"{label(switch)} {words}" if switch in NUMBERED else words


def shown(value: float) -> str:
    return "no solution" if np.isnan(value) else f"{value:.3g}"


def draw(path: Path, found: dict[str, dict[str, float]], chosen: tuple[str, ...]) -> None:
    """One panel for each measure, one row for each switch, logarithmic."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "fg_orient", "font.size": 9})
    figure, panels = plt.subplots(1, len(PANELS), figsize=(10.0, 4.6), sharey=True, layout="constrained")
    place = np.arange(len(chosen))[::-1]
    for axes, (name, title) in zip(panels, PANELS.items(), strict=True):
        axes.axvline(found["text"][name], color=BLUE, lw=1.0, ls="--")
        axes.axvline(found["program"][name], color=RED, lw=1.0)
        axes.plot([found[f"text + {s}"][name] for s in chosen], place, "o", color=BLUE, mfc="white", ms=6,
                  label="equations, this one on")  # fmt: skip
        axes.plot([found[f"program - {s}"][name] for s in chosen], place, "D", color=RED, ms=4,
                  label="program, this one off")  # fmt: skip
        axes.set_xscale("log")
        axes.set_title(title, fontsize=9)
        axes.grid(axis="y", lw=0.3)
    panels[0].set_yticks(place, [shown_name(switch) for switch in chosen])
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, ncols=2, loc="outside lower center")
    figure.suptitle("Each departure alone: dashed line the equations, solid line the program", fontsize=10)
    figure.savefig(path, metadata={"Date": None, "Creator": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
