"""Each format has its page, the table of formats is that of the registry, the commands of the pages are commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer.main

from fg_orient.cli import app
from fg_orient.formats.exchange.registry import Format, formats

pytestmark = pytest.mark.repository


def table(repository: Path) -> list[str]:
    text = (repository / "docs" / "formats" / "index.md").read_text("utf-8")
    return re.findall(r"^\| \[.*\|$", text, re.MULTILINE)


def row(f: Format) -> str:
    pixel = "-" if f.first_pixel is None else "{:g}, {:g}".format(*f.first_pixel)
    cells = f"[{f.name}]({f.name}.md)", ", ".join(f.files), pixel, f.ground_axes, f.evidence or "**unverified**"
    return f"| {' | '.join(cells)} |"


def test_the_table_of_formats_is_that_of_the_registry(repository: Path) -> None:
    assert table(repository) == [row(f) for f in formats().values()]


@pytest.mark.parametrize("name", sorted(formats()))
def test_every_format_has_a_page_that_says_whether_it_was_tried(repository: Path, name: str) -> None:
    page = (repository / "docs" / "formats" / f"{name}.md").read_text("utf-8")
    assert page.startswith(f"# {name}: ")
    said = "unverified" in page.partition("|")[0].lower()  # above the table: of this format, not of others
    assert said is not formats()[name].verified
    assert re.search(rf"^{name}$", (repository / "docs" / "formats" / "index.md").read_text("utf-8"), re.MULTILINE)


def test_options_of_the_pages_exist(repository: Path) -> None:
    command = typer.main.get_command(app).commands["convert"]  # type: ignore[attr-defined]
    known = {option for parameter in command.params for option in parameter.opts}
    text = "\n".join(page.read_text("utf-8") for page in (repository / "docs" / "formats").glob("*.md"))
    shown = {word for line in re.findall(r"^fg-orient convert (.*)$", text, re.MULTILINE) for word in line.split()}
    assert {word for word in shown if word.startswith("--")} - known == set()
