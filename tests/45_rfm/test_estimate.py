"""The estimation is compared with numpy, scipy, hat matrices and simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rpc.estimate import fit_linear, fit_true, fit_weighted, linear_system
from fg_orient.rpc.fit import RfmFit, least_denominators, leverages
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints, Scaling
from tests.support.repetitions import some_slow
from tests.support.rpc_model import reference_project

Make = Callable[..., ControlPoints]


@pytest.mark.oracle
@pytest.mark.parametrize("fit", [fit_linear, fit_weighted, fit_true])
def test_exact_points_give_the_model_back(make: Make, fit: Callable[..., RfmFit]) -> None:
    points = make()
    found = fit(points, RfmForm(2))
    assert np.abs(found.residuals_px()).max() < 1e-7
    fresh = make(seed=2)
    assert np.abs(found.residuals_px(fresh)).max() < 1e-6
    assert found.rank == 38
    assert found.redundancy == 2 * 60 - 38


@pytest.mark.oracle
@pytest.mark.parametrize("denominators", ["separate", "common", "one"])
@pytest.mark.parametrize("normalise", [True, False])
def test_linear_form_equals_numpy(make: Make, denominators: str, normalise: bool) -> None:
    points, form = make(noise_px=0.5), RfmForm(1, denominators)  # type: ignore[arg-type]
    found = fit_linear(points, form, normalise=normalise, allow_pole=True)
    system = linear_system(points, form, Scaling.of(points, normalise=normalise))
    design, observed = system.require_design("A")
    length = np.linalg.norm(design, axis=0)
    expected = np.linalg.lstsq(design / length, observed, rcond=None)[0] / length
    np.testing.assert_allclose(found.x, expected, rtol=1e-3 if not normalise else 1e-9)
    v = (design @ expected - observed).reshape(2, -1) * found.scaling.scales[1::-1, None]
    m0 = np.sqrt(np.sum(v**2) / (2 * len(points) - len(form)))
    assert found.m0_linear_px == pytest.approx(m0, rel=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("denominators", ["separate", "common"])
@pytest.mark.parametrize(("degree", "kappa"), [(1, 0.0), (2, 0.0), (2, 1e-3), (3, 1e-2)])
def test_true_equations_equal_scipy(make: Make, denominators: str, degree: int, kappa: float) -> None:
    points, form = make(80, noise_px=0.5), RfmForm(degree, denominators)  # type: ignore[arg-type]
    found = fit_true(points, form, kappa=kappa)
    m = form.monomials(found.scaling.ground(points.ground))
    image = found.scaling.image(points.line, points.sample)

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.concatenate([(image - form.image(x, m)).ravel(), np.sqrt(kappa) * form.beyond_affine * x])

    peer = least_squares(residuals, np.where(form.beyond_affine, 0.0, found.x), x_scale="jac", xtol=1e-15, ftol=1e-15)
    assert np.sum(residuals(found.x) ** 2) <= 2.0 * peer.cost * (1.0 + 1e-8)
    np.testing.assert_allclose(form.image(found.x, m), form.image(peer.x, m), atol=1e-7)


@pytest.mark.oracle
def test_weighted_form_ends_where_its_weights_stay(make: Make) -> None:
    """The weighted form ends at A^T P v = 0 with weights 1/f2^2 of its own denominators, and m0 is near the true one.

    Its v/f2 are the true residuals; A is not their Jacobian.
    """
    points = make(80, noise_px=0.5)
    for degree, share in ((1, 1e-3), (2, 0.05)):
        form = RfmForm(degree)
        weighted, true = fit_weighted(points, form), fit_true(points, form)
        m = form.monomials(weighted.scaling.ground(points.ground))
        below = form.below(weighted.x, m)[:, ::-1].T.ravel()
        a, observed = form.design(m, weighted.scaling.image(points.line, points.sample))
        a, v = a / below[:, None], (a @ weighted.x - observed) / below
        assert np.abs(a.T @ v).max() < 1e-8 * np.linalg.norm(v) * np.linalg.norm(a, axis=0).max()
        sample, line = v.reshape(2, -1) * weighted.scaling.scales[1::-1, None]
        np.testing.assert_allclose(np.column_stack([line, sample]), weighted.residuals_px(), atol=1e-8)
        assert true.m0_px * (1.0 - 1e-9) <= weighted.m0_px <= true.m0_px * (1.0 + share)


@pytest.mark.oracle
@pytest.mark.parametrize("draws", some_slow([50, 200]))
def test_covariance_by_simulation(make: Make, draws: int) -> None:
    """The covariance equals the scatter of simulated estimates within four standard errors of n draws.

    They are 1 / sqrt(2 n) of a standard deviation, and 0.17 / sqrt(n) of the mean of n variances.
    """
    share = 4.0 / np.sqrt(2 * draws)
    form = RfmForm(1)
    base = fit_true(make(40), form)
    rng, drawn, variances = np.random.default_rng(3), [], []
    line, sample = base.project(base.points.ground)
    sigma = 0.5 / base.scaling.scales[0]
    for _ in range(draws):
        noise = rng.standard_normal((2, len(line))) * sigma * base.scaling.scales[:2, None]
        points = ControlPoints(line + noise[0], sample + noise[1], base.points.ground)
        found = fit_true(points, form, scaling=base.scaling)
        assert found.covariance is not None and found.cofactors is not None
        drawn.append(found.x)
        variances.append(found.covariance[0, 0] / found.cofactors[0, 0])
    np.testing.assert_allclose(np.std(drawn, axis=0), sigma * np.sqrt(np.diag(base.cofactors)), rtol=share)
    assert np.mean(variances) == pytest.approx(sigma**2, rel=0.7 / np.sqrt(draws))


@pytest.mark.oracle
@pytest.mark.parametrize("kappa", [0.0, 0.1])
def test_leverages_are_those_of_the_hat_matrix(make: Make, kappa: float) -> None:
    found = fit_true(make(30, noise_px=0.5), RfmForm(1), kappa=kappa)
    a, penalty = found.design, kappa * found.penalised
    hat = a @ np.linalg.solve(a.T @ a + np.diag(penalty), a.T)
    n = len(found.points)
    for i in (0, 7, n - 1):
        np.testing.assert_allclose(leverages(a, penalty)[i], hat[np.ix_([i, n + i], [i, n + i])], atol=1e-9)
    assert found.redundancy == pytest.approx(2 * n - np.trace(hat), rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("seeds", some_slow([4, 20]))
def test_least_denominator_between_points_is_that_of_a_fine_search(rng: np.random.Generator, seeds: int) -> None:
    form = RfmForm(3)
    for seed in range(seeds):
        x = 0.4 * np.random.default_rng(seed).standard_normal(len(form))
        ground = rng.uniform(-1.0, 1.0, (4, 3))
        t = np.linspace(0.0, 1.0, 4001)[:, None]
        fine = [form.below(x, form.monomials(p + t * (q - p))).min(axis=0) for p in ground for q in ground]
        np.testing.assert_allclose(least_denominators(form, x, ground), np.min(fine, axis=0), atol=1e-5)


@pytest.mark.truth
def test_a_pole_between_points_is_refused(make: Make) -> None:
    points = make(40)
    good = fit_linear(points, RfmForm(1))
    x = good.x.copy()
    x[good.form.names.index("b100")] = -1.5  # zero at 2/3 of the way to the eastern border
    bad = RfmFit(good.form, good.scaling, points, x, "made up")
    assert bad.has_pole
    with pytest.raises(NoSolutionError, match="pole"):
        bad.without_pole()
    assert not good.has_pole


@pytest.mark.oracle
def test_model_projects_like_the_fit(make: Make) -> None:
    points = make(60)
    found = fit_true(points, RfmForm(2))
    model = found.model()
    expected = np.array(reference_project(model, *points.ground.T), float)
    np.testing.assert_allclose(model.project(*points.ground.T), expected, atol=1e-8)
    np.testing.assert_allclose(found.project(points.ground), expected, atol=1e-8)
    assert model.inside(*points.ground.T).all()
    assert not model.inside(*(points.ground[0] + [1.0, 0.0, 0.0])).any()


BAD = {
    "flat": (lambda p: fit_linear(ControlPoints(p.line, p.sample, p.ground * [1.0, 1.0, 0.0]), RfmForm(1)), "rfm.flat"),
    "few": (lambda p: fit_linear(p.take(np.arange(18)), RfmForm(2)), "rfm.few_points"),
    "few, true": (lambda p: fit_true(p.take(np.arange(18)), RfmForm(2)), "rfm.few_points"),
    "degree": (lambda p: RfmForm(4), "rfm.degree"),
    "denominators": (lambda p: RfmForm(1, "both"), "rfm.denominators"),
    "kept": (lambda p: RfmForm(1, kept=(3, 3)), "rfm.kept"),
    "kept, beyond": (lambda p: RfmForm(1, kept=(0, 14)), "rfm.kept"),
    "penalty": (lambda p: fit_true(p, RfmForm(1), penalty="all"), "rfm.penalty"),
    "kappa": (lambda p: fit_true(p, RfmForm(1), kappa=-1.0), "linear.kappa_value"),
    "solver": (lambda p: fit_linear(p, RfmForm(1), solver="magic"), "linear.solver"),
    "not finite": (lambda p: ControlPoints(p.line * np.nan, p.sample, p.ground), "argument.value"),
    "sizes": (lambda p: ControlPoints(p.line[1:], p.sample, p.ground), "argument.value"),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused(make: Make, name: str) -> None:
    call, code = BAD[name]
    with pytest.raises(InputError) as caught:
        call(make(30))  # type: ignore[no-untyped-call]
    assert [problem.code for problem in caught.value.problems] == [code]


@pytest.mark.behaviour
def test_few_points_will_do_with_a_penalty(make: Make) -> None:
    points = make(12)
    found = fit_true(points, RfmForm(2), kappa=1e-6)
    assert np.abs(found.residuals_px()).max() < 5.0
    assert found.redundancy > 0.0
