"""Find images and tables among the files of a folder; each image gets one metadata file."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fg_orient.formats.office.decisions import Decisions
from fg_orient.formats.office.sheets import LAYERS, TEXTS, WORKBOOKS
from fg_orient.formats.registry import format_claiming
from fg_orient.formats.rpc import rpc_format
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError

#: Files with these suffixes may contain an image or its metadata.
IMAGES: Final = (".xml", ".dim", ".rpb", ".tif", ".tiff", ".vrt", ".geom", ".toml", ".ntf")
#: Maximum number of files that are examined.
MAX_FILES: Final = 5000
_BEFORE: Final = re.compile(r"^(DIM|RPC|IMG|PHRDIMAP|METADATA)[_-](?=.)", re.IGNORECASE)
_AFTER: Final = re.compile(r"(_RPC|_metadata|_R\d+C\d+|\.aux|\.tif|\.tiff)$", re.IGNORECASE)
#: A list of 90 numbers is an RPC only if its file name indicates it, because tables of numbers look the same.
_LIST: Final = "list of 90 numbers"


@dataclass(frozen=True)
class FoundImage:
    """Image with its id, metadata file and sensor."""

    id: str
    path: Path
    sensor: Any


def sorted_files(sources: Sequence[Path]) -> tuple[list[tuple[Path, bool]], list[Path]]:
    """Divide files and folders into tables and files that may contain images; note whether the user named them.

    Raises
    ------
    InputError
        A source does not exist, or a folder has too many files.
    """
    images: list[tuple[Path, bool]] = []
    tables: list[Path] = []
    for source in sources:
        if not source.exists():
            raise InputError.of("table.missing_file", file=source)
        files = sorted(_below(source)) if source.is_dir() else [source]
        if len(files) > MAX_FILES:
            raise InputError.of("office.many_files", file=source, value=f"{len(files)} files")
        for path in files:
            suffix = path.suffix.lower()
            if suffix in TEXTS and _is_rpc(path):
                images.append((path, path == source))
            elif suffix in (*TEXTS, *WORKBOOKS, *LAYERS, ".xls"):
                tables.append(path)
            elif suffix in IMAGES or path == source:
                images.append((path, path == source))
    return images, tables


def _below(folder: Path) -> list[Path]:
    """Return all files below a folder, without hidden files and lock files."""
    found: list[Path] = []
    for at, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found += [Path(at) / name for name in names if not name.startswith((".", "~$"))]
        if len(found) > MAX_FILES:
            break
    return found


def _is_rpc(path: Path) -> bool:
    form = rpc_format(path)
    return form is not None and (form.title != _LIST or "rpc" in path.stem.lower())


def read_images(files: Sequence[tuple[Path, bool]], decisions: Decisions) -> list[FoundImage]:
    """Read the images.

    If several files describe the same image, the rigorous model is used; if there is
    none, the RPC file; otherwise the tags of the image.

    Raises
    ------
    InputError
        A file that the user named cannot be used, or no file contains an image.
    """
    found: dict[str, tuple[int, FoundImage]] = {}
    refused = []
    for path, named in files:
        if not named and path.suffix.lower() == ".toml" and format_claiming(path, "image") is None:
            continue
        try:
            form = format_claiming(path, "image")
            sensor = read_sensor(path)
        except InputError as error:
            if named:
                raise
            refused.append((path, error.problems[0]))
            continue
        own, rank = (
            _id_of(path),
            0 if form is not None else 2 if path.suffix.lower() in (".tif", ".tiff", ".ntf") else 1,
        )
        if own in found:
            kept = found[own][1].path if found[own][0] <= rank else path
            other = path if kept != path else found[own][1].path
            decisions.note(
                f"image {own}", kept.name, f"the same image as {other.name}, which is left out; name the file otherwise"
            )
        if own not in found or rank < found[own][0]:
            found[own] = rank, FoundImage(own, path, sensor)
    for path, problem in refused:
        if _id_of(path) not in found:
            decisions.note(f"file {path.name}", "left out", problem.message)
    if not found and refused:
        raise InputError(refused[0][1])
    return [image for _, image in found.values()]


def _id_of(path: Path) -> str:
    """Return the name of the image that a metadata file describes."""
    stem = path.stem if path.suffix.lower() != ".dim" or path.stem.upper() != "METADATA" else path.parent.name
    while True:
        shorter = _AFTER.sub("", _BEFORE.sub("", stem))
        if shorter == stem:
            return stem.strip() or path.stem
        stem = shorter
