"""What the documentation says is run: its code blocks, its EOP table, its commands."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(path: Path, language: str) -> list[str]:
    """Fenced code of a language in a Markdown file."""
    return [code for name, code in BLOCK.findall(path.read_text("utf-8")) if name == language]


def test_own_equation_solver_and_rule_of_the_extending_page_work(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs the page top to bottom as one module, checks its Jacobian by complex step, its solvers against LAPACK."""
    import numpy as np

    from factors import _contract, losses
    from fg_orient.linear import kappa, registry

    registry.solvers(), kappa.kappa_rules(), losses.losses()  # all loaded before the copies
    for module in (_contract, registry, kappa, losses):
        monkeypatch.setattr(module, "_REGISTRY", dict(module._REGISTRY))
    path = tmp_path / "extending_page.py"
    path.write_text("\n".join(blocks(repository / "docs" / "extending.md", "python")), "utf-8")
    spec = importlib.util.spec_from_file_location("extending_page", path)
    assert spec is not None and spec.loader is not None
    page = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "extending_page", page)
    spec.loader.exec_module(page)
    equation = _contract.registered()["docs_distance"]
    state = equation.example(np.random.default_rng(3))
    ground, step = state.unknowns[0], 1e-30
    value, jacobian = equation.kernel(state.record, state.setup, ground, True)
    numeric = [
        equation.residual(state.record, state.setup, ground + step * 1j * np.eye(3)[k])[0].imag / step for k in range(3)
    ]
    # the complex step has no truncation error at 1e-30: a few roundings of the row's largest element remain
    assert np.abs(jacobian[0] - numeric).max() <= 1e-14 * np.abs(jacobian).max()
    assert equation.kernel(state.record, state.setup, ground, False)[0] == value
    _check_linear(np.random.default_rng(4))
    u = np.linspace(0.0, 6.0, 6001)
    own = losses.losses()["docs_fair"]
    assert np.abs(np.gradient(own.cost(u), u, edge_order=2) - u * own.weight(u)).max() <= 1e-6  # step 1e-3, squared


def _check_linear(rng: Any) -> None:
    """The page's solver equals least squares; its rule is Mallows' prediction error, from matrices formed here."""
    import numpy as np

    from fg_orient.linear.kappa import Given, choose_kappa
    from fg_orient.linear.registry import solve
    from fg_orient.linear.system import LinearSystem

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


def test_eop_table_of_the_concepts_page_is_that_of_the_code(repository: Path) -> None:
    from fg_orient.parameters import EOP_SETS

    text = (repository / "docs" / "concepts.md").read_text("utf-8")
    table = {int(n): name for n, name in re.findall(r"\| (\d+) \| `(\w+)`", text)}
    assert table == {number: entry[0] for number, entry in EOP_SETS.items()}


def test_prior_sigmas_of_the_concepts_page_are_the_defaults(repository: Path) -> None:
    from fg_orient.block import Options

    text = (repository / "docs" / "concepts.md").read_text("utf-8")
    options, number = Options(), r"([\d.]+)"
    for kind, unit, scale, sigmas in (
        ("position", "m", 1.0, options.position_sigma_m),
        ("velocity", "m/s", 1.0, options.velocity_sigma_m_s),
        ("attitude", "µrad", 1e-6, options.attitude_sigma_rad),
    ):
        row = re.search(rf"\| {kind} \| {number} {unit} \| {number} {unit} \| {number} {unit} \|", text)
        assert row is not None
        assert [float(x) * scale for x in row.groups()] == pytest.approx(sigmas, rel=1e-12)


def test_commands_of_the_readme_exist(repository: Path) -> None:
    """Every command shown in README and quick start is one of the command line, and the other way round."""
    import typer.main

    from fg_orient.cli import app

    known = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    text = "\n".join(code for name in ("README.md", "docs/quickstart.md") for code in blocks(repository / name, "sh"))
    shown = set(re.findall(r"fg-orient (\w+)", text))
    assert shown - known == set()
    assert known - shown == set()


def test_project_file_of_the_readme_is_valid(repository: Path) -> None:
    from fg_orient.io.schema import ProjectFile, validate

    (text,) = blocks(repository / "README.md", "toml")
    project = validate(tomllib.loads(text), "README.md")
    assert isinstance(project, ProjectFile), project
    assert [image.id for image in project.images] == ["left", "right"]


def test_links_between_pages_exist(repository: Path) -> None:
    pages = [*repository.glob("*.md"), *(repository / "docs").glob("*.md")]
    missing = [
        f"{page.name}: {target}"
        for page in pages
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text("utf-8"))
        if not (page.parent / target).exists()
    ]
    assert missing == []
