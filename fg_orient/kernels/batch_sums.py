"""Weighted rows added to sums: eight rows and up to three sums at once.

An element of a sum is then loaded and stored once for eight rows, and an element of a row is loaded once for three
sums, whose weights remain in registers: the nine sums of a pair of rays take 20 ns one by one, 16 ns by threes
(measured).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.vectors import LANES, data_of, load, number_at, store

#: Sums at once: where vectors are narrower there are not enough registers for the weights of three.
TOGETHER: Final = 3 if LANES == 8 else 1
_FUSED: Final = ("contract",)


def _sum(builder: Any, first: Any, factors: list[Any], rows: list[Any]) -> Any:
    """``first`` plus all products; for eight and four rows the second half has a separate sum."""
    total, half = [first], len(rows) // 2
    for r, (factor, row) in enumerate(zip(factors, rows, strict=True)):
        product = builder.fmul(factor, row, flags=_FUSED)
        if r == half and r > 0:
            total.append(product)
        else:
            total[-1] = builder.fadd(total[-1], product, flags=_FUSED)
    return total[0] if len(total) == 1 else builder.fadd(*total)


def _adder(rows: int) -> Callable[..., None]:
    """Make the function that adds this number of rows to one, two or three sums."""

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


#: Compiled only; the first argument is numba's. ``f(out, at, apart, t, begin, stride, weight, w, width, vectors,
#: sums)``: to sums from ``at`` of ``out``, ``apart``, add eight, four, two rows or one from ``begin`` of ``t``,
#: ``stride`` behind each other, times the numbers of ``weight`` from ``w``, ``width`` further for the next sum;
#: ``vectors`` times LANES elements.
_eight, _four, _two, _one = _adder(8), _adder(4), _adder(2), _adder(1)


@threaded
def _add(n: int, weight: Array, m: int, sums: int, t: Array, end: int, out: Array, s: int) -> None:
    """Add n rows to up to TOGETHER sums: by eights, then the remainder by four, two and one."""
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
    """Add n rows of t, ``end`` numbers each, times rows m ... m + sums - 1 of ``weight``, to ``out[s, m]`` ..."""
    for first in range(m, m + sums, TOGETHER):
        _add(n, weight, first, min(TOGETHER, m + sums - first), t, end, out, s)
