"""Variance components agree with planted ones and with an independent likelihood; some are held or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2
from scipy.stats import t as student

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.model.block import Block
from fg_orient.orientation.components import adjust_with_components
from fg_orient.quality import observation_groups as module
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.suspects import suspects
from fg_orient.quality.variance_components import freedoms
from tests.support.full_statistics import turned_design, turned_rows
from tests.support.planted_errors import planted

GROUPS = ("image", "position", "height")
TRUE = {"image": 0.8, "position": 2.0, "height": 1.5}
DENSE = {"rpc_compensation": "shift", "backend": "schur"}


def drawn(seed: int, **factors: float) -> Block:
    return planted().draw(np.random.default_rng(seed), **(factors or TRUE))


def estimated(block: Block, **options: object) -> fg.Solution:
    return fg.adjust(block, variance_components=GROUPS, **{**DENSE, **options})


@pytest.fixture(scope="module")
def solution() -> fg.Solution:
    return estimated(drawn(1))


def relative_errors(seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Return estimated over true variances minus 1 (runs, groups), and their stated covariances (runs, g, g)."""
    errors, stated = [], []
    for seed in seeds:
        found = estimated(drawn(seed)).components
        assert found is not None
        errors.append([(found.factor(name) / TRUE[name]) ** 2 - 1.0 for name in GROUPS])
        stated.append(found.covariance)
    return np.array(errors), np.array(stated)


def calibrated(errors: np.ndarray, stated: np.ndarray) -> bool:
    """Return whether the mean of e^T C^-1 e is in its 99.9 % interval; C belongs to the true variances.

    e is a sum of squares of normal errors: its kurtosis widens the chi-square's interval by the root of 1 + 12 / (2 nu)
    per component, nu = 2 / C_ii.
    """
    c = stated.mean(axis=0)
    m = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(c), errors)
    dof = errors.size
    widened = float(np.sqrt(1.0 + 3.0 * np.diag(c).max()))
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], dof) / dof - 1.0
    return bool(low * widened < m.mean() / errors.shape[1] - 1.0 < high * widened)


@pytest.mark.oracle
def test_planted_components_are_met_within_their_stated_deviations() -> None:
    errors, stated = relative_errors(range(100, 104))
    assert calibrated(errors, stated)
    assert not calibrated(errors, stated / 16.0), "a standard deviation of a quarter must not pass"
    assert not calibrated(errors + 1.0, stated), "a variance twice as large must not pass"


@pytest.mark.oracle
@pytest.mark.slow
def test_planted_components_of_200_seeds() -> None:
    errors, stated = relative_errors(range(1000, 1200))
    c = stated.mean(axis=0)
    m = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(c), errors).mean() / 3.0
    print(f"\nmean of e C^-1 e / 3: {m:.3f}; mean error {errors.mean(axis=0)}; "
          f"spread over stated {errors.std(axis=0) / np.sqrt(np.diag(c))}")  # fmt: skip
    assert calibrated(errors, stated)
    assert np.abs(errors.mean(axis=0) / np.sqrt(np.diag(c) / len(errors))).max() < 3.9  # no bias
    assert not calibrated(errors, stated / 2.0)


