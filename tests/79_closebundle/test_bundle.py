"""The close-range bundle has the 77 unknowns of the thesis and agrees with an independent adjustment."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import null_space, subspace_angles
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from factors.cameras.image_corrections import ideal_points
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import compile_problem
from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.bundle_block import build
from fg_orient.closerange.bundle_checks import of_close_range
from fg_orient.closerange.bundle_result import BundleResult
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.photo import NAMES, SETS, Photo, parameters_of, rotation_from_ayhan
from fg_orient.model.block import Options
from fg_orient.model.constraint import Constraint
from fg_orient.model.errors import InputError, RankDeficientError, finding
from fg_orient.model.names import CellKey
from fg_orient.quality.observability import analyse_block
from fg_orient.studies.reproduce import ayhan1996_photos as thesis
from fg_orient.studies.reproduce.ayhan1996_photos import CONTROL, PHOTOS, POINTS, comparator, points_of

from .conftest import SIGMA, Array, Scene, make

Values = dict[CellKey, float]


def adjusted(scene: Scene, photos: list[BundlePhoto], **more: object) -> BundleResult:
    """Make all points new except the first five, which are held."""
    control = {name: (scene.points[k], 0.0) for k, name in enumerate(scene.ids[:5])}
    start = scene.points + np.random.default_rng(1).normal(scale=0.01, size=scene.points.shape)
    given = {"sigma": SIGMA, "control": control, **more}
    return adjust_bundle(photos, scene.ids, start, scene.which, scene.of, scene.image, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def held(values: Values) -> BundleResult:
    return thesis.bundle(values)


@pytest.mark.consistency
def test_graph_equals_correlates_on_the_77_unknowns_of_the_thesis(values: Values, held: BundleResult) -> None:
    graph = thesis.bundle(values, backend="graph")
    assert len(held.state) == 77 and held.redundancy == 43
    assert np.abs((graph.state - held.state) / np.sqrt(held.cofactors)).max() <= 1e-9
    assert np.abs(np.sqrt(graph.cofactors / held.cofactors) - 1.0).max() <= 1e-5
    base = [np.linalg.norm(found.centres_m[1] - found.centres_m[0]) for found in (held, graph)]
    assert base == pytest.approx([thesis.BASE_M] * 2, abs=1e-12)


@pytest.mark.truth
def test_mean_errors_of_the_thesis(values: Values, held: BundleResult) -> None:
    """The 77 mean errors are the printed ones within 1 % rms without the held base.

    With it X0 would be 24 % smaller.
    """
    free, ratios = thesis.bundle(values, with_base=False), []
    for k, photo in enumerate(PHOTOS):
        for name, (_, root) in thesis.parameters(free, k).items():
            ratios.append(root / values[CellKey("ek1.bundle", quantity=f"m_{name}", parameter=photo)])
    printed = points_of(values, "ek1.bundle", ("m_x_m", "m_y_m", "m_z_m"), CONTROL)
    ratios += (thesis.point_roots(free) / printed).ravel().tolist()
    assert len(ratios) == 77
    assert np.sqrt(np.mean((np.array(ratios) - 1.0) ** 2)) <= 0.01
    key = CellKey("ek1.bundle", quantity="m_x0", parameter=PHOTOS[0])
    assert thesis.parameters(held, 0)["x0"][1] / values[key] == pytest.approx(0.76, abs=0.01)


@pytest.mark.truth
def test_parameters_of_the_thesis(values: Values, held: BundleResult) -> None:
    off = []
    for k, photo in enumerate(PHOTOS):
        for name, (value, _) in thesis.parameters(held, k).items():
            if name not in thesis.STATION:
                error = values[CellKey("ek1.bundle", quantity=f"m_{name}", parameter=photo)]
                scale = np.pi / 200.0 if name in thesis.PRINTED[10:13] else 1.0
                off.append((value - values[CellKey("ek1.cameras", quantity=name, parameter=photo)]) * scale / error)
    assert len(off) == 26
    assert np.sqrt(np.mean(np.square(off))) <= 0.25 and np.abs(off).max() <= 0.6
    printed = points_of(values, "ek1.bundle", ("x_adjusted_m", "y_adjusted_m", "z_adjusted_m"), CONTROL)
    rms = 1e3 * np.sqrt(np.mean((held.points_m - printed) ** 2, axis=0))
    assert (rms <= [0.08, 0.08, 0.16]).all()


@pytest.mark.truth
def test_sums_of_the_thesis_from_the_comparator(values: Values, held: BundleResult) -> None:
    """The sums from comparator values are 0.375/2.070/0.587, near the printed 0.392/2.009/0.486.

    They agree as a pattern only, because the weights are inferred.
    """
    land = points_of(values, "ek1.points", ("x_geodetic_m", "y_geodetic_m", "z_geodetic_m"))
    raw, n = comparator(values), len(land)
    both, ids = np.concatenate([raw[:, :2], raw[:, 2:]]), [str(k) for k in POINTS]
    found = intersect_photos(held.oriented(), np.repeat([0, 1], n), np.tile(np.arange(n), 2), both, ids=ids).points_m
    found[np.isin(POINTS, CONTROL)] = held.points_m  # the thesis compares its adjusted control points
    sums = 1e4 * np.sum((land - found) ** 2, axis=0)
    assert sums == pytest.approx([0.375, 2.070, 0.587], abs=0.001)
    printed = [values[CellKey("text", quantity=q, parameter="sums")] for q in ("fxfx", "fyfy", "fzfz")]
    assert sums[:2] == pytest.approx(printed[:2], rel=0.05) and sums[2] == pytest.approx(printed[2], rel=0.25)


@pytest.mark.oracle
def test_bundle_equals_scipy() -> None:
    """A bundle with camera parameters and distances has the unknowns and sigmas of scipy's least squares.

    Parameters are own, shared and observed; distances soft and hard.
    """
    scene = make(1, 12, 2)
    photos = scene.photos(unknown=("c",), shared=("k1",), camera="one", observed={"c": (60.01, 0.01)})
    hard, soft = np.linalg.norm(np.diff(scene.points[[[5, 7], [6, 8]]], axis=1)[:, 0], axis=1) + 1e-3
    stated = [
        Constraint("distance", ("p5", "p7"), float(hard)),
        Constraint("distance", ("p6", "p8"), float(soft), 1e-3),
    ]
    found = adjusted(scene, photos, constraints=stated)

    def away(x: Array, weight: float = 1e6) -> Array:
        c, k1, points = x[:2], x[2], np.concatenate([scene.points[:5], x[15:].reshape(-1, 3) + scene.points[5:]])
        out = []
        for k, photo in enumerate(photos):
            turn = Rotation.from_rotvec(x[3 + 6 * k : 6 + 6 * k]).as_matrix() @ photo.rotation
            q = (points - photo.centre_m - x[6 + 6 * k : 9 + 6 * k]) @ turn.T
            lens = scene.interior.corrections.copy()
            lens[0] = 1e-5 * k1
            seen = ideal_points(lens, scene.image[scene.which == k] - scene.interior.principal)
            out.append((seen - c[k] * q[:, :2] / q[:, 2:] * [1.0, -1.0]).ravel() / SIGMA)
        sizes = [np.linalg.norm(points[a] - points[b]) for a, b in ((5, 7), (6, 8))]
        return np.concatenate([*out, (c - 60.01) / 0.01, [(sizes[1] - soft) / 1e-3, (sizes[0] - hard) * weight]])

    start = np.concatenate([[60.0, 60.0, 2.0], np.zeros(12 + 3 * 7)])
    other = least_squares(away, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    roots = np.sqrt(np.diag(np.linalg.inv(other.jac.T @ other.jac)))
    assert (found.points_m[5:] - scene.points[5:]).ravel() == pytest.approx(other.x[15:], abs=1e-4 * roots.max())
    assert [photo["c"][0] for photo in found.photos] == pytest.approx(other.x[:2], abs=1e-5)
    assert found.cameras[0]["k1"][0] == pytest.approx(1e-5 * other.x[2], abs=1e-9)
    assert found.m0 is not None and found.sigma_m is not None
    assert found.sigma_m[5:].ravel() / found.m0 == pytest.approx(roots[15:], rel=1e-3)
    assert np.linalg.norm(found.points_m[5] - found.points_m[7]) == pytest.approx(hard, abs=1e-12)


def distorted(scene: Scene, displacement: Callable[[Array], Array]) -> None:
    """Measure the photos with a displacement that is to be added; corrections are a hundredth of the coordinates."""
    ideal = ideal_points(scene.interior.corrections, scene.image - scene.interior.principal)
    at = ideal
    for _ in range(40):
        at = at + ideal - displacement(at) - ideal_points(scene.interior.corrections, at)
    scene.image = at + scene.interior.principal


@pytest.mark.consistency
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_equal_attitude_and_base_hold_in_the_bundle(backend: str) -> None:
    """A stereo camera's known rotation and base hold within 1e-12 and add four to the redundancy (eqs. 111 and 112)."""
    scene = make(6, 15, 2)
    offset = scene.rotations[1] @ scene.rotations[0].T
    size = float(np.linalg.norm(scene.centres[1] - scene.centres[0]))
    stated = [Constraint("base", ("ph0", "ph1"), size), Constraint("equal attitude", ("ph0", "ph1"), offset=offset)]
    free, found = (adjusted(scene, scene.photos(), constraints=c, backend=backend) for c in ([], stated))
    assert np.abs(found.rotations[1] @ found.rotations[0].T - offset).max() <= 1e-12
    assert np.linalg.norm(found.centres_m[1] - found.centres_m[0]) == pytest.approx(size, abs=1e-12)
    assert np.abs(free.rotations[1] @ free.rotations[0].T - offset).max() > 1e-6
    assert found.redundancy == free.redundancy + 4
    assert found.sigma_m is not None and free.sigma_m is not None
    assert (found.cofactors <= free.cofactors * (1.0 + 1e-9)).all()  # conditions only add


