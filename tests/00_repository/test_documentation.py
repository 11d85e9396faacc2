"""The tests run the code blocks and the commands of the documentation, and compare its table of EOPs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(path: Path, language: str) -> list[str]:
    """Return the fenced code of a language in a Markdown file."""
    return [code for name, code in BLOCK.findall(path.read_text("utf-8")) if name == language]


def test_eop_table_of_the_concepts_page_lists_the_published_sets(repository: Path) -> None:
    from fg_orient.model.names import EOP_SETS
    from fg_orient.studies.tables_spot5 import PUBLISHED_SETS

    text = (repository / "docs" / "concepts.md").read_text("utf-8")
    table = {int(n): name for n, name in re.findall(r"\| (\d+) \| `(\w+)`", text)}
    assert table == {number: EOP_SETS[number].name for number in PUBLISHED_SETS}


def test_page_of_bad_input_lists_each_limit_of_files(repository: Path) -> None:
    """The table of limits in docs/bad-input.md names all limits that ``FG_ORIENT_LIMITS`` can change."""
    from fg_orient.model.limits import LIMITS

    page = (repository / "docs" / "bad-input.md").read_text("utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(re.findall(r"`(\w+)`", " ".join(rows))) >= set(LIMITS)


def test_prior_sigmas_of_the_concepts_page_are_the_defaults(repository: Path) -> None:
    from fg_orient.model.block import Options

    text = (repository / "docs" / "concepts.md").read_text("utf-8")
    options, number = Options(), r"([\d.]+)"
    for kind, unit, scale, sigmas in (
        ("position", "m", 1.0, options.position_sigma_m),
        ("velocity", "m/s", 1.0, options.velocity_sigma_m_s),
        ("attitude", "µrad", 1e-6, options.attitude_sigma_rad),
    ):
        row = re.search(rf"\| {kind} \| {number} {unit} \| {number} {unit} \| {number} {unit} \|", text)
        assert row is not None
        assert [float(x) * scale for x in row.groups()] == pytest.approx(sigmas, rel=1e-12, abs=0.0)


def test_commands_of_the_readme_exist(repository: Path) -> None:
    """README and quick start show every command of the command line, and no command that does not exist."""
    import typer.main

    from fg_orient.cli import app

    known = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    text = "\n".join(code for name in ("README.md", "docs/quickstart.md") for code in blocks(repository / name, "sh"))
    shown = set(re.findall(r"fg-orient ([\w-]+)", text))
    assert shown - known == set()
    assert known - shown == set()


def test_project_file_of_the_readme_is_valid(repository: Path) -> None:
    from fg_orient.formats.schema import ProjectFile, validate

    (text,) = blocks(repository / "README.md", "toml")
    project = validate(tomllib.loads(text), "README.md", ProjectFile)
    assert [image.id for image in project.images] == ["left", "right"]


def test_links_between_pages_exist(repository: Path) -> None:
    pages = [*repository.glob("*.md"), *(repository / "docs").rglob("*.md")]
    missing = [
        f"{page.relative_to(repository)}: {target}"
        for page in pages
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text("utf-8"))
        if not (page.parent / target).exists()
    ]
    assert missing == []
