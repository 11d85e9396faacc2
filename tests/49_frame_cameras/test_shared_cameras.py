"""Cameras that images share: three backends, numpy, DBAT's published results, free networks, refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.rows import residuals
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.quality.camera import frame_cofactors, inseparable
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.covariance import cofactors_of
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.result.statistics import correlation_record
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameSensor
from tests.support import dbat
from tests.support.pinhole import SIGMA, pinhole_block

INTERIOR = {"focal": 5.0, "principal_sample": 3.0, "principal_line": 3.0, "k1": 1e-2}


@lru_cache
def shared(model: str = "", held: bool = True, priors: bool = False) -> Block:
    """Return four images of one camera.

    The first image and X of the second centre are held, or nothing is.
    """
    block, _ = pinhole_block(4, 25, views=3, seed=2)
    images = []
    for k, image in enumerate(block.images):
        exterior = {n: s for n, s in SIGMA.items() if n[:3] in ("rot", "cen")}
        if held:
            exterior = {} if k == 0 else {n: s for n, s in exterior.items() if (k, n) != (1, "centre_x")}
        own = image.sensor.camera
        camera = replace(
            own, sigma=exterior | INTERIOR, shared=dict.fromkeys(INTERIOR, "one"),
            distortion=np.zeros(5), focal_px=block.images[0].sensor.camera.focal_px,
            principal_px=np.zeros(2), **({"model": model, "unit_px": 900.0} if model else {}),
        )  # fmt: skip
        s = image.sensor
        images.append(replace(image, sensor=FrameSensor(
            camera, s.n_lines, s.n_samples, first_line=s.first_line, first_sample=s.first_sample, georeferenced=False,
        )))  # fmt: skip
    datum = "control" if held else "priors" if priors else "inner"
    options = replace(block.options, priors=priors, datum=datum, optimizer="gauss-newton")
    return replace(block, images=tuple(images), options=options)


def solved(block: Block, backend: str) -> tuple[Problem, Estimate, Cofactors]:
    problem = compile_problem(replace(block, options=replace(block.options, backend=backend)))
    estimate = solve(problem)
    assert estimate.converged
    return problem, estimate, cofactors_of(problem, estimate)


@pytest.mark.oracle
@pytest.mark.parametrize("model", ["", MEASURED_TO_IDEAL])
def test_backends_agree_with_numpy(model: str) -> None:
    found = {name: solved(shared(model), name) for name in ("graph", "schur", "dense")}
    problem, estimate, _ = found["dense"]
    assert problem.n_unknowns == 3 * 6 - 1 + 4 + 3 * int(problem.active.sum())
    assert problem.ties is not None
    wide = assemble(problem, estimate.state)[1]
    w, z = problem.n_image_unknowns, len(problem.ties)
    t = np.zeros((wide.shape[1], z + wide.shape[1] - w))
    t[np.arange(w), problem.ties.of] = 1.0
    t[w:, z:] = np.eye(wide.shape[1] - w)
    design = wide @ t
    residual = assemble(problem, estimate.state)[0]
    assert np.linalg.norm(design.T @ residual) < 1e-6 * np.linalg.norm(design) * np.linalg.norm(residual)
    q = t @ np.linalg.inv(design.T @ design) @ t.T
    point = int(np.flatnonzero(problem.active)[3])
    at = problem.first[2]
    columns = np.concatenate([np.arange(at, problem.first[4]), w + 3 * 3 + np.arange(3)])
    expected = q[np.ix_(columns, columns)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    for name, (_, other, cofactors) in found.items():
        assert np.abs(other.state.image - estimate.state.image).max() < 1e-7, name
        assert other.chi2 == pytest.approx(estimate.chi2, rel=1e-10)
        focal = [other.state.image[k][list(p.names).index("focal")] for k, p in enumerate(problem.parameters)]
        assert len(set(focal)) == 1
        joint = cofactors.joint((2, 3), (point,))
        assert np.abs((joint - expected) / scale).max() < 1e-5, name


@pytest.mark.oracle
def test_priors_count_what_is_shared_once() -> None:
    block = replace(shared(held=False, priors=True))
    found = {name: solved(block, name) for name in ("graph", "schur", "dense")}
    problem, estimate, _ = found["dense"]
    assert problem.n_observations == 2 * len(problem.observations) + 4 * 6 + 4
    r = residuals(problem, estimate.state)
    own = estimate.state.image.copy()
    own[1:, 6:] = 0.0
    assert estimate.chi2 == pytest.approx(float(np.sum(r**2) + np.sum(own**2)), rel=1e-12)
    for other in (found["graph"], found["schur"]):
        assert np.abs(other[1].state.image - estimate.state.image).max() < 1e-7


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "schur", "dense"])
def test_a_shared_prior_has_one_redundancy_number(backend: str) -> None:
    """A shared prior has one redundancy number, and all numbers equal the hat matrix with shared columns joined."""
    problem, estimate, cofactors = solved(replace(shared(held=False, priors=True)), backend)
    assert problem.ties is not None
    v, wide = assemble(problem, estimate.state)
    design = problem.ties.columns(wide)
    n, z = 2 * len(problem.observations), len(problem.ties)
    assert np.array_equal(design[n:, :z], np.eye(z))
    assert np.count_nonzero(v[n:] != problem.image_vector(estimate.state)) == 0
    expected = 1.0 - np.einsum("ij,jk,ik->i", design, np.linalg.inv(design.T @ design), design)
    found = ResidualCofactors(problem, estimate.state, cofactors)
    assert found.prior.shape == (4 * 6 + 4,)
    assert found.prior == pytest.approx(expected[n:], abs=1e-6)
    assert np.einsum("nii->ni", found.image).ravel() == pytest.approx(expected[:n], abs=1e-6)
    assert found.redundancy_sum == pytest.approx(problem.redundancy, abs=1e-5)


@pytest.mark.behaviour
def test_the_whole_job_names_no_defect_where_an_image_is_held() -> None:
    solution = fg.adjust(shared())
    assert solution.block_view is not None
    assert not solution.block_view.datum
    assert solution.observability[0].summary == "image 1: held"
    assert solution.cofactors is not None


@pytest.mark.truth
def test_free_network_of_one_camera_has_seven_motions() -> None:
    solution = fg.adjust(shared(held=False))
    network = solution.in_datum()
    assert network.datum_defect == 7
    problem = network.problem
    shared_places = np.flatnonzero(~np.concatenate([p.own for p in problem.parameters]))
    assert np.abs(network.null_space[shared_places]).max() < 1e-6


@pytest.mark.behaviour
def test_disagreement_and_what_does_not_work_are_refused() -> None:
    block = shared()
    other = block.images[1].sensor
    for changed in ({"focal_px": other.camera.focal_px + 1.0}, {"sigma": other.camera.sigma | {"focal": 1.0}}):
        images = list(block.images)
        images[1] = replace(images[1], sensor=FrameSensor(
            replace(other.camera, **changed), other.n_lines, other.n_samples, georeferenced=False
        ))  # fmt: skip
        with pytest.raises(InputError) as caught:
            fg.adjust(replace(block, images=tuple(images)))
        assert caught.value.problems[0].code == "frame.shared"
    with pytest.raises(InputError) as parted:
        fg.adjust(shared(held=False, priors=True), parts=2, workers=1)
    assert parted.value.problems[0].code == "frame.shared_not"


@pytest.mark.oracle
def test_correlations_of_the_camera_by_the_inverse_of_all_unknowns() -> None:
    """The note on the camera's distance is given below the median correlation from the full inverse, not above.

    The correlation is that of the focal length with the projection centres along the views; views by scipy.
    """
    block = shared()
    problem, estimate, cofactors = solved(block, "schur")
    _, design = assemble(problem, estimate.state)
    of = np.concatenate([problem.ties.of, np.arange(problem.n_free_unknowns, problem.n_unknowns)])
    tied = design @ np.eye(problem.n_unknowns)[of]
    q = np.linalg.inv(tied.T @ tied)
    column = {(k, name): int(problem.ties.of[problem.first[k] + j])
              for k, p in enumerate(problem.parameters) for j, name in enumerate(p.names)}  # fmt: skip
    sigma = {(k, name): s for k, p in enumerate(problem.parameters) for name, s in zip(p.names, p.sigma, strict=True)}
    found = []
    for k in range(1, problem.n_images):
        x = dict(zip(problem.parameters[k].names, problem.unknowns(estimate.state, k), strict=True))
        turn = Rotation.from_rotvec([x[f"rotation_{a}"] * sigma[k, f"rotation_{a}"] for a in "xyz"]).as_matrix()
        view = (turn @ block.images[k].sensor.camera.rotation)[2]
        rows = np.zeros((2, len(q)))
        rows[0, column[k, "focal"]] = 1.0
        for along, name in zip(view.tolist(), ("centre_x", "centre_y", "centre_z"), strict=True):
            if (k, name) in column:
                rows[1, column[k, name]] = along * sigma[k, name]
        (a, b), (_, d) = rows @ q @ rows.T
        found.append(abs(b) / np.sqrt(a * d))
    limit = float(np.median(found))
    images = frame_cofactors(problem, estimate.state, cofactors)
    assert {one.camera for one in images} == {"camera one"} and len(images) == 4
    (raised,) = inseparable(images, limit - 1e-6)
    assert raised.code == "camera.distance" and not inseparable(images, limit + 1e-6)


@pytest.mark.oracle
def test_a_shared_unknown_is_one_of_holms_tests() -> None:
    found = fg.adjust(shared()).significance()
    p = np.array([c.probability for c in found.coefficients])
    assert len(p) == 21 and [c.name for c in found.coefficients].count("focal") == 1
    stepped, worst = np.zeros(21), 0.0
    for rank, k in enumerate(np.argsort(p)):  # Holm (1979): the smallest of n times n, the next times n - 1, ...
        worst = max(worst, p[k] * (21 - rank))
        stepped[k] = min(worst, 1.0)
    assert [c.adjusted for c in found.coefficients] == pytest.approx(stepped, rel=1e-12)


def compare(block: Block, form: dbat.Format, folder: Path) -> tuple[int, float]:
    """Return the number of printed values and deviations, and the largest difference.

    It is in units of the last printed digit.
    """
    problem, estimate, q = solved(block, "schur")
    figures, printed = dbat.report(folder / "result" / "report.txt")
    sigma0 = dbat.same_figures(problem, estimate, figures)
    ours = {"camera": dbat.camera_values(problem, estimate.state, q, form)}
    ours |= {str(k + 1): dbat.photo_values(problem, estimate.state, q, k) for k in range(problem.n_images)}
    units = dbat.units_apart(ours, printed, sigma0)
    return len(units), max(units)


@pytest.mark.truth
@pytest.mark.real_data
def test_camcal_of_dbat(real_data: Path) -> None:
    folder = real_data / "dbat" / "script" / "camcaldemo"
    count, worst = compare(dbat.camcal(folder), dbat.Format(2272, 1704, 5.43764), folder)
    assert count == 2 * (9 + 21 * 6)
    assert worst < 1.0


@pytest.mark.truth
@pytest.mark.real_data
def test_roma_of_dbat(real_data: Path) -> None:
    folder = real_data / "dbat" / "script" / "romabundledemo"
    count, worst = compare(dbat.roma(folder), dbat.Format(5616, 3744, 24.0), folder)
    assert count >= 2 * (5 + 353)
    assert worst < 1.0


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.slow
def test_roma_with_a_fixed_camera(real_data: Path) -> None:
    """The Roma block with a fixed camera has the unknowns, redundancy and sigma0 of DBAT's report.

    The report is dbat/dbatexports/roma-dbatreport.txt; its aspect is printed there.
    """
    block = dbat.roma(real_data / "dbat" / "script" / "romabundledemo", calibrate=False, aspect=0.000998889)
    problem = compile_problem(block)
    assert (problem.n_unknowns, problem.redundancy) == (79316, 101806)
    assert round(float(np.sqrt(solve(problem).chi2 / problem.redundancy)), 6) == 0.623075
    assert not block.points.where(Role.CONTROL).size


@pytest.mark.oracle
def test_the_record_does_not_correlate_a_shared_unknown_with_itself() -> None:
    solution = fg.adjust(shared())
    record = correlation_record(solution)
    matrix = solution.cofactor_matrix(*(f"image:{image.id}" for image in solution.block.images))
    seen, once = set[str](), list[int]()
    for k, name in enumerate(matrix.names):
        of = name.rpartition(".")[2]
        if of not in INTERIOR or of not in seen:
            once.append(k)
        seen.add(of)
    sigma = np.sqrt(np.diag(matrix.values))
    r = np.triu(np.abs(matrix.values / np.outer(sigma, sigma))[np.ix_(once, once)], 1)
    assert record is not None and record["between_images"]
    assert record["n"] == len(record["largest"]) == (r > record["limit"]).sum()  # 24 more with all images
