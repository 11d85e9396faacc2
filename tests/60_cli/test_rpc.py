"""The ``rpc`` commands give the figures of independent code; the tests check files, exit codes and bad input."""

from __future__ import annotations

import csv
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

import fg_orient as fg
from fg_orient.formats.rpc import read_rpc, write_rpc
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.rpc.compensate import LEVEL, compensate
from fg_orient.rpc.files import corrected
from fg_orient.rpc.fitting import fit_image
from fg_orient.rpc.options import FitOptions
from fg_orient.rpc.points import MeasuredPoints
from fg_orient.sensors.rpc import RpcModel, RpcValidity
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.published_rays import misses_m
from tests.support.rpc_block import rpc_twin
from tests.support.rpc_block import terms as monomials_of
from tests.support.rpc_model import ground_points, reference_project, synthetic_model

Run = Callable[..., Any]

#: Compensation in pixels: shift, drift with l, drift with s, each of line and sample.
TRUE = np.array([3.0, -16.0, 1.5, 0.5, -0.75, 2.0])
KINDS = {"shift": 2, "shift_drift": 4, "affine": 6}


@pytest.fixture
def model() -> RpcModel:
    return synthetic_model(err_bias_m=2.5, err_rand_m=0.125)


@pytest.fixture
def file(tmp_path: Path, model: RpcModel) -> Path:
    """Return a ``_RPC.TXT``."""
    write_rpc(tmp_path / "scene_RPC.TXT", model)
    return tmp_path / "scene_RPC.TXT"


def write_points(
    path: Path, image: np.ndarray, ground: np.ndarray, *, check: int = 0, sigma: np.ndarray | None = None
) -> Path:
    """Write points p0 ...; the last ``check`` are check points."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        extra = ["role"] if check else []
        extra += ["sigma_line_px", "sigma_sample_px"] if sigma is not None else []
        writer.writerow(["id", "line", "sample", "lon_deg", "lat_deg", "height_m", *extra])
        for k, (pixel, point) in enumerate(zip(image, ground, strict=True)):
            row = [f"p{k}", *map(float, pixel), *map(float, point)]
            row += ["check" if k >= len(image) - check else "control"] if check else []
            writer.writerow([*row, *(sigma[k] if sigma is not None else [])])
    return path


def normalised(model: RpcModel, ground: np.ndarray) -> np.ndarray:
    """Return l and s (n, 2) of the model without its own code."""
    pixel = np.stack(reference_project(model, *ground.T), axis=1).astype(float)
    return (pixel - model.offsets[:2]) / model.scales[:2]


def measured(
    model: RpcModel, n: int = 40, *, values: np.ndarray = TRUE, noise: float = 0.0, seed: int = 5
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of a compensated model, and ground points."""
    ground = np.stack(ground_points(model, n, seed), axis=1)
    ls = normalised(model, ground)
    shift = values[:2] + ls[:, :1] * values[2:4] + ls[:, 1:] * values[4:6]
    image = model.offsets[:2] + model.scales[:2] * ls + shift
    return image + np.random.default_rng(seed).normal(scale=noise, size=image.shape), ground


# --- check ---------------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_check_describes_a_good_file(run: Run, file: Path, model: RpcModel) -> None:
    ended = run("rpc", "check", file, "--json")
    assert ended.code == 0, ended.stderr
    record = ended.json
    assert set(record) >= {
        "status", "warnings", "file", "format", "first_pixel", "n_lines", "n_samples", "offsets", "scales", "validity",
        "validity_stated", "err_bias_m", "err_rand_m", "image_to_ground", "common_denominator", "notes", "heights_m",
        "denominators", "extrapolation", "points", "against",
    }  # fmt: skip
    assert (record["status"], record["format"], record["first_pixel"]) == ("good", "_RPC.TXT", 0.0)
    assert (record["err_bias_m"], record["image_to_ground"], record["points"]) == (2.5, None, None)
    assert record["validity"]["height_m"] == [0.0, 1000.0]
    assert 0.9 < record["denominators"]["least_line"] < 1.0
    shown = run("rpc", "check", file)
    assert shown.code == 0
    assert "its first pixel is (0, 0)" in shown.stdout
    assert shown.stdout.rstrip().endswith("good")


@pytest.mark.truth
def test_least_denominators_are_those_of_the_corners_of_a_linear_one(run: Run, tmp_path: Path) -> None:
    """``rpc check`` states the least denominators and warns of heights beyond the range of the model.

    f2 = 1 + 0.3 z is least at the lowest height; f4 = 1.
    """
    c = synthetic_model().coefficients.copy()
    c[[1, 3], 1:] = 0.0
    c[1, 3] = 0.3
    write_rpc(tmp_path / "a.RPB", synthetic_model(coefficients=c))
    record = run("rpc", "check", tmp_path / "a.RPB", "--heights", 300, 900, "--json").json
    assert record["denominators"]["least_line"] == pytest.approx(1.0 + 0.3 * (300.0 - 500.0) / 500.0, rel=1e-12)
    assert record["denominators"]["least_sample"] == 1.0
    assert record["extrapolation"]["height"] == pytest.approx(0.8, rel=1e-12)
    beyond = run("rpc", "check", tmp_path / "a.RPB", "--heights", 0, 1200, "--json").json
    assert beyond["extrapolation"]["height"] == pytest.approx(1.4, rel=1e-12)
    assert any("height is extrapolated: 1.40" in text for text in beyond["warnings"])
    assert any("outside the validity range 0 .. 1000 m" in text for text in beyond["warnings"])


@pytest.mark.behaviour
def test_a_pole_in_the_image_is_not_trustworthy(run: Run, tmp_path: Path) -> None:
    c = synthetic_model().coefficients.copy()
    c[1, 1] = 1.4
    write_rpc(tmp_path / "a_RPC.TXT", synthetic_model(coefficients=c))
    ended = run("rpc", "check", tmp_path / "a_RPC.TXT", "--json")
    assert (ended.code, ended.json["status"]) == (4, "not_trustworthy")
    assert ended.json["denominators"]["pole"].startswith("line denominator")
    assert "not positive everywhere inside the image" in ended.json["warnings"][0]
    points = write_points(tmp_path / "p.csv", *measured(synthetic_model()))
    refused = run("rpc", "refine", tmp_path / "a_RPC.TXT", "--points", points, "--json")
    assert (refused.code, refused.json["errors"][0]["code"]) == (2, "rpc.pole")


