"""Adjustments continue from an earlier result: as start values, or as a prior with the joint covariance."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import fg_orient as fg
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.earlier import reduced_rows
from fg_orient.result.joint import JointCofactors
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process as run
from tests.support.full_statistics import Dense
from tests.support.results import sealed


@lru_cache
def block(noise: float = 0.01) -> Block:
    """Return four images with normal errors of ``noise`` sigmas; points that only image 0 and image 3 see are left out.

    The earlier result is linearised at its own values. Its difference to one adjustment of all images is therefore
    quadratic in the errors: 1.6e-3 sigma of an unknown with errors of 1 sigma, 1.3e-7 with errors of 0.01 sigma.
    """
    whole = grid_block(BlockOptions(
        rows=2, columns=2, points=80, seed=3, errors="none", control_share=0.3, image_noise_px=0.0,
        ground_noise_m=(0.0, 0.0, 0.0),
    ))[0]  # fmt: skip
    o, middle = whole.observations, np.zeros(len(whole.points.ids), bool)
    middle[o.point[(o.image == 1) | (o.image == 2)]] = True
    error = noise * np.random.default_rng(1).normal(size=(2, len(o)))
    o = replace(o, line=o.line + error[0] * o.sigma_line_px, sample=o.sample + error[1] * o.sigma_sample_px)
    control = np.array([role is Role.CONTROL for role in whole.points.roles])  # constants without their noise
    sigma = np.where(control[:, None], [[0.5, 0.5, 0.5]], np.nan)
    known = Coordinates(whole.points.known.ecef_m, sigma, np.zeros(len(control), bool))
    return replace(whole, observations=o.take(middle[o.point]), points=replace(whole.points, known=known))


def part(whole: Block, images: tuple[int, ...], rows: npt.NDArray[np.bool_]) -> Block:
    """Return some images with some of the image points, and all ground points."""
    o, order = whole.observations.take(rows), np.full(len(whole.images), -1)
    order[list(images)] = np.arange(len(images))
    return replace(whole, images=tuple(whole.images[k] for k in images), observations=replace(o, image=order[o.image]))


def campaigns(whole: Block) -> tuple[Block, Block]:
    """Return the blocks of images 0, 1, 2 and of images 1, 2, 3.

    The second has all rays of image 3, and some rays of images 1 and 2 to old points.
    """
    o = whole.observations
    rays = np.bincount(o.point[o.image < 3], minlength=len(whole.points.ids))[o.point]
    first = (o.image < 3) & (rays >= 2) & ~((rays == 3) & (o.image == 2))
    later = replace(whole, options=replace(whole.options, datum="priors"))
    return part(whole, (0, 1, 2), first), part(later, (1, 2, 3), ~first)


def require_equal(two: fg.Solution, whole: fg.Solution | Dense, within: float) -> None:
    """Compare images and points of the second campaign with the whole block, in standard deviations."""
    assert whole.cofactors is not None
    assert two.cofactors is not None
    for k, image in enumerate(two.block.images):
        n = whole.block.image_index(image.id)
        q = whole.cofactors.image(n)
        sigma = np.sqrt(np.diag(q))
        moved = two.problem.unknowns(two.state, k) - whole.problem.unknowns(whole.state, n)
        assert np.abs(moved / sigma).max() <= within
        assert np.abs((two.cofactors.image(k) - q) / np.outer(sigma, sigma)).max() <= 10 * within
    points = np.flatnonzero(two.problem.active)
    q = whole.cofactors.points(points)
    sigma = np.sqrt(np.einsum("nii->ni", q))
    assert np.abs((two.ground_m - whole.ground_m)[points] / sigma).max() <= within
    of_point = two.cofactors.points(points) - q
    assert np.abs(of_point / (sigma[:, :, None] * sigma[:, None, :])).max() <= 10 * within


def counted_again(one: fg.Solution, two: fg.Solution) -> tuple[float, int]:
    """Return the sum of squares and number of the rows that replace the first campaign, at its solution."""
    prior = two.block.extra[-1]
    x = [
        one.problem.unknowns(one.state, one.block.image_index(name.partition(":")[2])) if name.startswith("image:")
        else one.ground_m[one.block.points.ids.index(name.partition(":")[2])] - two.problem.origin_m
        for name in prior.unknowns
    ]  # fmt: skip
    v = prior.equation.residual(prior.record, prior.setup, *x)
    return float(v @ v), prior.n_residuals


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "dense"])
def test_two_campaigns_equal_the_whole_block(backend: fg.Backend) -> None:
    """A second campaign with the first result as prior equals numpy's whole block: solution, chi2 and redundancy.

    Priors and common control count once.
    """
    whole, (first, second) = Dense.of(compile_problem(block())), campaigns(block())
    one = fg.adjust(first, backend=backend)
    two = fg.adjust(second, start=one, start_prior=True, backend=backend)
    require_equal(two, whole, 1e-6)
    again, rows = counted_again(one, two)
    common = [image.id for image in second.images if image.id in {i.id for i in first.images}]
    twice = sum(float(np.sum(one.problem.unknowns(one.state, first.image_index(name)) ** 2)) for name in common)
    control = np.flatnonzero(one.problem.observed & two.problem.observed)
    v = one.problem.control_residuals(one.state, control).ravel()
    assert len(control) > 0
    assert whole.chi2 == pytest.approx(two.chi2 + one.chi2 - again - twice - float(v @ v), rel=1e-5)
    images = sum(len(one.problem.parameters[first.image_index(name)]) for name in common)
    points = len(two.block.extra[-1].unknowns) - len(common)
    counted = rows + images + 3 * len(control)  # rows of the prior; priors and control coordinates of both campaigns
    assert whole.redundancy == two.redundancy + one.redundancy - counted + images + 3 * points


@pytest.mark.oracle
def test_the_difference_to_the_whole_block_is_of_second_order() -> None:
    """With ten times larger errors, two campaigns differ at most a hundred times as much from the whole block."""
    whole, (first, second) = Dense.of(compile_problem(block(0.1))), campaigns(block(0.1))
    require_equal(fg.adjust(second, start=fg.adjust(first), start_prior=True), whole, 1e-4)


@pytest.mark.consistency
def test_a_result_folder_gives_the_same_as_the_solution(tmp_path: Path) -> None:
    first, second = campaigns(block())
    one = fg.adjust(first)
    one.save(tmp_path / "one")
    two = fg.adjust(second, start=one, start_prior=True)
    for start in (tmp_path / "one", fg.read_result(tmp_path / "one")):
        read = fg.adjust(second, start=start, start_prior=True)
        require_equal(read, two, 1e-6)
        assert read.redundancy == two.redundancy
    third = fg.adjust(second, start=two.result, start_prior=True)  # a result with a prior is an earlier result, too
    assert third.status is two.status


@pytest.mark.oracle
def test_unknowns_that_images_share_are_counted_once() -> None:
    """With shared look polynomials two campaigns equal numpy's solution of the whole block."""
    options = replace(block().options, look_polynomial=1, look_shared=True)
    whole = replace(block(), options=options)
    first, second = campaigns(whole)
    one = fg.adjust(first)
    assert one.problem.ties is not None
    two = fg.adjust(second, start=one, start_prior=True)
    require_equal(two, Dense.of(compile_problem(whole)), 1e-6)


