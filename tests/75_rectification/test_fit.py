"""Transformations and their statistics are compared with other computations; bad points are refused."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize, stats

from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rectification.fit import Observations, TransformationFit, fit
from fg_orient.rectification.outliers import point_tests, prune
from fg_orient.rectification.study import design_study, pair_distances
from fg_orient.rectification.transformation import NAMES, Transformation, find_model, read_transformation

from .conftest import SPATIAL

Array = np.ndarray
#: Each transformation once, the polynomial with two degrees.
CASES = [("polynomial", 2), ("polynomial", 5), *((name, None) for name in NAMES[1:])]


def plane_points(rng: np.random.Generator, n: int = 40) -> Observations:
    """Return the points whose true transformation is projective, in full metres, with unequal sigmas."""
    x, y = rng.uniform(0.0, 6000.0, (2, n))
    below = 1.0 + 2e-5 * x - 1e-5 * y
    target = np.stack([4.2 * x - 0.8 * y, 0.8 * x + 4.2 * y], axis=1) / below[:, None] + (660_000.0, 4_550_000.0)
    sigma = rng.uniform(1.0, 4.0, (n, 2))
    return Observations.of(np.stack([x, y], axis=1), target + sigma * rng.normal(size=(n, 2)), sigma)


def space_points(rng: np.random.Generator, n: int = 40) -> Observations:
    """Return points seen by a line scanner 10 degrees off nadir with a field of view of 4 degrees.

    The line is affine, the sample central.
    """
    east, north, h = rng.uniform(0, 30_000, n), rng.uniform(0, 30_000, n), rng.uniform(0, 900, n)
    across, along = (east - 15_000) * math.cos(0.2) + (north - 15_000) * math.sin(0.2), north - 0.2 * east
    view = np.arctan2(across + 145_000.0, 832_000.0 - h) - math.atan2(145_000.0, 832_000.0)
    image = np.stack([6000 - along / 5.0, 3000.0 + 832_000.0 / 5.0 * np.tan(view)], axis=1)
    source = np.stack([660_000 + east, 4_550_000 + north, h], axis=1)
    return Observations.of(source, image + 0.3 * rng.normal(size=(n, 2)), np.full((n, 2), 0.3))


def points_for(name: str, seed: int = 3, n: int = 40) -> Observations:
    rng = np.random.default_rng(seed)
    return space_points(rng, n) if name in SPATIAL else plane_points(rng, n)


def formula(name: str, degree: int | None, source: Array, x: Array) -> Array:
    """Return the values of a transformation, written out once more, for normalised coordinates."""
    s = source.T
    one = np.ones(s.shape[1])
    if name in {"polynomial", "affine"}:
        powers = [(k, d - k) for d in range((degree or 1) + 1) for k in range(d + 1)]
        return np.stack([s[0] ** j * s[1] ** k for j, k in powers], axis=1) @ x.reshape(2, -1).T
    if name == "helmert":
        return np.stack([x[0] + x[2] * s[0] - x[3] * s[1], x[1] + x[3] * s[0] + x[2] * s[1]], axis=1)
    if name == "projective":
        return np.stack([one, s[0], s[1]], axis=1) @ x[:6].reshape(2, 3).T / (1 + x[6] * s[0] + x[7] * s[1])[:, None]
    line, sample = (np.stack([one, *s], axis=1) @ x[:8].reshape(2, 4).T).T
    if name == "parallel":
        sample = sample / (1 + x[8] * sample)
    if name == "dlt":
        sample = sample / (1 + x[8:] @ s)
    return np.stack([line, sample], axis=1)


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "degree"), CASES)
def test_every_transformation_equals_scipys_least_squares(name: str, degree: int | None) -> None:
    points = points_for(name)
    found = fit(points, find_model(name, degree))
    t = found.transformation
    source, target = t.source.normalised(points.source), t.target.normalised(points.target)

    def residual(x: Array) -> Array:
        return ((formula(name, degree, source, x) - target) * t.target.scale / points.sigma).ravel()

    start = 0.9 * t.coefficients + 0.01
    other = optimize.least_squares(residual, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm")
    assert found.weighted_squares == pytest.approx(2.0 * other.cost, rel=1e-9)
    sigma = np.sqrt(np.diag(found.cofactors))
    assert np.abs(t.coefficients - other.x).max() <= 1e-5 * sigma.min()
    assert found.cofactors == pytest.approx(
        np.linalg.inv(other.jac.T @ other.jac), rel=1e-4, abs=1e-6 * sigma.max() ** 2
    )
    assert np.abs(t.apply(points.source) - points.target - found.residuals).max() <= 1e-8
    if name in {"projective", "dlt"}:  # the true ones
        assert found.m0 == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * found.redundancy))


@pytest.mark.oracle
def test_m0_is_no_rmse_and_weights_count() -> None:
    points = points_for("affine")
    found = fit(points, find_model("affine"))
    v = (found.transformation.apply(points.source) - points.target) / points.sigma
    assert found.m0 == pytest.approx(math.sqrt(np.sum(v**2) / (80 - 6)), rel=1e-9)
    plain = np.sqrt(np.mean(found.residuals**2, axis=0))
    assert found.rmse == pytest.approx((*plain, np.hypot(*plain)), rel=1e-12)
    scaled = fit(Observations.of(points.source, points.target, 7.0 * points.sigma), find_model("affine"))
    assert scaled.m0 == pytest.approx(found.m0 / 7.0, rel=1e-9)
    assert scaled.residuals == pytest.approx(found.residuals, abs=1e-7)


@pytest.mark.oracle
def test_redundancy_numbers_and_prediction_equal_plain_matrices() -> None:
    points = points_for("affine", n=12)
    found = fit(points, find_model("affine"))
    a, q = found.design, np.linalg.inv(found.design.T @ found.design)
    qvv = np.eye(24) - a @ q @ a.T
    assert found.redundancy_numbers.ravel() == pytest.approx(np.diag(qvv), abs=1e-12)
    assert found.redundancy_numbers.sum() == pytest.approx(found.redundancy, abs=1e-9)
    sigma = found.prediction_sigma(points.source)
    expected = found.m0 * np.sqrt(np.diag(a @ q @ a.T)).reshape(-1, 2) * points.sigma
    assert sigma == pytest.approx(expected, rel=1e-9)


def direct_test(found: TransformationFit, k: int) -> tuple[float, Array]:
    """Return F of point k and its error, from an adjustment with the point's two errors as unknowns."""
    a, v, extra = found.design, found.whitened.ravel(), np.zeros((2 * len(found.points), 2))
    extra[2 * k : 2 * k + 2] = np.eye(2)
    both = np.hstack([a, extra])
    x = np.linalg.lstsq(both, -v, rcond=None)[0]
    left, all_squares = np.sum((v + both @ x) ** 2), np.sum(v**2)
    f = found.redundancy
    return (all_squares - left) / 2 / (left / (f - 2)), x[-2:] * found.points.sigma[k]


