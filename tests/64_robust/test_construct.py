"""Losses made from their weight have costs and constants that agree with scipy and the registered losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid
from scipy.optimize import brentq
from scipy.stats import chi

import factors.losses as registry
from factors.losses import ALIASES, Loss, find, losses, register
from factors.losses.construct import constant_for, efficiency, loss_from_weight
from fg_orient.adjustment.robust import CONTROL, FLOOR, IMAGE, ScaledLoss, scaled

NAMES = tuple(losses())


def integral(loss: Loss, end: float) -> float:
    """Return ``int_0^end s w(s) ds`` by an adaptive quadrature between the corners."""
    places = [0.0, *(c for c in loss.corners if c < end), end]
    return sum(
        quad(lambda s: s * float(loss.weight(np.array(s))), a, b, epsabs=1e-13, limit=200)[0]
        for a, b in pairwise(places)
    )


def inconsistency(loss: Loss) -> float:
    """Return the largest difference of the cost from the integral of the weight."""
    return max(
        abs(float(loss.cost(np.array(u))) - integral(loss, u))
        for u in (0.2, 0.9, 1.1, 1.9, 2.5, 3.0, 3.3, 4.9, 6.0, 30.0)
    )


@pytest.mark.oracle
@pytest.mark.parametrize("name", NAMES)
def test_cost_is_the_integral_of_the_weight(name: str) -> None:
    assert inconsistency(losses()[name]) <= 1e-10


@pytest.mark.oracle
def test_a_cost_of_another_weight_is_found() -> None:
    known = losses()
    for a, b in (("huber", "hampel"), ("tukey", "andrews"), ("danish", "welsch")):
        assert inconsistency(replace(known[a], cost=known[b].cost)) > 1e-2


@pytest.mark.oracle
@pytest.mark.parametrize("name", NAMES)
def test_made_of_its_weight_a_loss_is_the_registered_one(name: str) -> None:
    loss = losses()[name]
    made = loss_from_weight("made", loss.weight, corners=loss.corners)
    assert made.constants == pytest.approx(loss.constants, rel=2e-9)
    u = np.concatenate([[0.0, 1e-9], np.linspace(0.01, 20.0, 397), np.geomspace(20.0, 1e6, 50)])
    expected = loss.cost(u)
    for at in (0.3, 1.0, 2.5, 9.0):
        ends = [0.0, *(c for c in loss.corners if c < at), at]
        integral = sum(
            quad(lambda s: s * float(loss.weight(np.array(s))), a, b, epsabs=1e-13)[0] for a, b in pairwise(ends)
        )
        assert float(made.cost(np.array(at))) == pytest.approx(integral, rel=1e-9)
    assert np.abs(made.cost(u) - expected).max() <= 1e-11 * max(1.0, float(expected.max()))


@pytest.mark.oracle
@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_efficiency_against_scipy(dimension: int) -> None:
    for name in ("huber", "hampel", "tls"):
        loss = losses()[name]
        for c in (0.8, 1.7, 4.0):
            places = [0.0, *(c * k for k in loss.corners), 12.0]

            ends = sorted(p for p in places if p <= 12.0)
            t = np.unique(np.concatenate([np.linspace(a + 1e-12, b - 1e-12, 20001) for a, b in pairwise(ends)]))
            w, density = loss.weight(t / c), chi(dimension).pdf(t)
            expected = trapezoid(w * t**2 * density, t) ** 2 / (dimension * trapezoid(w**2 * t**2 * density, t))
            assert efficiency(loss.weight, c, dimension, loss.corners) == pytest.approx(expected, rel=1e-7)


@pytest.mark.truth
def test_constants_of_the_literature() -> None:
    """The constants of Andrews and Danish are 1.339 and 2, and Hampel's 1.7 : 3.4 : 8.5 has an efficiency of 0.98.

    The sources are Holland & Welsch 1977 and Kubik.
    """
    known = losses()
    assert known["andrews"].constants[0] == pytest.approx(1.339, abs=5e-4)
    assert known["danish"].constants[0] == pytest.approx(2.0, abs=0.01)
    assert efficiency(known["hampel"].weight, 1.7, 1, known["hampel"].corners) == pytest.approx(0.98, abs=0.01)
    found = brentq(lambda c: efficiency(known["andrews"].weight, c, 3, (np.pi,)) - 0.95, 0.5, 5.0, xtol=1e-12)
    assert found == pytest.approx(known["andrews"].constants[2], rel=1e-8)


def hard_weight(u: np.ndarray) -> np.ndarray:
    """Return 1 up to 1 and 0.05 beyond: the weight jumps, and the cost grows without end."""
    return np.where(u <= 1.0, 1.0, 0.05)


@pytest.mark.oracle
def test_a_weight_with_a_jump() -> None:
    loss = loss_from_weight("hard", hard_weight, corners=(1.0,), source="nobody")
    u = np.array([0.0, 0.5, 1.0, 1.0 + 1e-9, 3.0, 500.0])
    assert loss.cost(u) == pytest.approx(np.where(u <= 1.0, 0.5 * u**2, 0.5 + 0.025 * (u**2 - 1.0)), rel=1e-12)
    floored = ScaledLoss(loss.weight, loss.cost, 2.0)
    assert floored.weights(np.array([1e6])) == pytest.approx(FLOOR + (1.0 - FLOOR) * 0.05)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("make", "words"),
    [*((lambda w=weight: loss_from_weight("bad", w), "is not 1 at 0") for weight in (
        lambda u: 0.5 * np.ones_like(u), lambda u: 1.0 + u, lambda u: 1.0 - u, lambda u: u / 0.0 * 0.0)),
     (lambda: constant_for(np.ones_like, 2), "no constant")],
)  # fmt: skip
def test_what_is_no_weight_and_has_no_constant_is_refused(make: Callable[[], object], words: str) -> None:
    with np.errstate(all="ignore"), pytest.raises(ValueError, match=words):
        make()


@pytest.mark.behaviour
def test_other_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    assert find("beaton_tukey") is losses()["tukey"]
    assert find("hubre") is None
    for name in ALIASES:
        with pytest.raises(ValueError, match="another name"):
            register(replace(losses()["huber"], name=name))


@pytest.mark.behaviour
def test_scales_multiply_the_constants() -> None:
    loss = losses()["hampel"]
    robust = scaled(loss, (2.0, 0.5))
    assert robust.image.constant == 2.0 * loss.constant(IMAGE)
    assert robust.control.constant == 0.5 * loss.constant(CONTROL)


@pytest.mark.behaviour
def test_a_convex_loss_of_its_weight_starts_from_least_squares() -> None:
    convex = loss_from_weight("soft", lambda u: 1.0 / (1.0 + u), redescending=False)
    assert not convex.redescending
    assert loss_from_weight("hard", lambda u: 1.0 / (1.0 + u * u)).redescending
