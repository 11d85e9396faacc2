"""Built-in losses as functions of arrays ``u >= 0``, and the table that lists them.

The influence of Andrews' sine is the arch of a sine that ends at pi. Cauchy's (Lorentz's)
loss grows with the logarithm. The Danish method has its continuous form here; in its
original form the exponent depends on the cycle, which is an iteration
(``fg_orient.adjustment.robust``). The weights of Geman and McClure and of Welsch never
reach zero, but their losses are bounded. Hampel's influence is constant from a to b = 2a
and zero from c = 5a; its u is in units of a. Only Huber's loss is convex. Truncated least
squares has the weights 1 and 0 only. Tukey's biweight has no influence beyond c.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors._contract import Array
from factors.losses import Loss, register

#: Constants b and c of Hampel's loss in units of a, from the proportions of 1.7, 3.4, 8.5 (Hampel 1974).
_B: Final = 2.0
_C: Final = 5.0


def _andrews(u: Array) -> Array:
    return np.asarray(np.where(u < np.pi, np.sinc(u / np.pi), 0.0))


def _andrews_cost(u: Array) -> Array:
    return np.asarray(2.0 * np.sin(0.5 * np.minimum(u, np.pi)) ** 2)  # 1 - cos u without cancellation


def _cauchy(u: Array) -> Array:
    return np.asarray(1.0 / (1.0 + u**2))


def _cauchy_cost(u: Array) -> Array:
    return np.asarray(0.5 * np.log1p(u**2))


def _danish(u: Array) -> Array:
    return np.asarray(np.exp(np.minimum(1.0 - u**2, 0.0)))


def _danish_cost(u: Array) -> Array:
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, 0.5 - 0.5 * np.expm1(np.minimum(1.0 - u**2, 0.0))))


def _geman_mcclure(u: Array) -> Array:
    return np.asarray(1.0 / (1.0 + u**2) ** 2)


def _geman_mcclure_cost(u: Array) -> Array:
    return np.asarray(0.5 * u**2 / (1.0 + u**2))


def _hampel(u: Array) -> Array:
    falling = np.maximum(_C - u, 0.0) / ((_C - _B) * np.maximum(u, _B))
    return np.asarray(np.where(u <= _B, 1.0 / np.maximum(u, 1.0), falling))


def _hampel_cost(u: Array) -> Array:
    end = np.minimum(u, _C)
    falling = _B - 0.5 + (_C * (end - _B) - 0.5 * (end**2 - _B**2)) / (_C - _B)
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, np.where(u <= _B, u - 0.5, falling)))


def _huber(u: Array) -> Array:
    return np.asarray(np.minimum(1.0, 1.0 / np.maximum(u, 1.0)))


def _huber_cost(u: Array) -> Array:
    return np.asarray(np.where(u <= 1.0, 0.5 * u**2, u - 0.5))


def _tls(u: Array) -> Array:
    return np.asarray(np.where(u <= 1.0, 1.0, 0.0))


def _tls_cost(u: Array) -> Array:
    return np.asarray(0.5 * np.minimum(u, 1.0) ** 2)


def _tukey(u: Array) -> Array:
    return np.asarray(np.maximum(1.0 - u**2, 0.0) ** 2)


def _tukey_cost(u: Array) -> Array:
    return np.asarray((1.0 - np.maximum(1.0 - u**2, 0.0) ** 3) / 6.0)


def _welsch(u: Array) -> Array:
    return np.asarray(np.exp(-(u**2)))


def _welsch_cost(u: Array) -> Array:
    return np.asarray(-0.5 * np.expm1(-(u**2)))


GEMAN_MCCLURE = Loss("geman_mcclure", _geman_mcclure, _geman_mcclure_cost,
                     (3.787418761, 4.095552337, 4.337289950), "Geman & McClure 1985")  # fmt: skip
HUBER = Loss("huber", _huber, _huber_cost, (1.344997509, 1.501141084, 1.627987920), "Huber 1964", (1.0,),
             redescending=False)  # fmt: skip
for _loss in (
    Loss("andrews", _andrews, _andrews_cost, (1.338710859, 1.462984352, 1.567162970), "Andrews 1974", (np.pi,)),
    Loss("cauchy", _cauchy, _cauchy_cost, (2.384947119, 2.548637624, 2.665568345), "Holland & Welsch 1977"),
    Loss("danish", _danish, _danish_cost, (1.993002202, 2.212605440, 2.404339807), "Krarup, Juhl & Kubik 1980",
         (1.0,)),
    GEMAN_MCCLURE,
    Loss("hampel", _hampel, _hampel_cost, (1.370552811, 1.525228239, 1.652560022), "Hampel 1974", (1.0, _B, _C)),
    HUBER,
    Loss("tls", _tls, _tls_cost, (2.795483483, 3.080215745, 3.327235744), "Yang et al. 2020, eq. 3", (1.0,)),
    Loss("tukey", _tukey, _tukey_cost, (4.685064949, 5.122986090, 5.490249208), "Beaton & Tukey 1974", (1.0,)),
    Loss("welsch", _welsch, _welsch_cost, (2.984637176, 3.250966769, 3.469061801), "Holland & Welsch 1977"),
):  # fmt: skip
    register(_loss)
