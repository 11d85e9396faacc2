"""Tables 4.35-4.55: rules on invented numbers, a twin of 99 points, verdicts on the real values."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.cli import app
from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.rpc.fit import cross_validate
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints, find_spot6, read_gcp
from fg_orient.rpc.select import fit_selected
from fg_orient.simulate.zonguldak import zonguldak_block
from fg_orient.studies import tables_spot6
from fg_orient.studies.claims_geometry import rfm_points
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce import spot6
from fg_orient.studies.reproduce.reproduction import reproduce
from fg_orient.studies.reproduce.verdict import CellComparison
from tests.support.repetitions import some_slow

Verdicts = dict[CellKey, CellComparison]
INVERSES = ("pivot_inverse", "cholesky_inverse", "gauss_inverse")
ELIMINATIONS = ("gauss_partial_pivot_elimination", "cholesky_elimination")
PSEUDO, CRAMER = "moore_penrose_inverse", "cramer_inverse"
NORMALISED = {method: table for table, method in tables_spot6.NORMALISED.items()}


# --- without the real points ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def twin() -> ControlPoints:
    """Return 99 points of the twin's left image."""
    return rfm_points(zonguldak_block()[0].images[0].sensor, 1)


@pytest.fixture(scope="module")
def computed(twin: ControlPoints) -> dict[CellKey, np.ndarray]:
    """Return the cells of degrees 1 and 2 with three permutations."""
    with one_blas_thread():
        return tables_spot6.compute(tables_spot6.TABLES, twin, permutations=3, degrees=(1, 2))


@pytest.mark.behaviour
def test_every_cell_of_these_degrees_is_computed(
    computed: dict[CellKey, np.ndarray], printed: dict[str, PublishedTables]
) -> None:
    cells = [c.key for c in printed["terlemezoglu2019"].cells if c.key.table in tables_spot6.TABLES]
    assert len(cells) == 210 + 18 + 98 + 21 + 18 + 210 + 18 + 98 + 21
    assert [key for key in cells if key.stage != "rfm degree 3" and key not in computed] == []
    assert {len(values) for values in computed.values()} == {4}


@pytest.mark.oracle
def test_cells_equal_an_independent_computation(twin: ControlPoints, computed: dict[CellKey, np.ndarray]) -> None:
    """Cells of degree 1 equal normalised least squares written out with numpy, within 1e-9."""
    n = twin.columns
    n = (2.0 * n - n.max(axis=0) - n.min(axis=0)) / np.ptp(n, axis=0)
    line, sample, lon, lat, h = n.T
    m = np.stack([np.ones(99), lon, lat, h], axis=1)
    out, scale = [], 0.5 * np.ptp(twin.columns, axis=0)
    for image in (sample, line):
        a = np.hstack([m, -image[:, None] * m[:, 1:]])
        x = np.linalg.lstsq(a, image, rcond=None)[0]
        out.append((x, a @ x - image, a))
    key = CellKey(NORMALISED[PSEUDO], stage="rfm degree 1", quantity="sum_squared_residual", method=PSEUDO)
    for axis, (_, v, _), px in zip("xy", out, (scale[1], scale[0]), strict=True):
        np.testing.assert_allclose(computed[key._replace(parameter=axis)], np.sum((v * px) ** 2), rtol=1e-9)
    rpc = CellKey("4.54", stage="rfm degree 1", quantity="rpc", method="gauss_inverse", parameter="c010")
    np.testing.assert_allclose(computed[rpc], out[1][0][2], rtol=1e-9)
    normal = np.zeros((14, 14))
    normal[:7, :7], normal[7:, 7:] = out[0][2].T @ out[0][2], out[1][2].T @ out[1][2]
    place = CellKey("4.53", stage="rfm degree 1")
    np.testing.assert_allclose(computed[place._replace(quantity="det")], np.linalg.det(normal), rtol=1e-9)
    np.testing.assert_allclose(computed[place._replace(quantity="cond_norm")], np.linalg.cond(normal, 2), rtol=1e-9)
    total = sum(np.sum((v * px) ** 2) for (_, v, _), px in zip(out, (scale[1], scale[0]), strict=True))
    m0 = CellKey("4.55", stage="rfm degree 1", quantity="m0", method="cholesky_elimination")
    np.testing.assert_allclose(computed[m0], np.sqrt(total / 184.0), rtol=1e-9)


