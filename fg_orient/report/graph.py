"""Drawings of the factor graph of a block, of its elimination trees and of its normal matrix."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.graph_structure import (
    ORDERINGS,
    EliminationTree,
    Structure,
    explicit_structure,
    reduced_structure,
)
from fg_orient.adjustment.native import with_observations
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.solve import EXPLICIT_LIMIT, eliminates_points
from fg_orient.formats.atomic import Contents, require_free
from fg_orient.model.block import Block
from fg_orient.model.names import Progress
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.quality.free_network import without_priors
from fg_orient.quality.regularisation import with_regularisation
from fg_orient.report.chart import Axis, Chart, cut
from fg_orient.report.figures import CAPTIONS_FILE, draw_figures, require_matplotlib
from fg_orient.report.words import printable

RECORD_FILE: Final = "graph.json"
#: Content of a folder of drawings.
GRAPH: Final = Contents(RECORD_FILE, (RECORD_FILE, CAPTIONS_FILE, "*.svg", "*.pdf"))
#: Maximum numbers of images and ground points of the drawn part, and of image vectors in the graph of images.
IMAGES, POINTS, VECTORS = 6, 24, 40
#: Maximum number of cliques of a tree, and of groups of points, that are labelled.
NAMED: Final = 12
#: Order of elimination of the graph of images, as in an adjustment.
REDUCED_ORDERING: Final = "COLAMD"
CAPTIONS: Final = {
    "graph": "Factor graph with explicit points. Squares: vectors of image unknowns; circles: ground points; dots: "
             "factors, each joined to its variables. A dot between a square and a circle is an image point, below a "
             "circle a control point, above a square a prior.",
    "reduced": "The same block with eliminated points, as the graph backend solves it. Squares: vectors of image "
               "unknowns; large dots: factors that hold a group of ground points with all their rays; small dots: "
               "priors and other factors. Circles, if any: ground points that an extra observation names.",
    "tree": "Elimination (Bayes) tree. Each node is a clique: variables that are eliminated together, given the "
            "variables of the nodes above. Squares contain image unknowns, circles only ground points.",
    "matrix": "Blocks of the factor R of the normal matrix in three elimination orders, and of the matrix of the graph "
              "of images. Blue: blocks of the normal matrix; orange: fill, blocks that only the factor has.",
}  # fmt: skip


@dataclass(frozen=True)
class Drawn:
    """Structures of a block: the drawn part with explicit points, the whole block, and the images alone.

    Parameters
    ----------
    part : Structure
    whole : Structure or None
        Of all image points; None above the limit.
    reduced : Structure or None
        None where points cannot be eliminated.
    """

    part: Structure
    whole: Structure | None
    reduced: Structure | None


def write_graph(
    block: Block, out: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Draw the factor graph of a block into a folder.

    Parameters
    ----------
    block : Block
    out : path
        Folder of the SVG and PDF files, ``captions.md`` and ``graph.json``.
    overwrite : bool
        Whether an existing folder of drawings is replaced.
    progress : callable, optional
        Called with the number of drawings done, the number of all, and "figures".

    Returns
    -------
    dict
        Content of ``graph.json``, and "out" and "files".

    Raises
    ------
    InputError
        The block cannot be compiled, matplotlib is missing, or the output may not be written.
    """
    require_matplotlib()
    target = Path(out)
    require_free(target, overwrite=overwrite, contents=GRAPH)
    inner = block.options.datum == "inner"
    problem = with_regularisation(compiled_problem(with_observations(without_priors(block) if inner else block)))
    drawn = structures(problem)
    charts: dict[str, Callable[[], Sequence[Chart | None]]] = {
        "graph": lambda: [graph_chart(drawn.part)],
        "reduced": lambda: [reduced_chart(drawn.reduced) if drawn.reduced else None],
        "tree": lambda: _trees(drawn),
        "matrix": lambda: _matrices(drawn),
    }
    record = {"name": block.name, **counts(drawn)}
    text = json.dumps(record, indent=1, ensure_ascii=False) + "\n"
    _, files = draw_figures(
        charts, lambda shown: _captions(block.name, drawn, shown), target, overwrite=overwrite, progress=progress,
        contents=GRAPH, more={RECORD_FILE: text.encode()},
    )  # fmt: skip
    return record | {"out": str(target), "files": files}


def structures(problem: Problem) -> Drawn:
    """Return the structures of the drawn part, of the whole block and of the graph of images."""
    few = len(problem.observations) <= EXPLICIT_LIMIT
    images, points = thinned(problem)
    return Drawn(
        explicit_structure(problem, images, points), explicit_structure(problem) if few else None,
        reduced_structure(problem) if eliminates_points(problem) else None,
    )  # fmt: skip


