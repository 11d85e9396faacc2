"""Inner loops with vector instructions of 512 bits, or 256 bits if the processor has no wider ones.

The loops are written explicitly because the compiler does not generate them for two kinds of loops. The
compiler unrolls a loop of nine and then does not vectorise it. Before each sum of rows
(``fg_orient.kernels.batch_pairs``) it tests whether the arrays overlap, which takes as long as the sum.
Nine components per image point (position, velocity, angles) are the usual case: their product takes 14
ns instead of 50 (measured). All arrays are contiguous; a place is the position of an element in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config, errors
from numba.extending import intrinsic
from numba.np import arrayobj

from factors._compile import threaded
from factors._contract import Array


def _has(feature: str) -> bool:
    """Return whether kernels are compiled for a feature of the processor (or of NUMBA_CPU_FEATURES)."""
    if config.CPU_FEATURES is not None:
        return f"+{feature}" in config.CPU_FEATURES.split(",")
    return bool(binding.get_host_cpu_features().get(feature))


#: Number of elements of one vector; the bits of a sum do not depend on it.
LANES: Final = 8 if _has("avx512f") else 4
#: Number of elements read after the nine used ones, because whole vectors are read.
SLACK: Final = -9 % LANES
_INT: Final = ir.IntType(64)


def padded(n: int) -> int:
    """Return the smallest multiple of :data:`LANES` that is at least n."""
    return -(-n // LANES) * LANES


def splat(builder: Any, number: Any, lanes: int = LANES) -> Any:
    """Return a vector with the same number in all lanes."""
    empty = ir.Constant(ir.VectorType(ir.DoubleType(), lanes), ir.Undefined)
    one = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))


def _sum(builder: Any, a: Any, x: Any, b: Any, y: Any) -> Any:
    """Return ``a x + b y``, computed with fused operations."""
    flags = ("contract",)
    return builder.fadd(builder.fmul(a, x, flags=flags), builder.fmul(b, y, flags=flags), flags=flags)


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Return the address of the first element of an array."""
    make_array: Callable[..., Any] = arrayobj.make_array
    return make_array(kind)(context, builder, array).data


def _vector_at(builder: Any, pointer: Any, offset: Any, lanes: int) -> Any:
    """Return the address of a vector that begins at an offset."""
    place = ir.Constant(_INT, offset) if isinstance(offset, int) else offset
    return builder.bitcast(builder.gep(pointer, [place]), ir.VectorType(ir.DoubleType(), lanes).as_pointer())


def load(builder: Any, pointer: Any, offset: Any, lanes: int = LANES) -> Any:
    """Return the vector that begins at an offset."""
    out = builder.load(_vector_at(builder, pointer, offset, lanes))
    out.align = 8
    return out


def store(builder: Any, vector: Any, pointer: Any, offset: Any) -> None:
    """Write a vector at an offset."""
    builder.store(vector, _vector_at(builder, pointer, offset, vector.type.count)).align = 8


def number_at(builder: Any, pointer: Any, offset: int) -> Any:
    """Return a vector with the number at an offset in all lanes."""
    return splat(builder, builder.load(builder.gep(pointer, [ir.Constant(_INT, offset)])))


def _columns(builder: Any, kind: Any, context: Any, array: Any, width: Any, row: Any) -> tuple[Any, Any]:
    """Return the addresses of both lines of a row of an array (n, 2, width)."""
    first = builder.gep(
        data_of(context, builder, kind, array), [builder.mul(builder.mul(row, width), ir.Constant(_INT, 2))]
    )
    return first, builder.gep(first, [width])


def _outer_nine(
    typing: Any, out: Any, at: Any, rows: Any, width: Any, a: Any, b: Any, m00: Any, m01: Any, m10: Any, m11: Any
) -> Any:
    """Write ``T = D_a^T M D_b`` (9 x 9) from place ``at`` of ``out``; D_a, D_b are rows a, b of ``rows`` (n, 2, width).

    The first eight columns of T are written row by row, then the ninth, so that no vector crosses a cache line:
    :func:`place_in_sum`. Nine columns of D are used, but more are read; the product is :func:`padded`.
    """
    number, place = types.float64, types.intp
    signature = types.void(out, place, rows, place, place, place, number, number, number, number)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target = builder.gep(data_of(context, builder, given.args[0], arguments[0]), [arguments[1]])
        d_a, d_b = (_columns(builder, given.args[2], context, arguments[2], arguments[3], arguments[k]) for k in (4, 5))
        m = [splat(builder, number) for number in arguments[6:]]
        for k in range(0, 8, LANES):
            x, y = (load(builder, line, ir.Constant(_INT, k)) for line in d_b)
            turned = [_sum(builder, m[2 * r], x, m[2 * r + 1], y) for r in range(2)]
            for c in range(9):
                one, two = (number_at(builder, line, c) for line in d_a)
                product = _sum(builder, one, turned[0], two, turned[1])
                store(builder, product, target, 8 * c + k)
        x, y = (number_at(builder, line, 8) for line in d_b)
        turned = [_sum(builder, m[2 * r], x, m[2 * r + 1], y) for r in range(2)]
        for k in range(0, 9, LANES):
            one, two = (load(builder, line, ir.Constant(_INT, k)) for line in d_a)
            store(builder, _sum(builder, turned[0], one, turned[1], two), target, 72 + k)
        return context.get_dummy_value()

    return signature, generate