@pytest.mark.oracle
def test_point_tests_equal_an_adjustment_with_the_error_as_unknown() -> None:
    rng = np.random.default_rng(9)
    source, sigma = rng.uniform(0.0, 1000.0, (15, 2)), rng.uniform(1.0, 4.0, (15, 2))
    points = Observations.of(source, 28.5 * source + sigma * rng.normal(size=(15, 2)), sigma)
    points.target[4] += (60.0, -45.0)
    found = fit(points, find_model("polynomial", 2))
    tests = point_tests(found)
    for k in range(15):
        f, error = direct_test(found, k)
        assert tests.statistic[k] == pytest.approx(f, rel=1e-6)
        assert tests.error[k] == pytest.approx(error, rel=1e-6, abs=1e-6)
        assert tests.probability[k] == pytest.approx(stats.f.sf(f, 2, found.redundancy - 2), rel=1e-6)
        assert tests.critical[k] == pytest.approx(stats.f.isf(0.001, 2, found.redundancy - 2), rel=1e-6)
    assert tests.suspicious[4] and int(np.argmin(tests.probability)) == 4
    uncertain = 4.0 * points.sigma[4] / np.sqrt(found.redundancy_numbers[4])
    assert (np.abs(tests.error[4] - (60.0, -45.0)) <= uncertain).all()


