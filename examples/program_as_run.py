"""Departures of the authors' program from the published equations: the computation behind docs/program-as-run.md.

    python examples/program_as_run.py [--seed N] [--only D2,D5] [--out FOLDER]

The script switches each departure on alone and off alone in the computation of a synthetic block. It prints the changes
and, with ``--out``, draws them (this needs matplotlib).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fg_orient.adjustment.linear.system import diagnose
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.studies.claims import AS_RUN_TWIN, Study
from fg_orient.studies.switches import NUMBERED, PROGRAM, TEXT, Switches, label, names
from fg_orient.studies.tables_spot5 import norm_condition
from fg_orient.studies.two_stage import TwoStage
from fg_orient.studies.two_stage_results import AxisErrors

SOLVER = "gauss_inverse"
PSEUDO_INVERSE = "moore_penrose_inverse"
#: EOP sets whose type-2 bundle is measured.
BUNDLES = (1, 14, 15, 16, 18, 19)
#: Words and unit of each measure.
MEASURES = {
    "uncorrected": ("control points without corrections", "m"),
    "step_1": ("control points after step 1", "m"),
    "step_1_check": ("check points after step 1", "m"),
    "w_rms": ("misclosures of step 2, rms", "rad"),
    "dp_1": ("largest correction of step 2, set 1", "m"),
    **{f"bundle_{k}": (f"control points after the type-2 bundle, set {k}", "m") for k in BUNDLES},
    "cured_13": ("control points after the type-2 bundle, set 13, Moore-Penrose", "m"),
    "check_1": ("check points after the type-2 bundle, set 1", "m"),
    "rank_a_5": ("rank of A, set 5 (9 unknowns)", ""),
    "rank_a_13": ("rank of A, set 13 (18 unknowns)", ""),
    "rank_n_1": ("rank of N, set 1 (9 unknowns)", ""),
    "cond_1": ("|N| |N^-1|, set 1", ""),
    "cond_15": ("|N| |N^-1|, set 15", ""),
    "cond_19": ("|N| |N^-1|, set 19", ""),
    "iterations_19": ("iterations of step 2, set 19, misclosures of 1e-8 rad", ""),
}
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


def effects(seed: int, chosen: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Measure the equations, the program, and both with each switch changed, on the synthetic block of a seed.

    The keys are "text", "program", "text + NAME" and "program - NAME"; the values are the numbers that
    MEASURES names. The block has radial velocity and attitude.
    """
    procedures = {"text": TEXT, "program": PROGRAM}
    procedures |= {f"text + {name}": TEXT.with_(name) for name in chosen}
    procedures |= {f"program - {name}": PROGRAM.without(name) for name in chosen}
    return {name: measure(seed, which) for name, which in procedures.items()}


def measure(seed: int, switches: Switches) -> dict[str, float]:
    """Values of MEASURES; nan where the solver breaks down. Errors are 3-D RMSE."""
    with one_blas_thread():  # rounding noise is a part of the measures
        run = Study(seed, switches, AS_RUN_TWIN).two_stage
        step_1 = run.look_only()
        first = run.pre_adjust(0, 1, SOLVER)
        _, w = first.system.require_design("w")
        out = {
            "uncorrected": length(run.uncorrected().gcp_rmse), "step_1": length(step_1.gcp_rmse),
            "step_1_check": length(step_1.icp_rmse), "w_rms": float(np.sqrt(np.mean(w**2))),
            "dp_1": float(np.abs(first.dP).max()),
        }  # fmt: skip
        errors = {number: bundle(run, number) for number in BUNDLES}
        out["cured_13"] = length(bundle(run, 13, PSEUDO_INVERSE).gcp_rmse)
        out |= {f"bundle_{number}": length(error.gcp_rmse) for number, error in errors.items()}
        out["check_1"] = length(errors[1].icp_rmse)
        out |= {f"rank_a_{number}": float(np.linalg.matrix_rank(design_of(run, number))) for number in (5, 13)}
        out["rank_n_1"] = float(diagnose(first.system).rank)
        out |= {
            f"cond_{number}": norm_condition(run.pre_adjust(0, number, SOLVER).system, SOLVER) for number in (1, 15, 19)
        }
        out["iterations_19"] = float(run.pre_adjust(0, 19, SOLVER, polynomial_misclosures=True).repeats)
    return {name: out[name] for name in MEASURES}


def bundle(run: TwoStage, number: int, solver: str = SOLVER) -> AxisErrors:
    """Errors of the type-2 bundle."""
    return run.bundle(number, 2, solver).accuracy


def design_of(run: TwoStage, number: int) -> np.ndarray:
    """A of step 2, left image."""
    return run.pre_adjust(0, number, PSEUDO_INVERSE).system.require_design("A")[0]


def length(rmse: np.ndarray) -> float:
    """RMSE in space, from its three axes."""
    return float(np.linalg.norm(rmse))


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
