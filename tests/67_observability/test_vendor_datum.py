"""Weakly determined directions stay at the vendor's metadata on every backend; the y-parallax decreases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.quality.accuracy import rms_px, y_parallaxes
from fg_orient.quality.vendor_datum import SEEN, absolute, of_problem
from tests.support.real_rpc import pleiades_neo, spot7
from tests.support.rpc_block import rpc_twin


def without_control(noise_px: float = 0.3, seed: int = 3) -> tuple[Block, np.ndarray]:
    """Return the RPC pair whose points are all tie points, and their true coordinates."""
    twin = rpc_twin("affine", seed=seed, noise_px=noise_px)
    points = twin.block.points
    known = replace(points.known, ecef_m=np.full(points.known.ecef_m.shape, np.nan))
    points = replace(points, roles=(Role.TIE,) * len(points.ids), known=known)
    block = replace(twin.block, points=points, withheld=replace(twin.block.withheld, ids=()))
    return replace(block, options=replace(block.options, datum="vendor", rpc_compensation="affine")), twin.ecef_m


def shares(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the shares mu, directions (u, h), N and the limit of mu, from all rows by numpy."""
    problem = compile_problem(replace(block, options=replace(block.options, datum="priors")))
    residual, design = assemble(problem, problem.start)
    rows = design[: 2 * len(problem.observations)]
    u = problem.n_image_unknowns
    images, points = rows[:, :u], rows[:, u:]
    left = images - points @ np.linalg.lstsq(points, images, rcond=None)[0]
    missed = residual[: len(rows)] - points @ np.linalg.lstsq(points, residual[: len(rows)], rcond=None)[0]
    root = block_diag(*(np.linalg.qr(images[:, problem.image_slice(k)], mode="r") for k in range(problem.n_images)))
    inverse = np.linalg.inv(root)
    mu, turn = np.linalg.eigh(inverse.T @ left.T @ left @ inverse)
    return mu, inverse @ turn, root.T @ root, SEEN / max(1.0, float(np.mean(missed**2)))


@pytest.mark.oracle
def test_directions_are_those_of_all_rows() -> None:
    """The vendor's datum holds the directions below the limit that numpy finds, and the result moves along others."""
    block, _ = without_control()
    mu, moves, n, limit = shares(block)
    solution = fg.adjust(block)
    held = of_problem(solution.problem)
    assert held is not None and held.n_residuals == int(np.sum(mu < limit)) > 3
    assert (mu < 1.0 + 1e-9).all() and (mu > -1e-9).all()
    along = moves.T @ n @ solution.problem.image_columns(solution.state)
    n_rays = len(solution.problem.observations)
    assert np.abs(along[mu < limit]).max() <= 0.1 * np.sqrt(2.0 * n_rays)
    assert np.abs(along[mu > limit]).max() > 1.0


@pytest.mark.oracle
@pytest.mark.parametrize("optimizer", ["gauss-newton", "levenberg-marquardt", "dogleg"])
def test_backends_agree(optimizer: str) -> None:
    """With the vendor's datum all backends, and parts, have one solution, chi2 and covariance."""
    block, _ = without_control()
    dense = fg.adjust(block, backend="dense", optimizer=optimizer)
    whole = [fg.adjust(block, backend=name, optimizer=optimizer) for name in ("graph", "schur")]
    for other in (*whole, fg.adjust(block, optimizer=optimizer, parts=3)):
        assert np.abs(other.state.image - dense.state.image).max() <= 1e-8
        assert other.chi2 == pytest.approx(dense.chi2, rel=1e-9)
        (mine, its) = (s.cofactor_matrix("image:left", "image:right").values for s in (other, dense))
        assert np.abs(mine - its).max() <= 1e-6 * np.abs(its).max()


@pytest.mark.oracle
@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_backends_agree_under_a_loss(loss: str) -> None:
    block, _ = without_control()
    schur, dense = (fg.adjust(block, loss=loss, backend=name) for name in ("schur", "dense"))
    graph = fg.adjust(block, loss=loss)
    for other in (schur, graph):
        assert np.abs(other.state.image - dense.state.image).max() <= 1e-6
        assert other.chi2 == pytest.approx(dense.chi2, rel=1e-7)


@pytest.mark.oracle
def test_constraints_tell_no_place() -> None:
    """A block with a hard distance and no control takes the vendor's datum on all backends."""
    block, truth = without_control()
    distance = fg.Constraint("distance", block.points.ids[:2], float(np.linalg.norm(truth[0] - truth[1])))
    block = replace(block, extra=(distance,), options=replace(block.options, datum="auto"))
    dense, graph, schur = (fg.adjust(block, backend=name) for name in ("dense", "graph", "schur"))
    assert dense.problem.block.options.datum == "vendor" and of_problem(dense.problem) is not None
    for other in (graph, schur):
        assert np.abs(other.ground_m - dense.ground_m).max() < 1e-5
        assert other.chi2 == pytest.approx(dense.chi2, rel=1e-8)
    assert np.linalg.norm(dense.ground_m[0] - dense.ground_m[1]) == pytest.approx(distance.value_m, abs=1e-6)
    free = fg.adjust(replace(block, extra=()))
    assert np.linalg.norm((dense.ground_m - free.ground_m).mean(axis=0)) < 1.0


@pytest.mark.truth
def test_parallax_falls_and_the_block_stays() -> None:
    """With the vendor's datum the y-parallax falls by half, and the block moves less than its rays miss each other."""
    for seed in range(5):
        block, _ = without_control(seed=seed)
        solution = fg.adjust(block)
        _, before = y_parallaxes(solution.problem, solution.problem.start)
        _, after = y_parallaxes(solution.problem, solution.state)
        assert rms_px(after) < 1.0 and rms_px(after) < 0.5 * rms_px(before)
        moved = np.linalg.norm((solution.state.ground - solution.problem.start.ground).mean(axis=0))
        data = next(f for f in solution.findings if f.code == "solution.relative").data
        assert moved <= data["disagreement_m"]