def thinned(problem: Problem) -> tuple[Index, Index]:
    """Return images and points of the drawn part: the first images, every k-th of their points with most rays."""
    images = np.arange(min(problem.n_images, IMAGES))
    o = problem.observations
    rays = np.bincount(o.point[o.image < len(images)], minlength=len(problem.active))
    rays[~problem.active] = 0
    for least in (2, 1):
        points = np.flatnonzero(rays >= least)
        if len(points):
            break
    if len(points) > POINTS:
        points = points[np.linspace(0, len(points) - 1, POINTS).round().astype(np.intp)]
    middle = np.array([o.image[(o.point == j) & (o.image < len(images))].mean() for j in points.tolist()])
    return images, points[np.argsort(middle, kind="stable")]


def counts(drawn: Drawn) -> dict[str, Any]:
    """Return the numbers of variables and factors, the fill and the largest clique."""
    whole = drawn.whole or drawn.part
    reduced = drawn.reduced
    return {
        "explicit": whole.counts, "explicit_is_whole": drawn.whole is not None,
        "orderings": {name: whole.eliminated(whole.ordering(name)).counts for name in ORDERINGS},
        "eliminated": reduced and {
            **reduced.counts, REDUCED_ORDERING: reduced.eliminated(reduced.ordering(REDUCED_ORDERING)).counts,
        },
        "drawn": drawn.part.counts,
    }  # fmt: skip


def _captions(name: str, drawn: Drawn, shown: Collection[str]) -> str:
    """Return the captions as Markdown, with the reason for a missing drawing."""
    lines = [f"# Factor graph of {printable(name)}", ""]
    own = drawn.part.counts
    thinned = drawn.whole is None or own["variables"] != drawn.whole.counts["variables"]
    remark = f" Only {own['image_vectors']} image vectors and {own['points']} ground points are drawn."
    for figure in shown:
        lines += [f"**{figure}** {CAPTIONS[figure]}{remark if thinned and figure != 'reduced' else ''}", ""]
    if "reduced" not in shown:
        lines += ["Not drawn:", "", "- reduced: the graph backend does not eliminate the points of this block", ""]
    return "\n".join(lines)


# --- charts ------------------------------------------------------------------------------------------


def _empty(words: str, x: tuple[float, float], y: tuple[float, float], title: str = "", **more: Any) -> Chart:
    return Chart(words, Axis(limits=x, about=0), Axis(limits=y, about=0), title=title, **more)


def _edges(chart: Chart, begin: Array, end: Array) -> None:
    """Add lines from (n, 2) to (n, 2)."""
    gap = np.full(len(begin), np.nan)
    x, y = (np.stack([begin[:, k], end[:, k], gap], axis=1).ravel() for k in (0, 1))
    chart.add("line", "ellipse", x, y)


def _dots(chart: Chart, kind: str, at: Array, size: float, label: str = "") -> None:
    if len(at):
        chart.add("dots", kind, at[:, 0], at[:, 1], label=label, sizes=np.full(len(at), size))


def _variables(chart: Chart, structure: Structure, at: Array, shown: Index) -> None:
    """Add squares for image vectors, circles for points, names of the image vectors."""
    images = shown[~structure.is_point[shown]]
    _dots(chart, "sample-dot", at[images], 6.0, "image unknowns")
    _dots(chart, "line-dot", at[shown[structure.is_point[shown]]], 3.4, "ground points")
    if len(images) <= VECTORS:
        names = [cut(structure.names[v].partition(":")[2], 10) for v in images]
        chart.add("names", "mark-label", at[images, 0], at[images, 1], tips=names)


def _factors(chart: Chart, structure: Structure, at: Array, outwards: Array) -> None:
    """Add the factors with their edges. A factor of one variable is drawn outside it, in the direction (n, 2)."""
    places, begin, end = [], [], []
    for own in structure.factors:
        place = at[list(own)].mean(axis=0) if len(own) > 1 else at[own[0]] + outwards[own[0]]
        places.append(place)
        begin += [place] * len(own)
        end += [at[v] for v in own]
    if places:
        _edges(chart, np.array(begin), np.array(end))
        large = np.array(structure.points) > 0
        _dots(chart, "dot-foot", np.array(places)[~large], 1.6, "factors")
        _dots(chart, "dot equal", np.array(places)[large], 4.0, "groups of points")


def graph_chart(structure: Structure) -> Chart:
    """Return the chart of the factor graph: images above, ground points below, factors as dots on the edges."""
    images, points = np.flatnonzero(~structure.is_point), np.flatnonzero(structure.is_point)
    at = np.zeros((len(structure.names), 2))
    at[images] = np.stack([(np.arange(len(images)) + 0.5) / max(len(images), 1), np.ones(len(images))], -1)
    at[points, 0] = (np.arange(len(points)) + 0.5) / max(len(points), 1)
    outwards = np.where(structure.is_point[:, None], [0.0, -0.12], [0.0, 0.12])
    chart = _empty("factor graph: images above, ground points below", (0.0, 1.0), (-0.3, 1.75))
    _factors(chart, structure, at, outwards)
    _variables(chart, structure, at, np.arange(len(at)))
    return chart


