"""The code of each page on extending is one file outside the package and is used as a reader would."""

from __future__ import annotations

import contextlib
import csv
import json
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from factors import _contract, losses
from fg_orient.adjustment.dense import DenseBackend
from fg_orient.adjustment.linear import kappa, registry
from fg_orient.adjustment.linear.kappa import Given, choose_kappa
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.formats import registry as format_registry
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.plugins import load_plugin
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support import pages
from tests.support.command import in_process
from tests.support.pages import Fence

#: Pages, and the name that each gives its file.
PAGES = {
    "format": "xyz",
    "sensor": "parallel",
    "equation": "distance",
    "solver": "cgls",
    "kappa-rule": "mallows",
    "loss": "fair",
}


@pytest.fixture(scope="module")
def registries() -> Iterator[pytest.MonkeyPatch]:
    """Yield the copies of all registries, of the modules and their path: what a page adds goes with them."""
    registry.solvers(), kappa.kappa_rules(), losses.losses()  # all loaded before the copies
    format_registry.formats("image"), format_registry.formats("rpc"), format_registry.formats()
    with pytest.MonkeyPatch.context() as patch:
        for module in (_contract, registry, kappa, losses, format_registry):
            patch.setattr(module, "_REGISTRY", dict(module._REGISTRY))
        patch.setattr(sys, "path", list(sys.path))
        yield patch
        for name in PAGES.values():
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def files(
    repository: Path, tmp_path_factory: pytest.TempPathFactory, registries: pytest.MonkeyPatch
) -> dict[str, Path]:
    """Return the first Python block of each page as a file, the only one in its folder."""
    out = {}
    for page, name in PAGES.items():
        out[page] = tmp_path_factory.mktemp("own") / f"{name}.py"
        out[page].write_text(python_of(repository, page)[0].text, "utf-8")
    return out


def fences_of(repository: Path, page: str) -> list[Fence]:
    """Return the blocks of a page on extending, or of the overview page."""
    path = repository / "docs" / ("extending.md" if page == "extending" else f"extending/{page}.md")
    return pages.fences(path, page)


def python_of(repository: Path, page: str) -> list[Fence]:
    """Return the Python blocks of a page on extending."""
    return [fence for fence in fences_of(repository, page) if fence.language == "python"]


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_zonguldak(tmp_path_factory.mktemp("twin") / "zonguldak", ZonguldakOptions(seed=3))


@pytest.fixture(scope="module")
def block(twin: Path) -> Block:
    return fg.read_project(twin)


def check_jacobians(equation: _contract.Equation, record: np.ndarray, setup: np.ndarray, *unknowns: np.ndarray) -> None:
    """Assert that Jacobians equal the complex step within a few roundings of the largest element.

    The complex step has no truncation error.
    """
    value, *jacobians = equation.kernel(record, setup, *unknowns, True)
    for k, jacobian in enumerate(jacobians):
        for c in range(jacobian.shape[1]):
            z = [u.astype(complex) for u in unknowns]
            z[k][c] += 1e-30j
            numeric = equation.residual(record, setup, *z).imag / 1e-30
            assert np.abs(jacobian[:, c] - numeric).max() <= 1e-14 * np.abs(jacobian).max()
    assert np.array_equal(equation.kernel(record, setup, *unknowns, False)[0], value)