@pytest.mark.behaviour
def test_a_point_that_nothing_checks_is_not_tested() -> None:
    rng = np.random.default_rng(2)
    source = np.vstack([np.column_stack([np.arange(6.0), np.zeros(6)]), [2.0, 5.0]])  # the last alone gives the y axis
    found = fit(Observations.of(source, source + rng.normal(0, 0.1, (7, 2))), find_model("affine"))
    tests = point_tests(found)
    assert tests.dimension.tolist() == [2] * 6 + [0]
    assert np.isnan(tests.statistic[6]) and not tests.suspicious[6]


@pytest.mark.oracle
@pytest.mark.parametrize("rule", ["residual", "test"])
def test_pruning_drops_the_bad_points_and_says_so(rule: str) -> None:
    rng = np.random.default_rng(5)
    source = rng.uniform(0.0, 1000.0, (30, 2))
    target = 28.5 * source + rng.normal(0.0, 10.0, source.shape)
    target[[3, 11, 20]] += ((400.0, 0.0), (0.0, -300.0), (200.0, 200.0))
    first = fit(Observations.of(source, target), find_model("affine"))
    found = prune(first, 16.0, rule=rule)  # type: ignore[arg-type]
    assert found.dropped == ("4", "12", "21")
    assert list(found.history) == sorted(found.history, reverse=True)
    assert found.fit.rmse[2] == found.history[-1] <= 16.0 < found.history[-2]
    with pytest.raises(NoSolutionError) as caught:
        prune(first, 1e-3, rule=rule)  # type: ignore[arg-type]
    assert caught.value.problems[0].code == "rectify.prune"


def refused(points: Observations, name: str, degree: int | None = None) -> str:
    """Return the code of the refusal."""
    with pytest.raises(InputError) as caught:
        fit(points, find_model(name, degree))
    return caught.value.problems[0].code


@pytest.mark.behaviour
def test_points_that_determine_nothing_are_refused() -> None:
    rng, s = np.random.default_rng(4), np.linspace(0.0, 5000.0, 30)
    line = np.column_stack([660_000.0 + s, 4_550_000.0 + 0.7 * s])
    target = rng.uniform(0.0, 1000.0, (30, 2))
    assert refused(Observations.of(line, target), "affine") == "rectify.collinear"
    assert refused(Observations.of(np.round(line, 3), target), "polynomial", 2) == "rectify.collinear"
    assert refused(Observations.of(line, target), "projective") == "rectify.collinear"
    assert refused(Observations.of(line[[0] * 30], target), "helmert") == "rectify.collinear"
    circle = 1000.0 * np.column_stack([np.cos(s), np.sin(s)]) + (660_000.0, 4_550_000.0)
    assert refused(Observations.of(circle, target), "polynomial", 2) == "rectify.degenerate"
    assert fit(Observations.of(circle, target), find_model("affine")).condition < 10.0
    flat = np.column_stack([rng.uniform(0.0, 3e4, (30, 2)), np.full(30, 120.0)])
    tilted = flat.copy()
    tilted[:, 2] += 0.01 * flat[:, 0] - 0.02 * flat[:, 1]
    for name in SPATIAL:
        assert refused(Observations.of(flat, target), name) == "rectify.degenerate"
        assert refused(Observations.of(tilted, target), name) == "rectify.degenerate"
    assert refused(Observations.of(flat[:, :2], target), "dlt") == "rectify.heights"