def reduced_chart(structure: Structure) -> Chart:
    """Return the chart of the graph of images: image vectors on a ring, factors between them."""
    shown = np.arange(min(len(structure.names), VECTORS))
    kept = [k for k, own in enumerate(structure.factors) if all(v < len(shown) for v in own)]
    part = Structure(
        structure.names[: len(shown)], structure.sizes[: len(shown)], tuple(structure.kinds[k] for k in kept),
        tuple(structure.factors[k] for k in kept), tuple(structure.points[k] for k in kept),
    )  # fmt: skip
    angle = math.pi - 2.0 * math.pi * np.arange(len(shown)) / max(len(shown), 1)
    at = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    chart = _empty("factor graph of the images", (-1.5, 1.5), (-1.4, 2.2))
    _factors(chart, part, at, 0.22 * at)
    _variables(chart, part, at, shown)
    groups = [k for k, n in enumerate(part.points) if n]
    if len(groups) <= NAMED:
        middle = np.array([at[list(part.factors[k])].mean(axis=0) for k in groups]).reshape(-1, 2)
        chart.add("names", "mark-label", middle[:, 0], middle[:, 1], tips=[f"{part.points[k]} points" for k in groups])
    return chart


def tree_chart(tree: EliminationTree, title: str) -> Chart:
    """Draw the cliques of an elimination: the root at the top, the first eliminated cliques at the bottom."""
    cliques = tree.cliques
    children: dict[int, list[int]] = {}
    depth: list[int] = []
    for k, (_, _, up) in enumerate(cliques):
        children.setdefault(up, []).append(k)
        depth.append(0 if up < 0 else depth[up] + 1)
    x, leaf = np.zeros(len(cliques)), 0
    stack = [(k, False) for k in reversed(children.get(-1, []))]
    while stack:
        k, seen = stack.pop()
        own = children.get(k, [])
        if not own:
            x[k], leaf = leaf, leaf + 1
        elif seen:
            x[k] = x[own].mean()
        else:
            stack += [(k, True), *((child, False) for child in reversed(own))]
    at = np.stack([(x + 0.5) / max(leaf, 1), -np.array(depth, float)], axis=-1)
    deepest = max(depth, default=0)
    chart = _empty("elimination tree", (0.0, 1.0), (-deepest - 0.3 * (deepest + 1), 0.6 * (deepest + 1)), title)
    lower = [k for k, (_, _, up) in enumerate(cliques) if up >= 0]
    _edges(chart, at[lower], at[[cliques[k][2] for k in lower]])
    point = np.array([tree.structure.is_point[list(own)].all() for own, _, _ in cliques])
    _dots(chart, "sample-dot", at[~point], 6.0, "with image unknowns")
    _dots(chart, "line-dot", at[point], 3.4, "ground points only")
    named = np.flatnonzero(~point)
    if len(named) <= NAMED:
        chart.add("names", "mark-label", at[named, 0], at[named, 1], tips=[_clique(tree, k) for k in named.tolist()])
    return chart


def _clique(tree: EliminationTree, k: int) -> str:
    """Return the names of the variables that a clique eliminates."""
    names = [tree.structure.names[v].partition(":")[2] for v in tree.cliques[k][0]]
    return cut(", ".join(names), 22) if len(names) <= 4 else f"{len(names)} variables"


def _trees(drawn: Drawn) -> list[Chart]:
    part, reduced = drawn.part, drawn.reduced
    out = [tree_chart(part.eliminated(part.ordering("points first")), "explicit, points first")]
    if reduced is not None and len(reduced.names) <= VECTORS:
        out.append(tree_chart(reduced.eliminated(reduced.ordering(REDUCED_ORDERING)), "eliminated, COLAMD"))
    return out


def matrix_chart(tree: EliminationTree, title: str) -> Chart:
    """Return the chart of the blocks of the normal matrix and of its factor, in the order of elimination."""
    sizes = tree.structure.sizes[list(tree.order)]
    ends = np.concatenate([[0], np.cumsum(sizes)])
    place = {v: k for k, v in enumerate(tree.order)}
    n = float(ends[-1])
    fill = tree.counts["fill"]
    chart = Chart(
        "blocks of a normal matrix", Axis(limits=(0.0, n)), Axis(limits=(0.0, n), down=True), aspect=1.0,
        legend="right", title=f"{title}: fill {fill}", width=250.0, height=250.0,
    )  # fmt: skip
    own = tree.structure.pairs | {(v, v) for v in place}
    for kind, pairs, label in (("line-dot", own, "N"), ("sample-dot", tree.fill_pairs, "fill")):
        spots = np.array(sorted((place[a], place[b]) for a, b in pairs)).reshape(-1, 2)
        if len(spots):
            row, column = spots.max(axis=1), spots.min(axis=1)
            across, down = (np.stack([ends[k], ends[k + 1]], axis=-1) for k in (column, row))
            chart.add("blocks", kind, across, down, label=label)
    return chart


def _matrices(drawn: Drawn) -> list[Chart]:
    part, reduced = drawn.part, drawn.reduced
    out = [matrix_chart(part.eliminated(part.ordering(name)), name) for name in ORDERINGS]
    if reduced is not None and len(reduced.names) <= VECTORS:
        out.append(matrix_chart(reduced.eliminated(reduced.ordering(REDUCED_ORDERING)), "eliminated points"))
    return out