@pytest.mark.behaviour
@pytest.mark.parametrize("page", ["extending", *PAGES])
def test_commands_and_further_blocks_of_the_page(
    page: str, files: dict[str, Path], repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands and code of each page on extending run in a folder with only its file."""
    monkeypatch.chdir(files["loss" if page == "extending" else page].parent)
    names: dict[str, Any] = {}
    for made in ("twin", "result"):  # two pages share the file of the loss, and with it the folder
        shutil.rmtree(made, ignore_errors=True)
    if page == "equation":
        names["np"] = np  # the page's first block has it
    found = fences_of(repository, page)
    if page != "extending":
        found.remove(next(f for f in found if f.language == "python"))
    if page == "equation":
        load_plugin(files[page])
    assert pages.run_page(found, names, repository, lambda _: True) >= 1
    if page == "equation":
        assert names["solution"].redundancy == names["before"].redundancy + 1


# --- a file format -------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_format_in_a_project_file(files: dict[str, Path], twin: Path, tmp_path: Path) -> None:
    """The format of the page gives the same points in a project, and ``convert --formats`` lists it."""
    folder = tmp_path / "own"
    shutil.copytree(twin.parent, folder)
    lines = [line for line in (folder / "points.csv").read_text("utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    known = [row for row in rows if row["role"] != "tie"]
    words = [[row["id"], row["lon_deg"], row["lat_deg"], row["height_m"]] for row in known]
    (folder / "ground.xyz").write_text("\n".join(" ".join(cells) for cells in words), "utf-8")
    text = (folder / "project.toml").read_text("utf-8")
    sigma, check = [0.5, 0.5, 0.5], [row["id"] for row in known if row["role"] == "check"]
    own = f'file = "ground.xyz"\nformat = "docs-xyz"\nsigma_m = {sigma}\ncheck = {check}\n'.replace("'", '"')
    (folder / "project.toml").write_text(text.replace('file = "points.csv"\n', own), "utf-8")
    load_plugin(files["format"])
    given, ours = fg.read_project(folder / "project.toml").points, fg.read_project(twin).points
    place = [given.ids.index(name) for name in ours.ids]
    assert [given.roles[k] for k in place] == list(ours.roles)
    np.testing.assert_array_equal(given.known.ecef_m[place], ours.known.ecef_m)
    listed = in_process("--plugin", files["format"], "convert", "--formats", "--json").json["formats"]
    (entry,) = (one for one in listed if one["name"] == "docs-xyz")
    assert entry["reads"] and entry["writes"] and entry["help"].startswith("Points between blanks")


@pytest.mark.behaviour
def test_rpc_format_of_a_user(tmp_path: Path, registries: pytest.MonkeyPatch) -> None:
    """A user's reader of RPC with a sniffing function is enough for ``project``."""
    (tmp_path / "docs_rpc.py").write_text(
        "import json\nimport fg_orient as fg\nfrom fg_orient.sensors.rpc import RpcModel\n"
        "def read(path, reading):\n    return RpcModel(**json.loads(path.read_text()), file=str(path), format='json')\n"
        "fg.register_format(fg.Format(name='docs-rpc', title='RPC in JSON', read_rpc=read,\n"
        "                             sniff=lambda path, head: head.startswith('{\"offsets\"')))\n"
    )
    one = [1.0] + [0.0] * 19
    line, sample = [0.0, 0.0, -1.0] + [0.0] * 17, [0.0, 1.0] + [0.0] * 18
    model = {"offsets": [500.0, 400.0, 31.0, 41.0, 100.0], "scales": [500.0, 400.0, 0.1, 0.1, 500.0],
             "coefficients": [line, one, sample, one]}  # fmt: skip
    (tmp_path / "image.json").write_text(json.dumps(model))
    words = ("project", tmp_path / "image.json", "--lon", 31.05, "--lat", 41.02, "--height", 100, "--json")
    ended = in_process("--plugin", tmp_path / "docs_rpc.py", *words)
    sys.modules.pop("docs_rpc", None)
    assert ended.code == 0, ended.stderr
    (point,) = ended.json["points"]
    assert (point["line"], point["sample"]) == (pytest.approx(400.0, abs=1e-6), pytest.approx(600.0, abs=1e-6))


# --- a sensor ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def parallel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the folder of the images that the page simulates, and the names that its block defines.

    They are shifts, matrices, place.
    """
    folder, names = tmp_path_factory.mktemp("parallel"), dict[str, Any]()
    with contextlib.chdir(folder):
        pages.run_python(python_of(repository, "sensor")[1], names)
    return folder, names


@pytest.mark.oracle
def test_sensor_in_a_project_file(parallel: tuple[Path, dict[str, Any]], files: dict[str, Path]) -> None:
    """A block of the page's sensor is adjusted, its planted shifts are found, and ``locate`` applies them."""
    folder, true = parallel
    own = ("--plugin", files["sensor"])
    ended = in_process(*own, "adjust", folder / "project.toml", "--out", folder / "result", "--json")
    assert ended.code == 0, ended.stderr
    assert ended.json["backend"] == "graph"
    assert ended.json["sigma0_interval_99_9"][0] < ended.json["sigma0"] < ended.json["sigma0_interval_99_9"][1]
    solution = fg.adjust(fg.read_project(folder / "project.toml"), backend="dense")
    for name, shift in true["SHIFTS"].items():
        sigma = np.sqrt(np.diag(solution.covariance(f"image:{name}").values))
        assert np.abs(solution.correction(name) - shift).max() < 4.0 * sigma.max() < 1.0
        pixel = ("--line", 400, "--sample", 1700, "--height", 250)
        words = (*own, "locate", folder / f"{name}.parallel", *pixel, "--result", folder / "result", "--json")
        place = in_process(*words).json["points"][0]
        where = place_of(true["PLACE"], np.array(true["MATRICES"][name]), np.subtract((400.0, 1700.0), shift), 250.0)
        assert np.linalg.norm([place["x_m"], place["y_m"], place["z_m"]] - where) < 3.0
    lon, lat, height = true["PLACE"]
    outside = in_process(*own, "project", folder / "left.parallel", "--lon", lon, "--lat", lat, "--height", height)
    assert "999.500" in outside.stdout
    rng, setup = np.random.default_rng(3), np.array([[0.0, 1.0], [2.0, 3.0]])
    for _ in range(5):
        unknowns = rng.normal(size=2), rng.normal(size=3)
        check_jacobians(_contract.registered()["docs_parallel"], rng.normal(size=13), setup, *unknowns)


@pytest.mark.consistency
def test_a_new_equation_of_image_points_runs_on_all_backends(
    parallel: tuple[Path, dict[str, Any]], files: dict[str, Path]
) -> None:
    """The page's equation has the same solution on all backends.

    It is only registered; the Schur backend compiles its own loop over it.
    """
    load_plugin(files["sensor"])
    block = fg.read_project(parallel[0] / "project.toml")
    schur, *others = (fg.adjust(block, backend=backend) for backend in ("schur", "graph", "dense"))
    assert schur.backend == "schur" and schur.redundancy == 38
    for other in others:
        assert np.abs(schur.state.image - other.state.image).max() <= 1e-10
        assert np.nanmax(np.abs(schur.ground_m - other.ground_m)) <= 1e-6
        assert schur.chi2 == pytest.approx(other.chi2, rel=1e-10)


@pytest.mark.behaviour
def test_a_wrong_kernel_of_a_new_equation_is_named(
    parallel: tuple[Path, dict[str, Any]], files: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kernel with one column too few is refused with equation, image point and shape."""
    text = files["sensor"].read_text().replace("docs_parallel", "docs_narrow").replace('"parallel"', '"narrow"')
    own = tmp_path / "docs_narrow.py"
    own.write_text(text.replace("np.diag(record[RECORD.weight] * setup[1])", "np.zeros((2, 1))"))
    others = {name: known for name, known in format_registry._REGISTRY.items() if name != "parallel"}
    monkeypatch.setattr(format_registry, "_REGISTRY", others)
    load_plugin(own)
    block = fg.read_project(parallel[0] / "project.toml")
    problem = compile_problem(block)
    for backend in (SchurBackend(problem), DenseBackend(problem)):
        with pytest.raises(ValueError, match=r"'docs_narrow', image left, point P\d+: Jacobian 1 has shape \(2, 1\)"):
            backend.linearise(problem.start)
    sys.modules.pop("docs_narrow", None)


def place_of(middle: tuple[float, float, float], matrix: np.ndarray, pixel: np.ndarray, height_m: float) -> np.ndarray:
    """Return the ground point by Newton on East, North, Up, its height being that above the ellipsoid."""
    enu, axes = np.zeros(3), enu_from_ecef(*middle[:2])[0]
    centre = geodetic_to_ecef(*middle)[0]
    for _ in range(10):
        height = ecef_to_geodetic((centre + enu @ axes)[None])[2][0]
        miss = np.array([*(pixel - [999.5, 1199.5] - matrix @ enu), height_m - height])
        enu = enu + np.linalg.solve(np.vstack([matrix, [0.0, 0.0, 1.0]]), miss)
    return np.asarray(centre + enu @ axes)


# --- an equation -----------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_equation_in_a_block(files: dict[str, Path], block: Block) -> None:
    """The page's distance to a check point, 5 m too long, moves the point to this distance."""
    page = load_plugin(files["equation"])
    rng = np.random.default_rng(3)
    for _ in range(5):
        record = page.TAPE.pack(station=rng.normal(size=3), distance=2.0, sigma=0.01)
        check_jacobians(page.DISTANCE, record, np.zeros((2, 0)), rng.normal(size=3) + 5.0)
    before = fg.adjust(block, backend="graph")
    j = int(block.points.where(fg.Role.CHECK)[0])
    up = before.problem.axes(before.ground_m[j][None])[0, 2]
    station = before.ground_m[j] + 2000.0 * up
    record = np.array([*(station - before.problem.origin_m), 2005.0, 0.01])
    name = block.points.ids[j]
    tape = fg.ExtraObservation(page.DISTANCE, (f"point:{name}",), record, np.zeros((2, 0)), 1, f"distance to {name}")
    after = fg.adjust(replace(block, extra=(tape,)), backend="dense")
    assert after.redundancy == before.redundancy + 1
    assert np.linalg.norm(after.ground_m[j] - station) == pytest.approx(2005.0, abs=0.05)
    schur = fg.adjust(replace(block, extra=(tape,)), backend="schur")
    assert schur.ground_m == pytest.approx(after.ground_m, abs=1e-5)


# --- solver and kappa rule -------------------------------------------------------------------------


@pytest.mark.behaviour
def test_solver_in_a_comparison(files: dict[str, Path], twin: Path, tmp_path: Path) -> None:
    """In a comparison the page's solver has the accuracy of QR, and its Tikhonov solver another one."""
    words = ("compare", twin, "--solvers", "qr,docs_cgls,docs_tikhonov", "--eop-sets", "2", "--types", "2",
             "--backends", "faithful,dense", "--out", tmp_path / "comparison", "--json")  # fmt: skip
    ended = in_process("--plugin", files["solver"], "--plugin", files["kappa-rule"], *words)
    assert ended.code == 0, ended.stderr
    rmse = {(row["backend"], row["solver"]): row["check_rmse_m"] for row in ended.json["rows"]}
    for backend in ("faithful", "dense"):
        assert rmse[backend, "docs_cgls"] == pytest.approx(rmse[backend, "qr"], rel=1e-6)
    assert 0.01 < abs(rmse["faithful", "docs_tikhonov"] - rmse["faithful", "qr"]) < 1.0
    assert rmse["dense", "docs_tikhonov"] is None
    assert "docs_tikhonov: left out" in ended.stdout
    unknown = in_process(*words[:3], "qr,docs_nothing", "--out", tmp_path / "none")
    assert (unknown.code, "docs_nothing" in unknown.stderr) == (2, True)


@pytest.mark.oracle
def test_solver_and_rule_against_formed_matrices(files: dict[str, Path]) -> None:
    """The page's solver equals least squares, and its rule minimises Mallows' prediction error."""
    load_plugin(files["solver"]), load_plugin(files["kappa-rule"])
    rng = np.random.default_rng(4)
    design, observed = rng.normal(size=(12, 4)), rng.normal(size=12)
    system = LinearSystem.from_design(design, observed)
    assert np.abs(solve("docs_cgls", system).x - np.linalg.lstsq(design, observed, rcond=None)[0]).max() <= 1e-12
    choice = choose_kappa("docs_mallows", system, Given(sigma_observed=0.5))

    def risk(parameter: float) -> float:
        hat = design @ np.linalg.solve(design.T @ design + parameter * np.eye(4), design.T)
        return float(np.sum((observed - hat @ observed) ** 2) + 2.0 * 0.25 * np.trace(hat))

    assert choice.grid is not None
    assert risk(choice.kappa) <= min(risk(parameter) for parameter in choice.grid) + 1e-12
    assert solve("docs_tikhonov", system).kappa == choose_kappa("docs_mallows", system, Given(sigma_observed=1.0)).kappa


# --- a loss ----------------------------------------------------------------------------------------


@pytest.mark.oracle
def test_loss_in_an_adjustment(files: dict[str, Path], twin: Path, tmp_path: Path) -> None:
    """With the page's loss the weights of the table follow from its residuals, and its cost is the integral."""
    out = tmp_path / "result"
    ended = in_process("--plugin", files["loss"], "adjust", twin, "--loss", "docs_fair", "--out", out, "--json")
    assert ended.code == 0, ended.stderr
    assert ended.json["loss"] == "docs_fair"
    with (out / "residuals.csv").open() as stream, (out / "points.csv").open() as points:
        roles, rows = {row["id"]: row["role"] for row in csv.DictReader(points)}, list(csv.DictReader(stream))
    square = [sum((float(row[f"v_{a}_px"]) / float(row[f"sigma_{a}_px"])) ** 2 for a in ("line", "sample"))
              for row in rows]  # fmt: skip
    for row in rows:
        mine = [s for s, other in zip(square, rows, strict=True) if other["id"] == row["id"]]
        two = len(mine) == 2 and roles[row["id"]] != "control"  # both rays have the mean of their squares
        u = np.sqrt(np.mean(mine) if two else square[rows.index(row)]) / 1.223
        assert float(row["weight"]) == pytest.approx(1.0 / (1.0 + u), abs=1e-4)
    u = np.linspace(0.0, 6.0, 6001)
    for name in ("docs_fair", "docs_halving"):
        own = losses.losses()[name]
        inside = np.abs(u - 1.0) > 2e-3  # the corner of the second one
        slope = np.gradient(own.cost(u), u, edge_order=2) - u * own.weight(u)
        assert np.abs(slope[inside]).max() <= 2e-6  # step 1e-3, squared


# --- loading ---------------------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("absent.py", None, "no Python file of this name"),
        ("two words.py", "", "no Python file of this name"),
        ("numpy.py", "", "another module has this name"),
        ("docs_fails.py", "x = 1\ny = 1 / 0\n", "docs_fails.py, line 2"),
        ("docs_wrong.py", "x = 1\nif x\n", "docs_wrong.py, line 2"),
    ],
)
def test_files_that_cannot_be_loaded(name: str, text: str | None, said: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    ended = in_process("--plugin", tmp_path / name, "doctor", "--json")
    assert ended.code == 2
    assert len(ended.stderr.strip().splitlines()) == 1
    assert said in ended.stderr
    assert Path(name).stem not in sys.modules or name == "numpy.py"


@pytest.mark.behaviour
def test_a_reader_that_stumbles_is_named_with_its_line(
    files: dict[str, Path], tmp_path: Path, registries: pytest.MonkeyPatch
) -> None:
    """A plugin that raises an error is named with its line and the file, with exit code 2.

    It does not count as an error of the program.
    """
    image = tmp_path / "left.parallel"
    words = ("--plugin", files["sensor"], "locate", image, "--line", 1, "--sample", 1, "--height", 0)
    missing = in_process(*words)
    assert (missing.code, missing.stderr) == (2, f"error: {image}, metadata: the file does not exist; check the path\n")
    image.write_text('{"lines": 5}')
    ended = in_process(*words)
    line = 1 + next(k for k, text in enumerate(files["sensor"].read_text().splitlines()) if 'found["place"]' in text)
    assert ended.code == 2 and len(ended.stderr.splitlines()) == 1 and "error of the program" not in ended.stderr
    assert ended.stderr.startswith(
        f"error: {image}, reader parallel: the plugin that reads the file, {files['sensor']}, line {line},"
    )
    assert "(found KeyError: 'place'); correct the plugin there" in ended.stderr
    assert "Traceback" in in_process(*words, "--debug").stderr
    told = in_process(*words, "--json")
    assert (told.code, [e["code"] for e in told.json["errors"]]) == (2, ["sensor.own_reader"])
    with pytest.raises(fg.InputError) as caught:
        fg.read_sensor(image)
    assert isinstance(caught.value.__cause__, KeyError)


@pytest.mark.behaviour
def test_any_other_exception_of_a_plugin_is_named_too(
    parallel: tuple[Path, dict[str, Any]], files: dict[str, Path], tmp_path: Path, registries: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "docs_stumbles.py"
    text = files["sensor"].read_text().replace("docs_parallel", "docs_stumbles").replace('"parallel"', '"stumbles"')
    own.write_text(text.replace(".parallel", ".stumbles").replace("return start, np.tile", "return start, np.tyle"))
    image = tmp_path / "left.stumbles"
    image.write_bytes((parallel[0] / "left.parallel").read_bytes())
    words = ("--plugin", own, "locate", image, "--line", 1, "--sample", 1, "--height", 0)
    ended = in_process(*words)
    sys.modules.pop("docs_stumbles", None)
    line = 1 + next(k for k, text in enumerate(own.read_text().splitlines()) if "np.tyle" in text)
    assert ended.code == 2 and ended.stderr.startswith(f"error: {own}, line {line}: the plugin raised an exception ")
    assert "AttributeError" in ended.stderr


@pytest.mark.behaviour
def test_the_environment_names_files_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FG_ORIENT_PLUGIN", str(tmp_path / "absent.py"))
    ended = in_process("report", tmp_path)
    assert (ended.code, "absent.py" in ended.stderr) == (2, True)


@pytest.mark.behaviour
def test_a_file_is_loaded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "docs_counts.py"
    path.write_text("loaded = object()\n")
    first: ModuleType = load_plugin(path)
    again: Any = load_plugin(path)
    monkeypatch.delitem(sys.modules, "docs_counts")
    assert first.loaded is again.loaded


# --- files that cannot be loaded -----------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("code", "place", "said"),
    [
        ("x = 1\nraise ValueError('two\\nlines')\n", "line 2", "ValueError: two lines"),
        ("import sys\nsys.exit(0)\n", "line 2", "SystemExit: 0"),  # it ended the command with exit code 0
    ],
)
def test_a_plugin_that_ends_is_named(tmp_path: Path, code: str, place: str, said: str) -> None:
    file = tmp_path / "ends_early.py"
    file.write_text(code, "utf-8")
    ended = in_process("--plugin", file, "completion", "bash")
    assert (ended.code, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"error: {file}, {place}: the plugin cannot be loaded (found {said})")
