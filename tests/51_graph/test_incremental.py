"""In a growing block each update is compared with an adjustment of all data; removal and waiting data work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

import fg_orient as fg
from fg_orient.adjustment import optimisers as engine
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block, ImagePoints
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import Role, Status
from fg_orient.orientation.incremental import GROUP_IMAGES
from fg_orient.orientation.solution import Solution
from fg_orient.sensors.frame import FrameSensor
from fg_orient.simulate.strips import StripOptions, strip_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import Dense

Array = npt.NDArray[np.float64]

#: Differences from the batch adjustment, in standard deviations of the unknowns: after an update, after a solution.
FOLLOWED, SOLVED = 1e-4, 1e-6
CONTROL_OF_IMAGE = 4
#: Image points with gross errors.
WRONG = np.array([3, 30, 60, 90, 120])


def strip(images: int) -> Block:
    """Return a strip with control points in every tenth image and the last one."""
    n = 12 * images
    options = StripOptions(seed=1, strips=1, images=images, points=n, control=n, navigation=False)
    block, o = (made := strip_block(options)[0]), made.observations
    control = np.zeros(n, bool)
    for k in {*range(0, images, 10), images - 1}:
        control[o.point[o.image == k][:CONTROL_OF_IMAGE]] = True
    return replace(block, points=block.points.without_coordinates(~control, Role.TIE))


def without_images(block: Block) -> Block:
    """Return the ground points alone."""
    return replace(block, images=(), observations=block.observations.take(np.zeros(0, np.intp)))


def part(block: Block, images: int) -> Block:
    """Return the first images, with control points and the tie points that two of these images see."""
    o = block.observations
    first = o.image < images
    count = np.bincount(o.point[first], minlength=len(block.points.ids))
    count[block.points.where(Role.CONTROL)] += 1
    return replace(block, images=block.images[:images], observations=o.take(first & (count[o.point] >= 2)))


def grown(block: Block) -> fg.Incremental:
    """Return the block, image by image."""
    out, o = fg.Incremental(without_images(block)), block.observations
    for k, image in enumerate(block.images):
        out.add(images=[image], observations=o.take(o.image == k))
    return out


def of_numpy(block: Block) -> Dense:
    """Return numpy's batch adjustment of the block from its rows."""
    return Dense.of(compile_problem(part(block, len(block.images))))


def difference(incremental: fg.Incremental, batch: Solution | Dense) -> float:
    """Return the largest difference of an unknown from a solution, in standard deviations."""
    assert batch.cofactors is not None
    out = [0.0]
    for k, image in enumerate(batch.block.images):
        sigma = np.sqrt(np.diag(batch.cofactors.image(k)))
        own = batch.problem.unknowns(batch.state, k)
        out.append(float(np.abs((incremental.unknowns(image.id) - own) / sigma).max(initial=0.0)))
    return max(out)


def solutions_differ(a: Solution, b: Solution | Dense) -> float:
    """Return the largest difference of an unknown of two solutions, in standard deviations."""
    assert b.cofactors is not None
    sigma = np.concatenate([np.sqrt(np.diag(b.cofactors.image(k))) for k in range(len(b.block.images))])
    return float(np.abs((a.problem.image_columns(a.state) - b.problem.image_columns(b.state)) / sigma).max())


def follow(block: Block, adjust: Callable[[Block], Solution | Dense]) -> None:
    """Assert that each update equals a batch adjustment of the same images."""
    incremental, o = fg.Incremental(without_images(block)), block.observations
    for k, image in enumerate(block.images):
        incremental.add(images=[image], observations=o.take(o.image == k))
        batch = adjust(part(block, k + 1))
        assert difference(incremental, batch) <= FOLLOWED
        if k % 10 == 0:
            solution = incremental.solution()
            assert solution.status is Status.CONVERGED
            assert solutions_differ(solution, batch) <= SOLVED
    assert incremental.waiting == ()
    end = incremental.solution()
    assert end.status is Status.CONVERGED
    assert solutions_differ(end, batch) <= SOLVED
    assert end.chi2 == pytest.approx(batch.chi2, rel=1e-10)
    assert end.cofactors is not None
    assert np.allclose(end.cofactors.image(0), batch.cofactors.image(0), rtol=1e-6)  # type: ignore[union-attr]


@pytest.mark.oracle
def test_a_strip_of_twelve_images_follows_the_batch_adjustment() -> None:
    """After each added image the unknowns are numpy's from the rows of all images so far."""
    follow(strip(12), of_numpy)


@pytest.mark.consistency
@pytest.mark.slow
def test_a_strip_of_a_hundred_images_follows_the_batch_adjustment() -> None:
    follow(strip(100), fg.adjust)