@pytest.mark.behaviour
@pytest.mark.parametrize("name", NAMES[1:])
def test_fewest_points_with_redundancy(name: str) -> None:
    model = find_model(name)
    points = points_for(name)
    assert refused(points.take(np.arange(model.n_unknowns // 2)), name) == "rectify.few_points"
    assert fit(points.take(np.arange(model.least_points + 1)), model).redundancy > 0


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "code"),
    [({"sigma": [[1.0, 0.0]] * 5}, "rectify.points"), ({"source": [[np.nan, 1.0]] * 5}, "rectify.points"),
     ({"ids": ["a"]}, "rectify.points"), ({"target": np.zeros((4, 2))}, "rectify.points")],
)  # fmt: skip
def test_observations_are_checked(change: dict[str, object], code: str) -> None:
    given = {"source": np.ones((5, 2)), "target": np.ones((5, 2))} | change
    with pytest.raises((InputError, ValueError)) as caught:
        Observations.of(**given)  # type: ignore[arg-type]
    assert isinstance(caught.value, InputError) and caught.value.problems[0].code == code


@pytest.mark.behaviour
@pytest.mark.parametrize(("name", "degree", "code"), [
    ("spline", None, "rectify.model"), ("polynomial", None, "rectify.degree"), ("polynomial", 6, "rectify.degree"),
    ("polynomial", 0, "rectify.degree"), ("affine", 1, "rectify.degree"),
])  # fmt: skip
def test_unknown_models_are_refused(name: str, degree: int | None, code: str) -> None:
    with pytest.raises(InputError) as caught:
        find_model(name, degree)
    assert caught.value.problems[0].code == code


@pytest.mark.behaviour
def test_a_pole_among_the_points_is_refused() -> None:
    """A projective fit is refused if half of the points are beyond the horizon. No denominator has one sign there."""
    rng = np.random.default_rng(6)
    source = rng.uniform(-1.0, 1.0, (30, 2))
    source = source[np.abs(source[:, 0]) > 0.3]
    target = np.stack([1.0 / source[:, 0], source[:, 1] / source[:, 0]], axis=1)
    with pytest.raises(NoSolutionError) as caught:
        fit(Observations.of(source, target), find_model("projective"))
    assert caught.value.problems[0].code in {"rectify.pole", "rectify.not_converged"}


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "degree"), CASES)
def test_written_and_read_a_transformation_is_the_same(name: str, degree: int | None, tmp_path: Path) -> None:
    points = points_for(name)
    t = fit(points, find_model(name, degree), crs="EPSG:32635").transformation
    path = tmp_path / "transformation.json"
    path.write_text(json.dumps(t.as_dict()), "utf-8")
    back = read_transformation(tmp_path)
    assert isinstance(back, Transformation)
    printed = back.target.physical(formula(name, degree, t.source.normalised(points.source), t.coefficients))
    np.testing.assert_allclose(back.apply(points.source), printed, rtol=1e-13)
    assert np.array_equal(back.apply(points.source), t.apply(points.source))
    assert (back.crs, back.source_names, back.model.name) == ("EPSG:32635", t.source_names, name)


@pytest.mark.behaviour
@pytest.mark.parametrize("text", ["", "[]", '{"schema": 2}', '{"schema": 1, "model": "affine"}', None])
def test_other_files_are_no_transformation(text: str | None, tmp_path: Path) -> None:
    path = tmp_path / "transformation.json"
    if text is not None:
        path.write_text(text, "utf-8")
    with pytest.raises(InputError) as caught:
        read_transformation(path)
    assert caught.value.problems[0].code == "rectify.saved"


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "degree"), [c for c in CASES if find_model(*c).linear])
def test_plain_coefficients_in_rational_numbers_give_the_same_points(name: str, degree: int | None) -> None:
    """The plain coefficients, evaluated exactly, give the fitted points within 1e-6.

    The rounding of degree 2 in full metres remains.
    """
    points = points_for(name, n=45)
    t = fit(points, find_model(name, degree)).transformation
    c = [Fraction(v) for v in (t.plain_coefficients() or {}).values()]
    for given, expected in zip(points.source[:5], t.apply(points.source[:5]), strict=True):
        s = [Fraction(float(v)) for v in given]
        if t.model.degree:
            powers = [(int(j), int(k)) for j, k in t.model.setup.T]
            found = [
                sum(c[r * len(powers) + i] * s[0] ** j * s[1] ** k for i, (j, k) in enumerate(powers)) for r in (0, 1)
            ]
        elif name == "helmert":
            found = [c[0] + c[2] * s[0] - c[3] * s[1], c[1] + c[3] * s[0] + c[2] * s[1]]
        else:
            found = [sum((c[4 * r + 1 + k] * s[k] for k in range(3)), c[4 * r]) for r in (0, 1)]
        assert [float(v) for v in found] == pytest.approx(expected, abs=1e-6)


