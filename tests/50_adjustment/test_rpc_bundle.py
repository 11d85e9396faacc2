"""RPC images in the bundle: both backends, an independent estimator, the truth, the datum, corrected models."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyproj
import pytest
from pyproj import Transformer
from scipy.optimize import least_squares
from scipy.stats import chi2

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.rows import groups
from fg_orient.model.block import Block, Image, ImagePoints
from fg_orient.model.errors import InputError, RankDeficientError
from fg_orient.model.names import Role, Status
from fg_orient.quality.accuracy import rms_px, y_parallaxes
from fg_orient.quality.covariance import cofactors_of
from fg_orient.rpc.files import corrected
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.full_statistics import Full, step_of_numpy
from tests.support.rpc_block import RpcTwin, rpc_twin, twin_with_models, without_control
from tests.support.rpc_model import reference_project

KINDS = ("shift", "shift_drift", "affine")

TO_GEODETIC = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)


def mixed(kind: str = "shift_drift") -> Block:
    """Return the left image with its rigorous model, the right one with an RPC: 18 and 2-6 unknowns."""
    rigorous, _, _ = twin_with_models()
    twin = rpc_twin(kind)
    o, p = rigorous.observations, twin.block.observations
    left = o.image == 0
    pixels = {n: np.where(left, getattr(o, n), getattr(p, n)) for n in ("line", "sample")}
    options = replace(rigorous.options, rpc_compensation=kind)
    return replace(rigorous, images=(rigorous.images[0], twin.block.images[1]), options=options,
                   observations=ImagePoints(o.image, o.point, **pixels, sigma_line_px=o.sigma_line_px,
                                            sigma_sample_px=o.sigma_sample_px))  # fmt: skip


def blocks() -> dict[str, Block]:
    """Return the blocks on which both backends must agree."""
    out = {kind: rpc_twin(kind).block for kind in KINDS} | {"mixed": mixed(), "mixed shift": mixed("shift")}
    fixed = out["affine"].points.known.fixed.copy()
    fixed[out["affine"].points.where(Role.CONTROL)[:5]] = True
    points = out["affine"].points
    out["fixed"] = replace(out["affine"], points=replace(points, known=replace(points.known, fixed=fixed)))
    out["excluded"] = replace(out["mixed"], options=replace(out["mixed"].options, check_points="exclude"))
    out["relative"] = relative(rpc_twin("shift").block)
    return out


def relative(block: Block) -> Block:
    """Return the block without control points, with the datum held by the priors."""
    free = without_control(block)
    return replace(free, options=replace(free.options, datum="priors"))


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name", ["shift", "shift_drift", "affine", "mixed", "mixed shift", "fixed", "excluded", "relative"]
)
@pytest.mark.parametrize("backend", ["graph", "schur"])
def test_graph_and_schur_equal_dense_and_numpy(name: str, backend: str) -> None:
    """For RPC blocks graph and Schur equal dense and numpy: unknowns, points, chi2 and cofactors.

    Limits are 1e-9 prior sigma, 1e-7 m, and 1e-7 of the cofactors' size.
    """
    block = blocks()[name]
    graph, dense = fg.adjust(block, backend=backend), fg.adjust(block, backend="dense")
    assert graph.status is dense.status is Status.CONVERGED, graph.reason
    assert np.abs(graph.state.image - dense.state.image).max() <= 1e-9
    assert np.nanmax(np.abs(graph.ground_m - dense.ground_m)) <= 1e-7
    assert graph.chi2 == pytest.approx(dense.chi2, rel=1e-9)
    assert graph.cofactors is not None and dense.cofactors is not None
    points = tuple(int(j) for j in np.flatnonzero(graph.problem.active)[:3])
    image, ground = step_of_numpy(graph.problem, graph.state)
    assert image <= 1e-9 and ground <= 1e-7
    full = Full.of(graph.problem, graph.state)
    for images, some in (((0, 1), points), ((0, 1), points[:1]), ((1,), points[1:2]), ((1, 0), ()), ((), points[:1])):
        parts = [full.problem.image_slice(k) for k in images] + [full.problem.point_slice(j) for j in some]
        columns = np.r_[tuple(parts)]
        expected = full.unknowns[np.ix_(columns, columns)]
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        for solution in (graph, dense):
            assert np.abs((solution.cofactors.joint(images, some) - expected) / scale).max() < 1e-7
    assert graph.cofactors.point(points[0]) == pytest.approx(dense.cofactors.point(points[0]), rel=1e-6)
    c, d = (s.accuracy.check.predicted_sigma_enu_m for s in (graph, dense))
    assert np.allclose(c, d, rtol=1e-6, atol=0.0)


@pytest.mark.behaviour
def test_images_of_different_kinds_keep_their_own_unknowns() -> None:
    """Images with 18 and 4 unknowns keep their sizes, names and units in states and matrices."""
    solution = fg.adjust(mixed())
    problem = solution.problem
    assert [len(p) for p in problem.parameters] == [18, 4]
    assert problem.first.tolist() == [0, 18, 22]
    assert solution.state.image.shape == (2, 18)
    assert not solution.state.image[1, 4:].any()
    assert groups(problem.models) == [[0], [1]]
    assert np.array_equal(problem.image_matrix(problem.image_vector(solution.state)), solution.state.image)
    matrix = solution.covariance("image:right", "image:left")
    assert matrix.names[:4] == ("right.line_0", "right.sample_0", "right.line_l1", "right.sample_l1")
    assert matrix.units[:5] == ("px", "px", "px", "px", "m")
    assert matrix.values.shape == (22, 22)
    assert solution.problem.n_observations == 2 * 94 + 3 * 37 + 22
    assert set(solution.rank_defect) == {"left", "right"}


@pytest.mark.consistency
def test_optimisers_agree() -> None:
    """GTSAM's Levenberg-Marquardt and Dogleg end at the solution of Gauss-Newton within 1e-9 prior sigma."""
    block = mixed()
    base = fg.adjust(block)
    for optimizer in ("levenberg-marquardt", "dogleg"):
        other = fg.adjust(block, optimizer=optimizer)
        assert np.abs(other.state.image - base.state.image).max() <= 1e-9, optimizer


