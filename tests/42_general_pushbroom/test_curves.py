"""Smooth curves of position and attitude have the stated prior and are adjusted by every backend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

import fg_orient as fg
from factors.geometry import polynomials
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options
from fg_orient.model.parameters import orientation_parameters, term_of
from fg_orient.result.tables import eop_rows
from fg_orient.sensors.correction import Correction
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

INTERVALS = 6


@pytest.mark.oracle
@pytest.mark.parametrize("n", [2, 5, 32])
def test_basis_is_that_of_scipy(n: int) -> None:
    tau = np.linspace(-1.0, 1.0, 101)
    knots = -1.0 + 2.0 / n * np.arange(-3, n + 4)
    expected = BSpline(knots, np.eye(n + 3), 3)(tau)
    assert np.abs(polynomials.basis(tau, n) - expected).max() < 1e-12
    assert (
        np.abs(polynomials.basis(np.array([-1.01, 1.01]), n) - BSpline(knots, np.eye(n + 3), 3)([-1.01, 1.01])).max()
        < 1e-12
    )


@pytest.mark.oracle
def test_the_prior_is_that_of_penalised_splines() -> None:
    """A curve with its prior equals a spline fitted with the penalty |D c|^2, and has the variance 1 on average."""
    rng, n, sigma = np.random.default_rng(5), 9, 0.3
    tau = np.sort(rng.uniform(-1.0, 1.0, 60))
    y = np.sin(4.0 * tau) + 0.1 * rng.normal(size=60)
    powers = tau[:, None] ** np.arange(3)
    ours = np.hstack([powers, sigma * polynomials.curves(tau, n)])
    prior = np.hstack([np.zeros((n, 3)), 0.1 * np.eye(n)])
    x = np.linalg.lstsq(np.vstack([ours, prior]), np.append(y, np.zeros(n)), rcond=None)[0]
    difference = np.diff(np.eye(n + 3), n=3, axis=0)
    # a curve of x has the third differences c x, c the scale of the curves
    scale = np.linalg.norm(
        difference @ np.linalg.lstsq(polynomials.basis(tau, n), polynomials.curves(tau, n), rcond=None)[0], 2
    )
    b = np.vstack([polynomials.basis(tau, n), 0.1 / (sigma * scale) * difference])
    c = np.linalg.lstsq(b, np.append(y, np.zeros(n)), rcond=None)[0]
    assert np.abs(ours @ x - polynomials.basis(tau, n) @ c).max() < 1e-9
    grid = polynomials.curves(np.linspace(-1.0, 1.0, 2001), n)
    assert np.mean(np.sum(grid**2, axis=1)) == pytest.approx(1.0, rel=1e-2)


@pytest.mark.behaviour
def test_names_and_sigmas() -> None:
    p = orientation_parameters(Options(eop_set=9, curve_intervals=3, curve_attitude_sigma_rad=7e-6))
    assert p.names[9:] == tuple(f"{a}_c{k}" for a in ("roll", "pitch", "yaw") for k in range(3))
    assert (p.sigma[9:] == 7e-6).all() and p.units[-1] == "rad" and p.words[9] == "roll (curve 0, rad)"
    term = term_of("roll_c11")
    assert term is not None and (term.component, term.degree, term.kind) == ("roll", None, "the curves")
    only = orientation_parameters(Options(image_unknowns=("roll_0", "x_c1"), curve_intervals=3))
    assert only.names == ("roll_0", "x_c1") and only.units == ("rad", "m")
    assert len(orientation_parameters(Options(eop_set=5, curve_intervals=3))) == 9  # velocities have none


@pytest.mark.behaviour
@pytest.mark.parametrize("value", [-1, 1, 33, 2.5])
def test_intervals_are_checked(value: object) -> None:
    with pytest.raises(InputError, match="curve_intervals"):
        Options(curve_intervals=value)  # type: ignore[arg-type]


def wavy(block: Block) -> tuple[Block, list[Correction]]:
    """Return the twin observed without noise by images whose attitude waves by some 1e-5 rad, and the true curves."""
    rng, o, known = np.random.default_rng(3), block.observations, block.points.known.ecef_m
    o = o.take(np.isfinite(known[o.point]).all(axis=1))
    line, sample, truth = o.line.copy(), o.sample.copy(), []
    for k, image in enumerate(block.images):
        curve = np.zeros((9, INTERVALS))
        curve[6:9] = 1e-5 * rng.normal(size=(3, INTERVALS))
        truth.append(Correction(curve=curve))
        rows = o.image == k
        line[rows], sample[rows] = image.sensor.project(known[o.point[rows]], truth[-1])
    observed = replace(o, line=line, sample=sample)
    return replace(block, observations=observed, withheld=replace(block.withheld, ids=())), truth


@pytest.fixture(scope="module")
def twin() -> tuple[Block, list[Correction]]:
    return wavy(zonguldak_block(ZonguldakOptions(seed=1))[0])


def with_options(block: Block, **changes: object) -> Block:
    return replace(block, options=replace(block.options, eop_set=9, **changes))


@pytest.mark.consistency
def test_rays_and_projection_agree_with_curves(twin: tuple[Block, list[Correction]]) -> None:
    block, truth = twin
    sensor = block.images[0].sensor
    line, sample = np.linspace(0.0, sensor.n_lines - 1.0, 7), np.linspace(0.0, sensor.n_samples - 1.0, 7)
    ground = sensor.locate(line, sample, height_m=300.0, correction=truth[0])
    back = sensor.project(ground, truth[0])
    assert max(np.abs(back[0] - line).max(), np.abs(back[1] - sample).max()) < 1e-6
    assert np.linalg.norm(ground - sensor.locate(line, sample, height_m=300.0), axis=1).max() > 3.0


def written(solution: fg.Solution) -> None:
    """Assert that the values of the result folder give the curves back."""
    for image in solution.block.images:
        values = {str(row[1]): float(str(row[5])) for row in eop_rows(solution) if row[0] == image.id}
        back, expected = image.sensor.correction_of(values, solution.block.options), solution.correction(image.id)
        assert isinstance(back, Correction)
        assert np.array_equal(back.curve, expected.curve) and np.array_equal(back.eop, expected.eop)


@pytest.mark.oracle
def test_curves_take_up_what_degree_2_cannot(twin: tuple[Block, list[Correction]]) -> None:
    """Curves reduce sigma0 tenfold and return the true attitudes within 10 %, equally on all three backends."""
    block, truth = twin
    plain = fg.adjust(with_options(block))
    options = {"curve_intervals": INTERVALS, "curve_attitude_sigma_rad": 1e-4}
    found = {b: fg.adjust(with_options(block, backend=b, **options)) for b in ("graph", "schur", "dense")}
    assert plain.sigma0 > 0.2 and found["graph"].sigma0 < 0.1 * plain.sigma0
    for name in ("schur", "dense"):
        assert np.abs(found[name].state.image - found["graph"].state.image).max() < 1e-8
        assert np.nanmax(np.abs(found[name].ground_m - found["graph"].ground_m)) < 1e-6
    written(found["schur"])
    o = block.observations
    for k in range(len(block.images)):
        tau = 2.0 * o.line[o.image == k] / (block.images[k].sensor.n_lines - 1.0) - 1.0
        got = found["schur"].correction(block.images[k].id)
        error = (got.eop_at(tau) - truth[k].eop_at(tau))[:, 6:8]
        assert np.abs(error).max() < 0.1 * np.abs(truth[k].eop_at(tau)[:, 6:8]).max()


@pytest.mark.oracle
def test_a_shared_look_polynomial_is_one(twin: tuple[Block, list[Correction]]) -> None:
    """A shared look polynomial is one set of unknowns, returns the true coefficients and is equal on all backends."""
    block, _ = twin
    o, known = block.observations, block.points.known.ecef_m
    truth = Correction(look=np.array([[0.0, 4e-6, 9e-6], [0.0, 2e-5, -6e-6]]))
    line, sample = o.line.copy(), o.sample.copy()
    for k, image in enumerate(block.images):
        rows = o.image == k
        line[rows], sample[rows] = image.sensor.project(known[o.point[rows]], truth)
    observed = replace(block, observations=replace(o, line=line, sample=sample))
    found = {
        b: fg.adjust(with_options(observed, look_polynomial=2, look_shared=True, backend=b))
        for b in ("graph", "schur", "dense")
    }
    first = found["graph"]
    assert first.problem.n_unknowns == fg.adjust(with_options(observed, look_polynomial=2)).problem.n_unknowns - 6
    for solution in found.values():
        look = [solution.correction(image.id).look for image in block.images]
        assert np.array_equal(look[0], look[1])
        assert np.abs(solution.state.image - first.state.image).max() < 1e-8
        assert np.abs(look[0][:, 2] - truth.look[:, 2]).max() < 2e-7
    assert first.sigma0 < 0.02  # nothing but the priors of the six coefficients: 0.018
