"""Command ``graph``: drawings of the factor graph of a project."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from fg_orient.cli.command import command
from fg_orient.cli.common import Overwrite, require_project
from fg_orient.cli.output import answer, say, table
from fg_orient.cli.progress import progress_bar
from fg_orient.model.options import Options, Reading


@command(Options, Reading)
def graph(
    project: Annotated[Path, typer.Argument(metavar="PROJECT.toml", help="Project file.", show_default=False)],
    options: Mapping[str, Any],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder; default: graph, beside the project file.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the factor graph of a project, its elimination tree and normal matrix; count variables, factors and fill.

    Nothing is adjusted. Large blocks are drawn in part, but counted whole. Options replace those of the project file.
    """
    require_project(project)
    from fg_orient.formats.project import read_project
    from fg_orient.report.graph import write_graph

    target = out or project.parent / "graph"
    with progress_bar("reading the project") as callback:
        record = write_graph(read_project(project, **options), target, overwrite=overwrite, progress=callback)
    answer(record, _show)


def _show(record: dict[str, Any]) -> None:
    """Print the counts of both graphs and of the elimination orders."""
    forms = [("explicit points", record["explicit"]), ("eliminated points", record["eliminated"])]
    rows = [(name, one["image_vectors"], one["points"], one["unknowns"], one["factors"]) for name, one in forms if one]
    table("factor graph", ("form", "image vectors", "points", "unknowns", "factors"), rows)
    part = "explicit points" if record["explicit_is_whole"] else "explicit points, the drawn part"
    orderings = [
        (name, one["nonzeros_normal_matrix"], one["fill"], one["cliques"], one["largest_clique_unknowns"])
        for name, one in record["orderings"].items()
    ]  # fmt: skip
    table(f"normal matrix, {part}", ("ordering", "elements", "fill", "cliques", "largest clique"), orderings)
    say(f"drawings: {record['out']} ({len(record['files'])} files)")
