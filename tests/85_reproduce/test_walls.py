"""Code that computes may not read published values; test_architecture.py forbids the import."""

from __future__ import annotations

from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

#: Tables that a comparison writes.
OWN_TABLES = (
    "compare.csv", "spectra.csv", "directions.csv", "l_curves.csv", "sets.csv",
    "scale.csv", "orderings.csv", "exponents.csv", "error_vectors.csv",
)  # fmt: skip


def test_no_published_number_is_computed_from_a_file(repository: Path) -> None:
    """No module that computes contains the path of a published table."""
    for files in ("studies/*.py", "studies/comparison/*.py", "adjustment/**/*.py"):
        paths = list((repository / "fg_orient").glob(files))
        assert len(paths) > 5, files
        for path in paths:
            text = path.read_text("utf-8")
            for written in OWN_TABLES:
                text = text.replace(f'"{written}"', "")
            assert "published/" not in text and ".csv" not in text, path
