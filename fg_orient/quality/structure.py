"""Structural rank: unknowns with too few observations, found from the structure of the block without numbers.

Unknowns and observations form a bipartite graph. Its coarse decomposition (Dulmage & Mendelsohn 1958) gives
the unknowns that have no observation under the best assignment. All unknowns of an image occur in the same
observations, and this also holds for the three coordinates of a ground point. Therefore the nodes of the
graph are whole images and ground points, not single unknowns. The assignment is a flow: an image point
supplies two observations, a control point three; an image needs one observation per unknown, a ground point
three.

Most blocks need no flow. Suppose that each point takes its three observations in equal shares from its image
points. If the remaining observations are sufficient for each image, this is a fractional flow. An integer
flow then also exists (the constraints of a flow are totally unimodular). This test reads the observations a
few times.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from factors.arrays import Index, Mask
from fg_orient.adjustment.problem import Problem

#: Maximum number of names in one sentence.
NAMED: Final = 10


@dataclass(frozen=True)
class Lack:
    """Unknowns that have too few observations.

    Parameters
    ----------
    images, points : tuple of str
        Ids of a connected under-determined part of the decomposition.
    free : int
        Minimum number of undetermined directions.
    sentence, remedy : str
    """

    images: tuple[str, ...]
    points: tuple[str, ...]
    free: int
    sentence: str
    remedy: str


@dataclass(frozen=True)
class Structure:
    """Parts of a block and its structural rank.

    Parameters
    ----------
    part : (M,) int array
        Part of the block of each image; different parts have no common ground point or extra observation.
    point_part : (N,) int array
        Part of each ground point; -1 for points in no observation.
    lacks : tuple of Lack
        Unknowns with too few observations; empty if the structural rank is full.
    """

    part: Index
    point_part: Index
    lacks: tuple[Lack, ...]

    @property
    def defect(self) -> int:
        """Unknowns minus structural rank."""
        return sum(lack.free for lack in self.lacks)

    @property
    def n_parts(self) -> int:
        """Number of parts."""
        return int(self.part.max()) + 1


def analyse_structure(problem: Problem) -> Structure:
    """Find the parts of a block, and its unknowns with too few observations; priors count as observations."""
    part, point_part = _parts(problem)
    image_need, point_need = _needs(problem)
    lacks = () if _enough(problem, image_need, point_need) else _lacking(problem, image_need, point_need)
    return Structure(part, point_part, lacks)


def named(ids: list[str] | tuple[str, ...]) -> str:
    """Join ids, the first ten of many."""
    return ", ".join(ids[:NAMED]) + (f" ... ({len(ids)})" if len(ids) > NAMED else "")


def of_ids(noun: str, ids: list[str] | tuple[str, ...]) -> str:
    """Return a noun with ids: "image 1", "images 1, 2"."""
    return f"{noun}{'s' if len(ids) > 1 else ''} {named(ids)}"


def _needs(problem: Problem) -> tuple[Index, Index]:
    """Count the observations that images (M,) and points (N,) need in addition to priors, penalties and coordinates.

    Shared unknowns of images are not counted, so the defect is a lower bound; the singular values include them.
    """
    own = np.array([int(p.own.sum()) for p in problem.parameters])
    images = own * (0 if problem.block.options.holds_unknowns else 1)
    return images.astype(np.intp), np.where(problem.active & ~problem.observed, 3, 0).astype(np.intp)


def _enough(problem: Problem, image_need: Index, point_need: Index) -> bool:
    """Return whether equal shares of image points are enough for all points and images (sufficient condition)."""
    o = problem.observations
    rays = np.bincount(o.point, minlength=len(point_need))
    if np.any(2 * rays < point_need):
        return False
    share = point_need / np.maximum(rays, 1)
    left = np.bincount(o.image, weights=2.0 - share[o.point], minlength=len(image_need))
    return bool(np.all(left >= image_need - 1e-9))


def _groups(problem: Problem) -> tuple[Index, Index, Index]:
    """Return pairs (observation, unknown) and the sizes of the observations.

    Unknowns are numbered: first images, then points.
    """
    o, m = problem.observations, problem.n_images
    n = len(o)
    rows, columns, sizes = [np.tile(np.arange(n), 2)], [np.concatenate([o.image, m + o.point])], [np.full(n, 2)]
    for k, extra in enumerate(problem.block.extra):
        unknown = [a for a in problem.extra_arguments(extra) if a.constant is None]
        rows.append(np.full(len(unknown), n + k))
        columns.append(np.array([a.index if a.is_image else m + a.index for a in unknown]))
        sizes.append(np.array([extra.n_residuals]))
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(sizes)


def _parts(problem: Problem) -> tuple[Index, Index]:
    """Find the parts of the block by images and unknown ground points; a fixed point does not connect images."""
    m, n_points, o = problem.n_images, len(problem.active), problem.observations
    linking = problem.active[o.point]
    image, point = o.image[linking].astype(np.intp), o.point[linking]
    first = np.full(n_points, -1, np.intp)
    first[point[::-1]] = image[::-1]  # the first image that sees a point represents it
    pairs = np.unique(image * m + first[point])
    links = list(zip((pairs // m).tolist(), (pairs % m).tolist(), strict=True))
    for extra in problem.block.extra:
        unknown = [a for a in problem.extra_arguments(extra) if a.constant is None]
        seen = [a.index if a.is_image else int(first[a.index]) for a in unknown]
        links += pairwise(m + a.index if k < 0 else k for a, k in zip(unknown, seen, strict=True))
    _, part = np.unique(_joined(m, links), return_inverse=True)
    points = np.full(n_points, -1, dtype=np.intp)
    points[problem.observations.point] = part[problem.observations.image]
    return part.astype(np.intp), points


def _joined(m: int, links: list[tuple[int, int]]) -> list[int]:
    """Return for each node below m the least node of its connected part; larger nodes occur only in links."""
    above: dict[int, int] = {}

    def least(node: int) -> int:
        while (up := above.get(node, node)) != node:
            above[node] = above.get(up, up)  # shorten the path to the root by half
            node = up
        return node

    for one, other in links:
        low, high = sorted((least(one), least(other)))
        above[high] = low
    return [least(node) for node in range(m)]


def _lacking(problem: Problem, image_need: Index, point_need: Index) -> tuple[Lack, ...]:
    """Decompose by the flow from a source through observations and unknowns to a sink."""
    row, column, supply = _groups(problem)
    need = np.concatenate([image_need, point_need])
    flow, got = _flow(row, column, supply, need)
    missing = need - got
    if not missing.any():
        return ()
    label, reached = _under_determined(row, column, flow, missing, len(supply))
    out, once = [], []
    rays = np.bincount(problem.observations.point, minlength=len(point_need))
    for part in np.unique(label[np.flatnonzero(missing)]):
        members = np.flatnonzero((label == part) & reached & (need > 0))
        images, points = members[members < len(image_need)], members[members >= len(image_need)] - len(image_need)
        free = int(missing[members].sum())
        if not len(images) and len(points) == 1 and rays[points[0]] == 1:
            once.append(int(points[0]))
        else:
            out.append(_lack(problem, images, points, free))
    return tuple([*([_seen_once(problem, once)] if once else []), *out])


def _flow(row: Index, column: Index, supply: Index, need: Index) -> tuple[Index, Index]:
    """Compute the largest flow along the pairs (observation, unknown), and to each unknown."""
    from scipy import sparse
    from scipy.sparse import csgraph

    n_rows, n = len(supply), len(supply) + len(need)
    source, sink = n, n + 1
    tail = np.concatenate([np.full(n_rows, source), row, n_rows + np.arange(len(need))])
    head = np.concatenate([np.arange(n_rows), n_rows + column, np.full(len(need), sink)])
    capacity = np.concatenate([supply, supply[row], need]).astype(np.int32)
    keep = capacity > 0
    graph = sparse.csr_array((capacity[keep], (tail[keep], head[keep])), shape=(n + 2, n + 2))
    result = csgraph.maximum_flow(graph, source, sink).flow
    along = np.asarray(result[row, n_rows + column]).ravel()
    got = np.asarray(result[n_rows + np.arange(len(need)), np.full(len(need), sink)]).ravel()
    return along.astype(np.intp), got.astype(np.intp)


def _under_determined(row: Index, column: Index, flow: Index, missing: Index, n_rows: int) -> tuple[Index, Mask]:
    """Return the connected part of each unknown, and whether the unknown is under-determined.

    The search starts at unknowns with unmet needs. It continues through any observation that contains them to the
    unknowns to which this observation was assigned: these are under-determined, too.
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    n, start = n_rows + len(missing), n_rows + len(missing)
    given, open_ = flow > 0, np.flatnonzero(missing)
    tail = np.concatenate([np.full(len(open_), start), n_rows + column, row[given]])
    head = np.concatenate([n_rows + open_, row, n_rows + column[given]])
    graph = sparse.csr_matrix((np.ones(len(tail), np.int8), (tail, head)), shape=(n + 1, n + 1))
    reached = np.zeros(n + 1, bool)
    reached[csgraph.breadth_first_order(graph, start, return_predecessors=False)] = True
    inside = reached[tail] & reached[head] & (tail != start)
    within = sparse.coo_matrix((np.ones(int(inside.sum()), np.int8), (tail[inside], head[inside])), shape=(n, n))
    label = csgraph.connected_components(within, directed=False)[1]
    return label[n_rows:].astype(np.intp), reached[n_rows:n]