@pytest.mark.oracle
def test_brown_parameters_are_recovered() -> None:
    """The bundle finds a2 and a13 of a simulated photo, and refuses to write what no photo file can contain."""
    scene = make(2, 40, 2, noise=0.0)

    def brown(at: Array) -> Array:
        s = 3e-5 * (at[:, 0] ** 2 - at[:, 1] ** 2) / 60.0
        return np.column_stack([1e-4 * at[:, 1] + at[:, 0] * s, at[:, 1] * s])

    distorted(scene, brown)
    found = adjusted(scene, scene.photos(shared=("a2", "a13"), camera="one"))
    assert found.cameras[0]["a2"][0] == pytest.approx(1e-4, rel=1e-6)
    assert found.cameras[0]["a13"][0] == pytest.approx(3e-5, rel=1e-6)
    with pytest.raises(InputError, match="a2, a13"):
        found.oriented()


FORMS = {
    "radial-even": {"radial_2": 2e-4, "radial_4": 3e-8, "radial_6": 4e-12},
    "radial-odd": {"radial_1": 1e-3, "k1": 3e-6, "k2": 2e-9},
    "radial-full": {"radial_1": 1e-3, "radial_2": 1e-4, "k1": 2e-6, "radial_4": 3e-8, "k2": 2e-9, "radial_6": 1e-11},
    "film-turned": {"film_xx": 1e-3, "affinity_a": -5e-4, "affinity_b": 2e-3},
    "film-affine": {"x0": 0.01, "y0": -0.02, "film_xx": 1e-3, "affinity_a": -5e-4, "film_yx": 3e-4, "affinity_b": 2e-3},
    "film-scales": {"film_xx": 1e-3, "affinity_b": 2e-3},
}