@pytest.mark.oracle
def test_a_pair_of_pushbroom_images() -> None:
    block = zonguldak_block(ZonguldakOptions(seed=1))[0]
    block = replace(block, options=replace(block.options, eop_set=15))
    incremental, batch = grown(block), of_numpy(block)
    assert difference(incremental, batch) <= FOLLOWED
    solution = incremental.solution()
    assert solutions_differ(solution, batch) <= SOLVED
    assert solution.accuracy.check.ids == fg.adjust(block).accuracy.check.ids
    for name in ("left", "right"):
        assert repr(incremental.correction(name))


@pytest.mark.oracle
@pytest.mark.parametrize("priors", [True, False])
def test_unknowns_that_images_share(priors: bool) -> None:
    block = strip(4)
    images = []
    for image in block.images:
        sensor = image.sensor
        assert isinstance(sensor, FrameSensor)
        camera = replace(sensor.camera, sigma={**sensor.camera.sigma, "focal": 5.0}, shared={"focal": "one"})
        images.append(replace(image, sensor=FrameSensor(camera, sensor.n_lines, sensor.n_samples)))
    block = replace(block, images=tuple(images), options=replace(block.options, priors=priors))
    incremental, batch = grown(block), of_numpy(block)
    assert batch.problem.ties is not None
    assert len(incremental.unknowns("image01")) == 7
    assert difference(incremental, batch) <= FOLLOWED
    assert solutions_differ(incremental.solution(), batch) <= SOLVED


@pytest.mark.oracle
def test_ground_points_are_those_of_the_solution() -> None:
    block = strip(4)
    incremental, batch = grown(block), of_numpy(block)
    ids = block.points.ids
    seen = np.flatnonzero(batch.problem.active)
    ground = np.array([incremental.ground_m(ids[j]) for j in seen])
    assert np.abs(ground - batch.ground_m[seen]).max() <= 1e-5


@pytest.mark.oracle
@pytest.mark.parametrize("priors", [True, False])
def test_removed_gross_errors_are_as_if_never_added(priors: bool) -> None:
    block = strip(6)
    block, o = replace(block, options=replace(block.options, priors=priors)), block.observations
    wrong = np.isin(np.arange(len(o)), WRONG)
    bad = replace(block, observations=ImagePoints(
        o.image, o.point, o.line + 40.0 * wrong, o.sample, o.sigma_line_px, o.sigma_sample_px
    ))  # fmt: skip
    incremental = grown(bad)
    assert difference(incremental, never := of_numpy(replace(block, observations=o.take(~wrong)))) > 1.0
    names = [(block.images[o.image[row]].id, block.points.ids[o.point[row]]) for row in WRONG]
    incremental.remove(names)
    assert difference(incremental, never) <= FOLLOWED
    solution = incremental.solution()
    assert solutions_differ(solution, never) <= SOLVED
    assert solution.chi2 == pytest.approx(never.chi2, rel=1e-9)
    assert len(incremental.block.observations) == len(o) - len(WRONG)
    with pytest.raises(InputError, match="no such image point"):
        incremental.remove(names[:1])


@pytest.mark.behaviour
def test_a_point_with_one_ray_waits_for_the_second() -> None:
    block = strip(3)
    o = block.observations
    incremental = fg.Incremental(part(block, 2))
    assert incremental.waiting == ()
    new = o.take((o.image == 2) & ~np.isin(o.point, incremental.block.observations.point))
    name = block.points.ids[new.point[0]]
    incremental.add(images=block.images[2:], observations=new.take(np.array([0])))
    places = {one.place: str(one) for one in incremental.waiting}
    assert set(places) == {f"point {name}", "image image03"}
    assert "seen in image image03 only, and a ground point without control needs two rays" in places[f"point {name}"]
    assert "no image point of a determined ground point" in places["image image03"]
    with pytest.raises(InputError, match="or it waits"):
        incremental.ground_m(name)
    with pytest.raises(InputError, match="or it waits"):
        incremental.unknowns("image03")
    solution = incremental.solution()
    assert set(incremental.waiting) <= set(solution.findings)
    assert [image.id for image in solution.block.images] == ["image01", "image02"]
    incremental.add(observations=o.take((o.image == 1) & (o.point == new.point[0])))
    assert incremental.waiting == ()
    assert np.isfinite(incremental.ground_m(name)).all()
    assert difference(incremental, incremental.solution()) <= FOLLOWED


