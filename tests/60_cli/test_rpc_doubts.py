"""``rpc check`` and ``rpc refine`` have exit code 4 if points or another model contradict the RPC, otherwise 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.formats.rpc import write_rpc
from fg_orient.model.errors import InputError
from fg_orient.rpc.check import check_rpc
from fg_orient.rpc.compensate import compensate
from fg_orient.rpc.files import RpcFile
from fg_orient.rpc.points import MeasuredPoints
from fg_orient.rpc.refine import refine
from fg_orient.sensors.rpc import RpcModel
from tests.support.rpc_model import ground_points, reference_project, synthetic_model

Run = Callable[..., Any]

#: Bias and noise of the good points, px; number of points; the last of them are check points.
BIAS, NOISE, N, CHECK = np.array([3.0, -16.0]), 0.5, 60, 20
#: Fields of a model whose vendor states 2.5 m (5 px) and 0.125 m.
VENDOR = {"err_bias_m": 2.5, "err_rand_m": 0.125}


def points(*, stated: bool = True, noise: float = NOISE, bias: np.ndarray = BIAS) -> MeasuredPoints:
    """Return points of the synthetic model with bias and noise."""
    model = synthetic_model()
    ground = np.stack(ground_points(model, N, 5), axis=1)
    image = np.stack(reference_project(model, *ground.T), axis=1).astype(float) + bias
    image += np.random.default_rng(5).normal(scale=noise, size=image.shape)
    ids = tuple(f"p{k}" for k in range(N))
    sigma = np.full(image.shape, NOISE if stated else 1.0)
    return MeasuredPoints(ids, np.arange(N) >= N - CHECK, image, ground, sigma, stated)


def moved(measured: MeasuredPoints, rows: slice, by: tuple[float, float]) -> MeasuredPoints:
    """Return the points with some of their pixels moved."""
    image = measured.image.copy()
    image[rows] += by
    return replace(measured, image=image)


def codes(record: dict[str, Any], severity: str = "doubt") -> list[str]:
    """Return the codes of the findings of this severity; the status follows from the doubts."""
    assert (record["status"] == "not_trustworthy") == any(f["severity"] == "doubt" for f in record["findings"])
    return [found["code"] for found in record["findings"] if found["severity"] == severity]


def checked(measured: MeasuredPoints, model: RpcModel | None = None) -> dict[str, Any]:
    """Return the record of ``rpc check --points``."""
    return check_rpc(RpcFile(model or synthetic_model(), 0.0), points=measured)


@pytest.mark.behaviour
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("vendor", [True, False])
def test_good_points_raise_no_doubt(stated: bool, vendor: bool) -> None:
    model, measured = synthetic_model(**VENDOR if vendor else {}), points(stated=stated)
    assert refine(model, measured, "shift")["findings"] == []
    record = checked(measured, model)
    assert [f["code"] for f in record["findings"] if f["code"] != "rpc.extrapolated"] == []


@pytest.mark.oracle
@pytest.mark.parametrize(("offset", "doubtful"), [(0.4, False), (2.0, True)])
def test_two_models_may_differ_by_half_a_pixel(run: Run, tmp_path: Path, offset: float, doubtful: bool) -> None:
    """``rpc check --against`` has exit code 4 above half a pixel, and states size, place and a constant difference."""
    write_rpc(tmp_path / "a_RPC.TXT", synthetic_model())
    write_rpc(tmp_path / "b_RPC.TXT", synthetic_model(offsets=[10000.0 + offset, 12000.0, 31.8, 41.4, 500.0]))
    ended = run("rpc", "check", tmp_path / "a_RPC.TXT", "--against", tmp_path / "b_RPC.TXT", "--json")
    assert (ended.code, codes(ended.json)) == ((4, ["rpc.against"]) if doubtful else (0, []))
    if doubtful:
        found = ended.json["findings"][0]
        assert found["data"]["largest_px"] == pytest.approx(offset, abs=1e-6)
        assert "nearly constant, -2.00 px in line" in found["message"] and "at line " in found["message"]
        assert found["remedy"].endswith("the pixel origin (option first_pixel)")
        shown = run("rpc", "check", tmp_path / "a_RPC.TXT", "--against", tmp_path / "b_RPC.TXT")
        assert "the pixel origin (--first-pixel)" in shown.stderr


@pytest.mark.behaviour
def test_the_rpc_of_another_image_has_no_constant_difference(run: Run, tmp_path: Path) -> None:
    write_rpc(tmp_path / "a_RPC.TXT", synthetic_model())
    write_rpc(tmp_path / "b_RPC.TXT", synthetic_model(seed=3))
    ended = run("rpc", "check", tmp_path / "a_RPC.TXT", "--against", tmp_path / "b_RPC.TXT", "--json")
    assert (ended.code, codes(ended.json)) == (4, ["rpc.against"])
    assert "constant" not in ended.json["findings"][0]["message"]


@pytest.mark.behaviour
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("rows", [slice(N - CHECK, N), slice(N - 1, N)])
def test_wrong_check_points_are_a_doubt(stated: bool, rows: slice) -> None:
    """All check points wrong by 300 px, or a single one by 20 px, make a refinement not trustworthy."""
    by = (20.0, 0.0) if rows.stop - rows.start == 1 else (300.0, 300.0)
    record = refine(synthetic_model(), moved(points(stated=stated), rows, by), "shift")
    assert codes(record) == ["rpc.check_far"]
    data = record["findings"][0]["data"]
    assert (data["n"], data["of"]) == (rows.stop - rows.start, CHECK)
    assert data["line_px"] == pytest.approx(-by[0], abs=4.0 * NOISE)


@pytest.mark.behaviour
def test_a_check_point_is_judged_also_by_one_control_point() -> None:
    """Without redundancy and sigmas, a residual must be possible with sigmas of 5 px."""
    measured = replace(points(stated=False), check=np.arange(N) > 0)
    assert codes(refine(synthetic_model(), measured, "shift")) == []
    assert codes(refine(synthetic_model(), moved(measured, slice(9, 10), (0.0, 300.0)), "shift")) == ["rpc.check_far"]


@pytest.mark.oracle
@pytest.mark.slow
def test_good_check_points_are_a_doubt_in_one_of_thousand_cases() -> None:
    """Among 400 good sets with sigmas hardly any has the doubt on check points; the level is 0.001 for each set."""
    model, measured, rng = synthetic_model(), points(noise=0.0), np.random.default_rng(2)
    alarms = 0
    for _ in range(400):
        noisy = replace(measured, image=measured.image + rng.normal(scale=NOISE, size=measured.image.shape))
        alarms += "rpc.check_far" in codes(refine(model, noisy, "shift"))
    assert alarms <= 4  # five or more have the probability 6e-5


@pytest.mark.behaviour
@pytest.mark.parametrize("command", [checked, lambda p: refine(synthetic_model(), p, "shift")])
def test_a_shift_beyond_its_prior_is_a_doubt(command: Callable[[MeasuredPoints], dict[str, Any]]) -> None:
    """3000 lines are impossible with the prior of 100 px; 200 px are possible."""
    record = command(points(bias=np.array([3000.0, 0.0])))
    assert codes(record) == ["rpc.beyond_prior"]
    assert (record["findings"][0]["place"], record["findings"][0]["data"]["sigma"]) == ("line_0", 100.0)
    assert codes(command(points(bias=np.array([200.0, 0.0])))) == []


@pytest.mark.oracle
def test_the_vendor_states_the_accuracy_of_the_shift() -> None:
    """ERR_BIAS in metres becomes pixels of 0.5 m: 2.5 m are 5 px, so a shift of 40 px is a doubt; without it, not."""
    measured = points(bias=np.array([40.0, 0.0]))
    record = checked(measured, synthetic_model(**VENDOR))
    assert codes(record) == ["rpc.beyond_prior"]
    assert record["findings"][0]["data"]["sigma"] == pytest.approx(5.0, rel=0.05)
    assert codes(checked(measured)) == []
    assert codes(checked(measured, synthetic_model(err_bias_m=0.0))) == []  # 0: not known


@pytest.mark.behaviour
@pytest.mark.parametrize("command", [checked, lambda p: refine(synthetic_model(), p, "shift")])
def test_exchanged_line_and_sample_are_named(command: Callable[[MeasuredPoints], dict[str, Any]]) -> None:
    measured = points()
    record = command(replace(measured, image=measured.image[:, ::-1].copy()))
    assert codes(record)[0] == "solution.mix_up"
    assert "line and sample exchanged" in record["findings"][0]["message"]


@pytest.mark.behaviour
def test_sigma0_above_its_interval() -> None:
    """Stated sigmas that are too small are a doubt that names them; if they are only assumed, it is a warning."""
    small = replace(points(), sigma_px=np.full((N, 2), NOISE / 100.0))
    found = refine(synthetic_model(), small, "shift")
    assert codes(found) == ["rpc.sigma0"]
    assert "correct the sigmas" in found["findings"][0]["remedy"]
    assumed = refine(synthetic_model(), points(stated=False, noise=3.3), "shift")
    assert (codes(assumed), codes(assumed, "warning")) == ([], ["rpc.sigma0_assumed"])
    large = refine(synthetic_model(), points(stated=False, noise=8.0), "shift")
    assert codes(large) == ["rpc.no_fit"]


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_equal_gross_errors_do_not_hide_each_other(kind: str) -> None:
    """Five of 32 points with the same error of 50 px are found, and the compensation is that of the other points."""
    model, measured = synthetic_model(), points().take(np.arange(N) < 32)
    fit = compensate(model, moved(measured, slice(0, 5), (50.0, 0.0)), kind)
    assert sorted(one["id"] for one in fit.outliers) == ["p0", "p1", "p2", "p3", "p4"]
    assert [one["error_line_px"] for one in fit.outliers] == pytest.approx([50.0] * 5, abs=5.0 * NOISE)
    rest = compensate(model, measured.take(np.arange(32) >= 5), kind)
    assert np.array_equal(fit.values, rest.values)


@pytest.mark.behaviour
def test_a_height_outside_is_not_an_order_of_coordinates() -> None:
    measured = points()
    high, exchanged = measured.ground.copy(), measured.ground[:, [1, 0, 2]]
    high[3, 2] = 1500.0
    for ground, words in ((high, "only the height is outside"), (exchanged, "check the order of the coordinates")):
        with pytest.raises(InputError) as caught:
            refine(synthetic_model(), replace(measured, ground=ground), "shift")
        assert words in caught.value.problems[0].remedy
        assert "extrapolate" in caught.value.problems[0].remedy


@pytest.mark.behaviour
def test_rpc_fit_names_what_is_not_written_after_the_causes(run: Run, tmp_path: Path) -> None:
    measured = points(bias=np.zeros(2))
    rows = [f"{k},{line},{sample},{lon},{lat},{h}" for k, ((line, sample), (lon, lat, h)) in
            enumerate(zip(measured.image[:12], measured.ground[:12], strict=True))]  # fmt: skip
    (tmp_path / "p.csv").write_text("\n".join(["id,line,sample,lon_deg,lat_deg,height_m", *rows]) + "\n")
    ended = run("rpc", "fit", tmp_path / "p.csv", "--degree", 2, "--denominators", "one", "--select", "none",
                "--out", tmp_path / "a.RPB")  # fmt: skip
    assert ended.code == 4
    assert ended.stderr.index("doubt: ") < ended.stderr.index("is not written; correct the causes above")
