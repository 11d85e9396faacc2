"""What the pairs of rays spend their time in, in vector instructions of 256 bits.

Written out, because the compiler does not find them: it unrolls a loop of nine before it could vectorise it, and it
asks before each sum of rows whether the arrays overlap, which takes as long as the sum. Nine components per image point
are the usual case (position, velocity, angles): their product takes 14 ns instead of 50, and its sum with nine
weights 40 instead of 75 (measured). All arrays are contiguous; places are those of their elements in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj

#: Numbers that one call reads and writes beyond what it means: its vectors hold 12.
SLACK: Final = 3
_LANES = ir.VectorType(ir.DoubleType(), 4)
_INT: Final = ir.IntType(64)


def _splat(builder: Any, number: Any) -> Any:
    """All lanes one number."""
    empty, places = ir.Constant(_LANES, ir.Undefined), ir.VectorType(ir.IntType(32), 4)
    one = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, empty, ir.Constant(places, [0] * 4))


def _sum(builder: Any, a: Any, x: Any, b: Any, y: Any) -> Any:
    """``a x + b y``, fused."""
    flags = ("contract",)
    return builder.fadd(builder.fmul(a, x, flags=flags), builder.fmul(b, y, flags=flags), flags=flags)


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Address of the first element of an array."""
    make_array: Callable[..., Any] = arrayobj.make_array
    return make_array(kind)(context, builder, array).data


def _vector(builder: Any, pointer: Any, offset: Any) -> Any:
    """Address of four numbers from an offset."""
    return builder.bitcast(builder.gep(pointer, [offset]), _LANES.as_pointer())


def _load(builder: Any, pointer: Any, offset: Any) -> Any:
    """Four numbers from an offset."""
    out = builder.load(_vector(builder, pointer, offset))
    out.align = 8
    return out


def _number(builder: Any, pointer: Any, offset: int) -> Any:
    """All lanes the number at an offset."""
    return _splat(builder, builder.load(builder.gep(pointer, [ir.Constant(_INT, offset)])))


def _outer_nine(
    typing: Any, out: Any, at: Any, rows: Any, a: Any, b: Any, m00: Any, m01: Any, m10: Any, m11: Any
) -> Any:
    """Write ``D_a^T M D_b`` (9 x 9, row-major) from place ``at`` of ``out``; D are rows a and b of ``rows`` (n, 2, 9).

    Arrays are contiguous. :data:`SLACK` numbers after the last row are read, and as many after the product written.
    """
    number = types.float64
    signature = types.void(out, types.intp, rows, types.intp, types.intp, number, number, number, number)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target, source = (_data(context, builder, given.args[k], arguments[k]) for k in (0, 2))
        target = builder.gep(target, [arguments[1]])
        first, second = (builder.gep(source, [builder.mul(arguments[k], ir.Constant(_INT, 18))]) for k in (3, 4))
        m = [_splat(builder, number) for number in arguments[5:]]
        x, y = ([_load(builder, second, ir.Constant(_INT, 9 * r + 4 * k)) for k in range(3)] for r in range(2))
        turned = [[_sum(builder, m[2 * r], x[k], m[2 * r + 1], y[k]) for k in range(3)] for r in range(2)]
        for c in range(9):
            d = [_number(builder, first, 9 * r + c) for r in range(2)]
            for k in range(3):
                product = _sum(builder, d[0], turned[0][k], d[1], turned[1][k])
                builder.store(product, _vector(builder, target, ir.Constant(_INT, 9 * c + 4 * k))).align = 8
        return context.get_dummy_value()

    return signature, generate


def _adder(rows: int) -> Callable[..., None]:
    """Make the function that adds so many rows at once: an element of the sum is then loaded and stored once."""

    def add_rows(
        typing: Any, out: Any, at: Any, t: Any, begin: Any, stride: Any, weight: Any, w: Any, fours: Any
    ) -> Any:
        place = types.intp
        signature = types.void(out, place, t, place, place, weight, place, place)

        def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
            target, source, weights = (_data(context, builder, given.args[k], arguments[k]) for k in (0, 2, 5))
            target, weights = builder.gep(target, [arguments[1]]), builder.gep(weights, [arguments[6]])
            start, factors = [builder.gep(source, [arguments[3]])], [_number(builder, weights, r) for r in range(rows)]
            for _ in range(rows - 1):
                start.append(builder.gep(start[-1], [arguments[4]]))
            with cgutils.for_range(builder, arguments[7]) as loop:
                e = builder.mul(loop.index, ir.Constant(_INT, 4))
                total = [_load(builder, target, e)]
                for r in range(rows):
                    product = builder.fmul(factors[r], _load(builder, start[r], e), flags=("contract",))
                    if r == rows // 2 and r > 0:
                        total.append(product)
                    else:
                        total[-1] = builder.fadd(total[-1], product, flags=("contract",))
                builder.store(
                    total[0] if rows == 1 else builder.fadd(*total), _vector(builder, target, e)
                ).align = 8  # fmt: skip
            return context.get_dummy_value()

        return signature, generate

    compiled: Callable[..., None] = intrinsic(add_rows)
    return compiled


#: Compiled only; the first argument is numba's.
outer_nine: Callable[..., None] = intrinsic(_outer_nine)
#: ``f(out, at, t, begin, stride, weight, w, fours)``: to ``out`` from ``at`` add eight rows, or one, of ``t``, the
#: first from ``begin``, each ``stride`` behind the one before, times the numbers of ``weight`` from ``w``; four times
#: ``fours`` elements.
add_eight = _adder(8)
add_one = _adder(1)