@pytest.mark.oracle
@pytest.mark.parametrize("name", FORMS)
def test_forms_of_corrections_are_recovered(name: str) -> None:
    """Each form of corrections is found in photos made with its formula (eqs. 44 to 55).

    c is known, so that all are determined.
    """
    scene, coefficient = make(2, 40, 2, noise=0.0), FORMS[name]
    names = SETS[name]
    assert set(names) == set(coefficient)
    power = {"k1": 3, "k2": 5} | {f"radial_{j}": j for j in (1, 2, 4, 6)}
    film = np.array([[coefficient.get("film_xx", 0.0), coefficient.get("affinity_a", 0.0)],
                     [coefficient.get("film_yx", 0.0), coefficient.get("affinity_b", 0.0)]])  # fmt: skip

    def formula(at: Array) -> Array:
        r = np.linalg.norm(at, axis=1, keepdims=True)
        along = sum(v * r ** (power[n] - 1) for n, v in coefficient.items() if n in power)
        return np.asarray(at * along + at @ film.T)

    distorted(scene, formula)
    shift = np.array([coefficient.get("x0", 0.0), coefficient.get("y0", 0.0)])
    scene.image = scene.image + shift  # the principal point stands there
    found = adjusted(scene, scene.photos(shared=names, camera="one"))
    start = dict(zip(("x0", "y0", "k1"), (*scene.interior.principal, scene.interior.corrections[0]), strict=True))
    for n, value in coefficient.items():
        assert found.cameras[0][n][0] - start.get(n, 0.0) == pytest.approx(value, rel=2e-5), n