@pytest.mark.consistency
def test_a_block_without_priors_takes_the_whole_covariance() -> None:
    """A second campaign without priors has the result of one with priors, because the covariance contains them."""
    whole = replace(block(), options=replace(block().options, image_unknowns=("x_0", "roll_0", "pitch_0", "yaw_0")))
    one, o = fg.adjust(campaigns(whole)[0]), block().observations
    both = part(whole, (1, 2), ((o.image == 1) | (o.image == 2)) & one.problem.active[o.point])
    loose = fg.adjust(both, start=one, start_prior=True, priors=False)
    held = fg.adjust(both, start=one, start_prior=True)
    require_equal(loose, held, 1e-6)
    assert loose.redundancy > 0


@pytest.mark.oracle
def test_rows_have_the_information_of_the_earlier_observations() -> None:
    """The rows fulfil R^T R = Q^-1 - P and R^T c = P (x_1 - x_0), and have no more rows than the rank."""
    rng = np.random.default_rng(5)
    design, own = rng.normal(size=(4, 6)), np.diag(rng.uniform(0.5, 2.0, 6))
    q, offset = np.linalg.inv(design.T @ design + own), rng.normal(size=6)
    # x_1 solves N x_1 = A^T l + P x_0, so P (x_1 - x_0) lies in the rows of A
    offset = design.T @ (design @ offset)
    rows, right = reduced_rows(q, own, offset)
    assert rows.shape == (4, 6)
    assert np.allclose(rows.T @ rows, design.T @ design, rtol=1e-10, atol=1e-10)
    assert np.allclose(rows.T @ right, offset, rtol=1e-10, atol=1e-10)
    free, zero = reduced_rows(q, np.zeros((6, 6)), np.zeros(6))
    assert np.allclose(free.T @ free @ q, np.eye(6), atol=1e-10)
    assert not zero.any()


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "schur", "dense"])
def test_the_start_does_not_change_the_solution(backend: fg.Backend) -> None:
    """A start from an earlier result does not change the solution, and from the solution needs fewer iterations."""
    plain, expected = fg.adjust(block(1.0), backend=backend), Dense.of(compile_problem(block(1.0)))
    first, _ = campaigns(block(1.0))
    require_equal(fg.adjust(block(1.0), start=fg.adjust(first), backend=backend), expected, 1e-6)
    again = fg.adjust(block(1.0), start=plain, backend=backend)
    require_equal(again, expected, 1e-6)
    assert again.iterations < plain.iterations
    assert again.redundancy == plain.redundancy


