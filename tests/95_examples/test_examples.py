"""Every example runs and prints what docs/examples.md shows, with real files where they exist."""

from __future__ import annotations

import ast
import json
import re
import tempfile
from pathlib import Path

import pandas
import pytest

from factors import _contract
from tests.support.examples import PAGE, check_shown, shown_of
from tests.support.pages import run_script


def run(repository: Path, name: str, *arguments: str, shown: bool = True) -> str:
    """Run an example in this process, where warnings are errors; the imports of an interpreter take longer than it."""
    ended = run_script(repository / "examples" / name, *arguments)
    assert ended.code == 0, ended.stderr
    if shown:
        check_shown(repository, name, ended)
    return ended.stdout


@pytest.mark.repository
def test_every_example_has_a_test(repository: Path) -> None:
    text = Path(__file__).read_text() + (repository / "tests/80_claims/test_pleiades_pair.py").read_text()
    examples = list((repository / "examples").glob("*.py"))
    assert examples
    for path in examples:
        assert path.name in text or path.stem in text


@pytest.mark.repository
def test_every_example_is_shown_with_its_source(repository: Path) -> None:
    names = {path.name for path in (repository / "examples").glob("*.py")}
    page = (repository / PAGE).read_text("utf-8")
    assert set(shown_of(repository)) == names
    assert set(re.findall(r"{literalinclude} \.\./examples/(\S+)", page)) == names
    assert all(f"[{name}](#" in page for name in names)


@pytest.mark.behaviour
def test_orient_twin_and_read_its_image(repository: Path, tmp_path: Path) -> None:
    out = run(repository, "orient_twin.py", str(tmp_path / "twin"))
    assert out.count("converged") == 3
    assert "velocity across track acts as yaw" in out
    assert (tmp_path / "twin" / "project.toml").is_file()
    out = run(repository, "read_dimap.py", str(tmp_path / "twin" / "left.DIM"), "100", "200.5", "300")
    assert "and back: line 100.000000, sample 200.500000" in out


@pytest.mark.behaviour
def test_own_factor(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example of an own factor has exact derivatives and holds the measured distance.

    It uses a copy of the registry, because other tests use the registry.
    """
    monkeypatch.setattr(_contract, "_REGISTRY", dict(_contract._REGISTRY))
    out = run(repository, "own_factor.py")
    assert float(re.search(r"complex step to (\S+)", out).group(1)) < 1e-12
    assert "redundancy 158 -> 159" in out
    before, after = (abs(float(v)) for v in re.search(r"distance: (\S+) m -> (\S+) m", out).groups())
    assert before > 0.05  # without the tape
    assert after < 0.03  # its sigma is 0.01 m


@pytest.mark.behaviour
def test_factor_graph(repository: Path) -> None:
    out = run(repository, "factor_graph.py")
    assert "redundancy 158 -> 161" in out  # three components of the baseline
    before, after = (float(v) for v in re.findall(r"the factor: (\S+) m", out))
    assert before > 1.0
    assert after < 0.03  # its sigma is 0.01 m
    assert out.endswith("converged, the same points: True\n")


@pytest.mark.behaviour
@pytest.mark.slow
def test_program_as_run(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = run(repository, "program_as_run.py", "--only", "D5", "--out", "figures")
    text, program = (
        float(v) for v in re.search(r"after step 1: equations (\S+), program (\S+) m", out).groups()
    )  # fmt: skip
    assert text < 1e-6 < 0.1 < program
    assert (tmp_path / "figures" / "program-as-run.svg").stat().st_size > 10_000


@pytest.mark.behaviour
def test_ill_conditioning(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = run(repository, "ill_conditioning.py", "--seeds", "1", "--out", "figures")
    assert re.search(r"orthonormal: control-point RMSE \[0\. 0\. 0\.\] m", out)
    size, scatter = (float(v) for v in re.search(r"as run: .* mean (\S+) m, scatter (\S+) m", out).groups())
    assert 0.7 < size < 1.0
    assert scatter < 0.02
    assert len(list((tmp_path / "figures").glob("*.svg"))) == 3


@pytest.mark.behaviour
def test_rpc_bundle(repository: Path) -> None:
    out = run(repository, "rpc_bundle.py")
    found = re.search(r"left: line (\S+) \(\S+\), sample (\S+)", out).groups()
    assert [float(v) for v in found] == pytest.approx([3.0, -16.0], abs=0.2)
    assert float(re.search(r"differ by (\S+) prior sigmas", out).group(1)) < 1e-9
    assert re.findall(r"gross error: (.*?):", out) == ["point 06 in image right"]
    before, after = (float(v) for v in re.search(r"y-parallax (\S+) px before, (\S+) px after", out).groups())
    assert after < 0.6 < 5.0 < before
    assert out.count("shifted together") == 3


@pytest.mark.behaviour
@pytest.mark.slow
def test_incremental(repository: Path) -> None:
    out = run(repository, "incremental.py")
    assert "30 images: 0 ground points wait" in out
    assert "image image20, point 7; removed" in out
    assert [s for s in re.findall(r"sigma0 \S+, (\w+)", out)] == ["not_trustworthy", "converged"]
    assert float(re.search(r"adjustment by (\S+) prior", out).group(1)) < 1e-8


@pytest.mark.behaviour
def test_rectify_by_points(repository: Path) -> None:
    out = run(repository, "rectify_by_points.py")
    assert "suspected: 12\n" in out
    m0 = [float(v) for v in re.findall(r"m0 (\S+) m", out)]
    assert len(m0) == 3 and all(10.0 < v < 22.0 for v in m0)
    assert out.count("1:100000 passed") == 2


@pytest.mark.behaviour
@pytest.mark.real_data
@pytest.mark.parametrize(
    "name", ["geocosicorr3d/SPOT5.DIM", "geocosicorr3d/SPOT6.XML", "geoetrim-pleiades/DIM_PHR1A_derived_img1.XML"]
)
def test_read_dimap(repository: Path, real_data: Path, name: str) -> None:
    out = run(repository, "read_dimap.py", str(real_data / name), "100", "200.5", "300", shown=False)
    assert "and back: line 100.000000, sample 200.500000" in out


@pytest.mark.behaviour
def test_read_dimap_says_what_is_wrong(repository: Path, tmp_path: Path) -> None:
    missing = tmp_path / "nowhere.DIM"
    done = run_script(repository / "examples" / "read_dimap.py", missing)
    assert done.code == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert str(missing) in done.stderr


def cells_of(path: Path) -> list[str]:
    """Return the code cells of a notebook."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run_cells(cells: list[str]) -> list[object]:
    """Run code cells one after the other; the value of the last expression of each, as a notebook shows it."""
    names: dict[str, object] = {}
    shown = []
    for cell in cells:
        tree = ast.parse(cell)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, "<cell>", "exec"), names)
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), "<cell>", "eval"), names))
    return shown


@pytest.mark.behaviour
def test_notebook(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (notebook,) = (repository / "examples").glob("*.ipynb")
    shown = run_cells(cells_of(notebook))
    assert "converged" in repr(shown[0]) and "converged" in repr(shown[-1])
    assert all(hasattr(value, "_repr_html_") or isinstance(value, pandas.Series) for value in shown)
    with pytest.raises(ZeroDivisionError):
        run_cells(["1 / 0"])
