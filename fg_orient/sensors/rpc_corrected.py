"""Corrected RPC: a compensation put into the model itself, so that other programs see it, too.

With l, s the model's normalised line and sample and c the compensation (``factors.rfm``), pixels::

    line   = LINE_OFF + c0 + (LINE_SCALE + c2) l + c4 s
    sample = SAMP_OFF + c1 + (SAMP_SCALE + c5) s + c3 l

Shift, line drift with the line and sample change with the sample go into offsets and scales: exact. The mixed terms
are exact if both coordinates have the same denominator (numerators then add); else the model must be fitted again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fg_orient.errors import InputError
from fg_orient.sensors.rpc import RpcModel, checked_compensation

#: Fits a model to another one with a compensation; states its error in the notes of what it gives.
Refit = Callable[[RpcModel, npt.NDArray[np.float64]], RpcModel]


def is_exact(model: RpcModel, compensation: npt.ArrayLike) -> bool:
    """Tell whether the compensation can be put into the model without a new fit."""
    c = checked_compensation(compensation)
    return bool((c[3] == 0.0 and c[4] == 0.0) or np.array_equal(model.coefficients[1], model.coefficients[3]))


def corrected(model: RpcModel, compensation: npt.ArrayLike, refit: Refit | None = None) -> RpcModel:
    """Give the model with a compensation of its image inside.

    Parameters
    ----------
    model : RpcModel
    compensation : (6,) array
        Pixels, as ``Solution.correction`` gives them.
    refit : callable, optional
        Called as ``refit(model, compensation)`` where no exact form exists.

    Raises
    ------
    InputError
        No exact form, and no ``refit``.
    """
    c = checked_compensation(compensation)
    if not is_exact(model, c):
        if refit is None:
            value = f"sample per line {c[3]:.3g} px, line per sample {c[4]:.3g} px"
            raise InputError.of("rpc.not_exact", file=model.file, place="compensation", value=value)
        return refit(model, c)
    offsets, scales, coefficients = model.offsets.copy(), model.scales.copy(), model.coefficients.copy()
    offsets[:2] += c[:2]
    scales[:2] += c[[2, 5]]
    mixed = bool(c[3] or c[4])
    if mixed:
        coefficients[0] += c[4] / scales[0] * model.coefficients[2]
        coefficients[2] += c[3] / scales[1] * model.coefficients[0]
    note = (
        "corrected by line, sample "
        + ", ".join(f"{v:+.4f}" for v in c[:2])
        + " px and linear terms "
        + ", ".join(f"{v:+.4f}" for v in c[2:])
    )
    return replace(
        model, offsets=offsets, scales=scales, coefficients=coefficients, stated_validity=model.validity,
        direct=None if mixed else model.direct, notes=(*model.notes, note),
    )  # fmt: skip
