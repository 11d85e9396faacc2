"""Versions of Python, fg_orient and the distributions that it needs; found without importing them."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib import metadata
from typing import Final

#: Distributions whose versions decide on the digits of a result.
COMPUTING: Final = ("gtsam", "numpy", "scipy", "numba")
#: All that fg_orient needs.
REQUIRED: Final = (
    *COMPUTING, "llvmlite", "pyproj", "pyerfa", "lxml", "pydantic", "typer", "rich", "jinja2", "markupsafe",
    "threadpoolctl",
)  # fmt: skip
#: Those of the extras.
OPTIONAL: Final = ("rasterio", "pyogrio", "shapely", "pandas", "matplotlib", "dask")


def version_of(distribution: str) -> str | None:
    """Version of an installed distribution, None if it is missing."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def versions(distributions: Sequence[str] = COMPUTING) -> dict[str, str | None]:
    """Versions of Python, fg_orient and the given distributions."""
    import fg_orient

    found = {name: version_of(name) for name in distributions}
    return {"python": platform.python_version(), "fg_orient": fg_orient.__version__, **found}