@pytest.mark.consistency
def test_permutations_move_noise_and_nothing_else(computed: dict[CellKey, np.ndarray]) -> None:
    noise = computed[CellKey("4.44", stage="rfm degree 2", quantity="m0", method="pivot_inverse")]
    assert len(set(noise.tolist())) == 4
    firm = computed[CellKey("4.55", stage="rfm degree 2", quantity="m0", method="pivot_inverse")]
    assert np.ptp(firm) < 1e-5 * firm[0]


@pytest.mark.oracle
def test_kappas_as_run(twin: ControlPoints) -> None:
    """As run, kappa of HKB is 14 m0/(x^T x), and kappa of OD lies between 0 and 1.

    The square of s0 is missing, and dP replaces the canonical coefficients.
    """
    run = tables_spot6.Run(twin, 1, False)
    with one_blas_thread():
        cells = tables_spot6.compute(["4.45"], twin, permutations=1, degrees=(1,))
        x = solve(CRAMER, run.system).x
    key = CellKey("4.45", stage="rfm degree 1", quantity="kappa")
    assert cells[key._replace(method="tikhonov_hkb")][0] == pytest.approx(14 * run.m0_px(x) / (x @ x), rel=1e-9)
    od = cells[key._replace(method="tikhonov_od")][0]
    assert 0.0 <= od <= 1.0


@pytest.mark.truth
def test_printed_coefficients_give_the_printed_kappas(printed: dict[str, PublishedTables]) -> None:
    """The printed m0 and dP of Cramer give the printed kappa 4.4e-5 by 14 m0/(dP^T dP), within 2 %."""
    cells = {c.key: c.value for c in printed["terlemezoglu2019"].cells}
    dp = np.array([v for k, v in cells.items() if k.table == "4.43" and k.method == CRAMER])
    m0 = cells[CellKey("4.44", stage="rfm degree 1", quantity="m0", method=CRAMER)]
    kappa = cells[CellKey("4.45", stage="rfm degree 1", quantity="kappa", method="tikhonov_hkb")]
    assert len(dp) == 14
    assert 14 * m0 / (dp @ dp) == pytest.approx(kappa, rel=0.02)


def judged(value: float, text: str, runs: list[float], **key: str) -> str:
    """Return the kind of judgement on a made-up cell."""
    cell = PublishedCell(
        CellKey(**{"table": "4.44", "stage": "rfm degree 2", "quantity": "m0", "method": "x"} | key), value, text, text
    )
    return spot6.assess(cell, {cell.key: np.array(runs)}).kind


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("value", "text", "runs", "key", "kind"),
    [
        (4.6, "4.6", [4.563, 4.563], {}, "equal"),
        (4.6, "4.6", [4.66, 4.6], {}, "spread"),
        (4.6, "4.6", [4.6, 5.0], {}, "spread"),
        (13.0, "13", [13.32, 13.32], {}, "equal"),
        (13.0, "13", [13.52, 13.52], {}, "spread"),
        (600.0, "600", [1.0, 20.1], {}, "spread"),
        (600.0, "600", [1.0, 19.9], {}, "differs"),
        (1.0, "1.0", [30.0, 29.0], {}, "spread"),
        (1.0, "1.0", [40.0, 33.0], {}, "differs"),
        (math.nan, "nan", [1.0, 1.0], {}, "not_reproducible"),
        (1.0, "1.0", [math.nan, math.nan], {}, "not_reproducible"),
        (1.0, "1.0", [math.inf, math.inf], {}, "not_reproducible"),
        (math.inf, "Inf", [-math.inf, math.inf], {}, "spread"),
        (math.inf, "Inf", [1e307, math.inf], {}, "spread"),
        (math.inf, "Inf", [1e300, 1e301], {}, "differs"),
        (1.0, "1.0", [math.nan, 2.0], {}, "spread"),
        (math.inf, "inf", [math.inf, -math.inf], {"quantity": "det"}, "equal"),
        (0.0, "0", [0.3, 0.3], {"quantity": "kappa"}, "differs"),
        (0.0, "0", [0.0, 0.0], {"quantity": "kappa"}, "equal"),
        (10.0, "10", [10.0, 11.0], {"quantity": "rank"}, "spread"),
        (2.6e8, "2.6e8", [2e-10, 2e-10], {"table": "4.53", "quantity": "cond_hadamard"}, "not_reproducible"),
        (3.0, "3.0", [3.16, 3.6], {"table": "4.48", "stage": "rfm degree 3", "quantity": "sum_squared_residual",
                                   "method": "cholesky_inverse"}, "spread"),
        (3.0, "3.0", [3.21, 3.0], {"table": "4.48", "stage": "rfm degree 3", "quantity": "sum_squared_residual",
                                   "method": "cholesky_inverse"}, "spread"),
        (2.9, "2.9", [3.0, 2.94], {"table": "4.51", "stage": "rfm degree 3", "quantity": "sum_squared_residual",
                                   "method": "gauss_partial_pivot_elimination"}, "spread"),
    ],
)  # fmt: skip
def test_rules(value: float, text: str, runs: list[float], key: dict[str, str], kind: str) -> None:
    assert judged(value, text, runs, **key) == kind