@pytest.mark.consistency
@pytest.mark.parametrize("options", [{"datum": "inner", "image_unknowns": ("x_0", "roll_0")}, {"loss": "huber"}])
def test_the_start_does_not_change_other_adjustments(options: dict[str, object]) -> None:
    """A start does not change a solution with inner constraints or a loss.

    Inner constraints refer to the metadata orientation, not to the start.
    """
    plain = fg.adjust(block(1.0), **options)
    again = fg.adjust(block(1.0), start=plain, **options)
    require_equal(again, plain, 1e-6)


@pytest.mark.consistency
def test_a_search_keeps_the_prior() -> None:
    """With a prior from a result the search finds a gross error, and the rest is the solution without it."""
    first, second = campaigns(block())
    one, o = fg.adjust(first), second.observations
    row = int(np.flatnonzero((o.image == 2) & (np.bincount(o.point)[o.point] > 1))[0])
    line = o.line + np.where(np.arange(len(o)) == row, 30.0 * o.sigma_line_px, 0.0)
    wrong = replace(second, observations=replace(o, line=line))
    found = fg.adjust(wrong, start=one, start_prior=True, snoop=True)
    assert found.snooping is not None
    assert len(found.problem.observations) == len(o) - 1
    without = replace(second, observations=o.take(np.arange(len(o)) != row))
    require_equal(found, fg.adjust(without, start=one, start_prior=True), 1e-5)


@pytest.mark.behaviour
def test_an_own_optimiser_begins_at_the_earlier_values() -> None:
    plain = fg.adjust(block())
    assert fg.adjust(block(), start=plain, optimizer=lambda graph, values: values).end.code == "loop.given"
    assert fg.adjust(block(), optimizer=lambda graph, values: values).end.code == "loop.gradient_left"


@pytest.mark.behaviour
def test_what_does_not_fit_is_refused_in_one_line() -> None:
    first, second = campaigns(block())
    one = fg.adjust(first)
    ids = tuple(replace(image, id=f"new{k}") for k, image in enumerate(second.images))
    control = second.points.ids[int(np.flatnonzero(one.problem.observed)[0])]
    roles = tuple(
        Role.CHECK if name == control else role
        for name, role in zip(second.points.ids, second.points.roles, strict=True)
    )
    known = second.points.known
    gone = np.array([name == control for name in second.points.ids])[:, None]
    sealed = Coordinates(np.where(gone, np.nan, known.ecef_m), np.where(gone, np.nan, known.sigma_enu_m), known.fixed)
    cases: tuple[tuple[Block, fg.Solution | fg.Result, dict[str, object], str], ...] = (
        (replace(second, images=ids), one, {}, "no image of this block"),
        (second, one, {"look_polynomial": 1}, "only one of the two adjustments"),
        (second, one, {"variance_components": ("image", "priors"), "start_prior": True}, "cannot be estimated"),
        (second, one, {"parts": 2, "start_prior": True}, "Schur backend cannot adjust"),
        (second, one, {"datum": "inner", "start_prior": True}, "free network"),
        (second, replace(one.result, joint=None), {"start_prior": True}, "covariance.npz"),
        (second, fg.adjust(first, max_iterations=1), {"start_prior": True}, "did not converge"),
        (replace(second, points=replace(second.points, roles=roles, known=sealed)), one, {"start_prior": True},
         "no independent check"),
    )  # fmt: skip
    for case, start, options, words in cases:
        with pytest.raises(InputError, match=words) as caught:
            fg.adjust(case, start=start, **options)
        assert "\n" not in str(caught.value.problems[0])
    with pytest.raises(InputError, match="no earlier result"):
        fg.adjust(second, start_prior=True)
    joint = one.result.joint
    assert joint is not None
    singular = replace(joint, cofactors=np.ones_like(joint.cofactors))
    with pytest.raises(InputError, match="not positive definite"):
        fg.adjust(second, start=replace(one.result, joint=singular), start_prior=True)


