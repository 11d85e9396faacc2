"""What computes may not import what was published: planting such an import breaks the contract."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CONTRACT = "what computes may not import what was published"


@pytest.fixture(scope="module")
def tree(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the packages and the contracts."""
    folder = tmp_path_factory.mktemp("tree")
    for package in ("factors", "fg_orient"):
        shutil.copytree(repository / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(repository / "pyproject.toml", folder)
    return folder


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("experiments/tables_spot5.py", "import fg_orient.published.tables"),
        ("classical/two_stage.py", "def f():\n    import fg_orient.published"),
        ("cli/reproduce.py", "def f():\n    from fg_orient.published.tables import load"),
    ],
)
def test_planted_import_is_caught(tree: Path, module: str, line: str) -> None:
    path = tree / "fg_orient" / module
    text = path.read_text("utf-8")
    path.write_text(f"{text}\n\n{line}\n", "utf-8")
    code = (
        "import sys; sys.path.insert(0, '.'); from importlinter.cli import lint_imports; "
        "sys.exit(lint_imports(cache_dir=None))"
    )
    try:
        done = subprocess.run([sys.executable, "-c", code], cwd=tree, capture_output=True, text=True, timeout=120)
    finally:
        path.write_text(text, "utf-8")
    assert done.returncode != 0
    assert any(CONTRACT in row for row in done.stdout.splitlines() if " BROKEN" in row), done.stdout


#: Tables that a comparison writes.
OWN_TABLES = ("compare.csv", "spectra.csv", "directions.csv", "l_curves.csv")


def test_no_published_number_is_computed_from_a_file(repository: Path) -> None:
    """The computing packages do not open the tables by path either."""
    for package in ("experiments", "classical", "linear", "adjustment", "comparison"):
        for path in (repository / "fg_orient" / package).rglob("*.py"):
            text = path.read_text("utf-8")
            for written in OWN_TABLES:
                text = text.replace(f'"{written}"', "")
            assert "published/" not in text and ".csv" not in text, path