@pytest.mark.consistency
def test_orthogonal_and_odd_powers_span_the_same() -> None:
    """Orthogonal and odd powers of the radial correction give the same m0 and points.

    R_3, R_5, R_7 with a scale are r, r^3, r^5, r^7.
    """
    scene = make(5, 40, 3)
    one, two = (
        adjusted(scene, scene.photos(shared=names, camera="one"))
        for names in (("radial_1", *SETS["radial"]), ("radial_1", *SETS["radial-orthogonal"]))
    )
    assert one.m0 == pytest.approx(two.m0, rel=1e-9)
    assert np.abs(one.points_m - two.points_m).max() <= 1e-8


@pytest.mark.behaviour
def test_sets_are_named() -> None:
    assert parameters_of(("c", "film", "affinity_b", "decentring"), "--shared") == ("c", *NAMES[8:10], *NAMES[6:8])
    with pytest.raises(InputError, match="radial-orthogonal, decentring"):
        parameters_of(("radial-9",), "--shared")
    scene = make(3, 20, 2)
    with pytest.raises(InputError, match="do not determine") as caught:
        adjusted(scene, scene.photos(shared=("c", *SETS["radial-odd"]), camera="one"))
    assert ": camera one c, camera one radial_1 (" in str(caught.value)


@pytest.mark.behaviour
def test_what_nothing_determines_is_named() -> None:
    scene = make(3, 20, 2)
    with pytest.raises(InputError, match="do not determine") as caught:
        adjusted(scene, scene.photos(unknown=("k1", "a16")))  # the same parameter twice
    assert [p.code for p in caught.value.problems] == ["closerange.unobservable"] * 2
    for photo in ("ph0", "ph1"):
        assert any(photo in p.place and "k1" in p.place and "a16" in p.place for p in caught.value.problems)
    flat = scene.points * [1.0, 0.0, 1.0] + [0.0, 2005.0, 0.0]
    control = {name: (flat[k], 0.0) for k, name in enumerate(scene.ids)}
    facing = [rotation_from_ayhan(0.0, 0.0, 0.0)] * 2
    views = [Photo.of("", scene.interior, r, c).project(flat) for r, c in zip(facing, scene.centres, strict=True)]
    image = np.concatenate(views) + np.random.default_rng(4).normal(scale=SIGMA, size=(40, 2))
    level = Scene(scene.interior, facing, scene.centres, flat, image)
    with pytest.raises(InputError, match="do not determine") as caught:  # distance and principal distance are one
        adjusted(level, level.photos(unknown=NAMES[:1]), control=control)
    assert [p.code for p in caught.value.problems] == ["closerange.unobservable"] * 2
    for photo, problem in zip(("ph0", "ph1"), caught.value.problems, strict=True):
        assert problem.place.startswith(f"image {photo}: ") and problem.place.endswith(": +1.00 c")
    turned = make(3, 20, 2, points=flat)  # by 0.1 rad: the plane does determine the principal distance
    assert adjusted(turned, turned.photos(unknown=NAMES[:1]), control=control).redundancy == 80 - 14


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["c", "x0", "y0", "p1", "p2"])
def test_an_undetermined_parameter_has_its_name_of_close_range(name: str) -> None:
    """An error names camera parameters as the photos do; frame images have pixels and number p1 and p2 otherwise."""
    scene, free = make(3, 20, 2), Options(priors=False, datum="free")
    observations = scene.which, scene.of, scene.image, np.full_like(scene.image, SIGMA)
    built = build(scene.photos(unknown=(name,)), tuple(scene.ids), scene.points, *observations, {}, (), False, free)
    (words,) = compile_problem(built.block).parameters[0].words[6:]
    error = RankDeficientError(finding("adjust.rank_deficient", place=f"image ph0: +0.71 {words} -0.71 aspect"))
    assert of_close_range(error).problems[0].place == f"image ph0: +0.71 {name} -0.71 aspect"