@pytest.mark.oracle
def test_maximum_of_an_independent_restricted_likelihood() -> None:
    """The factors of sigmas maximise the restricted likelihood of full matrices, by scipy.

    It is -2 ln L = ln|V| + ln|A^T V^-1 A| + l^T P l for the linear model at the solution.
    """
    start = fg.adjust(drawn(1), **DENSE)
    problem = start.problem
    given, a = assemble(problem, start.state)
    n = 2 * len(problem.observations)
    # rows of a control point are W (G - G_0), W upper triangular of East, North, Up in sigmas: turned back to the axes
    for k in range(int(problem.observed.sum())):
        rows = slice(n + 3 * k, n + 3 * k + 3)
        w = problem.control_records[k, POINT.whitening].reshape(3, 3)
        sigma = problem.block.points.known.sigma_enu_m[k]
        axes = problem.axes(problem.control_records[k : k + 1, POINT.place] + problem.origin_m)[0]
        turn = axes / sigma[:, None] @ np.linalg.inv(w)
        given[rows], a[rows] = turn @ given[rows], turn @ a[rows]
    a = a / np.linalg.norm(a, axis=0)
    group = np.concatenate([np.zeros(n, int), np.tile([1, 1, 2], (len(given) - n - 4) // 3), np.full(4, 3)])

    def minus_two_log(log_factor: np.ndarray) -> float:
        weight = 1.0 / np.append(np.exp(log_factor), 1.0)[group]
        r = np.linalg.qr(a * weight[:, None])
        v = given * weight
        v = v - r.Q @ (r.Q.T @ v)
        return float(v @ v - 2.0 * np.log(weight).sum() + 2.0 * np.log(np.abs(np.diag(r.R))).sum())

    best = minimize(minus_two_log, np.zeros(3), method="BFGS", options={"gtol": 1e-6})
    found = estimated(drawn(1)).components
    assert found is not None
    np.testing.assert_allclose([found.factor(name) for name in GROUPS], np.exp(best.x), rtol=2e-4)
    # the weights of heights wrong by 10 %: not the maximum
    assert minus_two_log(best.x + np.array([0.0, 0.0, 0.1])) > best.fun + 0.1


@pytest.mark.oracle
def test_after_the_rounds_each_group_has_the_squares_that_its_redundancy_says(solution: fg.Solution) -> None:
    """With the found sigmas the squares of the image points equal their redundancy, and all factors are 1.

    The squares are computed from pixel residuals.
    """
    o, components = solution.problem.observations, solution.components
    assert components is not None
    assert solution.block.options.variance_components == GROUPS
    v = solution.residuals_px / np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    by_name = {c.group: c for c in components.components}
    assert np.sum(v**2) == pytest.approx(by_name["image"].redundancy, rel=1e-4)
    assert o.sigma_line_px[0] == pytest.approx(0.5 * by_name["image"].factor)
    assert sum(c.n for c in components.components) == 188 + 141
    again = fg.adjust(replace(solution.block, options=replace(solution.block.options, variance_components=())))
    assert again.chi2 == pytest.approx(solution.chi2, rel=1e-9)
    once = again.variance_components(groups=GROUPS)
    assert [c.factor for c in once.components] == pytest.approx([1.0] * 3, abs=1e-5)


def moments(solution: fg.Solution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sums of squares (3,) and redundancies (3,) of the groups, and S (3, 3), from the full matrix.

    The weights of the solution apply.
    """
    v, a = turned_rows(solution.problem, solution.state)
    n, m = 2 * len(solution.problem.observations), int(solution.problem.observed.sum())
    basis = np.linalg.qr(a / np.linalg.norm(a, axis=0)).Q
    r = np.eye(len(v)) - basis @ basis.T
    select = np.eye(4)[np.concatenate([np.zeros(n, int), np.tile([1, 1, 2], m), np.full(len(v) - n - 3 * m, 3)])][:, :3]
    return v**2 @ select, np.diag(r) @ select, select.T @ r**2 @ select


@pytest.mark.oracle
def test_all_backends_and_both_equations_have_one_fixed_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """All backends and both equations end at one set of factors, where squares equal numpy's redundancy."""
    block, factors = drawn(1), []

    def require_fixed(solution: fg.Solution) -> None:
        given, known = block.observations.sigma_line_px[0], block.points.known.sigma_enu_m[0]
        now, components = solution.block, solution.components
        assert components is not None
        ratio = [now.observations.sigma_line_px[0] / given, *(now.points.known.sigma_enu_m[0] / known)[1:]]
        assert [c.factor for c in components.components] == pytest.approx(ratio, rel=1e-12)
        squares, redundancy, _ = moments(solution)
        assert squares == pytest.approx(redundancy, rel=1e-4)

    for backend in ("graph", "schur", "dense"):
        solution = estimated(block, backend=backend)
        found = solution.components
        assert found is not None and found.exact
        factors.append([c.factor for c in found.components])
        require_fixed(solution)
    np.testing.assert_allclose(factors[1:], factors[:1] * 2, rtol=1e-7)
    monkeypatch.setattr(module, "LARGEST", 0)  # Foerstner's equation, as for very large blocks
    solution = estimated(block)
    found = solution.components
    assert found is not None and not found.exact
    require_fixed(solution)
    assert [c.factor for c in found.components] == pytest.approx(factors[0], rel=1e-4)
    assert "lower bounds" in str(found.findings[-1]) and "too many false alarms" in str(found.findings[-1])


@pytest.mark.behaviour
def test_groups_by_image_and_of_priors() -> None:
    rng = np.random.default_rng(5)
    block = planted().draw(rng)
    o = block.observations
    noise = rng.normal(size=(2, len(o))) * (o.image == 1) * 2.0
    block = replace(block, observations=replace(o, line=o.line + noise[0], sample=o.sample + noise[1]))
    found = fg.adjust(block, variance_components=("image_by_image", "control", "priors"), **DENSE).components
    assert found is not None
    assert [c.group for c in found.components] == ["image left", "image right", "control", "prior RPC shift"]
    assert found.factor("image right") > 2.0 * found.factor("image left")
    shift = fg.adjust(block, variance_components=("priors",), **DENSE)
    assert shift.block.options.rpc_shift_sigma_px == pytest.approx(20.0 * shift.components.factor("prior RPC shift"))


@pytest.mark.behaviour
def test_too_little_redundancy_is_held_and_said() -> None:
    known = planted().block.points.known
    sigma = known.sigma_enu_m * [1e-3, 1e-3, 1.0]
    block = drawn(2, image=1.0, position=1e-3, height=1.0)
    block = replace(block, points=replace(block.points, known=replace(block.points.known, sigma_enu_m=sigma)))
    solution = estimated(block)
    components = solution.components
    assert components is not None
    position = {c.group: c for c in components.components}["position"]
    assert (position.factor, position.sd) == (1.0, None)
    assert position.held.endswith("at the given sigma it is 0.0")
    assert any("position is held" in text for text in solution.warnings)


def with_sigmas(block: Block, image: float, control: float) -> Block:
    """Return the block with other given sigmas and the same errors."""
    o, known = block.observations, block.points.known
    o = replace(o, sigma_line_px=image * o.sigma_line_px, sigma_sample_px=image * o.sigma_sample_px)
    known = replace(known, sigma_enu_m=control * known.sigma_enu_m)
    return replace(block, observations=o, points=replace(block.points, known=known))


@pytest.mark.oracle
def test_the_start_does_not_matter() -> None:
    """Factors and their sigmas do not depend on the given sigmas, wrong by 100 in opposite directions.

    Sums of squares and standard deviations at the end are those of the full matrix by numpy.
    """
    block = drawn(1)
    from_right, from_wrong = estimated(block), estimated(with_sigmas(block, 10.0, 0.1))
    right, wrong = from_right.components, from_wrong.components
    assert right is not None and wrong is not None
    for solution, found in ((from_right, right), (from_wrong, wrong)):
        squares, redundancy, s = moments(solution)
        assert squares == pytest.approx(redundancy, rel=1e-4)
        of_variances = np.sqrt(2.0 * np.diag(np.linalg.inv(s)))
        assert [c.sd for c in found.components] == pytest.approx(
            [0.5 * c.factor * sd for c, sd in zip(found.components, of_variances, strict=True)], rel=1e-3
        )
    given = [10.0, 0.1, 0.1]
    assert [c.factor * g for c, g in zip(wrong.components, given, strict=True)] == pytest.approx(
        [c.factor for c in right.components], rel=1e-4
    )
    assert [c.sd * g for c, g in zip(wrong.components, given, strict=True) if c.sd] == pytest.approx(
        [c.sd for c in right.components], rel=1e-3
    )


@pytest.mark.behaviour
@pytest.mark.parametrize(("factors", "code"), [
    ({"image": 1e-9, "position": 1.0, "height": 1.0}, "statistics.component_negative"),
    ({"image": 1.0, "position": 1.0, "height": 1.0}, "statistics.component_explodes"),
])  # fmt: skip
def test_what_cannot_be_estimated_is_refused_in_words(factors: dict[str, float], code: str) -> None:
    block = drawn(3, **factors)
    if code.endswith("explodes"):
        block = with_sigmas(block, 1e-5, 1e-5)
    with pytest.raises(fg.NoSolutionError) as caught:
        estimated(block)
    assert caught.value.problems[0].code == code


@pytest.mark.behaviour
@pytest.mark.parametrize(("options", "code"), [
    ({"variance_components": ("pixels",)}, "statistics.groups"),
    ({"variance_components": ("image", "image_by_image")}, "statistics.groups_overlap"),
    ({"variance_components": ("control", "height")}, "statistics.groups_overlap"),
    ({"variance_components": ("image",), "loss": "huber"}, "statistics.components_loss"),
])  # fmt: skip
def test_impossible_choices(options: dict[str, object], code: str) -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(planted().block, **{**DENSE, **options})
    assert caught.value.problems[0].code == code


@pytest.mark.oracle
def test_medians_withstand_gross_errors() -> None:
    """With a sixth of the image points wrong by 30 px the median factor is 0.7 to 2, that of sums above 10.

    Control points are better than image points, so that ground points cannot follow the errors.
    """
    block = drawn(4, image=1.0, position=0.1, height=0.1)
    known, o = block.points.known, block.observations
    rows = np.arange(len(o))
    error = np.where(rows % 6 == 0, 30.0, 0.0) * (-1.0) ** (rows // 6)  # both signs: the shift stays
    block = replace(
        block, observations=replace(o, sample=o.sample + error),
        points=replace(block.points, known=replace(known, sigma_enu_m=0.1 * known.sigma_enu_m)),
        options=replace(block.options, variance_components=("image",)),
    )  # fmt: skip

    def run(b: Block, begin: object) -> fg.Solution:
        return fg.adjust(b, **DENSE)

    sums, medians = (adjust_with_components(block, run, method=m).components for m in ("helmert", "median"))
    assert sums is not None and medians is not None
    assert sums.factor("image") > 10.0
    assert 0.7 < medians.factor("image") < 2.0
    assert medians.components[0].sd is None


@pytest.mark.oracle
def test_freedom_of_a_suspect_is_that_of_the_variance_of_its_error(solution: fg.Solution) -> None:
    """The degrees of freedom of a suspect follow from c_j = dVar / ds_j^2 of its error, from full matrices.

    The weights are held fixed.
    """
    problem, state, components = solution.problem, solution.state, solution.components
    assert components is not None
    residuals = GroupedResiduals(solution.residual_cofactors, groups_of(problem, GROUPS))
    found = suspects(solution.residual_cofactors)
    nu = freedoms(residuals, found, components)
    _, a = assemble(problem, state)
    n, row = len(a), 7
    e = np.zeros((n, 1))
    e[2 * row] = 1.0  # line of image point 7 alone
    full = np.hstack([a / np.linalg.norm(a, axis=0), e])
    estimator = np.linalg.pinv(full)[-1]
    labels = np.concatenate([np.zeros(188, int), np.repeat([1], 141), np.full(n - 188 - 141, 3)])
    share = np.array([np.sum(estimator[labels == k] ** 2) for k in (0, 1)]) / np.sum(estimator**2)
    line = replace(found[0], columns=found[0].columns[:, :, :1])
    one = freedoms(residuals, [line], components)[row]
    a = turned_design(problem, state)
    basis = np.linalg.qr(a / np.linalg.norm(a, axis=0)).Q
    r = np.eye(n) - basis @ basis.T
    c = np.bincount(np.where(residuals.labels < 0, 3, residuals.labels), r[:, 2 * row] ** 2 / r[2 * row, 2 * row])
    assert [c[0], c[1] + c[2]] == pytest.approx(share, rel=1e-6)
    assert one == pytest.approx(2.0 / (c[:3] @ components.covariance @ c[:3]), rel=1e-9)
    # by hand, one suspect at a time: a height and an image point
    for part, place, rows in ((0, 5, [10, 11]), (2, 4, [200, 201, 202])):
        s = found[part]
        e = np.zeros((n, s.columns.shape[2]))
        e[rows] = s.columns[place]
        effect = r @ e
        weight = np.einsum("na,ab,nb->n", effect, np.linalg.pinv(e.T @ effect), effect) / e.shape[1]
        share = np.bincount(np.where(residuals.labels < 0, 3, residuals.labels), weight)[:3]
        assert nu[sum(len(x.point) for x in found[:part]) + place] == pytest.approx(
            2.0 / (share @ components.covariance @ share), rel=1e-6
        )
    whole = suspects(solution.residual_cofactors, "points")
    at = int(np.flatnonzero(problem.observed)[3])
    s = next(s for s in whole if at in s.point)
    mine = np.flatnonzero(problem.observations.point == at)
    expected = [*np.stack([2 * mine, 2 * mine + 1], axis=1).ravel(), 197, 198, 199]
    assert s.rows[s.point.tolist().index(at)].tolist() == expected
    assert nu.max() < problem.redundancy  # less is known of a mixture than of one unit weight
    known = fg.adjust(solution.block, variance_components=(), **DENSE)
    assert solution.outlier_tests().critical.max() > known.outlier_tests().critical.max()


@pytest.mark.behaviour
def test_sigma0_does_not_test_a_model_whose_sigmas_it_gave(solution: fg.Solution) -> None:
    assert solution.sigma0 == pytest.approx(1.0, abs=0.05)
    assert np.isnan(solution.sigma0_interval).all()
    assert "sigma0 does not test the model" in solution.reason
    assert any("sigma0 does not test the model" in text for text in solution.warnings)
    with pytest.raises(fg.NoSolutionError, match="circular"):
        solution.global_test()
    known = fg.adjust(solution.block, variance_components=(), **DENSE)
    assert known.global_test() is not None and known.sigma0_interval[0] < 1.0


@pytest.mark.oracle
def test_freedom_of_an_unknown_is_that_of_its_variance(solution: fg.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """The degrees of freedom of an unknown follow from the derivatives of its variance, from full matrices."""
    problem, components = solution.problem, solution.components
    assert components is not None
    found = solution.significance()
    _, a = assemble(problem, solution.state)
    a = a / (length := np.linalg.norm(a, axis=0))
    h = np.linalg.pinv(a) / length[:, None]
    n = 2 * len(problem.observations)
    turn = np.eye(len(a))
    for k in range(int(problem.observed.sum())):
        record = problem.control_records[problem.observed][k]
        axes = problem.axes(record[None, POINT.place] + problem.origin_m)[0]
        sigma = problem.block.points.known.sigma_enu_m[problem.observed][k]
        rows = slice(n + 3 * k, n + 3 * k + 3)
        turn[rows, rows] = axes / sigma[:, None] @ np.linalg.inv(record[POINT.whitening].reshape(3, 3))
    h = h @ turn.T
    n_control = int(problem.observed.sum())
    group = np.concatenate([np.zeros(n, int), np.tile([1, 1, 2], n_control), np.full(len(a) - n - 3 * n_control, 3)])
    select = np.eye(4)[group][:, :3]

    def freedom(rows: list[int]) -> float:
        inverse = np.linalg.inv(h[rows] @ h[rows].T)
        share = np.array([np.trace(inverse @ (h[rows] * s) @ h[rows].T) for s in select.T]) / len(rows)
        return float(2.0 / (share @ components.covariance @ share))

    assert [c.freedom for c in found.coefficients] == pytest.approx([freedom([k]) for k in range(4)], rel=1e-6)
    groups = {g.group: g for g in found.groups}
    assert groups["line, all terms"].freedom == pytest.approx(freedom([0, 2]), rel=1e-6)
    assert max(c.freedom for c in found.coefficients) < problem.redundancy
    tails = [2.0 * student.sf(abs(c.t), c.freedom) for c in found.coefficients]
    assert [c.probability for c in found.coefficients] == pytest.approx(tails, rel=1e-6, abs=0.0)
    monkeypatch.setattr(module, "LARGEST", 0)
    with pytest.raises(fg.NoSolutionError, match="too large"):
        replace(solution).significance()


def false_alarms(seeds: range, level: float) -> tuple[int, int]:
    """Return the number of alarms and of tests in good blocks whose sigmas are estimated."""
    alarms, total = 0, 0
    for seed in seeds:
        tests = estimated(drawn(seed)).outlier_tests(level=level, control="none")
        alarms, total = alarms + len(tests.suspicious()), total + tests.n_tested
    return alarms, total


@pytest.mark.oracle
@pytest.mark.slow
def test_false_alarms_with_estimated_components() -> None:
    """With estimated components the rate of alarms at 1 % is within five deviations of independent tests."""
    alarms, total = false_alarms(range(3000, 3100), 0.01)
    print(f"\n{alarms} alarms in {total} tests: {100 * alarms / total:.2f} %")
    assert abs(alarms - 0.01 * total) < 5.0 * np.sqrt(0.01 * total)


@pytest.mark.oracle
def test_gross_errors_are_found_although_sigmas_are_unknown() -> None:
    block = drawn(6, image=1.0, position=1.0, height=1.0)
    o, known = block.observations, block.points.known
    o = replace(o, sample=o.sample + 15.0 * (np.arange(len(o)) == 11))
    block = replace(block, observations=o, points=replace(block.points, known=known))
    found = fg.adjust(block, snoop=True, variance_components=GROUPS, **DENSE)
    image, point = block.images[int(o.image[11])].id, block.points.ids[int(o.point[11])]
    assert [test.name for test in found.snooping.tests] == [f"point {point} in image {image}"]
    assert found.components is not None
    assert found.components.factor("image") == pytest.approx(1.0, abs=0.3)
