"""What the pairs of rays spend their time in, in vector instructions of 512 bits where the processor has them, or 256.

Written out, because the compiler does not find them: it unrolls a loop of nine before it could vectorise it, and it
asks before each sum of rows (``fg_orient.kernels.batch_sums``) whether the arrays overlap, which takes as long as the
sum. Nine components per image point are the usual case (position, velocity, angles): their product takes 14 ns instead
of 50
(measured). All arrays are contiguous; places are those of their elements in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import config
from numba.extending import intrinsic
from numba.np import arrayobj

from factors._compile import threaded
from factors._contract import Array


def _has(feature: str) -> bool:
    """Whether kernels are compiled for a processor with a feature: NUMBA_CPU_FEATURES says so, or the processor."""
    if config.CPU_FEATURES is not None:
        return f"+{feature}" in config.CPU_FEATURES.split(",")
    return bool(binding.get_host_cpu_features().get(feature))


#: Numbers of one vector; a sum has the same bits with any.
LANES: Final = 8 if _has("avx512f") else 4
#: Numbers that are read beyond nine: vectors are whole.
SLACK: Final = -9 % LANES
_INT: Final = ir.IntType(64)


def padded(n: int) -> int:
    """Least multiple of :data:`LANES` that holds n numbers."""
    return -(-n // LANES) * LANES


def splat(builder: Any, number: Any, lanes: int = LANES) -> Any:
    """All lanes one number."""
    empty = ir.Constant(ir.VectorType(ir.DoubleType(), lanes), ir.Undefined)
    one = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))


def _sum(builder: Any, a: Any, x: Any, b: Any, y: Any) -> Any:
    """``a x + b y``, fused."""
    flags = ("contract",)
    return builder.fadd(builder.fmul(a, x, flags=flags), builder.fmul(b, y, flags=flags), flags=flags)


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Address of the first element of an array."""
    make_array: Callable[..., Any] = arrayobj.make_array
    return make_array(kind)(context, builder, array).data


def _vector_at(builder: Any, pointer: Any, offset: Any, lanes: int) -> Any:
    """Address of a vector of numbers from an offset."""
    place = ir.Constant(_INT, offset) if isinstance(offset, int) else offset
    return builder.bitcast(builder.gep(pointer, [place]), ir.VectorType(ir.DoubleType(), lanes).as_pointer())


def load(builder: Any, pointer: Any, offset: Any, lanes: int = LANES) -> Any:
    """A vector of numbers from an offset."""
    out = builder.load(_vector_at(builder, pointer, offset, lanes))
    out.align = 8
    return out


def store(builder: Any, vector: Any, pointer: Any, offset: Any) -> None:
    """Write a vector from an offset."""
    builder.store(vector, _vector_at(builder, pointer, offset, vector.type.count)).align = 8


def number_at(builder: Any, pointer: Any, offset: int) -> Any:
    """All lanes the number at an offset."""
    return splat(builder, builder.load(builder.gep(pointer, [ir.Constant(_INT, offset)])))


def _columns(builder: Any, kind: Any, context: Any, array: Any, width: Any, row: Any) -> tuple[Any, Any]:
    """Addresses of both lines of a row of an array (n, 2, width)."""
    first = builder.gep(
        data_of(context, builder, kind, array), [builder.mul(builder.mul(row, width), ir.Constant(_INT, 2))]
    )
    return first, builder.gep(first, [width])


def _outer_nine(
    typing: Any, out: Any, at: Any, rows: Any, width: Any, a: Any, b: Any, m00: Any, m01: Any, m10: Any, m11: Any
) -> Any:
    """Write ``T = D_a^T M D_b`` (9 x 9) from place ``at`` of ``out``; D are rows a and b of ``rows`` (n, 2, width).

    First eight columns of T, row by row, then the ninth, so that no vector stands across two lines of memory:
    :func:`place_in_sum`. Nine columns of D count, and more are read; the product is :func:`padded`.
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
    """Write ``D_a^T (x, y)``, nine numbers and what a vector holds beyond them, from place ``at`` of ``out``."""
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


#: Compiled only; the first argument is numba's.
outer_nine: Callable[..., None] = intrinsic(_outer_nine)
combine_nine: Callable[..., None] = intrinsic(_combine_nine)


@threaded
def place_in_sum(c: int, d: int, c_a: int, c_b: int) -> int:
    """Place of the product of components c of c_a and d of c_b; of nine by nine as ``outer_nine`` writes it."""
    if c_a == 9 and c_b == 9:
        return 8 * c + d if d < 8 else 72 + c
    return c * c_b + d


@threaded
def aligned(rows: int, width: int) -> Array:
    """Zeros (rows, width) from the start of a cache line: vectors across two lines are half as fast (measured)."""
    space = np.zeros(rows * width + 8)
    skip = (-space.ctypes.data % 64) // 8
    return space[skip : skip + rows * width].reshape(rows, width)
