"""A change of a text fails if the old text is missing, because the test would then prove nothing."""

from __future__ import annotations

from pathlib import Path


def changed(text: str, *changes: tuple[str, str]) -> str:
    """Replace the first occurrence of each old text; fail if there is none."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def change_file(path: Path, *changes: tuple[str, str]) -> Path:
    """Change the text of a file in its place, and give its path."""
    path.write_text(changed(path.read_text("utf-8"), *changes), encoding="utf-8")
    return path