@pytest.mark.behaviour
def test_a_steady_number_is_not_called_noise() -> None:
    """If all orders of the points agree within the limits, the verdict is "steady", else "rounding noise"."""
    key = CellKey("4.45", stage="rfm degree 1", quantity="kappa", method="tikhonov_od")
    for runs, words in (([7.567e-3, 7.567e-3, 7.568e-3], "steady"), ([7.567e-3, 7.5e-3, 7.9e-3], "rounding noise")):
        verdict = spot6.assess(PublishedCell(key, 7.7e-3, "7.7e-3", "7.7e-3"), {key: np.array(runs)})
        assert verdict.kind == "spread"
        assert words in verdict.reason


@pytest.mark.behaviour
def test_without_points_the_command_works_and_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(spot6.VARIABLE, raising=False)
    words = ["reproduce", "terlemezoglu2019", "--tables", "4.35-4.55", "--no-claims", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    found = reproduce("terlemezoglu2019", tables="4.35-4.55", claims=False)
    assert {row.verdict for row in found.rows} == {"not_reproducible"}
    assert "give them as data" in found.rows[0].reason
    monkeypatch.setenv(spot6.VARIABLE, str(tmp_path))
    assert spot6.control_points(None) is None


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("text", "place"),
    [("", ""), ("1 2 3 41.4 31.7\n", "line 1"), ("1 2 3 41.4 31.7 200\n2 a 3 41.4 31.7 200\n", "line 2"),
     ("1 2 3 91.4 31.7 200\n", "line 1"), ("1 2 3 nan 31.7 200\n", "line 1")],
)  # fmt: skip
def test_damaged_files_are_refused(tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "points.gcp"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError) as caught:
        spot6.control_points(path)
    assert (caught.value.problems[0].code, caught.value.problems[0].place) == ("rfm.data", place)


@pytest.mark.behaviour
def test_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="SPOT6"):
        spot6.control_points(tmp_path)
    done = CliRunner().invoke(
        app, ["reproduce", "terlemezoglu2019", "--tables", "4.55", "--data", str(tmp_path / "no")]
    )
    assert done.exit_code == 2
    assert len(done.stderr.strip().splitlines()) == 1
    with pytest.raises(InputError, match="permutations"):
        reproduce("terlemezoglu2019", tables="4.55", permutations=0)


@pytest.mark.behaviour
def test_a_file_is_read_column_by_column(tmp_path: Path) -> None:
    path = tmp_path / "points.gcp"
    path.write_text("15  9959.5 5587.5 41.41 31.69 201.62\n\n 01 10760.0 3900.75 41.39 31.66 180.04\n", "utf-8")
    found = read_gcp(path)
    assert (found.line[0], found.sample[1], found.ground[0].tolist()) == (9959.5, 3900.75, [31.69, 41.41, 201.62])


# --- on the real points ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def points(real_data: Path) -> ControlPoints:
    return read_gcp(find_spot6(real_data))


@pytest.fixture(scope="module")
def verdicts(points: ControlPoints, printed: dict[str, PublishedTables]) -> Verdicts:
    """Return the judgements on the cells of degrees 1 and 2 with five permutations."""
    with one_blas_thread():
        values = tables_spot6.compute(tables_spot6.TABLES, points, permutations=5, degrees=(1, 2))
    return {c.key: spot6.assess(c, values) for c in printed["terlemezoglu2019"].cells if c.key in values}