def _seen_once(problem: Problem, points: list[int]) -> Lack:
    """Report points with one image point: their position along this ray is not determined."""
    o, block = problem.observations, problem.block
    ids = tuple(block.points.ids[j] for j in points)
    only = dict(zip(o.point.tolist(), o.image.tolist(), strict=True))
    seen = [block.images[only[j]].id for j in points]
    s, them = ("s", "them") if len(ids) > 1 else ("", "it")
    who, where = named(ids), f"image {seen[0]}"
    if len(set(seen)) > 1:
        who, where = named([f"{p} (image {image})" for p, image in zip(ids, seen, strict=True)]), "that image"
    sentence = f"point{s} {who}: seen in {where} only, without control: {len(ids)} free motion{s}, along the ray{s}"
    return Lack((), ids, len(ids), sentence, f"measure {them} in a second image, or give {them} coordinates as control")


def _lack(problem: Problem, images: Index, points: Index, free: int) -> Lack:
    """Report images, or images with their points, that have too few image points."""
    block, o = problem.block, problem.observations
    ids, names = tuple(block.images[k].id for k in images), tuple(block.points.ids[j] for j in points)
    unknowns = int(np.diff(problem.first)[images].sum())
    n = int(np.isin(o.image, images).sum())
    who = of_ids("image", ids) if ids else f"points {named(names)}"
    if ids and not n:
        why = f"in no observation, {'their' if len(ids) > 1 else 'its'} {unknowns} unknowns are free"
    elif ids:
        shared = f" and points {named(names)}" if names else ""
        why = f"{n} image points are too few for {unknowns} unknowns{shared}, {free} directions at least are free"
    else:
        why = f"too few rays, {free} directions at least are free"
    where = f" in {of_ids('image', ids)}" if ids else ""
    return Lack(
        ids, names, free, f"{who}: {why}", f"measure more points{where}, best control points, or keep the priors"
    )
