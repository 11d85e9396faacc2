"""Wrong values from Python are each refused with argument and row; usable values are accepted.

Every case spoils one argument of a call that works. The error is an ``InputError`` in one line that names the place;
no word of numpy or GTSAM reaches the user.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient import closerange, rectification, rpc, simulate
from fg_orient.model.block import Coordinates, WithheldCoordinates
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.rectification.fit import fit
from tests.support.pinhole import pinhole_block

pytestmark = pytest.mark.behaviour

N = 25
GENERATOR = np.random.default_rng(7)
GROUND = GENERATOR.uniform([31.0, 41.0, 0.0], [31.2, 41.2, 500.0], (30, 3))
PIXELS = np.column_stack([1e4 * (GROUND[:, 1] - 41.0), 1e4 * (GROUND[:, 0] - 31.0)])
ROOM = GENERATOR.uniform([-2.0, -2.0, 8.0], [2.0, 2.0, 12.0], (20, 3))
PHOTO = 60.0 * ROOM[:, :2] / ROOM[:, 2:]
ONE_CONTROL = (fg.Role.CONTROL, *(fg.Role.TIE,) * (N - 1))
NOWHERE = Coordinates(np.full((N, 3), np.nan), np.full((N, 3), np.nan), np.zeros(N, bool))
NOTHING: dict[str, Any] = dict.fromkeys(("image", "point", "line", "sample", "sigma_line_px", "sigma_sample_px"), ())
FORM = rpc.RfmForm(1, "common")


@cache
def block() -> fg.Block:
    return pinhole_block(4, N, views=3, seed=2)[0]


def spoilt(values: Any, row: int, value: float) -> Any:
    out = np.array(values, float)
    out[row] = value
    return out


def observed(**changed: Any) -> fg.Block:
    return replace(block(), observations=replace(block().observations, **changed))


def point_index(value: int) -> Any:
    out = block().observations.point.copy()
    out[3] = value
    return out


def image_index(value: int) -> Any:
    out = block().observations.image.copy()
    out[3] = value
    return out


def with_sensor(sensor: Any) -> fg.Block:
    first, second, *others = block().images
    return replace(block(), images=(first, replace(second, sensor=sensor), *others))


def ground_points(**changed: Any) -> fg.Block:
    return replace(block(), points=replace(block().points, **changed))


def ids(row: int, name: Any) -> tuple[Any, ...]:
    return tuple(name if k == row else one for k, one in enumerate(block().points.ids))


def known(**changed: Any) -> fg.Block:
    return ground_points(known=replace(block().points.known, **changed))


def extra(**changed: Any) -> fg.Block:
    from factors.conditions.control import CONTROL_POINT, POINT

    usual = {"equation": CONTROL_POINT, "unknowns": ("point:1",), "record": np.zeros(POINT.size),
             "setup": np.zeros((2, 0)), "n_residuals": 3, "label": "own"}  # fmt: skip
    return replace(block(), extra=(fg.ExtraObservation(**(usual | changed)),))


def rays(*values: Any, **more: Any) -> Any:
    return fg.intersect([image.sensor for image in block().images[:2]], *values, **more)


def dlt(ground: Any = ROOM, image: Any = PHOTO, **more: Any) -> Any:
    return closerange.fit_dlt(ground, image, **more)


def bundle(**changed: Any) -> Any:
    interior = closerange.PhotoInterior(60.0, np.zeros(2))
    photos = [closerange.BundlePhoto(f"ph{k}", interior, np.eye(3), np.array([k, 0.0, 0.0])) for k in range(2)]
    usual = {
        "photos": photos, "ids": [f"p{k}" for k in range(20)], "start_m": ROOM, "photo": np.repeat([0, 1], 20),
        "point": np.tile(np.arange(20), 2), "image": np.vstack([PHOTO, PHOTO - np.array([60.0, 0.0]) / ROOM[:, 2:]]),
        "control": {f"p{k}": (ROOM[k], 0.001) for k in range(4)},
    }  # fmt: skip
    return closerange.adjust_bundle(**(usual | changed))


def control_points(line: Any = PIXELS[:, 0], sample: Any = PIXELS[:, 1], ground: Any = GROUND) -> Any:
    return rpc.ControlPoints(line, sample, ground)


def plane(source: Any = PIXELS, target: Any = GROUND[:, :2] * 1e5, sigma: Any = None, names: Any = None) -> Any:
    return rectification.Observations.of(source, target, sigma, names)


CASES: dict[str, tuple[Callable[[], object], str]] = {
    # image points
    "image points: lengths that differ": (lambda: observed(line=np.zeros(7)), "line"),
    "image points: point of two dimensions": (lambda: observed(point=np.zeros((75, 1), int)), "point"),
    "image points: fractions as positions": (lambda: observed(point=np.full(75, 0.5)), "point"),
    "image points: masks as positions": (lambda: observed(image=np.ones(75, bool)), "image"),
    "image points: text as numbers": (lambda: observed(line=np.full(75, "12")), "line"),
    "image points: complex numbers": (lambda: observed(line=np.full(75, 1j)), "line"),
    "image points: None": (lambda: observed(sample=None), "sample"),
    "image points: None in a list": (lambda: observed(sample=[None] * 75), "sample"),
    "image points: rows of unequal length": (lambda: observed(sample=[[1.0], [1.0, 2.0]]), "sample"),
    "image points: a number": (lambda: observed(line=3.0), "line"),
    "image points: nan": (lambda: observed(line=spoilt(block().observations.line, 4, np.nan)), "line, row 4"),
    "image points: inf": (lambda: observed(sample=spoilt(block().observations.sample, 5, np.inf)), "sample, row 5"),
    "image points: 1e300": (lambda: observed(line=spoilt(block().observations.line, 4, 1e300)), "line, row 4"),
    "image points: sigma 0": (lambda: observed(sigma_line_px=spoilt(np.ones(75), 2, 0.0)), "sigma_line_px, row 2"),
    "image points: sigma below 0": (lambda: observed(sigma_line_px=-np.ones(75)), "sigma_line_px, row 0"),
    "image points: sigma 1e-300": (lambda: observed(sigma_sample_px=np.full(75, 1e-300)), "sigma_sample_px, row 0"),
    "image points: sigma 1e300": (lambda: observed(sigma_sample_px=np.full(75, 1e300)), "sigma_sample_px, row 0"),
    "image points: sigma inf": (lambda: observed(sigma_line_px=np.full(75, np.inf)), "sigma_line_px, row 0"),
    "image points: image -1": (lambda: observed(image=image_index(-1)), "image, row 3"),
    "image points: point -1": (lambda: observed(point=point_index(-1)), "point, row 3"),
    # ground points
    "ground points: an id twice": (lambda: ground_points(ids=ids(1, "1")), "ids, row 1"),
    "ground points: line break in an id": (lambda: ground_points(ids=ids(4, "a\nb")), "ids, row 4"),
    "ground points: carriage return in an id": (lambda: ground_points(ids=ids(4, "a\rb")), "ids, row 4"),
    "ground points: blank at the end of an id": (lambda: ground_points(ids=ids(4, "a ")), "ids, row 4"),
    "ground points: empty id": (lambda: ground_points(ids=ids(4, "")), "ids, row 4"),
    "ground points: number as id": (lambda: ground_points(ids=ids(4, 12)), "ids, row 4"),
    "ground points: None as ids": (lambda: ground_points(ids=None), "ids"),
    "ground points: one text as ids": (lambda: ground_points(ids="a" * N), "ids"),
    "ground points: ids too few": (lambda: ground_points(ids=block().points.ids[:-1]), "ids"),
    "ground points: roles too few": (lambda: ground_points(roles=(fg.Role.TIE,)), "roles"),
    "ground points: misspelt role": (lambda: ground_points(roles=("contrl",) * N), "roles, row 0"),
    "ground points: role None": (lambda: ground_points(roles=(None,) * N), "roles, row 0"),
    "ground points: known of another kind": (lambda: ground_points(known=np.zeros((N, 3))), "known"),
    # coordinates
    "coordinates: wrong shape": (lambda: known(ecef_m=np.zeros((N, 2))), "ecef_m"),
    "coordinates: transposed": (lambda: known(ecef_m=np.zeros((3, N))), "ecef_m"),
    "coordinates: inf": (lambda: known(ecef_m=np.full((N, 3), np.inf)), "ecef_m, row 0"),
    "coordinates: 1e300": (lambda: known(ecef_m=np.full((N, 3), 1e300)), "ecef_m, row 0"),
    "coordinates: nan in part of a row": (
        lambda: known(ecef_m=np.where(np.arange(3) == 1, np.nan, np.zeros((N, 3)))), "ecef_m, row 0"),
    "coordinates: sigma 0": (lambda: known(sigma_enu_m=np.zeros((N, 3))), "sigma_enu_m, row 0"),
    "coordinates: sigma 1e-300": (lambda: known(sigma_enu_m=np.full((N, 3), 1e-300)), "sigma_enu_m, row 0"),
    "coordinates: sigma 1e300": (lambda: known(sigma_enu_m=np.full((N, 3), 1e300)), "sigma_enu_m, row 0"),
    "coordinates: fixed too short": (lambda: known(fixed=np.zeros(3, bool)), "fixed"),
    "coordinates: fixed as numbers": (lambda: known(fixed=np.full(N, 2.0)), "fixed"),
    "coordinates: control without any": (
        lambda: ground_points(roles=ONE_CONTROL, known=NOWHERE), "points.known.ecef_m, row 0"),
    "coordinates: control without sigma": (
        lambda: ground_points(roles=ONE_CONTROL), "points.known.sigma_enu_m, row 0"),
    # image
    "image: id None": (lambda: fg.Image(None, block().images[0].sensor), "id"),  # type: ignore[arg-type]
    "image: line break in its id": (lambda: fg.Image("a\nb", block().images[0].sensor), "id"),
    "image: NUL in its id": (lambda: fg.Image("a\0b", block().images[0].sensor), "id"),
    "image: sensor None": (lambda: fg.adjust(with_sensor(None)), "image 2"),
    "image: a path as sensor": (lambda: fg.adjust(with_sensor("rpc.txt")), "image 2"),
    "image: pixels_origin with nan": (
        lambda: fg.Image("a", block().images[0].sensor, "a.tif", (np.nan, 0.0)), "pixels_origin"),
    # block
    "block: point n": (lambda: observed(point=point_index(N)), "observations.point, row 3"),
    "block: image n": (lambda: observed(image=image_index(4)), "observations.image, row 3"),
    "block: sigma nan": (lambda: observed(sigma_line_px=np.full(75, np.nan)), "observations.sigma_line_px, row 0"),
    "block: no images": (lambda: fg.adjust(replace(observed(**NOTHING), images=())), "images"),
    "block: observations without images": (lambda: replace(block(), images=()), "observations.image, row 0"),
    "block: images None": (lambda: replace(block(), images=None), "images"),  # type: ignore[arg-type]
    "block: a sensor as image": (lambda: replace(block(), images=(block().images[0].sensor,)), "images"),  # type: ignore[arg-type]
    "block: an image twice": (lambda: replace(block(), images=(block().images[0],) * 4), "images, row 1"),
    "block: points of another kind": (lambda: replace(block(), points=[1, 2]), "points"),  # type: ignore[arg-type]
    "block: observations None": (lambda: replace(block(), observations=None), "observations"),  # type: ignore[arg-type]
    "block: options as a dictionary": (lambda: replace(block(), options={"eop_set": 1}), "options"),  # type: ignore[arg-type]
    "block: withheld of another kind": (lambda: replace(block(), withheld=None), "withheld"),  # type: ignore[arg-type]
    "block: a withheld point that is none": (
        lambda: replace(block(), withheld=WithheldCoordinates(("x",))), "withheld"),
    "block: no observations": (lambda: fg.adjust(observed(**NOTHING)), "block.no_rays"),
    "block: an extra observation that is none": (
        lambda: fg.adjust(replace(block(), extra=("x",))), "extra observation 0"),  # type: ignore[arg-type]
    # constraints and extra observations
    "constraint: misspelt kind": (lambda: fg.Constraint("distence", ("1", "2"), 3.0), "kind"),
    "constraint: members None": (lambda: fg.Constraint("distance", None, 3.0), "members"),  # type: ignore[arg-type]
    "constraint: members as numbers": (lambda: fg.Constraint("distance", (1, 2), 3.0), "members"),  # type: ignore[arg-type]
    "constraint: one text as members": (lambda: fg.Constraint("distance", "12", 3.0), "members"),  # type: ignore[arg-type]
    "constraint: value as text": (lambda: fg.Constraint("distance", ("1", "2"), "3"), "value_m"),  # type: ignore[arg-type]
    "constraint: value nan": (lambda: fg.Constraint("distance", ("1", "2"), np.nan), "value_m"),
    "constraint: sigma 1e-300": (lambda: fg.Constraint("distance", ("1", "2"), 3.0, 1e-300), "sigma"),
    "constraint: sigma as text": (lambda: fg.Constraint("distance", ("1", "2"), 3.0, "1"), "sigma"),  # type: ignore[arg-type]
    "constraint: observed as a number": (
        lambda: fg.Constraint("circle", ("1", "2", "3"), observed={"radius": 2.0}), "observed radius"),  # type: ignore[dict-item]
    "constraint: offset of wrong shape": (
        lambda: fg.Constraint("equal attitude", ("1", "2"), offset=np.eye(2)), "offset"),
    "constraint: offset with nan": (
        lambda: fg.Constraint("equal attitude", ("1", "2"), offset=np.full((3, 3), np.nan)), "offset"),
    "constraint: foreign member": (
        lambda: fg.adjust(replace(block(), extra=(fg.Constraint("distance", ("1", "x"), 3.0, 0.1),))), "distance"),
    "extra observation: unknown point": (lambda: fg.adjust(extra(unknowns=("point:999",))), "own"),
    "extra observation: unknown kind": (lambda: fg.adjust(extra(unknowns=("pont:1",))), "own"),
    "extra observation: unknowns too many": (lambda: fg.adjust(extra(unknowns=("point:1", "point:2"))), "own"),
    "extra observation: record with nan": (lambda: extra(record=np.full(12, np.nan)), "record"),
    "extra observation: record cut off": (lambda: extra(record=np.zeros(11)), "record"),
    "extra observation: record too short": (lambda: fg.adjust(extra(record=np.zeros(2))), "record"),
    "extra observation: no equation": (lambda: extra(equation=None), "equation"),
    "extra observation: n_residuals -1": (lambda: extra(n_residuals=-1), "n_residuals"),
    # adjust
    "adjust: no block": (lambda: fg.adjust(None), "block"),  # type: ignore[arg-type]
    "adjust: a path": (lambda: fg.adjust("project.toml"), "block"),  # type: ignore[arg-type]
    "adjust: EOP set 99": (lambda: fg.adjust(block(), eop_set=99), "eop_set"),
    "adjust: options as a dictionary": (lambda: fg.adjust(block(), options={"eop_set": 1}), "options"),  # type: ignore[arg-type]
    "adjust: workers -1": (lambda: fg.adjust(block(), workers=-1), "workers"),
    "adjust: parts as text": (lambda: fg.adjust(block(), parts="4"), "parts"),  # type: ignore[arg-type]
    "adjust: max_iterations nan": (lambda: fg.adjust(block(), max_iterations=np.nan), "max_iterations"),
    "adjust: start of another kind": (lambda: fg.adjust(block(), start=3), "start"),  # type: ignore[arg-type]
    # intersect
    "intersect: nan": (lambda: rays([np.nan, 0.0], [0.0, 0.0]), "line"),
    "intersect: lengths that differ": (lambda: rays([0.0, 0.0], [0.0]), "line, sample"),
    "intersect: text": (lambda: rays(["a", "b"], [0.0, 0.0]), "line"),
    "intersect: None": (lambda: rays(None, [0.0, 0.0]), "line"),
    "intersect: empty": (lambda: rays(np.zeros((2, 0)), np.zeros((2, 0))), "line"),
    "intersect: no sensors": (lambda: fg.intersect([], [], []), "sensors"),
    "intersect: sensors None": (lambda: fg.intersect(None, [0.0, 0.0], [0.0, 0.0]), "sensors"),  # type: ignore[arg-type]
    # DLT and bundle
    "fit_dlt: None": (lambda: dlt(ground=None), "ground"),
    "fit_dlt: text": (lambda: dlt(image=[["a", "b"]] * 20), "image"),
    "fit_dlt: wrong shape": (lambda: dlt(ground=ROOM.T), "ground"),
    "fit_dlt: nan": (lambda: dlt(ground=spoilt(ROOM, 3, np.nan)), "ground, row 3"),
    "fit_dlt: lengths that differ": (lambda: dlt(image=PHOTO[:-1]), "DLT"),
    "fit_dlt: sigma of wrong shape": (lambda: dlt(sigma=np.ones(7)), "sigma"),
    "fit_dlt: sigma 0": (lambda: dlt(sigma=0.0), "sigma"),
    "fit_dlt: sigma as text": (lambda: dlt(sigma="x"), "sigma"),
    "fit_dlt: about of wrong shape": (lambda: dlt(distortion=("k1",), about=[1.0, 2.0, 3.0]), "about"),
    "adjust_bundle: photo -1": (lambda: bundle(photo=np.repeat([0, -1], 20)), "photo, row 20"),
    "adjust_bundle: point n": (lambda: bundle(point=np.tile(np.arange(1, 21), 2)), "point, row 19"),
    "adjust_bundle: fractions as positions": (lambda: bundle(point=np.full(40, 0.5)), "point"),
    "adjust_bundle: ids too few": (lambda: bundle(ids=["a"]), "ids"),
    "adjust_bundle: an id twice": (lambda: bundle(ids=["a"] * 20), "ids"),
    "adjust_bundle: no photos": (lambda: bundle(photos=[]), "photo"),
    "adjust_bundle: sigma of wrong shape": (lambda: bundle(sigma=np.ones(7)), "sigma"),
    "adjust_bundle: control of wrong shape": (lambda: bundle(control={"p1": ([0.0, 0.0], 0.1)}), "control p1"),
    "adjust_bundle: control 1e300": (lambda: bundle(control={"p1": ([0.0, 0.0, 1e300], 0.1)}), "control p1"),
    "adjust_bundle: unknown backend": (lambda: bundle(backend="grpah"), "backend"),
    "adjust_bundle: misspelt residual": (lambda: bundle(residual="images"), "residual"),
    "bundle photo: rotation with nan": (lambda: closerange.BundlePhoto(
        "a", closerange.PhotoInterior(60.0, np.zeros(2)), np.full((3, 3), np.nan), np.zeros(3)), "rotation"),
    "bundle photo: centre of wrong shape": (lambda: closerange.BundlePhoto(
        "a", closerange.PhotoInterior(60.0, np.zeros(2)), np.eye(3), np.zeros(2)), "centre_m"),
    # RPC
    "control points: lengths that differ": (lambda: control_points(line=PIXELS[:-1, 0]), "sample"),
    "control points: transposed": (lambda: control_points(ground=GROUND.T), "ground"),
    "control points: nan": (lambda: control_points(line=spoilt(PIXELS[:, 0], 6, np.nan)), "line, row 6"),
    "control points: lists of text": (lambda: control_points(line=["a"] * 30), "line"),
    "control points: None": (lambda: control_points(ground=None), "ground"),
    "control points: empty": (lambda: control_points([], [], np.zeros((0, 3))), "control points"),
    "fit_true: points as an array": (lambda: rpc.fit_true(GROUND, FORM), "points"),
    "fit_true: kappa nan": (lambda: rpc.fit_true(control_points(), FORM, kappa=np.nan), "kappa"),
    "fit_true: kappa as text": (lambda: rpc.fit_true(control_points(), FORM, kappa="1"), "kappa"),  # type: ignore[arg-type]
    "fit_linear: unknown penalty": (lambda: rpc.fit_linear(control_points(), FORM, penalty="none"), "penalty"),  # type: ignore[arg-type]
    "fit_selected: unknown selection": (lambda: rpc.fit_selected(control_points(), FORM, "x"), "selection"),
    "cross_validate: folds 1.5": (lambda: rpc.cross_validate(control_points(), rpc.fit_true, folds=1.5), "folds"),  # type: ignore[arg-type]
    # rectification
    "observations: lengths that differ": (lambda: plane(source=PIXELS[:-1]), "source"),
    "observations: nan": (lambda: plane(target=spoilt(GROUND[:, :2], 2, np.nan)), "target of point 3"),
    "observations: None": (lambda: plane(source=None), "source"),
    "observations: sigma of wrong shape": (lambda: plane(sigma=np.ones(7)), "sigmas"),
    "observations: sigma 0": (lambda: plane(sigma=0.0), "sigma"),
    "observations: ids too few": (lambda: plane(names=["a"]), "ids"),
    "observations: an id twice": (lambda: plane(names=["a"] * 30), "ids"),
    "fit_points: an array": (lambda: rectification.fit_points(PIXELS, rectification.find_model("affine")), "points"),
    "find_model: misspelt": (lambda: rectification.find_model("afine"), "model"),
    "nssda_m: nan": (lambda: rectification.nssda_m(np.nan, 1.0), "RMSE"),
    # simulate
    "simulate: seed -1": (lambda: simulate.zonguldak_block(simulate.ZonguldakOptions(seed=-1)), "seed"),
    "simulate: seed 1.5": (lambda: simulate.zonguldak_block(simulate.ZonguldakOptions(seed=1.5)), "seed"),  # type: ignore[arg-type]
    "simulate: noise nan": (lambda: simulate.ZonguldakOptions(image_noise_px=np.nan), "image_noise_px"),
    "simulate: noise 1e300": (lambda: simulate.BlockOptions(image_noise_px=1e300), "image_noise_px"),
    "simulate: two numbers for three": (lambda: simulate.BlockOptions(ground_noise_m=(1.0, 1.0)), "ground_noise_m"),  # type: ignore[arg-type]
    "simulate: options as a dictionary": (lambda: simulate.zonguldak_block({"seed": 1}), "options"),  # type: ignore[arg-type]
    "simulate: mixed options as a dictionary": (lambda: simulate.mixed_block({"seed": 1}), "options"),  # type: ignore[arg-type]
    "simulate: points 5": (lambda: simulate.grid_block(simulate.BlockOptions(points=5)), "points"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_value_is_refused_with_its_place(case: str) -> None:
    call, place = CASES[case]
    with pytest.raises(FgOrientError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert place in " ".join(one for p in caught.value.problems for one in (p.code, p.option, p.place)), text


@cache
def sensors() -> dict[str, Any]:
    """Return a sensor of each kind by the name of its class."""
    return {type(image.sensor).__name__: image.sensor for image in simulate.mixed_block()[0].images}


#: Values that numpy converts to numbers, or that end inside numpy or numba.
ODD: dict[str, Any] = {
    "objects": np.array([None, "x"], object), "text": ["1", "2"], "truth values": [True, False], "complex": [1j, 2.0],
    "dates": np.array(["2020-01-01"] * 2, "M8[D]"), "records": np.zeros(2, "f8,f8"), "ragged": [[1.0], [2.0, 3.0]],
    "masked": np.ma.masked_array([1.0, 2.0], [True, False]), "two dimensions": np.ones((2, 2)), "None": None,
}  # fmt: skip


@pytest.mark.parametrize("kind", ["PushbroomSensor", "FrameSensor", "RpcSensor"])
@pytest.mark.parametrize("odd", ODD)
def test_each_method_of_a_sensor_refuses_values_that_are_no_numbers(odd: str, kind: str) -> None:
    sensor, one = sensors()[kind], np.array([5.0, 7.0])
    for values in ((ODD[odd], one), (one, ODD[odd])):
        for method in (sensor.rays, sensor.locate):
            with pytest.raises(InputError, match="line, sample"):
                method(*values)
    for method in (sensor.rays, sensor.locate):
        with pytest.raises(InputError, match=r"line, sample.*of the same length"):
            method(one, [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="ground_m"):
        sensor.project(ODD[odd])
    with pytest.raises(InputError, match=r"ground_m.*\(n, 3\)"):
        sensor.project(sensor.locate(one, one).T)
    assert sensor.rays([], [])[0].shape == (0, 3)
    assert len(sensor.project(sensor.locate(5, 7)[0])[0]) == 1


def as_given(values: Any) -> Any:
    """Return a read-only view with the same values, in Fortran order and every second column of a larger array."""
    values = np.asarray(values)
    wide = np.zeros((*values.shape, 2), values.dtype, order="F")
    wide[..., 0] = values
    out = wide[..., 0]
    out.setflags(write=False)
    return out


USABLE: dict[str, Callable[[Any], Any]] = {
    "read-only and non-contiguous": as_given,
    "lists": lambda values: np.asarray(values).tolist(),
    "reversed twice": lambda values: np.asarray(values)[::-1].copy()[::-1],
    "big-endian": lambda values: np.asarray(values).astype(np.asarray(values).dtype.newbyteorder(">")),
    "int32 positions": lambda values: (
        np.asarray(values).astype(np.int32) if np.asarray(values).dtype.kind == "i" else values
    ),
}


@pytest.mark.parametrize("kind", USABLE)
def test_usable_arrays_give_the_same_bits(kind: str) -> None:
    """Arrays of another layout or type give the same bits in blocks, DLT, bundles, RPC and rectification."""
    give, b = USABLE[kind], block()
    arrays = [getattr(b.observations, name) for name in NOTHING]
    other = replace(
        b, observations=fg.ImagePoints(*map(give, arrays)),
        points=fg.GroundPoints(
            list(b.points.ids), [str(role) for role in b.points.roles],  # type: ignore[arg-type]
            Coordinates(give(b.points.known.ecef_m), give(b.points.known.sigma_enu_m), give(b.points.known.fixed)),
        ),
    )  # fmt: skip
    assert other.points.ids == b.points.ids
    assert other.points.roles == b.points.roles
    one, two = (fg.adjust(each, statistics="basic") for each in (b, other))
    assert np.array_equal(one.state.ground, two.state.ground, equal_nan=True)
    assert np.array_equal(dlt().values, dlt(give(ROOM), give(PHOTO)).values)
    usual, same = bundle(), bundle(start_m=give(ROOM), photo=give(np.repeat([0, 1], 20)))
    assert np.array_equal(usual.points_m, same.points_m)
    models = (rpc.fit_true(control_points(*map(to, (*PIXELS.T, GROUND))), FORM) for to in (np.asarray, give))
    assert len({model.x.tobytes() for model in models}) == 1
    affine = rectification.find_model("affine")
    made = (plane(to(PIXELS), to(GROUND[:, :2] * 1e5)) for to in (np.asarray, give))
    assert len({fit(each, affine).residuals.tobytes() for each in made}) == 1


def test_arrays_of_a_record_are_copies_and_cannot_be_changed() -> None:
    lines = block().observations.line.copy()
    points = replace(block().observations, line=lines)
    lines[0] = np.nan
    assert np.isfinite(points.line).all()
    with pytest.raises(ValueError, match="read-only"):
        points.line[0] = 1.0


def test_another_option_is_a_type_error_that_names_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"adjust\(\) has no option 'eop_sett'; did you mean 'eop_set'\?"):
        fg.adjust(block(), eop_sett=1)
    with pytest.raises(TypeError, match=r"adjust_bundle\(\) has no option"):
        bundle(los="huber")