@pytest.mark.behaviour
def test_an_image_without_priors_waits_for_enough_points() -> None:
    block = strip(3)
    block, o = replace(block, options=replace(block.options, priors=False)), block.observations
    first = replace(block, images=block.images[:2], observations=o.take(o.image < 2))
    incremental = fg.Incremental(first)
    known = np.flatnonzero((o.image == 2) & np.isin(o.point, part(block, 2).observations.point))
    incremental.add(images=block.images[2:], observations=o.take(known[:2]))
    (one,) = [one for one in incremental.waiting if one.place == "image image03"]
    assert "2 image points of determined ground points do not determine its 6 unknowns" in str(one)
    assert difference(incremental, fg.adjust(part(block, 2), priors=False)) <= FOLLOWED
    rest = np.flatnonzero((o.image == 2) & ~np.isin(np.arange(len(o)), known[:2]))
    incremental.add(observations=o.take(rest))
    assert incremental.waiting == ()
    solution, batch = incremental.solution(), fg.adjust(block)
    assert difference(incremental, batch) <= FOLLOWED
    assert solutions_differ(solution, batch) <= SOLVED
    own = [("image03", block.points.ids[j]) for j in o.point[known[4:]]]
    own += [("image03", block.points.ids[j]) for j in o.point[rest] if ("image03", block.points.ids[j]) not in own]
    incremental.remove(own[:-1])
    assert "image image03" in [one.place for one in incremental.waiting]
    assert difference(incremental, fg.adjust(part(block, 2), priors=False)) <= FOLLOWED


@pytest.mark.behaviour
def test_nothing_is_determined_without_control_and_priors() -> None:
    block = strip(2)
    tie = block.points.without_coordinates(np.ones(len(block.points.ids), bool), Role.TIE)
    incremental = fg.Incremental(replace(block, points=tie, options=replace(block.options, priors=False)))
    assert {one.place for one in incremental.waiting} >= {"image image01", "image image02"}
    with pytest.raises(InputError, match="no image is determined yet"):
        incremental.solution()


@pytest.mark.behaviour
def test_groups_are_local_and_stay_where_nothing_changes() -> None:
    block = strip(12)
    o, last = block.observations, block.observations.image == 11
    incremental = fg.Incremental(replace(block, images=block.images[:11], observations=o.take(~last)))
    before = incremental._groups
    incremental.add(images=block.images[11:], observations=o.take(last))
    seen = set(o.point[last].tolist())
    assert all(group in incremental._groups for group in before if seen.isdisjoint(group.points))
    assert all(group not in incremental._groups for group in before if not seen.isdisjoint(group.points))
    assert 0 < sum(seen.isdisjoint(group.points) for group in before)
    assert max(len(group.problem.block.images) for group in incremental._groups) <= GROUP_IMAGES
    points = sorted(j for group in incremental._groups for j in group.points)
    assert points == sorted(set(points)) == sorted(set(o.point.tolist()))


@pytest.mark.behaviour
def test_a_failed_update_leaves_the_object_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    block = strip(4)
    o, last = block.observations, block.observations.image == 3
    incremental = fg.Incremental(part(block, 3))
    before = incremental.solution()
    with monkeypatch.context() as patch:

        def fails(_graph: engine.IncrementalGraph) -> None:
            patch.undo()
            raise RuntimeError("Indeterminate linear system")

        patch.setattr(engine.IncrementalGraph, "_settle", fails)
        with pytest.raises(NoSolutionError, match="Indeterminate"):
            incremental.add(images=block.images[3:], observations=o.take(last))
    assert [image.id for image in incremental.block.images] == ["image01", "image02", "image03"]
    assert difference(incremental, before) <= FOLLOWED
    incremental.add(images=block.images[3:], observations=o.take(last))
    assert len(incremental.solution().block.images) == 4


@pytest.mark.behaviour
def test_input_errors() -> None:
    block = strip(2)
    o = block.observations
    for options in ({"loss": "huber"}, {"datum": "inner"}, {"snoop": True}):
        with pytest.raises(InputError, match="does not support"):
            fg.Incremental(replace(block, options=replace(block.options, **options)))
    incremental = fg.Incremental(block)
    with pytest.raises(InputError, match="image01"):
        incremental.add(images=block.images[:1])
    with pytest.raises(InputError, match="exists already"):
        incremental.add(points=block.points)
    far = ImagePoints(o.image[:1] + 2, o.point[:1], o.line[:1], o.sample[:1], o.sigma_line_px[:1], o.sigma_line_px[:1])
    with pytest.raises(InputError, match="there are 2"):
        incremental.add(observations=far)
    assert len(incremental.block.observations) == len(o)
    assert "0 images and points wait" in repr(incremental)


@pytest.mark.behaviour
def test_points_may_come_later() -> None:
    block = strip(3)
    o, n = block.observations, 20
    points, known = block.points, block.points.known
    early, late = (
        fg.GroundPoints(points.ids[part], points.roles[part],
                        type(known)(known.ecef_m[part], known.sigma_enu_m[part], known.fixed[part]))
        for part in (slice(0, n), slice(n, None))
    )  # fmt: skip
    incremental = fg.Incremental(replace(block, points=early, observations=o.take(o.point < n)))
    incremental.add(points=late, observations=o.take(o.point >= n))
    assert difference(incremental, fg.adjust(block)) <= FOLLOWED
