"""Sorting of image points by ground point, and of ground points by their images; division of the points into pieces.

Each counting sort needs one pass; ``fg_orient.kernels.batch_pairs`` describes the layout.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._plain import few_in_python
from fg_orient.kernels.batch_rows import Flags, Index, Small

#: Multiplier for the hash of a sequence (Knuth 1998, 6.4): 2^64 divided by the golden ratio, odd.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@few_in_python
@threaded
def sort_by(key: Index, order: Small, counts: Index, out: Small) -> None:
    """Sort ``order`` stably by the ``key`` of its rows; ``counts`` (largest key + 2,) is overwritten."""
    counts[:] = 0
    for n in range(len(order)):
        counts[key[order[n]] + 1] += 1
    for i in range(len(counts) - 1):
        counts[i + 1] += counts[i]
    for n in range(len(order)):
        i = key[order[n]]
        out[counts[i]] = order[n]
        counts[i] += 1


@few_in_python
@threaded
def signatures(
    order: Small, point: Index, image: Index, constant: Flags, n_images: int, key: Index, code: Index, start: Small
) -> int:
    """Write a key and a hash of the images of each ground point of a sorted list; return the number of points.

    The results for each point are ``key`` (first and last image, number of rays, constant
    or not), ``code`` (hash of its images) and ``start`` (its first row in ``order``; the
    last entry is the end).
    """
    total = 0
    n = 0
    while n < len(order):
        p, first, mixed = point[order[n]], n, np.uint64(1)
        while n < len(order) and point[order[n]] == p:
            mixed = (mixed ^ np.uint64(image[order[n]])) * _GOLDEN
            n += 1
        pair = image[order[first]] * n_images + image[order[n - 1]]
        key[total] = (pair * 128 + min(n - first, 127)) * 2 + constant[p]
        code[total] = np.int64(mixed >> np.uint64(1))
        start[total] = first
        total += 1
    start[total] = n
    return total


@few_in_python
@threaded
def arrange(
    points: Index,
    start: Small,
    order: Small,
    image_of: Index,
    point_of: Index,
    row: Small,
    image: Small,
    point: Small,
    first: Small,
) -> None:
    """Write the image points in the order of ``points`` (places of :func:`signatures`), and each point's first row."""
    n = 0
    for p in range(len(points)):
        first[p] = n
        for k in range(start[points[p]], start[points[p] + 1]):
            row[n], image[n], point[n] = order[k], image_of[order[k]], point_of[order[k]]
            n += 1
    first[len(points)] = n


@few_in_python
@threaded
def cut_pieces(
    first: Small, image: Small, free: Flags, fences: Flags, limit: int, pieces: Index, chunks: Index
) -> tuple[int, int]:
    """Write the pieces (P, 5) and the first piece of each chunk (P + 1,); return both numbers.

    A chunk begins at each point that ``fence`` (P,) marks, and at each point whose first
    image point reaches a multiple of ``limit``.
    """
    n_pieces, n_chunks, entries = 0, 0, 0
    for p in range(len(first) - 1):
        rays = first[p + 1] - first[p]
        fresh = p == 0 or fences[p] != 0 or first[p] // limit != first[p - 1] // limit
        same = not fresh and rays == first[p] - first[p - 1] and (free[p] == 0) == (free[p - 1] == 0)
        if same:
            for k in range(rays):
                same = same and image[first[p] + k] == image[first[p - 1] + k]
        if fresh:
            chunks[n_chunks] = n_pieces
            n_chunks += 1
        if same:
            pieces[n_pieces - 1, 2] += 1
            continue
        pieces[n_pieces, 0], pieces[n_pieces, 1], pieces[n_pieces, 2] = first[p], p, 1
        pieces[n_pieces, 3], pieces[n_pieces, 4] = rays, entries
        entries += rays * (rays + 1) // 2
        n_pieces += 1
    chunks[n_chunks] = n_pieces
    return n_pieces, n_chunks


@few_in_python
@threaded
def list_entries(
    pieces: Index, chunks: Index, image: Small, free: Flags, n_images: int, block: Index, kind: Index
) -> None:
    """Write block and kind of each pair of rays in each piece. The block is row times number of images plus column.

    The kind is twice the chunk, plus 1 for a ray with itself. It is -1 for two rays of a
    constant point, which have no common unknown.
    """
    for g in range(len(chunks) - 1):
        for q in range(chunks[g], chunks[g + 1]):
            first, rays, n = pieces[q, 0], pieces[q, 3], pieces[q, 4]
            for a in range(first, first + rays):
                for b in range(a, first + rays):
                    block[n] = image[a] * n_images + image[b]
                    kind[n] = 2 * g + (1 if a == b else 0)
                    if a != b and free[pieces[q, 1]] == 0:
                        kind[n] = -1
                    n += 1