@pytest.mark.behaviour
def test_command_line_and_replay(tmp_path: Path) -> None:
    """``--from`` and ``--from-prior`` are recorded and repeated by ``replay``, and refused without covariance.

    The covariance file has the names and sigmas of the table.
    """
    folder = tmp_path / "twin"
    simulate_zonguldak(folder, ZonguldakOptions())
    project, first = folder / "project.toml", folder / "first"
    assert run("adjust", project, "--out", first, "--quiet").code == 0
    with np.load(first / "covariance.npz", allow_pickle=False) as arrays:
        joint = JointCofactors.of_arrays(arrays)
    table = fg.read_result(first).eop
    names = zip(table.words["image"], table.words["parameter"], strict=True)
    assert joint.names[: len(table)] == tuple(f"image:{image}.{name}" for image, name in names)
    sigma = np.sqrt(np.diag(joint.cofactors))[: len(table)] * fg.read_result(first).record["sigma0"]
    assert np.allclose(sigma, table.numbers("sigma").ravel(), rtol=1e-9)
    second = folder / "second"
    # the same errors count twice here, and a test may suspect one of them
    doubt = ("--accept", "gross_error")
    ended = run("adjust", project, "--from", first, "--from-prior", *doubt, "--out", second, "--quiet")
    assert ended.code == 0
    record = json.loads((second / "result.json").read_text("utf-8"))
    start = record["provenance"]["repeat"]["start"]
    assert start["folder"] == "first"
    assert start["prior"]
    assert record["redundancy"] > json.loads((first / "result.json").read_text("utf-8"))["redundancy"]
    assert run("replay", second, "--out", tmp_path / "again").code == 0
    (first / "covariance.npz").unlink()
    sealed(first)
    for words, message in ((("--from", first, "--from-prior"), "covariance.npz"), (("--from-prior",), "add --from")):
        refused = run("adjust", project, *words, "--out", tmp_path / "third")
        assert refused.code == 2
        assert message in refused.stderr
    assert run("adjust", project, "--from", first, "--out", tmp_path / "third", "--quiet").code == 0


@pytest.mark.behaviour
def test_a_prior_from_a_doubtful_result_makes_the_new_one_doubtful() -> None:
    """A gross error of the first campaign has moved the prior; it can be accepted by the name of the doubt."""
    first, second = campaigns(block())
    o = first.observations
    wrong = fg.adjust(
        replace(first, observations=replace(o, line=o.line + np.where(np.arange(len(o)) == 5, 30.0, 0.0)))
    )
    assert wrong.status == "not_trustworthy"
    two = fg.adjust(second, start=wrong, start_prior=True)
    assert two.status == "not_trustworthy"
    (found,) = (one for one in two.findings if one.code == "verdict.doubtful_prior")
    assert "the prior comes from a result that is not trustworthy: " in str(found)
    good = fg.adjust(second, start=fg.adjust(first), start_prior=True)
    assert "verdict.doubtful_prior" not in {one.code for one in good.findings}
    known = fg.adjust(second, start=wrong, start_prior=True, accept=("doubtful_prior",))
    assert next(one for one in known.findings if one.code == "verdict.doubtful_prior").severity == "note"