def firm(found: Verdicts, degrees: tuple[int, ...]) -> None:
    """Assert that the cells that must agree digit by digit do so."""
    kinds = {key: verdict.kind for key, verdict in found.items() if int(key.stage[-1]) in degrees}
    wanted = []
    for degree in degrees:
        stage = tables_spot6.stage(degree)
        methods = tables_spot6.METHODS[1:] if degree > 1 else tables_spot6.METHODS
        for method in methods:
            vv = CellKey(NORMALISED[method], stage=stage, quantity="sum_squared_residual", method=method)
            wanted += [vv._replace(parameter=axis) for axis in "xy"]
            wanted.append(CellKey("4.55", stage=stage, quantity="m0", method=method))
        wanted += [
            CellKey("4.53", stage=stage, quantity=q)
            for q in ("matrix_order", "rank", "det", "cond_norm", "cond_spectral")
        ]
        key = CellKey("4.39", stage=stage, method=PSEUDO)
        wanted += [
            key._replace(quantity=q, parameter=a) for q in ("sum_residual", "sum_squared_residual") for a in "xy"
        ]
        wanted.append(CellKey("4.44", stage=stage, quantity="m0", method=PSEUDO))
        wanted += [CellKey("4.42", stage=stage, quantity=q) for q in ("matrix_order", "rank")]
    if 1 in degrees:
        wanted += [key for key in kinds if key.table == "4.54"]
        wanted += [CellKey("4.42", stage="rfm degree 1", quantity=q) for q in ("det", "cond_norm", "cond_spectral")]
        wanted += [CellKey("4.44", stage="rfm degree 1", quantity="m0", method=m) for m in ELIMINATIONS]
    # its second digit is rounding itself: 1.20e-3 to 1.52e-3 in 50 permutations, 1.34e-3 in the file, printed 1.4e-3
    loose = CellKey("4.39", stage="rfm degree 1", quantity="sum_residual", method=PSEUDO, parameter="y")
    near = {key for key in wanted if spot6._tolerance(key) is not None and kinds[key] == "spread"}  # digits are lost
    assert {key: found[key] for key in wanted if kinds[key] != "equal" and key not in {loose, *near}} == {}
    assert 1 not in degrees or kinds[loose] in {"equal", "spread"}
    hadamard = [v.kind for k, v in found.items() if k.table == "4.53" and k.quantity == "cond_hadamard"]
    assert set(hadamard) == {"not_reproducible"}


@pytest.mark.truth
@pytest.mark.real_data
def test_degrees_1_and_2_meet_the_printed_digits(verdicts: Verdicts) -> None:
    firm(verdicts, (1, 2))


@pytest.mark.behaviour
@pytest.mark.real_data
def test_true_residuals_stand_beside_m0(verdicts: Verdicts) -> None:
    reason = verdicts[CellKey("4.55", stage="rfm degree 2", quantity="m0", method="pivot_inverse")].reason
    assert "true image residuals of the same coefficients: m0 15.4 px" in reason


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.slow
def test_all_degrees_with_fifty_permutations(
    real_data: Path, printed: dict[str, PublishedTables], capsys: pytest.CaptureFixture[str]
) -> None:
    tables = printed["terlemezoglu2019"]
    judges = spot6.compare(tables, tables_spot6.TABLES, real_data)
    found = {cell.key: judges[cell.key](cell) for cell in tables.cells if cell.key in judges}
    with capsys.disabled():
        print(f"\n{Counter(verdict.kind for verdict in found.values())}")
        for key, verdict in found.items():
            if verdict.kind in {"differs", "not_reproducible"}:
                print(f"{key.table} {key}: {verdict.kind}: {verdict.reason}")
    firm(found, (1, 2, 3))
    differs = {(key.table, key.quantity) for key, verdict in found.items() if verdict.kind == "differs"}
    assert differs <= {("4.40", "sum_squared_residual"), ("4.42", "cond_hadamard"), ("4.43", "rpc"), ("4.45", "kappa"),
                       ("4.52", "normal_residual_abs_min")}  # fmt: skip
    assert sum(verdict.kind == "not_reproducible" for verdict in found.values()) == 3 + 1 + 2


def validated(points: ControlPoints, degree: int, capsys: pytest.CaptureFixture[str]) -> np.ndarray:
    """Return the leave-one-out RMS per axis of the image residuals; print it.

    Kappa is chosen in each fold.
    """
    form = RfmForm(degree)
    with one_blas_thread():
        found = cross_validate(points, lambda p: fit_selected(p, form, "ridge_l_curve"))
    kappas = sorted(fit.kappa for fit in found.fits if fit is not None)
    with capsys.disabled():
        print(f"\ndegree {degree}: leave-one-out RMS {found.rms_px} px; kappa {kappas[0]:.3g}-{kappas[-1]:.3g}")
    assert len(kappas) == len(points) == 99
    return found.rms_px


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("degree", some_slow([1, 2]))
def test_a_held_model_is_good_in_truth(points: ControlPoints, degree: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert (validated(points, degree, capsys) <= 1.0).all()


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.slow
def test_a_held_model_of_degree_3_is_good_in_truth(points: ControlPoints, capsys: pytest.CaptureFixture[str]) -> None:
    assert (validated(points, 3, capsys) <= 1.0).all()