@pytest.mark.behaviour
def test_quotients_have_no_plain_coefficients() -> None:
    assert fit(points_for("dlt"), find_model("dlt")).transformation.plain_coefficients() is None


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "degree"), CASES)
def test_many_points_follow_the_printed_formula(name: str, degree: int | None) -> None:
    points = points_for(name)
    t = fit(points, find_model(name, degree)).transformation
    normalised = formula(name, degree, t.source.normalised(points.source), t.coefficients)
    np.testing.assert_allclose(t.apply(points.source), t.target.physical(normalised), rtol=1e-13)


@pytest.mark.truth
def test_pair_distances_by_hand() -> None:
    first, second = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 8.0]]), np.array([[0.0, 0.0], [3.0, 3.0], [0.0, 7.0]])
    d = np.array([5.0 - math.sqrt(18.0), 1.0, 0.0])
    found = pair_distances(first, second)
    assert found.differences == pytest.approx(d)
    assert (found.mean, found.standard_deviation) == pytest.approx(
        (d.mean(), math.sqrt(np.sum((d - d.mean()) ** 2) / 2))
    )
    assert found.of_point[0] == pytest.approx(math.sqrt(np.mean((d[:2] - d.mean()) ** 2)))
    with pytest.raises(InputError):
        pair_distances(first[:2], second[:2])


@pytest.mark.oracle
def test_a_bad_point_stands_out_in_the_distances() -> None:
    rng = np.random.default_rng(1)
    first = rng.uniform(0.0, 3e4, (20, 2))
    second = first + rng.normal(0.0, 10.0, first.shape)
    second[7] += (150.0, 0.0)
    assert int(np.argmax(pair_distances(first, second).of_point)) == 7


@pytest.mark.oracle
def test_design_study_compares_at_independent_points() -> None:
    rng = np.random.default_rng(11)
    image = rng.uniform(0.0, 1000.0, (70, 2))
    every = Observations.of(image, 28.5 * image + rng.normal(0.0, 15.0, image.shape))
    control, test = every.take(np.arange(30)), every.take(np.arange(30, 70))
    cells = {(c.n_points, c.degree): c for c in design_study(control, test, [5, 30], [1, 2], layouts=5, seed=2)}
    assert cells[5, 2].layouts == 0 and "redundancy" in cells[5, 2].reason and math.isnan(cells[5, 2].median)
    assert cells[5, 1].layouts == 5 and cells[5, 1].low <= cells[5, 1].median <= cells[5, 1].high
    assert cells[30, 1].layouts == 1
    a = np.column_stack([np.ones(30), image[:30]])
    x = np.linalg.lstsq(a, control.target, rcond=None)[0]
    errors = np.column_stack([np.ones(40), image[30:]]) @ x - test.target
    assert cells[30, 1].median == pytest.approx(math.sqrt(np.mean(np.sum(errors**2, axis=1))), rel=1e-9)
    with pytest.raises(InputError):
        design_study(control, test, [31], [1])
    with pytest.raises(InputError, match="seed"):
        design_study(control, test, [30], [1], seed=-1)