def near_zero() -> RpcModel:
    """Return a model with f2 = 1 + 0.95 z, positive and 0.05 at the lowest height; the rest is affine."""
    c = np.zeros((4, 20))
    c[0, :4], c[2, :4], c[[1, 3], 0], c[1, 3] = [0.0, 0.05, -1.0, 0.02], [0.0, 1.0, 0.05, -0.03], 1.0, 0.95
    return synthetic_model(coefficients=c)


@pytest.mark.behaviour
def test_a_denominator_near_zero_is_not_trustworthy(run: Run, tmp_path: Path) -> None:
    model = near_zero()
    write_rpc(tmp_path / "a.RPB", model)
    ended = run("rpc", "check", tmp_path / "a.RPB", "--json")
    assert (ended.code, ended.json["denominators"]["pole"]) == (4, None)
    assert ended.json["warnings"][0] == "a denominator comes near zero inside the image: 0.05"
    ground = np.stack(ground_points(model, 60), axis=1)
    ground[0, 2] = 0.0
    image = np.stack(reference_project(model, *ground.T), axis=1).astype(float)
    points = write_points(tmp_path / "p.csv", image, ground)
    fitted = run("rpc", "fit", points, "--degree", 1, "--select", "none", "--json")
    assert fitted.code == 4
    assert any("comes near zero among the points" in text for text in fitted.json["warnings"])


@pytest.mark.oracle
def test_check_points_are_projected_minus_observed(run: Run, file: Path, tmp_path: Path, model: RpcModel) -> None:
    image, ground = measured(model, values=np.array([3.0, -16.0, 0.0, 0.0, 0.0, 0.0]))
    ground[4, 2] += 5000.0
    image[4] = np.array(reference_project(model, *ground[4:5].T), float).ravel() + TRUE[:2]
    record = run("rpc", "check", file, "--points", write_points(tmp_path / "p.csv", image, ground), "--json").json
    found = record["points"]["statistics"]
    assert found["n"] == 40
    for kind, line, sample in (("mean", -3.0, 16.0), ("rms", 3.0, 16.0), ("max", 3.0, 16.0)):
        # pixels near 1e4 carry 2e-12 of rounding, and the reference is exact
        assert abs(found[f"{kind}_line_px"] - line) <= 1e-9
        assert abs(found[f"{kind}_sample_px"] - sample) <= 1e-9
    assert (record["points"]["outside"], record["status"]) == (["p4"], "not_trustworthy")
    assert [r["id"] for r in record["points"]["residuals"] if not r["inside"]] == ["p4"]


@pytest.mark.truth
def test_check_against_another_file_gives_our_pixels_minus_its(run: Run, file: Path, tmp_path: Path) -> None:
    other = synthetic_model(offsets=[10002.0, 11995.0, 31.8, 41.4, 500.0])
    write_rpc(tmp_path / "other.RPB", other)
    found = run("rpc", "check", file, "--against", tmp_path / "other.RPB", "--json").json["against"]
    # ECEF metres carry 1e-9 m of rounding, a pixel is 0.5 m
    assert abs(found["statistics"]["mean_line_px"] + 2.0) <= 1e-8
    assert abs(found["statistics"]["max_sample_px"] - 5.0) <= 1e-8
    far = synthetic_model(offsets=[90000.0, 12000.0, 31.8, 41.4, 500.0])
    write_rpc(tmp_path / "far.RPB", far)
    ended = run("rpc", "check", file, "--against", tmp_path / "far.RPB", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "rpc.no_overlap")


@pytest.mark.behaviour
def test_check_takes_the_heights_of_a_dem(run: Run, file: Path, tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import Affine

    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=4, height=4, count=1, dtype="float32", crs="EPSG:4979",
        transform=Affine(0.05, 0.0, 31.7, 0.0, -0.05, 41.5),
    ) as dem:  # fmt: skip
        dem.write(np.linspace(120.0, 870.0, 16, dtype="float32").reshape(4, 4), 1)
    assert run("rpc", "check", file, "--dem", tmp_path / "dem.tif", "--json").json["heights_m"] == [120.0, 870.0]
    assert run("rpc", "check", file, "--dem", tmp_path / "dem.tif", "--heights", 0, 1).code == 2


# --- convert -------------------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("to", "name", "first", "form"),
    [("rpc-txt", "b.dat", 0.0, "_RPC.TXT"), ("rpb", "b.dat", 0.0, "RPB"), ("dimap", "b.dat", 1.0, "DIMAP 2.15 PHR"),
     (None, "b.RPB", 0.0, "RPB"), (None, "b.xml", 1.0, "DIMAP")],
)  # fmt: skip
def test_convert(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, to: str | None, name: str, first: float, form: str
) -> None:
    words = ("rpc", "convert", file, "--out", tmp_path / name, *(("--to", to) if to else ()), "--json")
    ended = run(*words)
    assert ended.code == 0, ended.stderr
    out = ended.json["out"]
    assert (out["first_pixel"], out["format"].startswith(form)) == (first, True)
    # the text has all digits; only adding 1 for the first pixel rounds the offset
    assert max(out["round_trip_line_px"], out["round_trip_sample_px"]) <= 4e-12
    assert ("error estimates" in out["not_kept"]) == form.startswith("DIMAP")
    assert np.array_equal(read_rpc(tmp_path / name).coefficients, model.coefficients)
    again = run(*words)
    assert (again.code, again.json["errors"][0]["code"]) == (2, "output.exists")
    assert run(*words, "--overwrite").code == 0


