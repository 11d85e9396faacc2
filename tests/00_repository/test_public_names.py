"""docs/api.md lists the names in ``__all__`` of each module that it names."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

ROW = re.compile(r"^\| `(fg_orient[\w.]*)` \|.*\| (`.*`) \|$", re.MULTILINE)


def listed(repository: Path) -> dict[str, list[str]]:
    """Return the names of docs/api.md by module."""
    found: dict[str, list[str]] = {}
    for module, names in ROW.findall((repository / "docs" / "api.md").read_text("utf-8")):
        found.setdefault(module, []).extend(re.findall(r"`(\w+)`", names))
    return found


def test_page_lists_what_the_modules_declare(repository: Path) -> None:
    for module, names in listed(repository).items():
        assert sorted(names) == sorted(import_module(module).__all__), module


def test_listed_names_exist(repository: Path) -> None:
    modules = listed(repository)
    assert {"fg_orient", "fg_orient.closerange", "fg_orient.rpc", "fg_orient.rectification"} <= set(modules)
    for module, names in modules.items():
        for name in names:
            assert getattr(import_module(module), name) is not None, (module, name)


def test_what_declares_public_names_is_on_the_page(repository: Path) -> None:
    files = [path for path in (repository / "fg_orient").rglob("*.py") if "cli" not in path.parts]
    declaring = {path for path in files if re.search(r"^__all__", path.read_text("utf-8"), re.MULTILINE)}
    named = {
        ".".join(path.relative_to(repository).with_suffix("").parts).removesuffix(".__init__") for path in declaring
    }
    assert named == set(listed(repository))