def together(verb: str) -> str:
    return ", ".join(f"{verb} {axis}" for axis in "XYZ")


SHIFTS, TURNS = together("shifted together"), together("turned together about")
DISTANCE = Constraint("distance", ("p0", "p1"), 1.0)
PLUMB_LINE = Constraint("plumb line", ("p0", "p1", "p2"), sigma=0.005)
SPHERE = Constraint("sphere", ("p2", "p3", "p4", "p5"), sigma=0.001)


@pytest.mark.truth
@pytest.mark.parametrize(
    ("held", "constraints", "words"),
    [
        (0, [], f"7 motions are free ({SHIFTS}, {TURNS}, scaled together)"),
        (1, [], "turned about Z through control point p0, scaled from control point p0)"),
        (2, [], "1 motion is free (turned about the line through control points p0, p1)"),
        (0, [DISTANCE], f"6 motions are free ({SHIFTS}, {TURNS})"),
        (0, [PLUMB_LINE], f"5 motions are free ({SHIFTS}, turned together about Z, scaled together)"),
        (0, [SPHERE], "7 motions are free"),
    ],
)
def test_open_motions_are_counted(held: int, constraints: list[Constraint], words: str) -> None:
    points = make(3, 20, 3).points
    points[:3, :2] = points[0, :2]
    scene = make(3, 20, 3, points=points)
    control = {name: (scene.points[k], 0.0) for k, name in enumerate(scene.ids[:held])}
    with pytest.raises(InputError, match="nothing ties these photos") as caught:
        adjusted(scene, scene.photos(), control=control, constraints=constraints)
    assert words in str(caught.value)
    assert caught.value.problems[0].code == "closerange.datum"


@pytest.mark.oracle
def test_free_motions_leave_image_residuals_alone() -> None:
    """The free motions of exact photos span scipy's null space of the Jacobian."""
    scene = make(8, 12, 2, noise=0.0)
    exact = [BundlePhoto(f"ph{k}", scene.interior, r, c)
             for k, (r, c) in enumerate(zip(scene.rotations, scene.centres, strict=True))]  # fmt: skip
    sigma = np.ones_like(scene.image)
    observations = scene.which, scene.of, scene.image, sigma
    options = Options(priors=False, datum="free")
    built = build(exact, tuple(scene.ids), scene.points, *observations, {}, (), False, options)
    (part,) = analyse_block(built.problem).motions
    design = assemble(built.problem, built.problem.start)[1]
    free = null_space(design, rcond=1e-10)
    of_photos = free[: built.problem.n_free_unknowns]
    assert part.words[-1] == "scaled together" and free.shape[1] == len(part) == 7
    assert subspace_angles(of_photos, part.moves).max() < 1e-6