@pytest.mark.truth
@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_shape_and_datum_cover_the_true_errors(kind: str) -> None:
    """True errors fit the covariance of shape and datum together at 99.9 %, and not that of the shape alone.

    Metadata errors of 40 seeds are drawn from the priors.
    """
    squares, of_shape, at = 0.0, 0.0, (3, 20, 40)
    for seed in range(40):
        twin = rpc_twin(kind, seed=seed)
        block, _ = without_control(seed=seed)
        block = replace(twin.block, points=block.points, withheld=block.withheld)
        solution = fg.adjust(block, rpc_compensation=kind)
        assert solution.problem.block.options.datum == "vendor"
        e = (solution.ground_m - twin.ecef_m)[list(at)].ravel()
        c = absolute(solution.problem, solution.cofactors)
        assert c is not None and solution.cofactors is not None
        squares += float(e @ np.linalg.solve(c.joint((), at), e))
        of_shape += float(e @ np.linalg.solve(solution.cofactors.joint((), at), e))
        points = c.points(np.array(at))
        assert points == pytest.approx(c.joint((), at).reshape(3, 3, 3, 3)[range(3), :, range(3)], rel=1e-9)
        assert c.point(at[1]) == pytest.approx(points[1], rel=1e-9)
        assert c.blocks(np.array([[0, 1]]))[0] == pytest.approx(
            c.joint((0, 1), ())[: len(c.image(0)), len(c.image(0)) :]
        )
    low, high = chi2.ppf([0.0005, 0.9995], 9 * 40)
    assert low < squares < high, squares / (9 * 40)
    assert of_shape > 2.0 * high


@pytest.mark.behaviour
def test_control_leaves_nothing_to_hold() -> None:
    """With control points the vendor's datum holds no direction and has the default result."""
    twin = rpc_twin("shift", seed=3, noise_px=0.3)
    block = replace(twin.block, options=replace(twin.block.options, rpc_compensation="shift"))
    vendor, default = fg.adjust(block, datum="vendor"), fg.adjust(block)
    assert of_problem(vendor.problem) is None
    assert np.abs(vendor.state.image - default.state.image).max() <= 1e-12


def neo(real_data: Path) -> Block:
    """Return the Pléiades Neo pair with the points of both images as tie points."""
    block = pleiades_neo(real_data)
    o = block.observations
    points = replace(
        block.points, roles=(Role.TIE,) * len(block.points.ids),
        known=replace(block.points.known, ecef_m=np.full(block.points.known.ecef_m.shape, np.nan)),
    )  # fmt: skip
    both = np.bincount(o.point, minlength=len(block.points.ids))[o.point] == 2
    return replace(block, points=points, observations=o.take(both))


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_pleiades_neo_pair_stays(real_data: Path, kind: str) -> None:
    """The Pléiades Neo pair without control moves less than its rays miss each other, and its y-parallax does not grow.

    It has 24 common points; the search removes an image point that is 52 px wrong.
    """
    block = neo(real_data)
    solution = fg.adjust(block, rpc_compensation=kind, datum="vendor", snoop=True)
    data = next(f for f in solution.findings if f.code == "solution.relative").data
    assert np.linalg.norm(data["moved_m"]) <= data["disagreement_m"]
    _, before = y_parallaxes(solution.problem, solution.problem.start)
    _, after = y_parallaxes(solution.problem, solution.state)
    assert np.median(after) <= np.median(before)


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_spot7_pair_stays(real_data: Path, kind: str) -> None:
    """The SPOT 7 pair moves less than its rays miss each other, with a y-parallax near that of the datum ``priors``."""
    block = spot7(real_data, 300)
    solution = fg.adjust(block, rpc_compensation=kind, datum="vendor")
    free = fg.adjust(block, rpc_compensation=kind, datum="priors")
    data = next(f for f in solution.findings if f.code == "solution.relative").data
    (_, held), (_, loose) = (y_parallaxes(s.problem, s.state) for s in (solution, free))
    assert np.linalg.norm(data["moved_m"]) <= data["disagreement_m"]
    assert np.median(held) <= 1.1 * np.median(loose)


@pytest.mark.truth
@pytest.mark.real_data
def test_pleiades_pair_of_s2p_stays_and_fits_its_surface(real_data: Path, tmp_path: Path) -> None:
    """The Pléiades pair of s2p moves below 1 m, with a y-parallax below 0.40 px and an NMAD to its DSM below 0.55 m."""
    folder = (real_data / "s2p-pair").as_posix()
    images = "".join(f'[[images]]\nid = "im{k}"\nmetadata = "{folder}/img_0{k}.tif"\n' for k in (1, 2))
    path = tmp_path / "project.toml"
    path.write_text(
        f'schema = 1\nname = "s2p"\n{images}[points]\nfile = "{folder}/points.csv"\ncrs = "EPSG:4979"\n'
        f'[observations]\nfile = "{folder}/observations.csv"\n', "utf-8",
    )  # fmt: skip
    block = fg.read_project(path)
    for kind in ("shift", "affine"):
        solution = fg.adjust(block, rpc_compensation=kind)
        data = next(f for f in solution.findings if f.code == "solution.relative").data
        _, after = y_parallaxes(solution.problem, solution.state)
        assert np.linalg.norm(data["moved_m"]) < 1.0
        assert rms_px(after) <= 0.40
        assert solution.compare_dem(real_data / "s2p-pair" / "dsm.tif").statistics()["nmad_m"] <= 0.55