def _combine_nine(typing: Any, out: Any, at: Any, rows: Any, width: Any, a: Any, x: Any, y: Any) -> Any:
    """Write ``D_a^T (x, y)`` from place ``at`` of ``out``: nine numbers, and the rest of the last vector."""
    signature = types.void(out, types.intp, rows, types.intp, types.intp, types.float64, types.float64)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target = builder.gep(data_of(context, builder, given.args[0], arguments[0]), [arguments[1]])
        one, two = _columns(builder, given.args[2], context, arguments[2], arguments[3], arguments[4])
        x, y = (splat(builder, number) for number in arguments[5:])
        for k in range(0, 9, LANES):
            place = ir.Constant(_INT, k)
            store(builder, _sum(builder, x, load(builder, one, place), y, load(builder, two, place)), target, k)
        return context.get_dummy_value()

    return signature, generate


#: Only for compiled code; numba supplies the first argument.
outer_nine: Callable[..., None] = intrinsic(_outer_nine)
combine_nine: Callable[..., None] = intrinsic(_combine_nine)


@threaded
def place_in_sum(c: int, d: int, c_a: int, c_b: int) -> int:
    """Return the place of the product of components c of c_a and d of c_b.

    ``outer_nine`` writes nine by nine in this order.
    """
    if c_a == 9 and c_b == 9:
        return 8 * c + d if d < 8 else 72 + c
    return c * c_b + d


@threaded
def aligned(rows: int, width: int) -> Array:
    """Return zeros (rows, width) that begin at a cache line. Vectors across two lines are half as fast (measured)."""
    space = np.zeros(rows * width + 8)
    skip = (-space.ctypes.data % 64) // 8
    return space[skip : skip + rows * width].reshape(rows, width)


#: Side length of a tile in numbers; processors with narrower vectors use several vectors per line. Tiles are transposed
#: if arrays are stored by observation but computed side by side: copying the 34 numbers of a record one by one takes 9
#: ns, by tiles half of that (measured).
SIDE: Final = 8
_LANE: Final = ir.IntType(32)
LINE: Final = ir.VectorType(ir.DoubleType(), SIDE)


def contiguous(*arrays: Any) -> None:
    """Refuse an array that is not contiguous, during compilation."""
    if any(a.layout != "C" for a in arrays):
        raise errors.TypingError("tiles are read from contiguous arrays only")


def element(builder: Any, pointer: Any, at: Any, k: int) -> Any:
    """Return the number k after a place."""
    return builder.load(builder.gep(pointer, [builder.add(at, ir.Constant(at.type, k))]))


def _shuffled(builder: Any, line: Any, lanes: list[int]) -> Any:
    """Return the selected lanes of a line, in this order."""
    return builder.shuffle_vector(line, line, ir.Constant(ir.VectorType(_LANE, len(lanes)), lanes))


def total_of(builder: Any, line: Any) -> Any:
    """Return the sum of the lanes, added in a fixed order so that the bits do not depend on the processor."""
    for half in (4, 2, 1):
        low, high = (_shuffled(builder, line, list(range(at, at + half))) for at in (0, half))
        line = builder.fadd(low, high)
    return builder.extract_element(line, ir.Constant(_LANE, 0))


def _swapped(builder: Any, a: Any, b: Any, apart: int) -> tuple[Any, Any]:
    """Return lines a and b of a tile after one step of the transposition: blocks of ``apart`` numbers are exchanged."""
    index = ir.VectorType(_LANE, SIDE)
    low = [k if not k & apart else SIDE + k - apart for k in range(SIDE)]
    high = [k + apart if not k & apart else SIDE + k for k in range(SIDE)]
    return tuple(builder.shuffle_vector(a, b, ir.Constant(index, mask)) for mask in (low, high))


def _turned(builder: Any, tile: list[Any]) -> list[Any]:
    """Return the transpose of eight lines."""
    for apart in (4, 2, 1):
        for k in (k for k in range(SIDE) if not k & apart):
            tile[k], tile[k + apart] = _swapped(builder, tile[k], tile[k + apart], apart)
    return tile


def _listed(builder: Any, base: Any, places: Any, shift: Any) -> list[Any]:
    """Return the addresses ``places[k] + shift``."""
    listed = [builder.load(builder.gep(places, [ir.Constant(shift.type, k)])) for k in range(SIDE)]
    return [builder.gep(base, [builder.add(place, shift)]) for place in listed]


