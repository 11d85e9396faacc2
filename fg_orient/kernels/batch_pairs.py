"""Reduced normal equations of the images, after elimination of the ground points.

Two rays a, b of one ground point add ``J_a^T M J_b``, ``M = [a is b] I - Z_a Z_b^T``, ``Z
= G R^T`` (``fg_orient.kernels.batch_points``), to the block of their images. With J =
basis kron components, the sum over many pairs is a sum of products ``basis_a basis_b``
times one small matrix of components. This takes half the arithmetic operations and a
third of the memory traffic of the full columns.

Points measured in the same images are adjacent and form a *piece*; all points of a piece
have the same pairs. Pieces are grouped into *chunks*; their limits do not depend on the
number of threads. Each chunk has its own sums, one *slot* for each block to which it
contributes; :func:`gather_blocks` adds the slots of all chunks in a fixed order.

Eight rows at once are added to up to three sums. An element of a sum is loaded and stored
once for eight rows; an element of a row is loaded once for three sums, whose weights
remain in registers. The nine sums of a pair of rays take 20 ns one by one and 16 ns in
groups of three (measured).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_points import SCALED
from fg_orient.kernels.batch_rows import Index, Small
from fg_orient.kernels.vectors import (
    LANES,
    aligned,
    combine_nine,
    data_of,
    load,
    number_at,
    outer_nine,
    place_in_sum,
    store,
)

#: Number of sums processed together. With narrower vectors there are not enough registers
#: for the weights of three sums.
TOGETHER: Final = 3 if LANES == 8 else 1
_FUSED: Final = ("contract",)


def _sum(builder: Any, first: Any, factors: list[Any], rows: list[Any]) -> Any:
    """Return ``first`` plus all products; for eight and four rows the second half has a separate sum."""
    total, half = [first], len(rows) // 2
    for r, (factor, row) in enumerate(zip(factors, rows, strict=True)):
        product = builder.fmul(factor, row, flags=_FUSED)
        if r == half and r > 0:
            total.append(product)
        else:
            total[-1] = builder.fadd(total[-1], product, flags=_FUSED)
    return total[0] if len(total) == 1 else builder.fadd(*total)


def _adder(rows: int) -> Callable[..., None]:
    """Return the function that adds this number of rows to one, two or three sums."""

    def emit(builder: Any, pointers: list[Any], steps: Any, vectors: Any, sums: int) -> None:
        def follow(k: int, count: int) -> list[Any]:
            places = [pointers[k]]
            for _ in range(count - 1):
                places.append(builder.gep(places[-1], [steps[k]]))
            return places

        targets, lines = follow(0, sums), follow(1, rows)
        factors = [[number_at(builder, weight, r) for r in range(rows)] for weight in follow(2, sums)]
        with cgutils.for_range(builder, vectors) as loop:
            e = builder.mul(loop.index, ir.Constant(loop.index.type, LANES))
            taken = [load(builder, line, e) for line in lines]
            for target, own in zip(targets, factors, strict=True):
                total = _sum(builder, load(builder, target, e), own, taken)
                store(builder, total, target, e)

    def add(
        typing: Any, out: Any, at: Any, apart: Any, t: Any, begin: Any, stride: Any, weight: Any, w: Any, width: Any,
        vectors: Any, sums: Any,
    ) -> Any:  # fmt: skip
        place = types.intp
        signature = types.void(out, place, place, t, place, place, weight, place, place, place, place)

        def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
            bases = [data_of(context, builder, given.args[k], arguments[k]) for k in (0, 3, 6)]
            pointers = [builder.gep(base, [arguments[k]]) for base, k in zip(bases, (1, 4, 7), strict=True)]
            steps, vectors, wanted = [arguments[k] for k in (2, 5, 8)], arguments[9], arguments[10]
            for sums in range(1, TOGETHER + 1):
                with builder.if_then(builder.icmp_signed("==", wanted, ir.Constant(wanted.type, sums))):
                    emit(builder, pointers, steps, vectors, sums)
            return context.get_dummy_value()

        return signature, generate

    compiled: Callable[..., None] = intrinsic(add)
    return compiled


#: Only for compiled code; numba supplies the first argument. ``f(out, at, apart, t,
#: begin, stride, weight, w, width, vectors, sums)`` adds eight, four, two rows or one row
#: to sums. The rows begin at ``begin`` of ``t``; the distance from row to row is ``stride``. The sums
#: begin at ``at`` of ``out``; the distance from sum to sum is ``apart``. The factors of the first sum
#: begin at ``w`` of ``weight``; the factors of each further sum begin ``width`` elements later. A row
#: has ``vectors`` times LANES elements.
_eight, _four, _two, _one = _adder(8), _adder(4), _adder(2), _adder(1)


@threaded
def _add(n: int, weight: Array, m: int, sums: int, t: Array, end: int, out: Array, s: int) -> None:
    """Add n rows to up to TOGETHER sums: eight rows at a time, then the remaining rows by four, two and one."""
    size, stride, width, k = out.shape[2], t.shape[1], weight.shape[1], 0
    at, w, vectors = (s * out.shape[1] + m) * size, m * width, end // LANES
    while k + 8 <= n:
        _eight(out, at, size, t, k * stride, stride, weight, w + k, width, vectors, sums)
        k += 8
    if n - k >= 4:
        _four(out, at, size, t, k * stride, stride, weight, w + k, width, vectors, sums)
        k += 4
    if n - k >= 2:
        _two(out, at, size, t, k * stride, stride, weight, w + k, width, vectors, sums)
        k += 2
    if k < n:
        _one(out, at, size, t, k * stride, stride, weight, w + k, width, vectors, sums)


@threaded
def add_rows(n: int, weight: Array, m: int, sums: int, t: Array, end: int, out: Array, s: int) -> None:
    """Add n rows of t, of ``end`` numbers each, times rows m ..

    M + sums - 1 of ``weight``, to ``out[s, m]`` ...
    """
    for first in range(m, m + sums, TOGETHER):
        _add(n, weight, first, min(TOGETHER, m + sums - first), t, end, out, s)


#: Pairs are formed for this number of points before they are added, so that the data of the points remain in the cache.
BATCH = 24


@threaded
def _form(
    n: int, a: int, b: int, rays: int, base: int, d_image: Array, scaled: Array, c_a: int, c_b: int, t: Array
) -> None:  # fmt: skip
    """Write ``D_a^T M D_b`` of the pair a, b and of the next n - 1 pairs, ``rays`` apart, to the rows of t."""
    same = 1.0 if a == b else 0.0
    for k in range(n):
        i, j = a + k * rays - base, b + k * rays - base
        x0, x1, x2, x3, x4, x5 = (
            scaled[i, SCALED.x0], scaled[i, SCALED.x1], scaled[i, SCALED.x2],
            scaled[i, SCALED.y0], scaled[i, SCALED.y1], scaled[i, SCALED.y2],
        )  # fmt: skip
        y0, y1, y2, y3, y4, y5 = (
            scaled[j, SCALED.x0], scaled[j, SCALED.x1], scaled[j, SCALED.x2],
            scaled[j, SCALED.y0], scaled[j, SCALED.y1], scaled[j, SCALED.y2],
        )  # fmt: skip
        m00, m01 = same - (x0 * y0 + x1 * y1 + x2 * y2), -(x0 * y3 + x1 * y4 + x2 * y5)
        m10, m11 = -(x3 * y0 + x4 * y1 + x5 * y2), same - (x3 * y3 + x4 * y4 + x5 * y5)
        if c_a == 9 and c_b == 9:
            outer_nine(t, k * t.shape[1], d_image, d_image.shape[2], i, j, m00, m01, m10, m11)
            continue
        for c in range(c_a):
            l0 = d_image[i, 0, c] * m00 + d_image[i, 1, c] * m10
            l1 = d_image[i, 0, c] * m01 + d_image[i, 1, c] * m11
            for d in range(c_b):
                t[k, c * c_b + d] = l0 * d_image[j, 0, d] + l1 * d_image[j, 1, d]


@threaded
def _weigh(n: int, a: int, b: int, rays: int, basis: Array, b_a: int, b_b: int, weight: Array) -> None:
    """Write the products of basis values (b_a b_b, n) for the pair a, b and the next n - 1 pairs."""
    if b_a == 3 and b_b == 3:  # 1, tau, tau^2: the usual case, three times as fast
        for k in range(n):
            i, j = a + k * rays, b + k * rays
            x0, x1, x2, y0, y1, y2 = basis[i, 0], basis[i, 1], basis[i, 2], basis[j, 0], basis[j, 1], basis[j, 2]
            weight[0, k], weight[1, k], weight[2, k] = x0 * y0, x0 * y1, x0 * y2
            weight[3, k], weight[4, k], weight[5, k] = x1 * y0, x1 * y1, x1 * y2
            weight[6, k], weight[7, k], weight[8, k] = x2 * y0, x2 * y1, x2 * y2
        return
    for p in range(b_a):
        for q in range(b_b):
            for k in range(n):
                weight[p * b_b + q, k] = basis[a + k * rays, p] * basis[b + k * rays, q]


@threaded
def _add_gradient(
    n: int, a: int, rays: int, base: int, n_b: int, n_c: int, basis: Array, value: Array, line: int, sample: int,
    d_image: Array, t: Array, weight: Array, out: Array, s: int,
) -> None:  # fmt: skip
    """Add ``D^T r`` of ray a and of the next n - 1 to a slot's gradient.

    ``line``, ``sample``: columns of r in value.
    """
    for k in range(n):
        i = a + k * rays - base
        q0, q1 = value[i, line], value[i, sample]
        if n_c == 9:
            combine_nine(t, k * t.shape[1], d_image, d_image.shape[2], i, q0, q1)
        else:
            for c in range(n_c):
                t[k, c] = d_image[i, 0, c] * q0 + d_image[i, 1, c] * q1
        for b in range(n_b):
            weight[b, k] = basis[base + i, b]
    add_rows(n, weight, 0, n_b, t, out.shape[2], out, s)


@threaded
def pair_blocks(
    lo: int, hi: int, chunks: Index, pieces: Index, slots: Small, slot_begin: Index, image: Small, n_basis: Index,
    n_components: Index, basis: Array, base: int, d_image: Array, scaled: Array, sums: Array, gradients: Array,
) -> None:  # fmt: skip
    """Write sums (S, b^2, e) for pairs of basis values and components, and gradients (S, b, c), of chunks lo to hi.

    Parameters
    ----------
    chunks, slot_begin : (N + 1,) int arrays
        First piece and first slot of each chunk.
    pieces : (Q, 5) int array
        First image point, first place, number of points, number of rays of each point,
        and first of its ``slots``.
    slots : int array
        Slot of each pair of rays j <= k of a piece, ordered by j, then k; -1 if there is none.
    base : int
        Number of the image point in row 0 of ``d_image`` (n, 2, c) and ``scaled`` (n, 8:
        Z, residuals reduced by the point); ``basis`` and ``image`` contain all image
        points. At least :data:`fg_orient.kernels.vectors.SLACK` further numbers must
        follow ``d_image`` in memory.
    sums : (S, b^2, e) array
        Components c, d of a sum are at :func:`fg_orient.kernels.vectors.place_in_sum`.
    """
    size = sums.shape[2]
    # one extra row, because the last product of nine writes beyond its row
    t, weight = aligned(BATCH + 1, max(size, gradients.shape[2])), np.zeros((sums.shape[1], BATCH))
    for g in range(lo, hi):
        own = slice(slot_begin[g], slot_begin[g + 1])
        sums[own], gradients[own] = 0.0, 0.0
        for piece in range(chunks[g], chunks[g + 1]):
            first, count, rays = pieces[piece, 0], pieces[piece, 2], pieces[piece, 3]
            for start in range(0, count, BATCH):
                n, entry = min(BATCH, count - start), pieces[piece, 4]
                for a in range(first + start * rays, first + (start + 1) * rays):
                    i = image[a]
                    c_a, b_a = n_components[i], n_basis[i]
                    for b in range(a, first + (start + 1) * rays):
                        j, s = image[b], slots[entry]
                        entry += 1
                        if s < 0:
                            continue
                        c_b, b_b = n_components[j], n_basis[j]
                        end = min(size, -(-c_a * c_b // LANES) * LANES)
                        _form(n, a, b, rays, base, d_image, scaled, c_a, c_b, t)
                        _weigh(n, a, b, rays, basis, b_a, b_b, weight)
                        if a == b:  # symmetric
                            for p in range(b_a):
                                add_rows(n, weight, p * b_b + p, b_b - p, t, end, sums, s)
                            _add_gradient(
                                n, a, rays, base, b_a, c_a, basis, scaled, SCALED.r_line, SCALED.r_sample, d_image, t,
                                weight, gradients, s,
                            )  # fmt: skip
                            continue
                        add_rows(n, weight, 0, b_a * b_b, t, end, sums, s)
                        if i == j:  # two rays in one image: add both orders
                            _form(n, b, a, rays, base, d_image, scaled, c_b, c_a, t)
                            _weigh(n, b, a, rays, basis, b_b, b_a, weight)
                            add_rows(n, weight, 0, b_a * b_b, t, end, sums, s)


@threaded
def image_gradients(
    lo: int, hi: int, chunks: Index, pieces: Index, slots: Small, slot_begin: Index, image: Small, n_basis: Index,
    n_components: Index, basis: Array, base: int, value: Array, d_image: Array, gradients: Array,
) -> None:  # fmt: skip
    """Write the unreduced gradients (S, b, c) of chunks lo to hi; see :func:`pair_blocks`."""
    t, weight = np.zeros((BATCH, gradients.shape[2])), np.zeros((gradients.shape[1], BATCH))
    for g in range(lo, hi):
        gradients[slot_begin[g] : slot_begin[g + 1]] = 0.0
        for piece in range(chunks[g], chunks[g + 1]):
            first, count, rays = pieces[piece, 0], pieces[piece, 2], pieces[piece, 3]
            for start in range(0, count, BATCH):
                entry = pieces[piece, 4]
                for j in range(rays):
                    a = first + start * rays + j
                    _add_gradient(min(BATCH, count - start), a, rays, base, n_basis[image[a]],
                                  n_components[image[a]], basis, value, 0, 1, d_image, t, weight, gradients,
                                  slots[entry])  # fmt: skip
                    entry += rays - j


@threaded
def gather_blocks(
    lo: int, hi: int, begin: Index, order: Small, own: Small, row: Index, column: Index, sums: Array, wide: Index,
    scale: Array, size: Index, n_basis: Index, n_components: Index, out: Array,
) -> None:  # fmt: skip
    """Add the slots of blocks lo to hi, and select the existing unknowns: (B, k, k).

    Parameters
    ----------
    begin, order : (B + 1,), (S,) int arrays
        Slots of each block.
    own : (S,) int array
        1 if each ray is paired with itself: such a sum is symmetric and is given only for basis p <= q.
    row, column : (B,) int arrays
        Row image and column image of each block.
    wide, scale : (M, k) arrays
        Place and factor of each image's unknowns, of which there are ``size`` (M,).
    """
    b2, end = sums.shape[1], sums.shape[2]
    total, half = np.empty((b2, end)), np.empty((b2, end))
    flat, offset, step = total.reshape(b2 * end), np.empty(wide.shape[1], np.int64), np.empty(wide.shape[1], np.int64)
    for n in range(lo, hi):
        i, j = row[n], column[n]
        c_a, c_b, b_b = n_components[i], n_components[j], n_basis[j]
        for q in range(size[j]):
            b_q, c_q = wide[j, q] // c_b, wide[j, q] % c_b
            offset[q] = b_q * end + place_in_sum(0, c_q, c_a, c_b)
            step[q] = place_in_sum(1, c_q, c_a, c_b) - place_in_sum(0, c_q, c_a, c_b)
        _add_up(begin[n], begin[n + 1], order, own, sums, n_basis[i], b_b, c_b, i == j, half, total)
        for p in range(size[i]):
            at, c_p, factor = wide[i, p] // c_a * b_b * end, wide[i, p] % c_a, scale[i, p]
            for q in range(size[j]):
                out[n, p, q] = factor * scale[j, q] * flat[at + offset[q] + step[q] * c_p]


@threaded
def _add_slot(sums: Array, s: int, out: Array) -> None:
    """Add the sums (b^2, e) of a slot."""
    for m in range(out.shape[0]):
        for e in range(out.shape[1]):
            out[m, e] += sums[s, m, e]


@threaded
def _add_up(
    lo: int, hi: int, order: Small, own: Small, sums: Array, b_a: int, b_b: int, c_b: int, diagonal: bool, half: Array,
    total: Array,
) -> None:  # fmt: skip
    """Write the total (b^2, c^2) of the slots lo to hi of a block; ``half`` is a work array."""
    b2, end = sums.shape[1], sums.shape[2]
    for m in range(b2):
        for e in range(end):
            total[m, e], half[m, e] = 0.0, 0.0
    for k in range(lo, hi):
        s = order[k]
        if own[s] > 0:
            _add_slot(sums, s, half)
        else:
            _add_slot(sums, s, total)
    if not diagonal:
        return
    for p in range(b_a):
        for q in range(b_b):
            for c in range(c_b):
                for d in range(c_b):
                    low, high = p * b_b + q, q * b_b + p
                    here, turned = place_in_sum(c, d, c_b, c_b), place_in_sum(d, c, c_b, c_b)
                    total[low, here] += half[low, here] if p <= q else half[high, turned]


@threaded
def gather_gradients(
    begin: Index, order: Small, own: Small, row: Index, column: Index, gradients: Array, wide: Index, scale: Array,
    size: Index, n_components: Index, out: Array,
) -> None:  # fmt: skip
    """Add the gradients (S, b, c) of each image's slots, for the existing unknowns, to ``out`` (u,).

    For the other parameters see :func:`gather_blocks`.
    """
    first = np.empty(len(size) + 1, np.int64)
    first[0] = 0
    for i in range(len(size)):
        first[i + 1] = first[i] + size[i]
    for n in range(len(row)):
        i = row[n]
        if i != column[n]:
            continue
        for p in range(size[i]):
            b, c, total = wide[i, p] // n_components[i], wide[i, p] % n_components[i], 0.0
            for k in range(begin[n], begin[n + 1]):
                if own[order[k]] > 0:
                    total += gradients[order[k], b, c]
            out[first[i] + p] += scale[i, p] * total


@threaded
def widen(image: Array, wide: Index, scale: Array, size: Index, out: Array) -> None:
    """Write unknowns (M, k), in units of the components, to their places among the wide numbers (M, w)."""
    for i in range(len(size)):
        for p in range(size[i]):
            out[i, wide[i, p]] = image[i, p] * scale[i, p]