@pytest.mark.oracle
def test_estimate_of_scipy() -> None:
    """scipy with residuals by pyproj and the RPC term by term has the same chi2, compensation and points."""
    block = few_points(rpc_twin("affine", seed=3).block)
    solution = fg.adjust(block)
    o, known = block.observations, block.points.known
    used = np.unique(o.point)
    geodetic = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    origin = solution.problem.origin_m
    prior = np.array([20.0, 20.0, 2.0, 2.0, 2.0, 2.0])
    control = np.array([j for j in block.points.where(Role.CONTROL) if j in used])
    whitening = [solution.problem.control_records[j, POINT.whitening].reshape(3, 3) for j in control]

    def residuals(z: np.ndarray) -> np.ndarray:
        c, ground = z[:12].reshape(2, 6), np.full((len(known.ecef_m), 3), np.nan)
        ground[used] = z[12:].reshape(-1, 3) + origin
        out = [z[:12]]
        for k, image in enumerate(block.images):
            rows, m, b = o.image == k, image.sensor.model, c[k] * prior
            line, sample = reference_project(m, *geodetic.transform(*ground[o.point[rows]].T))
            l, s = (line - m.offsets[0]) / m.scales[0], (sample - m.offsets[1]) / m.scales[1]  # noqa: E741
            out += [(line + b[0] + b[2] * l + b[4] * s - o.line[rows]) / 0.3,
                    (sample + b[1] + b[3] * l + b[5] * s - o.sample[rows]) / 0.3]  # fmt: skip
        out += [w @ (ground[j] - known.ecef_m[j]) for w, j in zip(whitening, control, strict=True)]
        return np.concatenate(out).astype(float)

    start = np.concatenate([np.zeros(12), solution.problem.start.ground[used].ravel()])
    scale = np.concatenate([np.ones(12), np.full(3 * len(used), 10.0)])
    found = least_squares(residuals, start, method="trf", x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert 2.0 * found.cost == pytest.approx(solution.chi2, rel=1e-9)
    assert np.abs(found.x[:12] - solution.problem.image_vector(solution.state)).max() < 1e-5
    assert np.abs(found.x[12:].reshape(-1, 3) - solution.state.ground[used]).max() < 1e-4  # differences of 1e-8 px


def few_points(block: Block, count: int = 9) -> Block:
    """Return the block with every fifth point only, and all observations of it."""
    return replace(block, observations=block.observations.take(block.observations.point % 5 == 0))


@pytest.mark.oracle
def test_residuals_are_those_of_the_corrected_sensor() -> None:
    """Residuals are projected minus observed pixels of the sensor with the compensation of the solution."""
    block = mixed("affine")
    solution = fg.adjust(block)
    o = solution.problem.observations
    for k, image in enumerate(block.images):
        rows = np.flatnonzero(o.image == k)
        line, sample = image.sensor.project(solution.ground_m[o.point[rows]], solution.correction(image.id))
        v = np.stack([line - o.line[rows], sample - o.sample[rows]], axis=1)
        if k == 1:  # the RPC by the evaluation written apart, the terms of the compensation in normalised pixels
            model, geodetic = image.sensor.model, TO_GEODETIC.transform(*solution.ground_m[o.point[rows]].T)
            plain = np.array(reference_project(model, *geodetic), float)
            normal = np.vstack([np.ones((1, len(rows))), (plain - model.offsets[:2, None]) / model.scales[:2, None]])
            moved = plain + np.asarray(solution.correction(image.id)).reshape(3, 2).T @ normal
            assert np.abs((moved - [o.line[rows], o.sample[rows]]).T - solution.residuals_px[rows]).max() < 1e-6
        # the rigorous image is whitened with derivatives at the start: second order in the correction
        assert np.abs(v - solution.residuals_px[rows]).max() < (1e-9 if k == 1 else 1e-4)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_truth_is_met_within_the_covariance(kind: str) -> None:
    """Over ten blocks the squares of normalised true errors lie in the 99.9 % interval of their chi-square.

    Compensations are drawn from the priors.
    """
    squares, freedom, fits, redundancy = 0.0, 0, 0.0, 0
    for seed in range(10):
        twin = rpc_twin(kind, seed=100 + seed)
        solution = fg.adjust(twin.block)
        error, q = _error(twin, solution)
        squares, freedom = squares + float(error @ np.linalg.solve(q, error)), freedom + len(error)
        fits, redundancy = fits + solution.chi2, redundancy + solution.redundancy
    low, high = chi2.ppf([0.0005, 0.9995], freedom)
    assert low < squares < high, (squares, freedom)
    # control coordinates are those of one simulation: only image noise and compensation are drawn anew
    assert fits < chi2.ppf(0.9995, redundancy)


def _error(twin: RpcTwin, solution: fg.Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint error of all compensation unknowns and check points, and its covariance in prior scale."""
    check = tuple(int(j) for j in twin.block.points.where(Role.CHECK))
    names = [f"image:{i.id}" for i in twin.block.images] + [f"point:{twin.block.points.ids[j]}" for j in check[:4]]
    codes = list(solution.problem.parameters[0].codes)
    found = np.concatenate([solution.correction(i.id)[codes] for i in twin.block.images])
    error = np.concatenate([found - twin.compensation[:, codes].ravel(),
                            (solution.ground_m - twin.ecef_m)[list(check[:4])].ravel()])  # fmt: skip
    return error, solution.cofactor_matrix(*names).values


# --- datum --------------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_block_without_control_is_refused_unless_it_may_be_relative() -> None:
    free = without_control(rpc_twin("shift").block)
    with pytest.raises(InputError) as caught:
        fg.adjust(free, datum="control")
    assert caught.value.problems[0].code == "block.no_control"
    assert fg.adjust(free).problem.block.options.datum == "vendor"
    with pytest.raises(InputError) as caught:
        fg.adjust(free, datum="priors", priors=False)
    assert caught.value.problems[0].code == "adjust.relative_priors"


@pytest.mark.oracle
def test_relative_adjustment_names_its_datum_and_removes_parallax() -> None:
    """A relative adjustment names three common shifts, reduces the y-parallax to noise and states no accuracy."""
    twin = rpc_twin("shift", seed=5)
    solution = fg.adjust(relative(twin.block))
    shifts = [text for text in solution.unobservable if "shifted together" in text]
    assert [next(w for w in ("East", "North", "Up") if w in text) for text in shifts] == ["East", "North", "Up"]
    assert any(text.startswith("relative adjustment: no control point") for text in solution.warnings)
    _, before = y_parallaxes(solution.problem, solution.problem.start)
    _, after = y_parallaxes(solution.problem, solution.state)
    assert len(before) == len(after) == 47
    assert rms_px(before) > 3.0
    # one condition per point, in the unit of one image's coordinate across the epipolar line: sqrt(2) sigma
    assert rms_px(after) == pytest.approx(np.sqrt(2.0) * 0.3, rel=0.25)
    assert len(solution.accuracy.control) == len(solution.accuracy.check) == 0


@pytest.mark.oracle
def test_parallax_is_what_one_image_is_off() -> None:
    """If the right image is moved by 2 px across its epipolar lines, the y-parallax is 2 px within 5 %."""
    twin = rpc_twin("shift", noise_px=0.0)
    block = relative(twin.block)
    images = tuple(Image(i.id, RpcSensor(corrected(i.sensor.model, twin.compensation[k]).model))
                   for k, i in enumerate(block.images))  # fmt: skip
    exact = compile_problem(replace(block, images=images))
    assert y_parallaxes(exact, exact.start)[1].max() < 1e-5
    o = block.observations
    moved = replace(block, images=images, observations=replace(o, line=o.line + 2.0 * (o.image == 1)))
    problem = compile_problem(moved)
    _, parallax = y_parallaxes(problem, problem.start)
    # sideways stereo: lines are across the epipolar plane, up to the angle between both tracks
    assert parallax == pytest.approx(np.full(len(parallax), 2.0), rel=0.05)


@pytest.mark.consistency
def test_control_fixes_the_datum_also_when_priors_may_hold_it() -> None:
    block = rpc_twin("shift").block
    solution = fg.adjust(block, datum="priors")
    assert solution.unobservable == ()
    assert np.array_equal(solution.state.image, fg.adjust(block).state.image)


def with_control(block: Block, keep: tuple[int, ...]) -> Block:
    """Return the block with only these points as control points and the others as tie points."""
    roles = tuple(Role.CONTROL if j in keep else Role.TIE for j in range(len(block.points.ids)))
    known = block.points.known
    mask = np.array([r is Role.CONTROL for r in roles])[:, None]
    ecef, sigma = np.where(mask, known.ecef_m, np.nan), np.where(mask, known.sigma_enu_m, np.nan)
    points = replace(block.points, roles=roles, known=replace(known, ecef_m=ecef, sigma_enu_m=sigma))
    return replace(block, points=points, withheld=replace(block.withheld, ids=()))


@pytest.mark.behaviour
def test_without_priors_what_an_image_cannot_show_is_refused_in_words() -> None:
    """Without priors two control points in one image are refused, with the terms that are not observable.

    With priors the rank defect is stated and the block is solved.
    """
    block = rpc_twin("affine").block
    keep = tuple(int(j) for j in block.points.where(Role.CONTROL)[:2])
    o = block.observations
    few = replace(with_control(block, keep), images=block.images[:1],
                  observations=o.take((o.image == 0) & np.isin(o.point, keep)))  # fmt: skip
    with pytest.raises(RankDeficientError) as caught:
        fg.adjust(few, priors=False)
    assert caught.value.rank_defect == {"left": 2}
    structural, *directions = caught.value.problems
    assert structural.code == "statistics.too_few" and structural.place.startswith("image left: 2 image points")
    assert all("not observable" in p.place and "(px)" in p.place for p in directions)
    assert fg.adjust(few).rank_defect == {"left": 2}  # with priors it is said, and solved


@pytest.mark.behaviour
def test_without_priors_weak_directions_are_pointed_out() -> None:
    """Without priors one control point gives a warning about weak directions; all control points do not."""
    block = rpc_twin("affine").block
    keep = tuple(int(j) for j in block.points.where(Role.CONTROL)[:1])
    weak = fg.adjust(with_control(block, keep), priors=False)
    assert any("determined 100 times worse" in text for text in weak.warnings)
    free = fg.adjust(block, priors=False)
    assert not any("determined 100 times worse" in text for text in free.warnings)
    assert np.abs(free.correction("left") - fg.adjust(block).correction("left")).max() < 0.5


@pytest.mark.behaviour
def test_sensor_without_model_is_refused() -> None:
    block = rpc_twin("shift").block
    stranger = SimpleNamespace(georeferenced=True, orients=True, n_lines=100, n_samples=100, notes=(), file="a")
    other = replace(block, images=(block.images[0], Image("right", stranger)))  # type: ignore[arg-type]
    with pytest.raises(InputError) as caught:
        fg.adjust(other)
    assert caught.value.problems[0].code == "adjust.no_model"
    assert caught.value.problems[0].place == "image right"


@pytest.mark.oracle
def test_cofactors_are_the_inverse_of_the_normal_matrix() -> None:
    """Joint cofactors of all image unknowns of a mixed block equal numpy's inverse within 1e-6."""
    from fg_orient.adjustment.dense import assemble
    from fg_orient.adjustment.solve import solve

    problem = compile_problem(mixed())
    estimate = solve(problem)
    _, design = assemble(problem, estimate.state)
    expected = np.linalg.inv(design.T @ design)[:22, :22]
    found = cofactors_of(problem, estimate).joint((0, 1), ())
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 1e-6
    assert design.shape[1] == problem.n_unknowns
