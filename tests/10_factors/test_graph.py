"""The tests check what the wrapper of GTSAM passes to GTSAM and what it refuses."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors._contract import Argument, Equation, check_blocks, evaluate
from factors.cameras import pushbroom
from factors.conditions.control import CONTROL_POINT, POINT, whitening
from factors.graph import factor
from tests.support.equation_examples import Example, control_point, look_angle_collinearity
from tests.support.observed_parameters import OBSERVED_PARAMETERS, observed_parameters

E0, P0 = gtsam.symbol("e", 0), gtsam.symbol("p", 0)
LABEL = "image left, point 12"


def example() -> tuple[Example, gtsam.Values]:
    e = look_angle_collinearity(np.random.default_rng(7))
    values = gtsam.Values()
    values.insert(E0, e.unknowns[0])
    values.insertPoint3(P0, e.unknowns[1])
    return e, values


def image_point(e: Example, equation: Equation, ground: object = P0) -> gtsam.CustomFactor:
    return factor(equation, (E0, ground), (len(e.unknowns[0]), 3), e.record, e.setup, label=LABEL)


def gradient_of_error(f: gtsam.CustomFactor, values: gtsam.Values, length: int) -> np.ndarray:
    """Return the central difference quotients of GTSAM's error.

    Each unknown moves by its own step, the image's first.
    """
    image, ground, found = values.atVector(E0), values.atPoint3(P0), []
    steps = np.r_[np.full(len(image), 1e-4), np.ones(3)][:length]
    for k, h in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            d = np.zeros(len(image) + 3)
            d[k] = sign * h
            moved = gtsam.Values()
            moved.insert(E0, image + d[: len(image)])
            moved.insertPoint3(P0, ground + d[len(image) :])
            ends.append(f.error(moved))
        found.append((ends[0] - ends[1]) / (2.0 * h))
    return np.array(found)


@pytest.mark.oracle
def test_linearisation_equals_the_kernel() -> None:
    """The linearised factor has the kernel's Jacobian and residual; the gradient equals differences of the error."""
    e, values = example()
    f = image_point(e, pushbroom.LOOK_ANGLE_COLLINEARITY)
    value, j_image, j_ground = pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(e.record, e.setup, *e.unknowns, True)
    a, b = f.linearize(values).jacobian()
    assert np.array_equal(a, np.hstack([j_image, j_ground]))
    assert np.array_equal(b, -value)
    quotients = gradient_of_error(f, values, a.shape[1])
    assert np.abs(-a.T @ b - quotients).max() <= 1e-6 * np.abs(quotients).max()


@pytest.mark.consistency
def test_error_is_half_the_weighted_square() -> None:
    e, values = example()
    f = image_point(e, pushbroom.LOOK_ANGLE_COLLINEARITY)
    value = pushbroom.residual(e.record, e.setup, *e.unknowns)
    assert f.error(values) == pytest.approx(0.5 * value @ value, rel=1e-15, abs=0.0)


@pytest.mark.oracle
def test_constant_ground_point_is_no_unknown() -> None:
    """A factor with a constant ground point has the key and Jacobian of its image only, and the right gradient."""
    e, values = example()
    f = image_point(e, pushbroom.LOOK_ANGLE_COLLINEARITY, ground=e.unknowns[1])
    assert list(f.keys()) == [E0]
    a, b = f.linearize(values).jacobian()
    assert np.array_equal(a, pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(e.record, e.setup, *e.unknowns, True)[1])
    quotients = gradient_of_error(f, values, a.shape[1])
    assert np.abs(-a.T @ b - quotients).max() <= 1e-6 * np.abs(quotients).max()


@pytest.mark.behaviour
def test_image_of_three_unknowns_and_a_fixed_point() -> None:
    """A factor does not mistake an image's vector of three unknowns for a ground point."""
    e, _ = example()
    setup = np.ascontiguousarray(e.setup[:, :3])
    values = gtsam.Values()
    values.insert(E0, e.unknowns[0][:3])
    f = factor(pushbroom.LOOK_ANGLE_COLLINEARITY, (E0, e.unknowns[1]), (3, 3), e.record, setup, label=LABEL)
    value, j_image, _ = pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(
        e.record, setup, e.unknowns[0][:3], e.unknowns[1], True
    )
    a, b = f.linearize(values).jacobian()
    assert list(f.keys()) == [E0] and np.array_equal(a, j_image) and np.array_equal(b, -value)
    assert f.error(values) == pytest.approx(0.5 * value @ value, rel=1e-15, abs=0.0)