@pytest.mark.behaviour
def test_convert_to_tags_of_an_image(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    import rasterio

    path = tmp_path / "image.tif"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", width=3, height=2, count=1, dtype="uint8") as image:
            image.write(np.arange(6, dtype="uint8").reshape(2, 3), 1)
    words = ("rpc", "convert", file, "--out", path, "--to", "geotiff-tags")
    assert run(*words).code == 2
    with pytest.raises(InputError, match="contains no RPC"):
        read_rpc(path)
    out = run(*words, "--overwrite", "--json").json["out"]
    # GDAL hands tags over with 15 digits: 1e-15 x 1e4 px, times a few terms
    assert max(out["round_trip_line_px"], out["round_trip_sample_px"]) <= 1e-9
    assert np.allclose(read_rpc(path).coefficients, model.coefficients, rtol=1e-13, atol=0.0)
    hidden = run("rpc", "convert", file, "--out", path.rename(tmp_path / "scene.tif"), "--overwrite", "--json")
    assert (hidden.code, hidden.json["errors"][0]["code"]) == (2, "rpc.sidecar")
    gone = run("rpc", "convert", file, "--out", tmp_path / "none.tif", "--json")
    assert (gone.code, gone.json["errors"][0]["code"]) == (2, "rpc.tags_target")


@pytest.mark.behaviour
def test_convert_says_what_is_not_kept(run: Run, tmp_path: Path) -> None:
    direct = synthetic_model(seed=4).coefficients[[2, 3, 0, 1]]
    ranges = RpcValidity((0.0, 900.0), (0.0, 800.0), (31.75, 31.85), (41.37, 41.43), (0.0, 1000.0))
    write_rpc(tmp_path / "a.xml", synthetic_model(direct=direct, stated_validity=ranges))
    out = run("rpc", "convert", tmp_path / "a.xml", "--out", tmp_path / "b.RPB", "--json").json["out"]
    assert out["not_kept"] == ["coefficients from image to ground", "validity range"]
    out = run("rpc", "convert", tmp_path / "a.xml", "--out", tmp_path / "b.xml", "--json").json["out"]
    assert out["not_kept"] == []


@pytest.mark.behaviour
def test_convert_of_a_list_needs_the_first_pixel(run: Run, model: RpcModel, tmp_path: Path) -> None:
    order = [0, 1, 3, 2, 4]
    numbers = [*(model.offsets + np.array([1, 1, 0, 0, 0]))[order], *model.scales[order], *model.coefficients.ravel()]
    (tmp_path / "list.txt").write_text("\n".join(repr(float(v)) for v in numbers) + "\n")
    words = ("rpc", "convert", tmp_path / "list.txt", "--out", tmp_path / "b.RPB", "--json")
    assert run(*words).json["errors"][0]["code"] == "rpc.origin"
    record = run(*words, "--first-pixel", 1).json
    assert (record["source"]["first_pixel"], record["out"]["first_pixel"]) == (1.0, 0.0)
    assert np.array_equal(read_rpc(tmp_path / "b.RPB").offsets, model.offsets)


# --- refine --------------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("weighted", [False, True])
def test_refine_equals_weighted_least_squares(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, kind: str, weighted: bool
) -> None:
    """``rpc refine`` has values, covariance, residuals and errors of excluded points of the test's normal equations."""
    k = KINDS[kind] // 2
    values = np.where(np.arange(6) < 2 * k, TRUE, 0.0)
    image, ground = measured(model, values=values, noise=0.3)
    sigma = np.random.default_rng(8).uniform(0.2, 0.6, image.shape) if weighted else None
    points = write_points(tmp_path / "p.csv", image, ground, check=15, sigma=sigma)
    record = run("rpc", "refine", file, "--points", points, "--compensation", kind, "--json").json
    ls = normalised(model, ground)
    a = np.column_stack([np.ones(40), ls])[:, :k]
    l = image - (model.offsets[:2] + model.scales[:2] * ls)  # noqa: E741
    weight = np.ones_like(image) if sigma is None else 1.0 / sigma**2
    n, x, q = 25, np.zeros((k, 2)), []
    for axis in (0, 1):
        normal = a[:n].T @ (weight[:n, axis, None] * a[:n])
        q.append(np.linalg.inv(normal))
        x[:, axis] = q[axis] @ (a[:n].T @ (weight[:n, axis] * l[:n, axis]))
    v = l - a @ x
    variance = np.sum(weight[:n] * v[:n] ** 2) / (2 * n - 2 * k)
    assert (record["status"], record["outliers"], record["redundancy"]) == ("good", [], 2 * n - 2 * k)
    # pixels near 1e4 carry 2e-12 of rounding
    assert np.abs(np.array(record["values_px"])[: 2 * k] - x.ravel()).max() <= 1e-9
    assert record["sigma0"] == pytest.approx(np.sqrt(variance), rel=1e-9)
    expected = np.zeros((2 * k, 2 * k))
    for axis in (0, 1):
        expected[axis::2, axis::2] = q[axis] * variance
    assert np.abs(np.array(record["covariance_px2"]) - expected).max() <= 1e-9 * expected.max()
    after = record["check"]["after"]
    assert (after["n"], record["control"]["after"]["n"]) == (15, 25)
    assert after["rms_line_px"] == pytest.approx(np.sqrt(np.mean(v[n:, 0] ** 2)), rel=1e-8)
    left_out = []
    for i in range(n):  # by adjustments without the point
        rest = np.arange(n) != i
        root = np.sqrt(weight[:n][rest, 1])
        other = np.linalg.lstsq(a[:n][rest] * root[:, None], l[:n][rest, 1] * root, rcond=None)[0]
        left_out.append(l[i, 1] - a[i] @ other)
    assert record["leave_one_out"]["rms_sample_px"] == pytest.approx(np.sqrt(np.mean(np.square(left_out))), rel=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_corrected_file_projects_as_the_compensated_model(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, kind: str
) -> None:
    values = np.where(np.arange(6) < KINDS[kind], TRUE, 0.0)
    image, ground = measured(model, values=values)
    points = write_points(tmp_path / "p.csv", image, ground)
    out = tmp_path / "new.RPB"
    words = ("rpc", "refine", file, "--points", points, "--compensation", kind, "--out", out, "--json")
    record = run(*words).json
    found = np.stack(read_rpc(out).project(*ground.T), axis=1)
    errors = record["out"]["errors"]
    assert record["out"]["exact"] == (kind == "shift")
    # other points than those of the statement: twice its maximum; rounding where it is exact
    largest = max(2.0 * max(errors["max_line_px"], errors["max_sample_px"]), 1e-9)
    assert largest < (2e-9 if kind == "shift" else 0.01)
    assert np.abs(found - image).max() <= largest
    assert run(*words).json["errors"][0]["code"] == "output.exists"
    assert "the written model is" in run(*words[:-1], "--overwrite").stdout


@pytest.mark.oracle
def test_the_fitted_product_is_nearly_the_best_one() -> None:
    """The corrected RPC has at most twice the error of the best numerator at random points.

    Chebyshev nodes keep the largest error low, not the RMS, which may be twice the best; f3 itself would be far worse.
    """
    model = synthetic_model()
    new = corrected(model, TRUE).model
    ground = np.stack(ground_points(model, 2000), axis=1)
    error = np.stack(new.project(*ground.T), axis=1) - np.stack(model.project(*ground.T, TRUE), axis=1)
    monomials = monomials_of(*((ground - model.offsets[2:]) / model.scales[2:]).T)
    f = monomials @ model.coefficients.T
    for axis, value, own, other in ((0, TRUE[4], 0, 2), (1, TRUE[3], 2, 0)):
        design, wanted = monomials / f[:, own + 1, None], f[:, other] / f[:, other + 1]
        left = value * (wanted - design @ np.linalg.lstsq(design, wanted, rcond=None)[0])
        assert np.linalg.norm(error[:, axis]) <= 2.0 * np.linalg.norm(left)
        plain = value * (wanted - f[:, other] / f[:, own + 1])
        assert np.linalg.norm(plain) >= 5.0 * np.linalg.norm(left)


@pytest.mark.oracle
def test_affine_compensation_is_exact_with_a_common_denominator() -> None:
    c = synthetic_model().coefficients.copy()
    c[3] = c[1]
    model = synthetic_model(coefficients=c)
    found = corrected(model, TRUE)
    ground = ground_points(model)
    plain = np.array(reference_project(model, *ground), float)
    l, s = (plain - model.offsets[:2, None]) / model.scales[:2, None]  # noqa: E741
    moved = [plain[k] + TRUE[k] + TRUE[2 + k] * l + TRUE[4 + k] * s for k in (0, 1)]
    assert found.exact
    assert np.abs(np.array(reference_project(found.model, *ground), float) - moved).max() <= 1e-10


@pytest.mark.consistency
def test_corrected_coefficients_to_the_ground_follow_the_pixels() -> None:
    """The corrected model to the ground gives for moved pixels the points of the old pixels within 1e-12 degrees.

    Substitution of an affine map into cubics is exact.
    """
    direct = synthetic_model(seed=4).coefficients[[2, 3, 0, 1]]
    model = synthetic_model(direct=direct)
    new = corrected(model, TRUE).model
    rng = np.random.default_rng(1)
    l, s = rng.uniform(-0.9, 0.9, (2, 50))  # noqa: E741
    h = rng.uniform(0.0, 1000.0, 50)
    old_pixel = model.offsets[0] + model.scales[0] * l, model.offsets[1] + model.scales[1] * s
    moved = [p + TRUE[k] + TRUE[2 + k] * l + TRUE[4 + k] * s for k, p in enumerate(old_pixel)]
    d = np.stack(new.locate_directly(*moved, h)) - np.stack(model.locate_directly(*old_pixel, h))
    # degrees: 1e-12 are 1e-7 m
    assert np.abs(d).max() <= 1e-12
    assert new.direct is not None
    assert new.direct[[1, 3], 0].tolist() == [1.0, 1.0]


@pytest.mark.oracle
def test_gross_errors_are_named_and_left_out(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    image, ground = measured(model, 60, values=TRUE * [1, 1, 0, 0, 0, 0], noise=0.3)
    image[7] += [9.0, 0.0]
    image[21] += [0.0, -4.0]
    image[55] += [-6.0, 6.0]
    points = write_points(tmp_path / "p.csv", image, ground, check=10)
    record = run("rpc", "refine", file, "--points", points, "--json").json
    assert [found["id"] for found in record["outliers"]] == ["p7", "p21"]
    assert record["outliers"][0]["error_line_px"] == pytest.approx(9.0, abs=4 * 0.3)
    assert record["outliers"][1]["error_sample_px"] == pytest.approx(-4.0, abs=4 * 0.3)
    assert record["check_suspicious"] == ["p55"]
    assert [r["id"] for r in record["residuals"] if r["role"] == "control" and not r["used"]] == ["p7", "p21"]
    assert np.abs(np.array(record["values_px"][:2]) - TRUE[:2]).max() <= 4 * 0.3 / np.sqrt(48)
    assert any("point p7: gross error" in text for text in record["warnings"])


@pytest.mark.consistency
@pytest.mark.parametrize("kind", KINDS)
def test_compensation_equals_the_bundle_of_one_image(kind: str) -> None:
    """``compensate`` has terms and covariance of the bundle of one image with fixed points and wide priors."""
    twin = rpc_twin(kind)
    block, o, known = twin.block, twin.block.observations, twin.block.points.known
    control = np.zeros(len(block.points.ids), bool)
    control[block.points.where(Role.CONTROL)] = True
    rows = (o.image == 0) & control[o.point]
    fixed = replace(known, fixed=control)
    options = replace(block.options, rpc_compensation=kind, rpc_shift_sigma_px=1e5, rpc_linear_sigma_px=1e5)
    solution = fg.adjust(replace(
        block, images=block.images[:1], observations=o.take(rows), points=replace(block.points, known=fixed),
        options=options, withheld=replace(block.withheld, ids=()),
    ))  # fmt: skip
    sensor = block.images[0].sensor
    assert isinstance(sensor, RpcSensor)
    at, sigma = o.point[rows], np.column_stack([o.sigma_line_px, o.sigma_sample_px])[rows]
    image, ground = np.column_stack([o.line, o.sample])[rows], np.column_stack(ecef_to_geodetic(known.ecef_m[at]))
    ids = tuple(map(str, at))
    points = MeasuredPoints(ids, np.zeros(len(ids), bool), image, ground, sigma)
    found = compensate(sensor.model, points, kind, level=1e-12)
    assert found.outliers == ()
    # the priors pull by (0.3/1e5)^2 of a value
    assert np.abs(found.values - solution.correction(block.images[0].id)).max() <= 1e-7
    ours = found.covariance[np.ix_(found.codes, found.codes)]
    theirs = solution.covariance(f"image:{block.images[0].id}").values
    scale = solution.sigma0**2 / found.sigma0**2  # the priors count as observations there
    assert np.abs(theirs - scale * ours).max() <= 1e-6 * np.abs(ours).max()


@pytest.mark.oracle
@pytest.mark.slow
def test_false_alarms_are_as_rare_as_promised() -> None:
    """Among 1500 good sets of 12 points the share with a suspect is 12 times the level, within 4 sigmas."""
    model, level, runs, n = synthetic_model(), 0.005, 1500, 12
    image, ground = measured(model, n, values=np.zeros(6))
    rng, alarms = np.random.default_rng(3), 0
    ids, check, sigma = tuple(map(str, range(n))), np.zeros(n, bool), np.ones((n, 2))
    for _ in range(runs):
        points = MeasuredPoints(ids, check, image + rng.normal(size=(n, 2)), ground, sigma)
        found = compensate(model, points, level=level)
        alarms += bool(found.outliers)
    expected = n * level
    assert abs(alarms / runs - expected) <= 4.0 * np.sqrt(expected * (1.0 - expected) / runs)
    assert LEVEL == 0.001


@pytest.mark.behaviour
def test_one_point_has_no_redundancy_and_says_so(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    image, ground = measured(model, 5)
    record = run("rpc", "refine", file, "--points", write_points(tmp_path / "p.csv", image, ground, check=4), "--json")
    assert record.code == 0
    assert (record.json["sigma0"], record.json["terms"][0]["sd_px"]) == (None, None)
    assert "no redundancy" in record.json["warnings"][0]


@pytest.mark.oracle
def test_points_of_another_image_are_not_trustworthy(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    """A misfit that grows by 30 px per 1000 m of height is not trustworthy and is stated, with the likely cause."""
    image, ground = measured(model, values=np.zeros(6), noise=0.3)
    image[:, 0] += 0.03 * ground[:, 2]
    ended = run("rpc", "refine", file, "--points", write_points(tmp_path / "p.csv", image, ground), "--json")
    assert (ended.code, ended.json["status"]) == (4, "not_trustworthy")
    assert ended.json["height_dependence"]["line_px_per_km"] == pytest.approx(30.0, abs=1.0)
    assert any("check that the RPC belongs to this image" in text for text in ended.json["warnings"])


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("kind", "n", "status", "code"),
    [("affine", 2, 2, "rpc.few_control"), ("shift_drift", 1, 2, "rpc.few_control"),
     ("cubic", 9, 2, "rpc.compensation_kind"), ("affine", -5, 3, "rpc.control_spread")],
)  # fmt: skip
def test_too_few_or_badly_spread_points(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, kind: str, n: int, status: int, code: str
) -> None:
    image, ground = measured(model, abs(n))
    if n < 0:
        ground[:] = ground[0]  # five times the same place
    points = write_points(tmp_path / "p.csv", image, ground)
    ended = run("rpc", "refine", file, "--points", points, "--compensation", kind, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (status, code)


@pytest.mark.behaviour
def test_check_points_only_are_no_control(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    points = write_points(tmp_path / "p.csv", *measured(model, 5), check=5)
    for words, code in ((("refine", file, "--points", points), "rpc.few_control"), (("fit", points), "rfm.points")):
        ended = run("rpc", *words, "--json")
        assert (ended.code, ended.json["errors"][0]["code"]) == (2, code)


@pytest.mark.behaviour
def test_points_outside_the_validity_range_are_refused(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    image, ground = measured(model)
    ground[3, 2] = 1500.0
    words = ("rpc", "refine", file, "--points", write_points(tmp_path / "p.csv", image, ground), "--json")
    ended = run(*words)
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "rpc.outside")
    assert ended.json["errors"][0]["place"] == "point p3"
    assert "rpc.outside" not in run(*words, "--extrapolate").stdout


HEAD = "id,line,sample,lon_deg,lat_deg,height_m"


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("table", "codes"),
    [(f"{HEAD}\na,1,2,31.8,41.4", ["table.cell_count"]), (f"{HEAD}\na,1,x,31.8,41.4,0", ["table.not_a_number"]),
     (f"{HEAD}\na,1,2,131.8,141.4,0", ["points.latitude"]), (f"{HEAD}\na,1,2,41.4,131.8,0", ["points.swapped_range"]),
     (f"{HEAD}\na,1,2,231.8,41.4,0", ["points.longitude"]),
     (f"{HEAD}\na,1,2,31.8,41.4,0\na,1,2,31.8,41.4,0", ["points.id_twice"]),
     (f"{HEAD},role,sigma_line_px,sigma_sample_px\na,1,2,31.8,41.4,0,tie,1,1\nb,1,2,31.8,41.4,0,check,0,1",
      ["rectify.role", "rectify.positive"])],
)  # fmt: skip
def test_bad_points(run: Run, file: Path, tmp_path: Path, table: str, codes: list[str]) -> None:
    (tmp_path / "p.csv").write_text(f"{table}\n")
    ended = run("rpc", "refine", file, "--points", tmp_path / "p.csv", "--json")
    assert ended.code == 2
    found = [error["code"] for error in ended.json["errors"]]
    assert set(codes) <= set(found) and (len(codes) == 1 or found == codes)


# --- fit -----------------------------------------------------------------------------------------


@pytest.mark.oracle
def test_fit_to_points_recovers_the_model(run: Run, model: RpcModel, tmp_path: Path) -> None:
    """``rpc fit`` to exact points has errors at check points below 1.5 px, and its record states them."""
    image, ground = measured(model, 90, values=np.zeros(6))
    points, out = write_points(tmp_path / "p.csv", image, ground, check=20), tmp_path / "fit.RPB"
    ended = run("rpc", "fit", points, "--degree", 2, "--kappa", 1e-10, "--out", out, "--json")
    assert ended.code == 0, ended.json["warnings"]
    record = ended.json
    assert set(record) >= {
        "status", "warnings", "source", "degree", "denominators", "equations", "method", "choice", "kappa", "unknowns",
        "rank", "condition", "redundancy", "m0_linear_px", "m0_px", "control", "check", "cross_validation", "out",
    }  # fmt: skip
    assert (record["control"]["n"], record["check"]["n"], record["cross_validation"]["folds"]) == (70, 20, 10)
    d = image[70:] - np.stack(read_rpc(out).project(*ground[70:].T), axis=1)
    rms = np.sqrt(np.mean(d**2, axis=0))
    assert [record["check"]["rms_line_px"], record["check"]["rms_sample_px"]] == pytest.approx(rms, rel=1e-6)
    assert rms.max() < 1.5  # cubic terms of 1e-4 x 1e4 px are missing


@pytest.mark.behaviour
def test_fit_says_that_m0_of_the_linear_form_is_not_the_accuracy(run: Run, model: RpcModel, tmp_path: Path) -> None:
    """Too many coefficients give exit code 4 and true residuals above m0 of the linear form; a selection does not."""
    image, ground = measured(model, 45, values=np.zeros(6), noise=0.5)
    points = write_points(tmp_path / "p.csv", image, ground)
    ended = run("rpc", "fit", points, "--equations", "linear", "--solver", "svd_scaled", "--json")
    assert (ended.code, ended.json["unknowns"]) == (4, 78)
    assert ended.json["m0_px"] > 2.0 * ended.json["m0_linear_px"]
    (said,) = (f for f in ended.json["findings"] if f["code"] == "rpc.linear_m0")
    assert said["data"] == {"linear_px": ended.json["m0_linear_px"], "true_px": ended.json["m0_px"]}
    assert "is not the accuracy of the image" in said["message"]
    good = run("rpc", "fit", points, "--degree", 2, "--json", "--log", tmp_path / "fit.log")
    assert good.code == 0 and "rpc.linear_m0" not in {f["code"] for f in good.json["findings"]}
    told = [json.loads(line) for line in (tmp_path / "fit.log").read_text("utf-8").splitlines()]
    folds = good.json["cross_validation"]["folds"]
    assert {(e["total"], e["text"]) for e in told if e["event"] == "progress"} == {(folds, "cross-validation")}
    assert good.json["choice"].keys() == {"kappa"}
    assert sum(good.json["cross_validation"]["choices"].values()) == 10


@pytest.mark.behaviour
def test_more_coefficients_than_the_points_carry(run: Run, model: RpcModel, tmp_path: Path) -> None:
    """More coefficients than the points determine give exit code 4 and one warning.

    Polynomials have no pole; therefore only excluded points show the error.
    """
    points = write_points(tmp_path / "p.csv", *measured(model, 12, values=np.zeros(6), noise=0.5))
    words = ("--degree", 2, "--denominators", "one", "--select", "none")
    ended = run("rpc", "fit", points, *words, "--json")
    assert ended.code == 4
    assert len(ended.json["warnings"]) == 1
    assert "the points do not determine so many coefficients" in ended.json["warnings"][0]


@pytest.mark.behaviour
def test_what_is_not_trustworthy_is_written_with_force_only(run: Run, model: RpcModel, tmp_path: Path) -> None:
    points = write_points(tmp_path / "p.csv", *measured(model, 12, values=np.zeros(6), noise=0.5))
    out = tmp_path / "fit.RPB"
    words = ("rpc", "fit", points, "--degree", 2, "--denominators", "one", "--select", "none", "--out", out)
    ended = run(*words, "--json")
    assert (ended.code, ended.json["out"]) == (4, None) and not out.exists()
    assert "not trustworthy and is not written" in ended.stderr and "--force" in ended.stderr
    forced = run(*words, "--force", "--json")
    assert forced.code == 4 and forced.json["out"]["file"] and out.exists()


@pytest.mark.behaviour
def test_random_searches_take_seed_and_budget(run: Run, model: RpcModel, tmp_path: Path) -> None:
    points = write_points(tmp_path / "p.csv", *measured(model, 45, values=np.zeros(6), noise=0.5))
    words = ("rpc", "fit", points, "--degree", 2, "--folds", 2, "--evaluations", 200)
    found = [run(*words, "--select", name, "--seed", 3, "--json") for name in ("genetic", "genetic", "particle_swarm")]
    assert [one.code for one in found] == [0, 0, 0], found[0].json["warnings"]
    assert found[0].json["choice"] == found[1].json["choice"] and found[0].json["choice"]["terms"]
    assert (found[0].json["method"], found[2].json["method"]) == ("genetic search", "particle swarm")
    assert run(*words, "--evaluations", 0).code == 2


@pytest.mark.behaviour
def test_fewer_points_than_coefficients(run: Run, model: RpcModel, tmp_path: Path) -> None:
    points = write_points(tmp_path / "p.csv", *measured(model, 38))
    for words in (("--select", "none"), ()):
        ended = run("rpc", "fit", points, *words, "--json")
        assert (ended.code, ended.json["errors"][0]["code"]) == (2, "rfm.few_points")
    held = run("rpc", "fit", points, "--kappa", 1e-3, "--json")
    assert held.json["unknowns"] == 78


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "code"),
    [(("fit", "--equations", "cubic"), "options.value"), (("fit", "--select", "best"), "rfm.selector"),
     (("fit", "--select", "lasso", "--kappa", "1"), "options.two_ways"), (("fit", "--solver", "qr"), "rpc.solver_form"),
     (("fit", "--degree", "4"), "options.value"), (("fit", "--denominators", "two"), "options.value"),
     (("fit", "--heights", "0", "1"), "rpc.foreign_option"), (("fit", "--folds", "1"), "options.value"),
     (("fit", "--folds", "70"), "rfm.folds"),
     (("fit", "--no-normalise", "--out", "a.RPB"), "rpc.unscaled"), (("fit", "--kappa", "-1"), "options.value"),
     (("fit", "--penalty", "none", "--kappa", "1"), "options.value"),
     (("convert", "--out", "b.txt", "--to", "nitf"), "rpc.target_name"), (("convert", "--out", "b.img"), "rpc.target")],
)  # fmt: skip
def test_options_that_do_not_fit(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, words: tuple[str, ...], code: str
) -> None:
    source = file if words[0] == "convert" else write_points(tmp_path / "p.csv", *measured(model, 60))
    ended = run("rpc", words[0], source, *words[1:], "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, code)


@pytest.mark.oracle
def test_fit_to_a_sensor(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    """``rpc fit`` to an RPC file finds it again in both directions, and refuses options and heights that do not fit."""
    out = tmp_path / "fit.XML"
    words = ("rpc", "fit", file, "--heights", 0, 1000, "--grid", 8, 8, 5, "--out", out, "--json")
    ended = run(*words)
    assert ended.code == 0, ended.stderr
    record, written = ended.json, read_rpc(out)
    assert record["check"]["max_line_px"] < 1e-3
    assert record["image_to_ground"]["max_east_m"] < 1e-2
    ground = np.stack(ground_points(model, 100), axis=1)
    pixel = np.array(reference_project(model, *ground.T), float)
    inside = np.all((pixel > 0.0) & (pixel < 2.0 * model.scales[:2, None]), axis=0)
    d = (np.stack(written.project(*ground.T)) - pixel)[:, inside]
    assert inside.sum() > 50
    assert np.abs(d).max() <= 2.0 * max(record["check"]["max_line_px"], record["check"]["max_sample_px"])
    assert written.direct is not None
    assert record["out"]["first_pixel"] == 1.0
    for extra, code in ((("--kappa", 1.0), "rpc.foreign_option"), (("--no-normalise",), "rpc.foreign_option")):
        assert run(*words, "--overwrite", *extra).json["errors"][0]["code"] == code
    assert run("rpc", "fit", file, "--json").json["errors"][0]["code"] == "rpc.no_heights"
    for pair in ((5, 5), (3000, 0)):
        (error,) = run("rpc", "fit", file, "--heights", *pair, "--json").json["errors"]
        assert (error["code"], error["place"]) == ("rfm.heights", "heights")


@pytest.mark.behaviour
def test_independent_points_of_a_sensor_depend_on_the_seed_only(model: RpcModel) -> None:
    sensor = RpcSensor(model)
    records = [fit_image(sensor, (0.0, 1000.0), FitOptions(degree=2, seed=seed), (6, 6, 5))[1] for seed in (1, 1, 2)]
    assert records[0] == records[1]
    assert records[0]["check"] != records[2]["check"]


@pytest.mark.behaviour
def test_tables_for_people(run: Run, file: Path, model: RpcModel, tmp_path: Path) -> None:
    points = write_points(tmp_path / "p.csv", *measured(model, 60, noise=0.2), check=20)
    shown = run("rpc", "refine", file, "--points", points, "--compensation", "affine").stdout
    for text in ("line_s1", "check after (20)", "left out as gross errors: none", "sigma0"):
        assert text in shown
    shown = run("rpc", "fit", points, "--degree", 1).stdout
    for text in ("m0 of the linear form", "left out, 10 folds", "control (40)"):
        assert text in shown
    shown = run("rpc", "fit", file, "--heights", 0, 900, "--grid", 6, 6, 5, "--degree", 2).stdout
    assert "at independent points" in shown
    shown = run("rpc", "convert", file, "--out", tmp_path / "b.xml").stdout
    assert "its first pixel is (1, 1)" in shown
    assert "the format cannot contain: error estimates" in shown


# --- files that no command takes -----------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "code"),
    [(lambda t: t.replace("LINE_NUM_COEFF_20: ", "LINE_NUM_COEFF_21: ", 1), "rpc.missing"),
     (lambda t: "\n".join(r for r in t.splitlines() if not r.startswith("LINE_NUM_COEFF_20:")),
      "rpc.coefficient_count"),
     (lambda t: t + "LINE_NUM_COEFF_21: 0\n", "rpc.coefficient_count"),
     (lambda t: t.replace("LAT_SCALE: 0.045", "LAT_SCALE: 0.0"), "rpc.zero_scale"),
     (lambda t: t.replace("SAMP_DEN_COEFF_1: 1.0", "SAMP_DEN_COEFF_1: 0.5"), "rpc.denominator_constant"),
     (lambda t: "what is this", "rpc.unknown_format")],
)  # fmt: skip
@pytest.mark.parametrize("command", ["check", "convert", "refine"])
def test_bad_files(
    run: Run, file: Path, model: RpcModel, tmp_path: Path, command: str, change: Callable[[str], str], code: str
) -> None:
    text = file.read_text()
    assert change(text) != text
    file.write_text(change(text))
    points = write_points(tmp_path / "p.csv", *measured(model))
    more = {"convert": ("--out", tmp_path / "b.RPB"), "refine": ("--points", points)}.get(command, ())
    ended = run("rpc", command, file, *more, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, code)
    assert ended.stderr.count("\n") == 1


@pytest.mark.behaviour
def test_rpc00a_is_refused_until_asked_for(run: Run, model: RpcModel, tmp_path: Path) -> None:
    path = tmp_path / "a.RPB"
    write_rpc(path, model)
    path.write_text(path.read_text().replace("RPC00B", "RPC00A"))
    ended = run("rpc", "check", path, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "rpc.order")
    assert "--order RPC00A" in ended.json["errors"][0]["remedy"]
    assert run("rpc", "check", path, "--order", "RPC00A", "--json").code == 0


# --- real files ----------------------------------------------------------------------------------


@pytest.fixture
def zonguldak(real_data: Path) -> Path:
    return real_data / "geoetrim-pleiades"


def pleiades_points(zonguldak: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (0-based) and ground of the 86 points."""
    with (zonguldak / "points_img1_llh.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    image = np.array([[float(r["line"]) - 1.0, float(r["col"]) - 1.0] for r in rows])
    return image, np.array([[float(r["lon_deg"]), float(r["lat_deg"]), float(r["h_ell_m"])] for r in rows])


@pytest.mark.truth
@pytest.mark.real_data
def test_vendor_rpc_of_pleiades(run: Run, zonguldak: Path, tmp_path: Path) -> None:
    """The Pléiades RPC has a bias of 16.3 px, and 1, 5, 10 control points reduce check points to 1.7, 1.2, 1.1 px."""
    image, ground = pleiades_points(zonguldak)
    source = (zonguldak / "PHR1A_img1_RPC.txt", "--first-pixel", 1)
    points = write_points(tmp_path / "all.csv", image, ground)
    rigorous = zonguldak / "DIM_PHR1A_derived_img1.XML"
    record = run("rpc", "check", *source, "--points", points, "--against", rigorous, "--json").json
    assert record["status"] == "good"
    assert record["points"]["statistics"]["mean_sample_px"] == pytest.approx(-16.29, abs=0.01)
    assert abs(record["points"]["statistics"]["mean_line_px"]) < 0.1
    against = record["against"]["statistics"]
    # README of the data: 0.0008 and 0.0032 px
    assert (against["max_line_px"] < 0.001, against["max_sample_px"] < 0.004) == (True, True)
    middle = np.argsort(np.linalg.norm((image - image.mean(axis=0)) / image.std(axis=0), axis=1))
    for n, limit in ((1, 1.7), (5, 1.2), (10, 1.1)):
        chosen = middle[:1] if n == 1 else _spread(image, n)
        order = np.concatenate([chosen, np.setdiff1d(np.arange(86), chosen)])
        points = write_points(tmp_path / f"{n}.csv", image[order], ground[order], check=86 - n)
        ended = run("rpc", "refine", *source, "--points", points, "--json")
        assert ended.code == 0
        after, before = ended.json["check"]["after"], ended.json["check"]["before"]
        assert before["rms_sample_px"] == pytest.approx(16.3, abs=0.2)
        assert max(after["rms_line_px"], after["rms_sample_px"]) < limit


def _spread(image: np.ndarray, n: int) -> np.ndarray:
    """Return the farthest-point choice of n points."""
    unit, chosen = image / image.max(axis=0), [int(np.argmin(image.sum(axis=1)))]
    while len(chosen) < n:
        distance = np.linalg.norm(unit[:, None] - unit[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return np.array(chosen)


@pytest.mark.truth
@pytest.mark.real_data
def test_spot6_points(run: Run, zonguldak: Path, tmp_path: Path) -> None:
    """``rpc fit`` has the published m0 and warns that the true residuals are 15.39 px; a regularised fit is below 1 px.

    The RPC of another image is not trustworthy.
    """
    table = np.array([row.split()[1:] for row in _lines(zonguldak)], float)
    points = write_points(tmp_path / "p.csv", table[:, :2], table[:, [3, 2, 4]])
    plain = run("rpc", "fit", points, "--degree", 2, "--equations", "linear", "--folds", 2, "--json")
    assert plain.code == 4
    assert plain.json["m0_linear_px"] == pytest.approx(0.4096, abs=5e-5)
    assert plain.json["m0_px"] == pytest.approx(15.39, abs=0.05)
    assert any("0.41 px, is not the accuracy of the image: 15.39 px" in text for text in plain.json["warnings"])
    good = run("rpc", "fit", points, "--degree", 2, "--json")
    assert good.code == 0
    left_out = good.json["cross_validation"]["statistics"]
    assert (left_out["rms_line_px"] <= 1.0, left_out["rms_sample_px"] <= 1.0) == (True, True)
    other = (zonguldak / "SPOT6_other_image_RPC.txt", "--first-pixel", 0, "--points", points, "--json")
    assert run("rpc", "refine", *other).code == 2  # a point above its height range
    foreign = run("rpc", "refine", *other, "--extrapolate")
    assert foreign.code == 4
    assert foreign.json["height_dependence"]["line_px_per_km"] == pytest.approx(-310.0, abs=15.0)


def _lines(zonguldak: Path) -> list[str]:
    text = (zonguldak / "SPOT6_201805150822087_GCP_WGS84_blh.gcp").read_text()
    return [row for row in text.splitlines() if row.strip()]


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_spot6_leave_one_out(run: Run, zonguldak: Path, tmp_path: Path, degree: int) -> None:
    table = np.array([row.split()[1:] for row in _lines(zonguldak)], float)
    points = write_points(tmp_path / "p.csv", table[:, :2], table[:, [3, 2, 4]])
    ended = run("rpc", "fit", points, "--degree", degree, "--folds", 99, "--json")
    left_out = ended.json["cross_validation"]["statistics"]
    assert (left_out["rms_line_px"] <= 1.0, left_out["rms_sample_px"] <= 1.0) == (True, True)


@pytest.mark.oracle
@pytest.mark.real_data
def test_fit_to_the_rigorous_model_of_spot5(run: Run, real_data: Path, tmp_path: Path) -> None:
    scene, out = real_data / "geocosicorr3d" / "SPOT5.DIM", tmp_path / "spot5_RPC.TXT"
    record = run("rpc", "fit", scene, "--heights", 0, 3000, "--out", out, "--json").json
    for axis in ("line", "sample"):
        assert record["check"][f"rms_{axis}_px"] <= 0.035
        assert record["check"][f"max_{axis}_px"] <= 0.12
    sensor = read_sensor(scene)
    pixels, height = np.random.default_rng(4).uniform(9.0, 11990.0, (2, 400)), np.linspace(10.0, 2990.0, 400)
    ground = sensor.locate(*pixels, height_m=height)
    assert misses_m(sensor.metadata, *pixels, ground).max() < 1e-6  # rays and polynomials, both written apart
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ground.T)
    assert np.abs(np.array(reference_project(read_rpc(out), *geodetic), float) - pixels).max() <= 0.12
    ended = run("rpc", "check", out, "--against", scene, "--json")
    against = ended.json["against"]["statistics"]
    assert max(against["rms_line_px"], against["rms_sample_px"]) <= 0.06  # a grid that has the border
    assert max(against["max_line_px"], against["max_sample_px"]) <= 0.12


@pytest.mark.behaviour
@pytest.mark.real_data
def test_real_files_that_contradict_themselves(run: Run, real_data: Path) -> None:
    name = "RPC_PHR1A_P_202503191043438_SEN_7342362101-1.XML"
    ended = run("rpc", "check", real_data / "shareloc" / name, "--json")
    assert (ended.code, ended.json["image_to_ground"]["max_sample_px"] > 100.0) == (4, True)
    assert run("rpc", "check", real_data / "asp" / "sample.RPB").code == 4
    for name in ("rpcm/rpc_SPOT6.xml", "rpcm/rpc_IKONOS.txt", "otb/qb-1.geom"):
        assert run("rpc", "check", real_data / name).code == 0


@pytest.mark.truth
@pytest.mark.real_data
def test_gross_error_of_pleiades_neo_is_named(run: Run, real_data: Path, tmp_path: Path) -> None:
    """``rpc refine`` names point 53, wrong in one image, as outlier, and refuses it below the range of heights."""
    folder, image = real_data / "micmac-pneo-pair", "PNEO3_202309051055194"
    with (folder / "gcp_ground.csv").open() as stream:
        ground = {row["gcp_id"]: row for row in csv.DictReader(stream)}
    with (folder / "gcp_image.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["image"] == image and row["gcp_id"] in ground]
    lines = [
        ",".join([r["gcp_id"], r["line"], r["col"], *(ground[r["gcp_id"]][k] for k in ("lon_deg", "lat_deg", "h_m"))])
        for r in rows
    ]
    points = tmp_path / "p.csv"
    points.write_text("\n".join(["id,line,sample,lon_deg,lat_deg,height_m", *lines]) + "\n")
    (model,) = folder.glob(f"RPC_{image}*.XML")
    words = ("rpc", "refine", model, "--points", points, "--json")
    assert run(*words).json["errors"][0]["place"] == "point 53"
    record = run(*words, "--extrapolate").json
    assert [found["id"] for found in record["outliers"]] == ["53"]
    assert record["outliers"][0]["statistic"] > 30.0 * record["outliers"][0]["limit"]
