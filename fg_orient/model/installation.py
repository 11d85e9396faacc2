"""Versions of installed distributions; cause and remedy if Python does not find our package ``factors``.

Another distribution is called ``factors``, and users may have files of that name. ``import fg_orient`` imports this
module only if something is wrong.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from fg_orient.model.errors import Finding, finding

#: Distributions whose versions influence the digits of a result.
COMPUTING: Final = ("gtsam", "numpy", "scipy", "numba")
#: All distributions that fg_orient needs.
REQUIRED: Final = (
    *COMPUTING, "llvmlite", "pyproj", "pyerfa", "lxml", "pydantic", "typer", "rich", "jinja2", "markupsafe",
    "threadpoolctl", "orjson",
)  # fmt: skip
#: Distributions needed by the extras.
OPTIONAL: Final = (
    "rasterio", "pyogrio", "shapely", "opencv-python-headless", "pandas", "openpyxl", "pyarrow", "matplotlib", "dask",
    "laspy", "lazrs", "python-flint", "cryptography",
)  # fmt: skip
_HOME: Final = Path(__file__).resolve().parents[2]
_OURS: Final = _HOME / "factors"


def version_of(distribution: str) -> str | None:
    """Return the version of an installed distribution, None if it is missing."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def versions(distributions: Sequence[str] = COMPUTING) -> dict[str, str | None]:
    """Return the versions of Python, of fg_orient and of the given distributions."""
    import fg_orient

    found = {name: version_of(name) for name in distributions}
    return {"python": platform.python_version(), "fg_orient": fg_orient.__version__, **found}


def stamp(command: Sequence[str]) -> dict[str, Any]:
    """Return versions, command line (file names without folders) and time of a run, for its record."""
    words, now = [_without_folders(word) for word in command], datetime.now(UTC).isoformat(timespec="seconds")
    return {"versions": versions(), "command": words, "date_time_utc": now}


def _without_folders(word: str) -> str:
    option, equals, value = word.partition("=")
    if equals and option.startswith("--"):
        return f"{option}={_without_folders(value)}"
    return Path(word).name if Path(word).is_absolute() else word


def is_ours(found: str) -> bool:
    """Return whether a file belongs to fg_orient. Links are followed first."""
    return os.path.realpath(os.path.dirname(found)) == os.path.realpath(_OURS)


def clash(found: str | None, version: str, other: object = None) -> ImportError | SystemExit:
    """Return the error for a foreign package ``factors``: its file, the distribution that owns it, and a remedy.

    The command ``fg-orient`` cannot catch an error of this import, so it ends with the text and exit code 1.

    Parameters
    ----------
    found : str or None
        File of the package ``factors`` found by Python; None if there is none, or if it has no ``__init__``.
    version : str
        Version of ``fg_orient``.
    other : object
        Mark of the imported ``factors``: the fg_orient version to which it belongs.
    """
    ours = _OURS / "__init__.py"
    file = ours if found is None or not ours.exists() else Path(found)
    text = str(_own(file, version, other) if is_ours(str(file)) else _hidden(file))
    if Path(*sys.argv[:1]).name == "fg-orient":
        return SystemExit(f"error: {text}")
    return ImportError(text, name="factors", path=str(file))


def shared_file() -> Finding | None:
    """Return a warning if another distribution also lists our file."""
    file = _OURS / "__init__.py"
    owner = _owner(file)
    if owner is None:
        return None
    return finding(
        "installation.shared (warning): the distribution {owner} has this file too, and takes it along when it is "
        "updated or uninstalled -> pip uninstall {name}, and then pip install --force-reinstall --no-deps {source}, in "
        "this order",
        file=file, owner=f"{owner.name} {owner.version}", name=owner.name, source=_source() or "fg-orient",
    )  # fmt: skip


def _own(file: Path, version: str, other: object) -> Finding:
    """Return the error if another distribution has replaced our file."""
    source = _source()
    owner = _owner(file)
    if owner is not None:
        return finding("installation.overwritten", file=file, owner=f"{owner.name} {owner.version}", name=owner.name,
                       source=source or "fg-orient")  # fmt: skip
    if source is None:
        return finding("installation.damaged_tree", file=file)
    if isinstance(other, str):
        return finding("installation.other_version", file=file, other=other, version=version, source=source)
    return finding("installation.damaged", file=file, source=source)


def _hidden(file: Path) -> Finding:
    """Return the error if Python finds another file before ours."""
    package = file.stem == "__init__"
    thing, root = (file.parent, file.parent.parent) if package else (file, file.parent)
    listed = [Path(entry).resolve() for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    if root.resolve() in listed:
        return finding("installation.on_pythonpath", file=thing, ours=_OURS, root=root)
    owner = _owner(file)
    if owner is not None:
        return finding("installation.other_distribution", file=file, owner=f"{owner.name} {owner.version}",
                       name=owner.name, ours=_OURS)  # fmt: skip
    if package:
        return finding("installation.user_folder", file=thing, ours=_OURS)
    return finding("installation.user_file", file=thing, ours=_OURS, new=f"my_{file.name}")


def _owner(file: Path) -> metadata.Distribution | None:
    """Return the other distribution that lists the file, or whose source tree contains it."""
    place = file.resolve()
    for distribution in _others():
        tree = _direct_url(distribution)
        if tree.get("dir_info", {}).get("editable") and place.is_relative_to(_local(tree).resolve()):
            return distribution
        if "factors" not in (distribution.read_text("RECORD") or "factors"):
            continue  # skipped now, because parsing the list of files is slow
        listed = (f for f in distribution.files or () if f.name == file.name and "factors" in (f.parent.name, f.stem))
        if any(Path(str(distribution.locate_file(f))).resolve() == place for f in listed):
            return distribution
    return None


def _others() -> Iterable[metadata.Distribution]:
    for distribution in metadata.distributions():
        name = distribution.metadata["Name"] or ""  # the name is missing after an interrupted installation
        if name and re.sub(r"[-_.]+", "-", name).lower() != "fg-orient":
            yield distribution


def _source() -> str | None:
    """Return the requirement with which pip reinstalls this fg_orient; None if it runs from its source tree."""
    try:
        own = metadata.distribution("fg-orient")
    except metadata.PackageNotFoundError:
        return None
    if not Path(str(own.locate_file("fg_orient"))).exists() or not os.path.samefile(
        str(own.locate_file("fg_orient")), _HOME / "fg_orient"
    ):
        return None  # an editable installation, or another kind without a known source
    origin = _direct_url(own)
    if not origin:
        return "fg-orient"
    if "vcs_info" in origin:
        at = origin["vcs_info"].get("commit_id", "")
        return shlex.quote(f"{origin['vcs_info']['vcs']}+{origin['url']}@{at}")
    return shlex.quote(str(_local(origin)) if origin["url"].startswith("file:") else origin["url"])


def _direct_url(distribution: metadata.Distribution) -> dict[str, Any]:
    """Return the origin of a distribution that pip did not take from an index (PEP 610); otherwise an empty record."""
    text = distribution.read_text("direct_url.json")
    return json.loads(text) if text else {}


def _local(origin: dict[str, Any]) -> Path:
    return Path(unquote(urlsplit(origin["url"]).path))