def _spaced(builder: Any, base: Any, at: Any, apart: Any) -> list[Any]:
    """Return the addresses ``at + k apart``."""
    return [builder.gep(base, [builder.add(at, builder.mul(ir.Constant(at.type, k), apart))]) for k in range(SIDE)]


def _turner(gathers: bool) -> Callable[..., None]:
    """Return a function that copies lines at listed places to columns, or lines to columns at listed places."""

    def turn(typing: Any, source: Any, target: Any, places: Any, shift: Any, at: Any, apart: Any) -> Any:
        contiguous(source, target, places)
        place = types.intp

        def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
            read, written, listed = (data_of(context, builder, given.args[k], arguments[k]) for k in range(3))
            here = _listed(builder, read if gathers else written, listed, arguments[3])
            there = _spaced(builder, written if gathers else read, *arguments[4:])
            lines = [load(builder, pointer, 0, SIDE) for pointer in (here if gathers else there)]
            for line, pointer in zip(_turned(builder, lines), there if gathers else here, strict=True):
                store(builder, line, pointer, 0)
            return context.get_dummy_value()

        return types.void(source, target, places, place, place, place), generate

    compiled: Callable[..., None] = intrinsic(turn)
    return compiled


#: Compiled code calls ``f(source, target, places, shift, at, apart)``. ``turn_in`` reads line k of the source at
#: ``places[k] + shift``, and writes it as a column of the target; the columns begin at ``at`` and have the distance
#: ``apart``. ``turn_out`` reads the lines of the source at ``at``, ``at + apart``, ..., and writes line k as the column
#: ``places[k] + shift`` of the target.
turn_in, turn_out = _turner(gathers=True), _turner(gathers=False)


#: The usual case: position, velocity and angles of a pushbroom image with quadratic polynomials; nine components, each
#: a sum of three basis values times unknowns. With plain loops, the sums of an observation take 17 ns,
#: and the product of its row and a step takes 18 ns. With these instructions they take 4 and 5 ns
#: (measured).
N_BASIS: Final = 3
N_COMPONENTS: Final = 9


def _write_eight(typing: Any, out: Any, to: Any, wide: Any, at: Any, basis: Any, place: Any) -> Any:
    """Write, from ``to`` of ``out``, the first eight components of the unknowns from ``at`` of ``wide``.

    Each product and sum is rounded, in the order of a loop that starts with zero.
    """
    contiguous(out, wide, basis)
    signature = types.void(out, types.intp, wide, types.intp, basis, types.intp)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target, unknowns, values = (data_of(context, builder, given.args[k], arguments[k]) for k in (0, 2, 4))
        total = ir.Constant(LINE, [0.0] * SIDE)
        for b in range(N_BASIS):
            at = builder.add(arguments[3], ir.Constant(arguments[3].type, b * N_COMPONENTS))
            value = splat(builder, element(builder, values, arguments[5], b), SIDE)
            total = builder.fadd(total, builder.fmul(value, load(builder, unknowns, at, SIDE)))
        store(builder, total, target, arguments[1])
        return context.get_dummy_value()

    return signature, generate


def _row_along(typing: Any, rows: Any, row: Any, basis: Any, place: Any, wide: Any, at: Any) -> Any:
    """Return both lines of a Jacobian (``row`` of ``rows``) times components of unknowns from ``at`` of ``wide``."""
    contiguous(rows, basis, wide)
    pair: Any = types.UniTuple
    signature = pair(types.float64, 2)(rows, types.intp, basis, types.intp, wide, types.intp)
    fused = ("contract",)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        lines, values, unknowns = (data_of(context, builder, given.args[k], arguments[k]) for k in (0, 2, 4))
        parts = []
        for b in range(N_BASIS):
            at = builder.add(arguments[5], ir.Constant(arguments[5].type, b * N_COMPONENTS))
            value, eight = element(builder, values, arguments[3], b), load(builder, unknowns, at, SIDE)
            last = element(builder, unknowns, at, SIDE)
            product = (
                builder.fmul(splat(builder, value, SIDE), eight, flags=fused),
                builder.fmul(value, last, flags=fused),
            )
            parts.append(product)
        x, ninth = parts[0]
        for more, last in parts[1:]:
            x, ninth = builder.fadd(x, more, flags=fused), builder.fadd(ninth, last, flags=fused)
        out = []
        for r in range(2):
            at = builder.add(arguments[1], ir.Constant(arguments[1].type, r * N_COMPONENTS))
            eight = total_of(builder, builder.fmul(x, load(builder, lines, at, SIDE)))
            last = builder.fmul(ninth, element(builder, lines, at, SIDE), flags=fused)
            out.append(builder.fadd(eight, last, flags=fused))
        pack: Any = cgutils.pack_array
        return pack(builder, out)

    return signature, generate


#: Only for compiled code; numba supplies the first argument.
write_eight: Callable[..., None] = intrinsic(_write_eight)
row_along: Callable[..., tuple[float, float]] = intrinsic(_row_along)