@pytest.mark.behaviour
def test_points_without_two_rays_are_named() -> None:
    """All points without two rays are named, except one that a constraint and its ray determine.

    A plane may cut its ray.
    """
    scene = make(3, 20, 2)
    keep = ~(((scene.of == 7) & (scene.which == 1)) | (scene.of == 9))
    start, control = scene.points.copy(), {name: (scene.points[k], 0.0) for k, name in enumerate(scene.ids[:5])}

    def given(**more: object) -> BundleResult:
        return adjust_bundle(scene.photos(), scene.ids, start, scene.which[keep], scene.of[keep], scene.image[keep],
                             sigma=SIGMA, control=control, **more)  # type: ignore[arg-type]  # fmt: skip

    with pytest.raises(InputError) as caught:
        given()
    assert [(p.code, p.place) for p in caught.value.problems] == [
        ("closerange.one_ray", "point p7, photo ph0"), ("closerange.no_ray", "point p9"),
    ]  # fmt: skip
    start[:3, 1] = start[7, 1]  # a plane of three held points
    control = {name: (start[k], 0.0) for k, name in enumerate(scene.ids[:8]) if k != 7}
    keep &= scene.of > 2
    keep |= scene.of == 9
    found = given(constraints=[Constraint("plane", ("p0", "p1", "p2", "p7"))])
    assert found.points_m[7, 1] == pytest.approx(start[7, 1], abs=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_a_free_network_has_the_shape_of_any_minimal_datum(backend: str) -> None:
    """A free network has squares and distances of a minimal datum, and a smaller trace of cofactors.

    Without a datum it is refused.
    """
    scene = make(9, 15, 4)
    photos, p = scene.photos(), scene.points
    free = adjusted(scene, photos, control={}, datum="inner", backend=backend)
    weak = np.array([1e4, 1e4, 1e-4])  # one coordinate keeps the block from turning about the first two points
    seven = {"p0": (free.points_m[0], 0.0), "p1": (free.points_m[1], 0.0), "p2": (free.points_m[2], weak)}
    held = adjusted(scene, photos, control=seven)
    assert held.redundancy == free.redundancy + 2 and free.solution.in_datum().datum_defect == 7
    assert free.m0**2 * free.redundancy == pytest.approx(held.m0**2 * held.redundancy, rel=1e-8)
    distances = [np.linalg.norm(found.points_m[:, None] - found.points_m[None], axis=2) for found in (free, held)]
    assert np.abs(distances[0] - distances[1]).max() < 1e-7
    traces = [np.einsum("nii->", found.point_cofactors) for found in (free, held)]
    assert traces[0] < traces[1]
    away = free.points_m - scene.points
    start = np.random.default_rng(1).normal(scale=0.01, size=p.shape)
    assert np.abs((away - start).mean(axis=0)).max() < 1e-6  # the centre of the start values stays
    with pytest.raises(InputError) as caught:
        adjusted(scene, photos, control={}, backend=backend)
    assert caught.value.problems[0].code == "closerange.datum"


@pytest.mark.behaviour
def test_refusals() -> None:
    scene = make(4, 8, 2)
    photos = scene.photos()
    size = float(np.linalg.norm(scene.points[6] - scene.points[7]))
    twice = [Constraint("distance", ("p6", "p7"), size), Constraint("distance", ("p7", "p6"), size)]
    for words, code, more in (
        ("follows from the others", "closerange.dependent", {"constraints": twice}),
        ("not allowed", "options.value", {"backend": "ceres"}),
        ("does not exist", "closerange.member", {"constraints": [Constraint("base", ("p1", "ph1"), 1.0)]}),
        ("standard deviations", "closerange.sigma", {"sigma": 0.0}),
    ):
        with pytest.raises(InputError, match=words) as caught:
            adjusted(scene, photos, **more)
        assert caught.value.problems[0].code == code
    with pytest.raises(InputError, match="unknown k9"):
        scene.photos(unknown=("k9",))
    with pytest.raises(InputError, match="give 2 different ones"):
        Constraint("distance", ("a", "a"), 1.0)
