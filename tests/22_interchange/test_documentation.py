"""Each format has its page, the table of formats equals the registry, and the commands of the pages exist."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
import typer.main

from fg_orient.cli import app
from fg_orient.formats.registry import formats

pytestmark = pytest.mark.repository


def test_the_table_of_formats_is_that_of_the_registry(repository: Path) -> None:
    made = runpy.run_path(str(repository / "docs" / "formats.py"))
    text = (repository / "docs" / "formats" / "index.md").read_text("utf-8")
    assert made["page"](text) == text
    assert all(made["row"](one) in text for one in formats().values())


@pytest.mark.parametrize("name", sorted(formats()))
def test_every_format_has_a_page_that_says_whether_it_was_tried(repository: Path, name: str) -> None:
    page = (repository / "docs" / "formats" / f"{name}.md").read_text("utf-8")
    assert page.startswith(f"# {name}: ")
    said = "unverified" in page.partition("|")[0].lower()  # above the table: of this format, not of others
    assert said is not formats()[name].verified


def test_options_of_the_pages_exist(repository: Path) -> None:
    command = typer.main.get_command(app).get_command(None, "convert")  # type: ignore[attr-defined]
    known = {option for parameter in command.params for option in parameter.opts}
    text = "\n".join(page.read_text("utf-8") for page in (repository / "docs" / "formats").glob("*.md"))
    shown = {word for line in re.findall(r"^fg-orient convert (.*)$", text, re.MULTILINE) for word in line.split()}
    assert {word for word in shown if word.startswith("--")} - known == set()
