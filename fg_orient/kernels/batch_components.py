"""Nine components that are sums of three basis values times unknowns: their values, and rows along a step.

Position, velocity and angles of a pushbroom image with quadratic polynomials: the usual case. As plain loops the sums
take 17 ns for an observation, and its row along a step 18; here 4 and 5 (measured).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fg_orient.kernels.batch_tiles import LINE, SIDE, contiguous, element, total_of
from fg_orient.kernels.vectors import data_of, load, splat, store

N_BASIS: Final = 3
N_COMPONENTS: Final = 9


def _write_eight(typing: Any, out: Any, to: Any, wide: Any, at: Any, basis: Any, place: Any) -> Any:
    """Write to ``out`` from ``to`` the first eight components of unknowns from ``at`` of ``wide``.

    Products and sums are rounded one by one, in the order of a loop that begins with zero.
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
    """Both lines of a Jacobian from ``row`` of ``rows`` times the components of unknowns from ``at`` of ``wide``."""
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


#: Compiled only; the first argument is numba's.
write_eight: Callable[..., None] = intrinsic(_write_eight)
row_along: Callable[..., tuple[float, float]] = intrinsic(_row_along)
