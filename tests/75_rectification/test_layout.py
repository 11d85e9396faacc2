"""The tests check positions and weights of control points, and single check points."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from fg_orient.model.errors import InputError
from fg_orient.rectification.fit import Observations, TransformationFit, fit
from fg_orient.rectification.outliers import check_tests
from fg_orient.rectification.points import PointFit
from fg_orient.rectification.record import record_of
from fg_orient.rectification.transformation import find_model
from tests.support.command import in_process as run

from .conftest import SPATIAL, scene, write_points

Array = np.ndarray
CENTRE = np.array([500.0, 400.0])


def strip(
    width: float, angle: float, *, n: int = 30, noise_px: float = 0.5, scale: float = 28.5, seed: int = 1
) -> Observations:
    """Return points in a strip of 1000 pixels in a direction; only image points have noise."""
    rng = np.random.default_rng(seed)
    along, across = rng.uniform(-500.0, 500.0, n), rng.uniform(-0.5, 0.5, n) * width
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    true = CENTRE + np.stack([along, across], axis=1) @ turn.T
    image = true + rng.normal(0.0, noise_px, true.shape)
    return Observations.of(image, scale * true + (6e5, 4.5e6))


def refusal(points: Observations, name: str = "affine", degree: int | None = None) -> InputError:
    with pytest.raises(InputError) as caught:
        fit(points, find_model(name, degree), source_names=("sample", "line"))
    return caught.value


@pytest.mark.behaviour
@pytest.mark.parametrize("angle", [0.0, 0.7, 1.5708])
@pytest.mark.parametrize("n", [12, 30, 300])
@pytest.mark.parametrize(("name", "degree"), [("affine", None), ("polynomial", 2), ("projective", None)])
def test_points_within_their_noise_of_a_line_are_refused(name: str, degree: int | None, n: int, angle: float) -> None:
    """Control points on a line within their noise are refused, in any direction and for any number of points.

    For a line along an axis no condition number shows it.
    """
    assert refusal(strip(0.0, angle, n=n, seed=n), name, degree).problems[0].code == "rectify.narrow"


@pytest.mark.behaviour
def test_the_refusal_names_the_direction() -> None:
    text = str(refusal(strip(0.0, 0.0)))
    assert "their spread along line is only" in text
    assert "0.71 sample" in str(refusal(strip(0.0, math.pi / 4.0)))


@pytest.mark.consistency
def test_neither_unit_nor_size_nor_sigma_of_all_enters() -> None:
    """The test of the layout does not depend on the unit, the image size or one sigma of all points."""
    for width, refused in ((0.0, True), (30.0, False)):
        points = strip(width, 0.3)
        alike = (
            points, Observations.of(1e-3 * points.source, points.target),
            Observations.of(points.source, 1e-3 * points.target), Observations.of(points.source, points.target, 7.0),
        )  # fmt: skip
        found = []
        for some in alike:
            if refused:
                assert refusal(some).problems[0].code == "rectify.narrow"
            else:
                (reach,) = fit(some, find_model("affine")).reaches
                found.append((reach.ratio, reach.noise))
        assert not found or np.ptp(found, axis=0) == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.oracle
def test_the_ratio_is_that_of_the_extents_and_sigma_that_of_a_simulation() -> None:
    points = strip(40.0, 0.4)
    found = fit(points, find_model("affine"))
    (reach,) = found.reaches
    extents = np.linalg.svd(points.source - points.source.mean(axis=0), compute_uv=False)
    assert reach.ratio == pytest.approx(extents[0] / extents[1], rel=1e-6)
    assert abs(reach.direction @ (-math.sin(0.4), math.cos(0.4))) == pytest.approx(1.0, abs=1e-3)
    rng = np.random.default_rng(2)
    design = np.column_stack([np.ones(len(points)), points.source - points.source.mean(axis=0)])
    slopes = [np.linalg.lstsq(design, rng.normal(0.0, found.m0, len(points)), rcond=None)[0][1:] for _ in range(2000)]
    expected = float(np.std(np.array(slopes) @ reach.direction)) / 28.5
    assert reach.sigma == pytest.approx(expected, rel=5.0 / math.sqrt(2.0 * 2000))


@pytest.mark.behaviour
def test_narrow_points_are_remarked_and_wide_ones_are_not(tmp_path: Path) -> None:
    for width, remarked in ((30.0, True), (300.0, False)):
        points = strip(width, 0.0)
        path = write_points(tmp_path / "p.csv", points.source[:, ::-1], points.target)
        words = run("rectify", "fit", path, "--json").json["warnings"]
        assert any("have a small extent along line" in text for text in words) is remarked


@pytest.mark.behaviour
def test_helmert_needs_no_width() -> None:
    (reach,) = fit(strip(0.0, 0.3), find_model("helmert")).reaches
    assert reach.ratio == pytest.approx(1.0) and not reach.is_weak


@pytest.mark.behaviour
def test_points_near_a_circle_are_remarked_at_degree_2() -> None:
    rng = np.random.default_rng(3)
    angle = rng.uniform(0.0, 2.0 * math.pi, 30)
    for noise, remarked in ((0.5, True), (60.0, False)):
        image = CENTRE + 400.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + rng.normal(0.0, noise, (30, 2))
        found = fit(Observations.of(image, 28.5 * image + rng.normal(0.0, 5.0, (30, 2))), find_model("polynomial", 2))
        words = record_of(PointFit(found, "image-to-map", None, np.zeros((0, 2))))["warnings"]
        assert any("close to a curve" in text for text in words) is remarked


@pytest.mark.behaviour
@pytest.mark.parametrize("name", SPATIAL)
def test_heights_that_say_nothing_are_remarked(name: str) -> None:
    """Heights with a range of 1 m give a remark, those of 300 m do not, and neither is refused.

    300 m move an image point by about 20 pixels; 1 m is hidden in noise of 0.3 pixels.
    """
    rng = np.random.default_rng(4)
    plan, share = rng.uniform(0.0, 3e4, (30, 2)), rng.uniform(0.0, 1.0, 30)
    for height, remarked in ((300.0, False), (1.0, True)):
        image = np.stack([6000.0 - plan[:, 1] / 5.0, plan[:, 0] / 5.0 + 0.06 * height * share], axis=1)
        points = Observations.of(np.column_stack([plan, height * share]), image + rng.normal(0.0, 0.3, image.shape))
        found = fit(points, find_model(name), source_names=("easting", "northing", "height"))
        words = record_of(PointFit(found, "map-to-image", None, np.zeros((0, 2))))["warnings"]
        assert any("have a small extent along height" in text for text in words) is remarked


def derivatives(found: TransformationFit, source: Array) -> Array:
    """Return the derivatives (2, u) of a transformed point by the coefficients, from differences."""
    t = found.transformation
    step = 1e-5
    ends = [
        [replace(t, coefficients=t.coefficients + sign * step * unit).apply(source)[0] for sign in (1.0, -1.0)]
        for unit in np.eye(len(t.coefficients))
    ]
    return np.stack([(high - low) / (2.0 * step) for high, low in ends], axis=1)


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "degree"), [("helmert", None), ("projective", None), ("polynomial", 2)])
def test_check_points_against_plain_matrices(name: str, degree: int | None) -> None:
    rng = np.random.default_rng(7)
    image, sigma = rng.uniform(0.0, 1000.0, (20, 2)), rng.uniform(1.0, 4.0, (20, 2))
    every = Observations.of(image, 28.5 * image + sigma * rng.normal(size=(20, 2)), sigma)
    control, check = every.take(np.arange(15)), every.take(np.arange(15, 20))
    found = fit(control, find_model(name, degree))
    residuals = found.transformation.apply(check.source) - check.target
    tests = check_tests(found, check, residuals)
    for k in range(5):
        rows = derivatives(found, check.source[k])
        covariance = found.m0**2 * (np.diag(check.sigma[k] ** 2) + rows @ found.cofactors @ rows.T)
        expected = float(residuals[k] @ np.linalg.inv(covariance) @ residuals[k]) / 2.0
        assert tests.statistic[k] == pytest.approx(expected, rel=1e-5)
        assert tests.critical[k] == pytest.approx(stats.f.isf(0.001, 2, found.redundancy))
        assert tests.probability[k] == pytest.approx(stats.f.sf(expected, 2, found.redundancy), rel=1e-4)


@pytest.mark.oracle
def test_false_alarms_of_check_points_are_as_stated_and_not_without_the_error_of_the_fit() -> None:
    """Check points are rejected at the level of 20 %, and more often without the error of the fit.

    200 runs, 8 control points, a check point outside of them; interval of 4 standard deviations.
    """
    rng, model, level, runs = np.random.default_rng(11), find_model("affine"), 0.2, 200
    image = np.vstack([rng.uniform(0.0, 1000.0, (8, 2)), [[1600.0, 1500.0]]])
    alarms = careless = 0
    for _ in range(runs):
        every = Observations.of(image, 28.5 * image + rng.normal(0.0, 15.0, image.shape))
        found, check = fit(every.take(np.arange(8)), model), every.take(np.array([8]))
        residual = found.transformation.apply(check.source) - check.target
        alarms += bool(check_tests(found, check, residual).probability[0] < level)
        careless += float(np.sum(residual**2)) / (2.0 * found.m0**2) > stats.f.isf(level, 2, found.redundancy)
    half = 4.0 * math.sqrt(level * (1.0 - level) / runs)
    assert abs(alarms / runs - level) <= half
    assert careless / runs > level + half


@pytest.mark.behaviour
def test_each_bad_check_point_is_named(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 40)
    plane[33] += (300.0, -200.0)
    plane[37] += (0.0, 250.0)
    path, out = write_points(tmp_path / "p.csv", image, plane, check=10), tmp_path / "fit"
    record = run("rectify", "fit", path, "--degree", "2", "--out", out, "--json").json
    named = [text for text in record["warnings"] if text.startswith("check point ")]
    assert [text.split(":")[0] for text in named] == ["check point P34", "check point P38"]
    assert any("times as large as the control points predict" in text for text in record["warnings"])
    rows = {row["id"]: row for row in record["points"]}
    assert [name for name, row in rows.items() if row["suspicious"]] == ["P34", "P38"]
    assert rows["P34"]["redundancy"] is None and rows["P34"]["F"] > rows["P34"]["F_limit"]
    assert (rows["P34"]["error_easting_m"], rows["P34"]["error_northing_m"]) == pytest.approx((300.0, -200.0), abs=60.0)
    assert (out / "report.html").read_text("utf-8").count('class="bad"') == 2


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("sigma", "code"),
    [(1e-300, "rectify.sigma_absurd"), ([[1e-12, 1.0]] + [[1.0, 1.0]] * 11, "rectify.sigma_absurd"),
     ([[1.0, 1.0]] * 11 + [[1e300, 1.0]], "rectify.sigma_absurd"), (np.inf, "rectify.points"),
     (-1.0, "rectify.points"), ([1.0, 2.0, 3.0], "rectify.points"), ("few", "argument.value")],
)  # fmt: skip
def test_absurd_sigmas_are_refused(sigma: object, code: str) -> None:
    points = strip(500.0, 0.0, n=12)
    with pytest.raises(InputError) as caught:
        Observations.of(points.source, points.target, sigma)  # type: ignore[arg-type]
    assert caught.value.problems[0].code == code


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("sigmas", "text"), [(("1e-4", "1e-4"), "not fit the transformation within their sigmas"),
                         (("1e6", "1e6"), "the sigmas are too large"), (("15", "15"), ""),
                         (("15", "1e6"), "negligible weight")],
)  # fmt: skip
def test_sigmas_that_the_residuals_contradict_are_remarked(
    sigmas: tuple[str, str], text: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    image, plane, _ = scene(rng, 12)
    path = write_points(tmp_path / "p.csv", image, plane, sigma="sigma_easting_m,sigma_northing_m")
    path.write_text(path.read_text("utf-8").replace(",10,20\n", f",{sigmas[0]},{sigmas[1]}\n"), "utf-8")
    done = run("rectify", "fit", path, "--json")
    words = done.json["warnings"]
    assert any(text in w for w in words) if text else not any("sigma" in w for w in words)
    assert done.code == (4 if "not fit" in text else 0)


@pytest.mark.behaviour
def test_points_far_from_their_zone_are_remarked(tmp_path: Path, rng: np.random.Generator) -> None:
    """Points two zones away from zone 35, or with exchanged coordinates, give a warning; the next zone does not."""
    from fg_orient.rectification.projections import project, unproject, utm

    image, plane, _ = scene(rng, 12)
    home = unproject(utm(35), plane)
    for east_deg, remarked in ((0.0, False), (3.0, False), (12.0, True), (-14.0, True)):
        far = project(utm(35), home[:, 0] + east_deg, home[:, 1])
        path = write_points(tmp_path / "p.csv", image, far)
        words = run("rectify", "fit", path, "--crs", "EPSG:32635", "--json").json["warnings"]
        found = [text for text in words if "far outside the area of EPSG:32635" in text]
        assert bool(found) is remarked
        assert not found or f"longitude {home[0, 0] + east_deg:.1f}" in found[0] or "such as" in found[0]
    swapped = write_points(tmp_path / "p.csv", image, plane[:, ::-1])
    words = run("rectify", "fit", swapped, "--crs", "EPSG:32635", "--direction", "map-to-image", "--json").json[
        "warnings"
    ]
    assert any("far outside the area" in text for text in words)


@pytest.mark.behaviour
@pytest.mark.parametrize("command", ["fit", "check"])
def test_points_without_ids_are_refused(command: str, tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "p.csv"
    if command == "fit":
        image, plane, _ = scene(rng, 8)
        write_points(path, image, plane)
    else:
        path.write_text("id,residual_easting_m,residual_northing_m\nP1,1,2\nP2,0,1\nP3,3,-1\n", "utf-8")
    text = path.read_text("utf-8")
    path.write_text(text.replace("\nP2,", "\n,").replace("\nP3,", "\n ,"), "utf-8")
    done = run("rectify", command, path)
    assert done.code == 2 and done.stderr.count("the point has no id") == 2
    assert "line 3, column id" in done.stderr and "line 4, column id" in done.stderr
    path.write_text(text.replace("\nP2,", "\nP1,"), "utf-8")
    done = run("rectify", command, path)
    assert done.code == 2 and "used twice" in done.stderr
