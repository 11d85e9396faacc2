"""Structure of a factor graph without numerical values: variables, factors, elimination orders, fill and cliques.

Variables are numbered in this order: image vectors, vectors that images share, ground
points. GTSAM eliminates the structure symbolically. Therefore a graph can be counted and
drawn without an evaluation of its factors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import gtsam
import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.explicit import image_unknown, key_names, vector_keys
from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.problem import Problem

Index = npt.NDArray[np.int64]

#: Names of elimination orders. The order "natural" also exists: images, then points, in the order of their numbers.
ORDERINGS = ("points first", "COLAMD", "METIS")


@dataclass(frozen=True)
class Structure:
    """Variables and factors of a graph.

    Parameters
    ----------
    names : tuple of str
        "image:ID", "shared:ID", "point:ID"; points follow the others.
    sizes : (n,) int array
        Number of unknowns of each variable.
    kinds : tuple of str
        Kind of each factor: "image point", "control point", "image prior", "extra
        observation", "group of points".
    factors : tuple of int tuples
        Variables of each factor, ascending.
    points : tuple of int
        Number of ground points that each factor has eliminated; 0 for factors that are not groups.
    """

    names: tuple[str, ...]
    sizes: Index
    kinds: tuple[str, ...]
    factors: tuple[tuple[int, ...], ...]
    points: tuple[int, ...]

    @cached_property
    def is_point(self) -> npt.NDArray[np.bool_]:
        """True for each variable that is a ground point."""
        return np.array([name.startswith("point:") for name in self.names], bool)

    @cached_property
    def counts(self) -> dict[str, object]:
        """Numbers of variables, unknowns and factors."""
        points = int(self.is_point.sum())
        return {
            "variables": len(self.names),
            "image_vectors": len(self.names) - points,
            "points": points,
            "unknowns": int(self.sizes.sum()),
            "factors": len(self.factors),
            "factors_by_kind": dict(Counter(self.kinds)),
        }

    @cached_property
    def pairs(self) -> set[tuple[int, int]]:
        """Pairs of variables in a common factor, smaller number first: blocks of the normal matrix."""
        return {pair for own in set(self.factors) for pair in combinations(own, 2)}

    @cached_property
    def without_points(self) -> Structure:
        """Graph of the other variables after the elimination of the ground points.

        The order of the points has no effect.
        """
        kept = np.flatnonzero(~self.is_point)
        place = {int(v): n for n, v in enumerate(kept)}
        points = [int(v) for v in np.flatnonzero(self.is_point)]
        tree = self.eliminated([*points, *place])
        joined = {tuple(sorted(place[v] for v in tree.separators[j] if v in place)) for j in points}
        joined |= {(place[a], place[b]) for a, b in self.pairs if a in place and b in place}
        factors = tuple(own for own in sorted(joined) if len(own) > 1)
        names = tuple(self.names[v] for v in kept)
        return Structure(names, self.sizes[kept], ("images",) * len(factors), factors, (0,) * len(factors))

    def ordering(self, name: str) -> list[int]:
        """Return the order of elimination; see :data:`ORDERINGS`."""
        if name == "natural":
            return list(range(len(self.names)))
        if name == "points first":
            return [int(v) for v in np.argsort(~self.is_point, kind="stable")]
        make = gtsam.Ordering.ColamdSymbolicFactorGraph
        if name == "METIS" and self.pairs:  # METIS needs an edge
            make = gtsam.Ordering.MetisSymbolicFactorGraph
        found = make(self._symbolic)
        return [int(found.at(k)) for k in range(found.size())]

    @cached_property
    def _symbolic(self) -> gtsam.SymbolicFactorGraph:
        graph = gtsam.SymbolicFactorGraph()
        for own in dict.fromkeys([*self.pairs, *((v,) for v in range(len(self.names)))]):
            graph.push_factor(*own)
        return graph

    def eliminated(self, order: Sequence[int]) -> EliminationTree:
        """Eliminate in an order."""
        ordering = gtsam.Ordering()
        for v in order:
            ordering.push_back(v)
        place = {v: k for k, v in enumerate(order)}
        net = self._symbolic.eliminateSequential(ordering)
        separators: dict[int, tuple[int, ...]] = {}
        for k in range(net.size()):
            own, *rest = net.at(k).keys()
            separators[int(own)] = tuple(sorted((int(v) for v in rest), key=place.__getitem__))
        return EliminationTree(self, tuple(order), separators)


@dataclass(frozen=True)
class EliminationTree:
    """Result of an elimination.

    Parameters
    ----------
    structure : Structure
    order : tuple of int
        Variables in the order of their elimination.
    separators : dict
        For each variable, the variables in its conditional, in the same order. They are
        the blocks of its row of R.
    """

    structure: Structure
    order: tuple[int, ...]
    separators: dict[int, tuple[int, ...]]

    @cached_property
    def cliques(self) -> list[tuple[tuple[int, ...], tuple[int, ...], int]]:
        """Cliques of the Bayes tree: eliminated variables, separator and number of the parent clique (-1: root).

        Parents come first. A variable joins the clique of the next variable if it adds
        nothing to the separator.
        """
        number: dict[int, int] = {}
        frontals: list[list[int]] = []
        parents: list[int] = []
        for v in reversed(self.order):
            separator = self.separators[v]
            above = number[separator[0]] if separator else -1
            joins = bool(separator) and frontals[above][0] == separator[0]
            if joins and len(separator) == 1 + len(self.separators[separator[0]]):
                frontals[above].insert(0, v)
                number[v] = above
            else:
                number[v] = len(frontals)
                frontals.append([v])
                parents.append(above)
        return [(tuple(own), self.separators[own[-1]], up) for own, up in zip(frontals, parents, strict=True)]

    @cached_property
    def fill_pairs(self) -> set[tuple[int, int]]:
        """Blocks of R that the normal matrix does not have, smaller number first."""
        blocks = {(min(v, w), max(v, w)) for v, rest in self.separators.items() for w in rest}
        return blocks - self.structure.pairs

    @cached_property
    def operations(self) -> float:
        """Number of multiplications and additions of the Cholesky factor; each pair of them counts twice.

        A variable of s unknowns with a separator of d unknowns takes ``s^3/3 + s^2 d + s d^2``.
        """
        s = self.structure.sizes[list(self.order)].astype(float)
        d = np.array([float(self.structure.sizes[list(self.separators[v])].sum()) for v in self.order])
        return float(np.sum(s**3 / 3.0 + s**2 * d + s * d**2))

    @cached_property
    def counts(self) -> dict[str, int]:
        """Numbers of elements of the lower triangle of N, of R, and of fill.

        Largest clique, number of cliques.
        """
        sizes = self.structure.sizes
        own = int((sizes * (sizes + 1) // 2).sum())
        normal = own + int(sum(sizes[a] * sizes[b] for a, b in self.structure.pairs))
        fill = int(sum(sizes[a] * sizes[b] for a, b in self.fill_pairs))
        cliques = [(*frontals, *separator) for frontals, separator, _ in self.cliques]
        return {
            "nonzeros_normal_matrix": normal,
            "nonzeros_factor": normal + fill,
            "fill": fill,
            "cliques": len(cliques),
            "largest_clique_variables": max((len(c) for c in cliques), default=0),
            "largest_clique_unknowns": max((int(sizes[list(c)].sum()) for c in cliques), default=0),
        }


class _Variables:
    """Numbers of the variables of a problem."""

    def __init__(self, problem: Problem, images: Sequence[int], points: Sequence[int]) -> None:
        self._problem = problem
        wanted = set().union(*(self._keys(k) for k in images)) if len(images) else set()
        names = key_names(problem)
        vectors = [(key, part) for key, part in vector_keys(problem) if key in wanted]
        self.vector = {key: n for n, (key, _) in enumerate(vectors)}
        self.point = {j: len(vectors) + n for n, j in enumerate(points)}
        ids = problem.block.points.ids
        self.names = (*(names[key] for key, _ in vectors), *(f"point:{ids[j]}" for j in points))
        self.sizes = np.array([*(part.stop - part.start for _, part in vectors), *(3 for _ in points)], np.int64)

    def _keys(self, k: int) -> set[int]:
        unknown = image_unknown(self._problem, k)
        if isinstance(unknown, np.ndarray):
            return set()
        return {unknown} if isinstance(unknown, int) else {int(key) for key in unknown.keys}

    def image(self, k: int) -> tuple[int, ...]:
        """Return the variables of an image."""
        return tuple(sorted(self.vector[key] for key in self._keys(k)))


def explicit_structure(problem: Problem, images: Index | None = None, points: Index | None = None) -> Structure:
    """Return the graph with one factor for each image point, or only the part of the given images and ground points."""
    shown = np.arange(problem.n_images) if images is None else images
    wanted = problem.active.copy()
    if points is not None:
        wanted &= np.isin(np.arange(len(wanted)), points)
    active = np.flatnonzero(wanted)
    o = problem.observations
    variables = _Variables(problem, shown.tolist(), active.tolist())
    kinds: list[str] = []
    factors: list[tuple[int, ...]] = []

    def add(kind: str, own: tuple[int, ...]) -> None:
        if own:
            kinds.append(kind)
            factors.append(own)

    of_image = {k: variables.image(k) for k in shown.tolist()}
    seen = np.isin(o.image, shown) if images is not None else np.ones(len(o), bool)
    if points is not None:
        seen &= np.isin(o.point, points)
    for i, j in zip(o.image[seen].tolist(), o.point[seen].tolist(), strict=True):
        place = variables.point.get(j)
        add("image point", of_image[i] + (() if place is None else (place,)))
    for j in np.flatnonzero(problem.observed).tolist():
        if j in variables.point:
            add("control point", (variables.point[j],))
    _add_others(problem, variables, add, of_image)
    return Structure(variables.names, variables.sizes, tuple(kinds), tuple(factors), (0,) * len(factors))


def reduced_structure(problem: Problem) -> Structure:
    """Return the graph of images with groups of eliminated points as factors, see :func:`fg_orient.factor_graph`."""
    backend = GraphBackend(problem)
    named = backend.points
    own = explicit_structure(problem, points=named)
    number = {name: n for n, name in enumerate(own.names)}
    variables = _Variables(problem, range(problem.n_images), [])
    of_vector = [number[name] for name in variables.names]
    vectors = {n: of_vector[k] for k, n in enumerate(backend.elimination.parts)}
    groups = backend.elimination.groups
    factors = tuple(tuple(sorted(vectors[n] for n in group.vectors)) for group in groups)
    counts = tuple(group.places[1] - group.places[0] for group in groups)
    return Structure(
        own.names,
        own.sizes,
        ("group of points",) * len(groups) + own.kinds,
        factors + own.factors,
        counts + own.points,
    )


def _add_others(
    problem: Problem,
    variables: _Variables,
    add: Callable[[str, tuple[int, ...]], None],
    of_image: dict[int, tuple[int, ...]],
) -> None:
    """Add priors of image vectors, and extra observations if the graph contains all their variables."""
    if problem.block.options.priors:
        for n in variables.vector.values():
            add("image prior", (n,))
    for extra in problem.block.extra:
        own: list[int] = []
        for argument in problem.extra_arguments(extra):
            if argument.constant is not None:
                continue
            if argument.is_image and argument.index in of_image:
                own += of_image[argument.index]
            elif not argument.is_image and argument.index in variables.point:
                own.append(variables.point[argument.index])
            else:
                break
        else:
            add("extra observation", tuple(sorted(set(own))))
