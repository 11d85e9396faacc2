"""Tiles of eight by eight numbers turned over, for what stands observation by observation and is computed side by side.

To copy 34 numbers of an observation one by one takes 9 ns, by tiles 3; the sum of three basis values times nine
numbers 17 and 4 (measured). Numbers are copied, or rounded as they are written: the bits are those of plain loops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import errors
from numba.extending import intrinsic

from factors.vectors import data_of

#: Numbers along a side of a tile; processors with narrower vectors take several for a line.
SIDE: Final = 8
_LINE: Final = ir.VectorType(ir.DoubleType(), SIDE)


def _contiguous(*arrays: Any) -> None:
    """Refuse, while compiling, an array whose elements do not follow each other."""
    if any(a.layout != "C" for a in arrays):
        raise errors.TypingError("tiles are read from contiguous arrays only")


def _line(builder: Any, pointer: Any) -> Any:
    return builder.bitcast(pointer, _LINE.as_pointer())


def _load(builder: Any, pointer: Any) -> Any:
    out = builder.load(_line(builder, pointer))
    out.align = 8
    return out


def _store(builder: Any, line: Any, pointer: Any) -> None:
    builder.store(line, _line(builder, pointer)).align = 8


def _swapped(builder: Any, a: Any, b: Any, apart: int) -> tuple[Any, Any]:
    """Lines a and b after the squares of ``apart`` numbers on their other diagonal have changed places."""
    index = ir.VectorType(ir.IntType(32), SIDE)
    low = [k if not k & apart else SIDE + k - apart for k in range(SIDE)]
    high = [k + apart if not k & apart else SIDE + k for k in range(SIDE)]
    return tuple(builder.shuffle_vector(a, b, ir.Constant(index, mask)) for mask in (low, high))


def _turned(builder: Any, tile: list[Any]) -> list[Any]:
    """Columns of eight lines."""
    for apart in (4, 2, 1):
        for k in (k for k in range(SIDE) if not k & apart):
            tile[k], tile[k + apart] = _swapped(builder, tile[k], tile[k + apart], apart)
    return tile


def _listed(builder: Any, base: Any, places: Any, shift: Any) -> list[Any]:
    """Addresses ``places[k] + shift``."""
    listed = [builder.load(builder.gep(places, [ir.Constant(shift.type, k)])) for k in range(SIDE)]
    return [builder.gep(base, [builder.add(place, shift)]) for place in listed]


def _spaced(builder: Any, base: Any, at: Any, apart: Any) -> list[Any]:
    """Addresses ``at + k apart``."""
    return [
        builder.gep(base, [builder.add(at, builder.mul(ir.Constant(at.type, k), apart))]) for k in range(SIDE)
    ]  # fmt: skip


def _turner(gathers: bool) -> Callable[..., None]:
    """Make the function that copies lines at listed places to columns ``apart``, or lines ``apart`` to listed ones."""

    def turn(typing: Any, source: Any, target: Any, places: Any, shift: Any, at: Any, apart: Any) -> Any:
        _contiguous(source, target, places)
        place = types.intp

        def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
            read, written, listed = (data_of(context, builder, given.args[k], arguments[k]) for k in range(3))
            here = _listed(builder, read if gathers else written, listed, arguments[3])
            there = _spaced(builder, written if gathers else read, *arguments[4:])
            lines = [_load(builder, pointer) for pointer in (here if gathers else there)]
            for line, pointer in zip(_turned(builder, lines), there if gathers else here, strict=True):
                _store(builder, line, pointer)
            return context.get_dummy_value()

        return types.void(source, target, places, place, place, place), generate

    compiled: Callable[..., None] = intrinsic(turn)
    return compiled


def _sum_lines(typing: Any, out: Any, to: Any, wide: Any, at: Any, apart: Any, basis: Any, place: Any) -> Any:
    """Write to ``out`` from ``to`` the sum of three lines of ``wide``, ``apart``, times the three numbers of ``basis``.

    Products and sums are rounded one by one, in the order of a loop that begins with zero.
    """
    _contiguous(out, wide, basis)
    signature = types.void(out, types.intp, wide, types.intp, types.intp, basis, types.intp)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target, lines, factors = (data_of(context, builder, given.args[k], arguments[k]) for k in (0, 2, 5))
        line, total = builder.gep(lines, [arguments[3]]), ir.Constant(_LINE, [0.0] * SIDE)
        for k in range(3):
            place = builder.add(arguments[6], ir.Constant(arguments[6].type, k))
            number = builder.load(builder.gep(factors, [place]))
            same = builder.insert_element(ir.Constant(_LINE, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
            same = builder.shuffle_vector(same, same, ir.Constant(ir.VectorType(ir.IntType(32), SIDE), [0] * SIDE))
            total = builder.fadd(total, builder.fmul(same, _load(builder, line)))
            line = builder.gep(line, [arguments[4]])
        _store(builder, total, builder.gep(target, [arguments[1]]))
        return context.get_dummy_value()

    return signature, generate


#: Compiled only; the first argument is numba's. ``f(source, target, places, shift, at, apart)``: lines from
#: ``places[k] + shift`` of the source become columns, the first from ``at`` of the target, ``apart``; and lines from
#: ``at``, ``apart``, become columns from ``places[k] + shift`` of the target.
turn_in, turn_out = _turner(gathers=True), _turner(gathers=False)
sum_lines: Callable[..., None] = intrinsic(_sum_lines)
