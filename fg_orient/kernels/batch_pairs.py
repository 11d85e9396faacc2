"""The reduced camera system: what is left of the normal equations when the ground points are eliminated.

Two rays a, b of one ground point add ``J_a^T M J_b``, ``M = [a is b] I - Z_a Z_b^T``, ``Z = G R^T``
(``fg_orient.kernels.batch_points``), to the block of their images. With J = basis kron components the sum over many
pairs is a sum of ``basis_a basis_b`` times one small matrix of components: half the arithmetic of the full columns, and
a third of the memory traffic.

Points seen in the same images follow each other; a run of them is a *piece*: its pairs are the pairs of places among
their rays, for all its points. Pieces are cut into *chunks*, which do not depend on the number of threads. A chunk has
sums of its own, one *slot* for each block it adds to; ``fg_orient.kernels.batch_gather`` adds those of all, in one
order.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_points import SCALED
from fg_orient.kernels.batch_rows import Index, Small
from fg_orient.kernels.batch_sums import add_rows
from fg_orient.kernels.vectors import LANES, aligned, combine_nine, outer_nine

#: Points whose pairs are formed before they are added up: what is read and written then stays near the processor.
BATCH = 24


@threaded
def _form(
    n: int, a: int, b: int, rays: int, base: int, d_image: Array, scaled: Array, c_a: int, c_b: int, t: Array
) -> None:  # fmt: skip
    """Write ``D_a^T M D_b`` of the pair a, b and of its n - 1 followers, ``rays`` apart, to the rows of t."""
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
    """Write the products of basis values (b_a b_b, n) of the pair a, b and of its followers."""
    if b_a == 3 and b_b == 3:  # 1, tau, tau^2: the usual case, in a third of the time
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
    """Add ``D^T r`` of the ray a and of its followers to the gradient of a slot; ``line``, ``sample``: r in value."""
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
def _clear(lo: int, hi: int, sums: Array, gradients: Array) -> None:
    for s in range(lo, hi):
        for m in range(sums.shape[1]):
            for e in range(sums.shape[2]):
                sums[s, m, e] = 0.0
        for b in range(gradients.shape[1]):
            for c in range(gradients.shape[2]):
                gradients[s, b, c] = 0.0


@threaded
def pair_blocks(
    lo: int, hi: int, chunks: Index, pieces: Index, slots: Small, slot_begin: Index, image: Small, n_basis: Index,
    n_components: Index, basis: Array, base: int, d_image: Array, scaled: Array, sums: Array, gradients: Array,
) -> None:  # fmt: skip
    """Write sums (S, b^2, e) over pairs of basis values and of components, and gradients (S, b, c), of chunks lo to hi.

    Parameters
    ----------
    chunks, slot_begin : (N + 1,) int arrays
        First piece and first slot of each chunk.
    pieces : (Q, 5) int array
        First image point, first place, number of points, rays of each, first of its ``slots``.
    slots : int array
        Slot of each pair of rays j <= k of a piece, by j, then k; -1 for none.
    base : int
        Image point of row 0 of ``d_image`` (n, 2, c) and ``scaled`` (n, 8: Z, residuals reduced by the point);
        ``basis`` and ``image`` are those of all. ``d_image`` has :data:`fg_orient.kernels.vectors.SLACK` numbers more
        behind it.
    sums : (S, b^2, e) array
        Components c, d of a sum stand at :func:`fg_orient.kernels.vectors.place_in_sum`.
    """
    size = sums.shape[2]
    # one row more than used: the last product of nine writes beyond its own
    t, weight = aligned(BATCH + 1, max(size, gradients.shape[2])), np.zeros((sums.shape[1], BATCH))
    for g in range(lo, hi):
        _clear(slot_begin[g], slot_begin[g + 1], sums, gradients)
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
                        if i == j:  # two rays in one image stand in both orders
                            _form(n, b, a, rays, base, d_image, scaled, c_b, c_a, t)
                            _weigh(n, b, a, rays, basis, b_b, b_a, weight)
                            add_rows(n, weight, 0, b_a * b_b, t, end, sums, s)


@threaded
def image_gradients(
    lo: int, hi: int, chunks: Index, pieces: Index, slots: Small, slot_begin: Index, image: Small, n_basis: Index,
    n_components: Index, basis: Array, base: int, value: Array, d_image: Array, gradients: Array,
) -> None:  # fmt: skip
    """Write the gradients (S, b, c) of chunks lo to hi, not reduced; see :func:`pair_blocks`."""
    t, weight = np.zeros((BATCH, gradients.shape[2])), np.zeros((gradients.shape[1], BATCH))
    for g in range(lo, hi):
        for s in range(slot_begin[g], slot_begin[g + 1]):
            for b in range(gradients.shape[1]):
                for c in range(gradients.shape[2]):
                    gradients[s, b, c] = 0.0
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
