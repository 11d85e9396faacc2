"""Tiles of eight by eight numbers turned over, for what stands observation by observation and is computed side by side.

To copy the 34 numbers of a record one by one takes 9 ns, by tiles half of it (measured).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import errors
from numba.extending import intrinsic

from fg_orient.kernels.vectors import data_of, load, store

#: Numbers along a side of a tile; processors with narrower vectors take several for a line.
SIDE: Final = 8
_LANE: Final = ir.IntType(32)
LINE: Final = ir.VectorType(ir.DoubleType(), SIDE)


def contiguous(*arrays: Any) -> None:
    """Refuse, while compiling, an array whose elements do not follow each other."""
    if any(a.layout != "C" for a in arrays):
        raise errors.TypingError("tiles are read from contiguous arrays only")


def element(builder: Any, pointer: Any, at: Any, k: int) -> Any:
    """Number k behind a place."""
    return builder.load(builder.gep(pointer, [builder.add(at, ir.Constant(at.type, k))]))


def _shuffled(builder: Any, line: Any, lanes: list[int]) -> Any:
    """Lanes of a line, in this order."""
    return builder.shuffle_vector(line, line, ir.Constant(ir.VectorType(_LANE, len(lanes)), lanes))


def total_of(builder: Any, line: Any) -> Any:
    """Sum of the lanes: halves, quarters, neighbours, so that the bits do not depend on the processor."""
    for half in (4, 2, 1):
        low, high = (_shuffled(builder, line, list(range(at, at + half))) for at in (0, half))
        line = builder.fadd(low, high)
    return builder.extract_element(line, ir.Constant(_LANE, 0))


def _swapped(builder: Any, a: Any, b: Any, apart: int) -> tuple[Any, Any]:
    """Lines a and b after the squares of ``apart`` numbers on their other diagonal have changed places."""
    index = ir.VectorType(_LANE, SIDE)
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


#: Compiled only; the first argument is numba's. ``f(source, target, places, shift, at, apart)``: lines from
#: ``places[k] + shift`` of the source become columns, the first from ``at`` of the target, ``apart``; and lines from
#: ``at``, ``apart``, become columns from ``places[k] + shift`` of the target.
turn_in, turn_out = _turner(gathers=True), _turner(gathers=False)
