"""Command ``reduce``: which unknowns of the images are significant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.common import Debug, Json, Log, Quiet, number, outcome, require_project, table
from fg_orient.cli.options import flags, named_as_typed, with_options
from fg_orient.cli.output import emit, say
from fg_orient.cli.progress import progress_bar
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options

if TYPE_CHECKING:
    from fg_orient.orientation.reduction import Reduction


@with_options(Options, only=("eop_set", "look_polynomial", "priors", "rpc_compensation"))
def reduce(
    project: Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="Project file.", show_default=False)],
    options: Mapping[str, Any],
    direction: Annotated[
        str, typer.Option(metavar="backward|forward", help="Drop from the whole set, or add to the best coefficient.")
    ] = "backward",
    level: Annotated[float, typer.Option(metavar="P", help="Probability of a false choice in one step.")] = 0.05,
    cross_validation: Annotated[
        str | None,
        typer.Option(metavar="loo|K", help="Predict control points left out: one at a time, or in K parts."),
    ] = None,
    quiet: Quiet = False,
    log: Log = None,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Reduce the unknowns of the images one at a time by F tests; AIC, AICc, BIC and prediction errors beside it."""
    with outcome(as_json, debug, quiet, log):
        folds = _folds(cross_validation)
        require_project(project)
        from fg_orient.formats.project import read_project
        from fg_orient.orientation.reduction import reduce_unknowns

        with named_as_typed(flags(Options)):
            block = read_project(project, **options)
        if direction not in ("backward", "forward"):
            raise InputError.of("options.value", option="direction", value=direction, expected="backward or forward")
        with progress_bar("adjusting") as callback:
            with named_as_typed({"folds": "--cross-validation", "level": "--level"}):
                found = reduce_unknowns(
                    block, direction="backward" if direction == "backward" else "forward", level=level, folds=folds,
                    progress=callback,
                )  # fmt: skip
        if as_json:
            emit({"name": block.name, **found.as_dict()})
        else:
            show(found)


def _folds(text: str | None) -> int | None:
    """Number of parts; 0: leave one out; None: no cross-validation."""
    if text is None or text == "loo":
        return None if text is None else 0
    if text.isdecimal() and int(text) >= 2:
        return int(text)
    raise InputError.of("options.value", option="cross_validation", value=text, expected="loo or a number from 2")


def show(found: Reduction) -> None:
    """Print one line per model, what is left and which set it comes closest to."""
    first = found.steps[0]
    columns = ["step", "u", "p", "sigma0", "AIC", "AICc", "BIC"]
    columns += ["image px", "ground m"] if first.validation else []
    sign, rows = "-" if found.direction == "backward" else "+", []
    for step in found.steps:
        c, v = step.criteria, step.validation
        row = [f"{sign} {step.changed}" if step.changed else "all", len(step.unknowns),
               number(step.test.probability if step.test else None), number(c.sigma0), number(c.aic, 1),
               number(c.aicc, 1), number(c.bic, 1)]  # fmt: skip
        rows.append(row + ([number(v.image_rms), number(v.ground_rms)] if v else []))
    table(f"{found.direction} reduction at a level of {found.level:g} per step", columns, rows)
    for test in found.steps[-1].tests[::-1]:
        say(f"{test.group}: F = {test.statistic:.1f}, p = {test.probability:.2g}")
    names = ", ".join(f'"{name}"' for name in found.unknowns)
    say(f"significant: image_unknowns = [{names}]")
    closest = found.closest_set
    if closest is not None:
        from fg_orient.model.parameters import EOP_SETS

        number_, less, more = closest
        differences = [*(f"without {name}" for name in less), *(f"with {name}" for name in more)]
        say(
            f"closest EOP set: {number_} {EOP_SETS[number_][0]}"
            + (f", {', '.join(differences)}" if differences else "")
        )
    for criterion, words in (("aic", "AIC"), ("aicc", "AICc"), ("bic", "BIC"), *(
        (("image", "prediction in the image"), ("ground", "prediction on the ground")) if first.validation else ()
    )):  # fmt: skip
        say(f"best by {words}: {', '.join(found.best(criterion).unknowns)}")