@pytest.mark.behaviour
def test_nothing_unknown_is_refused() -> None:
    e, _ = example()
    with pytest.raises(ValueError, match=f"{LABEL}: no unknown"):
        factor(pushbroom.LOOK_ANGLE_COLLINEARITY, e.unknowns, (36, 3), e.record, e.setup, label=LABEL)


WRONG = {
    "wrong width": lambda v, a, b: (v, a[:, :5], b),
    "transposed": lambda v, a, b: (v, a, b.T),
    "flat": lambda v, a, b: (v, a, b.ravel()),
    "residual of length 1": lambda v, a, b: (v[:1], a, b),
    "nan in the Jacobian": lambda v, a, b: (v, np.full_like(a, np.nan), b),
    "inf in the residual": lambda v, a, b: (v + np.inf, a, b),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("fault", WRONG)
def test_faulty_kernels_are_named(fault: str) -> None:
    """A kernel that returns a Jacobian of wrong size or nan is refused with its name and the factor's label.

    GTSAM accepts both without a message.
    """
    e, values = example()

    def kernel(record: np.ndarray, setup: np.ndarray, x: np.ndarray, g: np.ndarray, want: bool) -> tuple:
        return WRONG[fault](*pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(record, setup, x, g, True))

    base = pushbroom.LOOK_ANGLE_COLLINEARITY
    broken = Equation("my_broken_equation", kernel, base.residual, base.arguments, "")
    graph = gtsam.NonlinearFactorGraph()
    graph.add(image_point(e, broken))
    with pytest.raises(ValueError, match=f"'my_broken_equation', {LABEL}"):
        graph.linearize(values)


@pytest.mark.behaviour
@pytest.mark.parametrize("size", [5, 35, 37])
def test_wrong_sizes_are_named_with_a_constant_ground_point(size: int) -> None:
    """A vector of wrong size is refused with both sizes, and the kernel itself returns nan for it."""
    e, _ = example()
    values = gtsam.Values()
    values.insert(E0, np.zeros(size))
    f = image_point(e, pushbroom.LOOK_ANGLE_COLLINEARITY, ground=e.unknowns[1])
    for call in (f.error, f.linearize):
        with pytest.raises(ValueError, match=f"{LABEL}: 36 unknowns expected, the values hold {size}"):
            call(values)
    value, j_image, j_ground = pushbroom.LOOK_ANGLE_COLLINEARITY.kernel(
        e.record, e.setup, np.zeros(size), e.unknowns[1], True
    )
    assert all(np.isnan(block).all() for block in (value, j_image, j_ground))


@pytest.mark.behaviour
def test_evaluate_gives_nan_for_a_vector_of_the_wrong_size() -> None:
    e, _ = example()
    batch = (e.record[None], [e.setup], [e.unknowns[0][:-1]], [e.unknowns[1]])
    for jacobian in (True, False):
        values, (j_image, j_ground) = evaluate(pushbroom.LOOK_ANGLE_COLLINEARITY, *batch, jacobian=jacobian)
        assert np.isnan(values).all()
        assert all(np.isnan(block).all() for block in (*j_image, *j_ground))


@pytest.mark.behaviour
def test_nan_and_wrong_sizes_are_named_on_the_fast_path() -> None:
    e, values = example()
    graph = gtsam.NonlinearFactorGraph()
    graph.add(image_point(e, pushbroom.LOOK_ANGLE_COLLINEARITY))
    values = gtsam.Values()
    values.insert(E0, e.unknowns[0])
    values.insertPoint3(P0, np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(ValueError, match=f"{LABEL}: residual is not finite"):
        graph.linearize(values)
    with pytest.raises(ValueError, match=f"{LABEL}: residual is not finite"):
        graph.error(values)
    short = gtsam.Values()
    short.insert(E0, e.unknowns[0][:5])
    short.insertPoint3(P0, e.unknowns[1])
    with pytest.raises(ValueError, match=f"{LABEL}: 36 unknowns expected, the values hold 5"):
        graph.linearize(short)


@pytest.mark.behaviour
def test_float32_and_missing_blocks_are_refused() -> None:
    ok = np.zeros((2, 3))
    check_blocks("a", "b", (np.zeros(2), ok), (3,), 2)
    with pytest.raises(ValueError, match="not a float64 array"):
        check_blocks("a", "b", (np.zeros(2), ok.astype(np.float32)), (3,), 2)
    with pytest.raises(ValueError, match="2 arrays expected, 1 returned"):
        check_blocks("a", "b", (np.zeros(2),), (3,), 2)


@pytest.mark.consistency
def test_general_wrapper_checks_too() -> None:
    """An equation of one argument gives the kernel's numbers, and one without a Jacobian is refused by name."""
    rng = np.random.default_rng(8)
    e = control_point(rng)
    values = gtsam.Values()
    values.insertPoint3(P0, e.unknowns[0])
    good = factor(CONTROL_POINT, (P0,), (3,), e.record, e.setup, label=LABEL, n_residuals=3)
    a, b = good.linearize(values).jacobian()
    value, j = CONTROL_POINT.kernel(e.record, e.setup, e.unknowns[0], True)
    assert np.array_equal(a, j)
    assert np.array_equal(b, -value)
    bad = Equation(
        "short", lambda *a: CONTROL_POINT.kernel(*a)[:1], CONTROL_POINT.residual, (Argument("ground", "m", True),),
        "",
    )  # fmt: skip
    with pytest.raises(ValueError, match="'short'"):
        factor(bad, (P0,), (3,), e.record, e.setup, label=LABEL, n_residuals=3).linearize(values)


@pytest.mark.oracle
def test_priors_equal_gtsams_own() -> None:
    """The control point equation has the normal matrix of GTSAM's prior factor, and priors have the error by hand."""
    rng = np.random.default_rng(9)
    e = control_point(rng)
    values = gtsam.Values()
    values.insertPoint3(P0, e.unknowns[0])
    ours = factor(CONTROL_POINT, (P0,), (3,), e.record, e.setup, label=LABEL, n_residuals=3)
    graph = gtsam.NonlinearFactorGraph()
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(e.record[POINT.whitening].reshape(3, 3))
    graph.addPriorPoint3(P0, e.record[POINT.place], noise)
    n_theirs = graph.linearize(values).hessian()[0]
    n_ours = ours.linearize(values).information()
    assert np.abs(n_ours - n_theirs).max() <= 1e-14 * np.abs(n_theirs).max()
    p = observed_parameters(rng)
    vector = gtsam.Values()
    vector.insert(E0, p.unknowns[0])
    f = factor(OBSERVED_PARAMETERS, (E0,), (5,), p.record, p.setup, label=LABEL, n_residuals=5)
    assert f.error(vector) == pytest.approx(0.5 * np.sum(((p.unknowns[0] - p.setup[0]) / p.setup[1]) ** 2))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "covariance",
    [
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1, 2, 0], [0, 1, 0], [0, 0, 1.0]]),
        np.full((3, 3), np.nan),
    ],
)
def test_impossible_covariances_are_refused(covariance: np.ndarray) -> None:
    with pytest.raises(ValueError, match="covariance is not"):
        whitening(covariance)


@pytest.mark.oracle
def test_robust_loss_lowers_the_weight() -> None:
    e, values = example()
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    base = pushbroom.LOOK_ANGLE_COLLINEARITY
    robust = factor(base, (E0, P0), (36, 3), e.record, e.setup, label=LABEL, loss=huber)
    r = np.linalg.norm(pushbroom.residual(e.record, e.setup, *e.unknowns))
    assert r > 1.0
    assert robust.error(values) == pytest.approx(r - 0.5, rel=1e-12)  # Huber's loss at k = 1
