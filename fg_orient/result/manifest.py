"""Manifest of a result folder: size and SHA-256 of each file, and the run that wrote the files.

People and programs copy, edit and rename folders. Therefore commands that read a result
compare it with ``manifest.json``. They report if files are missing, if a file was
changed, or if files belong to another run. Version 0.1 wrote no manifest; its folders are
read without this check. The page and the figures are made from the other files and are
not listed. The folders of ``adjust``, ``closerange`` and ``rectify fit`` have a manifest. These folders
differ in their contents (:class:`fg_orient.formats.atomic.Contents`) and in the file of the record.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final

from fg_orient.formats.atomic import RESULT, Contents
from fg_orient.formats.load import load_json
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.errors import InputError
from fg_orient.result.plain import dumps, plain
from fg_orient.result.provenance import MANIFEST_SCHEMA

MANIFEST_FILE: Final = "manifest.json"
#: A complete file of these kinds contains these bytes at its end. Files of other kinds end with a line end.
_END: Final = {".npz": b"PK\x05\x06", ".parquet": b"PAR1", ".arrow": b"ARROW1"}
_TAIL: Final = 22
#: Files that are made from the other files.
_DERIVED: Final = ("report.html", "figures/*")
#: Provenance in records that do not have it as a table: inputs, command with its options, versions and time.
_STAMP: Final = ("input", "command", "versions", "date_time_utc")


def run_of(record: Mapping[str, Any]) -> str:
    """Return the identifier of a run: the SHA-256 of its provenance (inputs, options, versions and time)."""
    provenance = record["provenance"] if "provenance" in record else {name: record.get(name) for name in _STAMP}
    text = json.dumps(plain(provenance), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def write_manifest(folder: Path, record: Mapping[str, Any], contents: Contents = RESULT) -> None:
    """Write the manifest of a complete folder; ``record`` is the content of the file with its record."""
    files = {
        name: {"bytes": (folder / name).stat().st_size, "sha256": sha256_of(folder / name)}
        for name in _names(folder, contents) if name != MANIFEST_FILE
    }  # fmt: skip
    content = {"schema": MANIFEST_SCHEMA, "run": run_of(record), "files": files}
    (folder / MANIFEST_FILE).write_text(dumps(content, indent=1) + "\n", encoding="utf-8")


def with_manifest(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record that states that its folder has a manifest: without it, the folder is incomplete."""
    return {**record, "manifest": MANIFEST_SCHEMA}


def _names(folder: Path, contents: Contents) -> list[str]:
    """Return the names of the result files in a folder, without those that are made from other files."""
    found = {
        path.relative_to(folder).as_posix() for pattern in contents.names if pattern not in _DERIVED
        for path in folder.glob(pattern) if path.is_file()
    }  # fmt: skip
    return sorted(name for name in found if not any(PurePosixPath(name).match(one) for one in _DERIVED))


def is_made_by(folder: Path, contents: Contents) -> bool:
    """Return whether a folder has the mark of an output, or only the manifest of one."""
    if (folder / contents.mark).is_file():
        return True
    with suppress(InputError, KeyError, TypeError):
        return contents.mark in load_json(folder / MANIFEST_FILE, "manifest.damaged")["files"]
    return False


def checked_record(folder: Path, file: str, contents: Contents, code: str) -> dict[str, Any]:
    """Read the record of a folder, and check that all its files belong to its run.

    Parameters
    ----------
    folder : Path
    file : str
        Name of the record's file.
    contents : Contents
        Names of the files of this kind of output.
    code : str
        Code of the message if the record is missing or damaged.

    Raises
    ------
    InputError
        See :func:`read_manifest` and :func:`require_run`.
    """
    stated = read_manifest(folder, contents)
    record = load_json(folder / file, code)
    if not isinstance(record, dict):
        raise InputError.of(code, file=folder / file, value="no JSON object")
    require_run(folder, stated, record, contents)
    return record


def read_manifest(folder: Path, contents: Contents = RESULT) -> Mapping[str, Any] | None:
    """Read the manifest of a folder and check that all its files exist; None if there is no manifest.

    Raises
    ------
    InputError
        The manifest is damaged or has a later version. Or it lists a file that is missing or
        outside the folder.
    """
    path = folder / MANIFEST_FILE
    if not path.is_file():
        return None
    content = load_json(path, "manifest.damaged")
    if isinstance(content, dict) and content.get("schema") != MANIFEST_SCHEMA and type(content.get("schema")) is int:
        raise InputError.of("manifest.later", file=path, place="schema", value=content["schema"], known=MANIFEST_SCHEMA)
    try:
        files = {str(name): (int(one["bytes"]), str(one["sha256"])) for name, one in content["files"].items()}
        run = str(content["run"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError.of("manifest.damaged", file=path, value=error) from None
    for name in files:
        if not _is_plain(name, contents):
            raise InputError.of("manifest.damaged", file=path, place="files", value=name)
    missing = [name for name in files if not (folder / name).exists()]
    mark = contents.mark
    missing += [mark] if mark in files and mark not in missing and _is_cut(folder, files, mark) else []
    if missing:
        raise InputError.of("manifest.incomplete", file=folder, value=missing[0], count=len(missing), n=len(files))
    for name in files:
        file = folder / name
        if not file.resolve().is_relative_to(folder.resolve()) or not file.is_file():
            raise InputError.of("manifest.outside", file=file)
    return {"run": run, "files": files}


def _is_cut(folder: Path, files: Mapping[str, tuple[int, str]], name: str) -> bool:
    """Return whether a file was truncated: it is too short, and the usual end of a complete file is missing."""
    path = folder / name
    size = path.stat().st_size
    if size >= files[name][0]:
        return False
    with path.open("rb") as stream:
        stream.seek(max(size - _TAIL, 0))
        tail = stream.read()
    return _END[path.suffix] not in tail if path.suffix in _END else not tail.endswith(b"\n")


def _is_plain(name: str, contents: Contents) -> bool:
    """Return whether a name can be the name of a result file, that is, whether it stays inside the folder."""
    return ".." not in name.split("/") and any(PurePosixPath(name).match(pattern) for pattern in contents.names)


def require_run(
    folder: Path, stated: Mapping[str, Any] | None, record: Mapping[str, Any], contents: Contents = RESULT
) -> None:  # fmt: skip
    """Refuse a folder with files that its run did not write.

    Parameters
    ----------
    folder : Path
    stated : mapping or None
        Manifest from :func:`read_manifest`.
    record : mapping
        Content of the file with its record.
    contents : Contents
        Names of the files of this kind of output.

    Raises
    ------
    InputError
        The manifest is missing or belongs to another run, or a file was truncated, changed or added.
    """
    provenance = record.get("provenance", record)
    if stated is None:
        if isinstance(provenance, dict) and "manifest" in provenance:
            raise InputError.of("manifest.incomplete", file=folder, value=MANIFEST_FILE, count=1, n=1)
        return
    if stated["run"] != run_of(record):
        raise InputError.of("manifest.other_run", file=folder, place=contents.mark)
    files = stated["files"]
    cut = [name for name in files if _is_cut(folder, files, name)]
    if cut:
        raise InputError.of("manifest.incomplete", file=folder, value=cut[0], count=len(cut), n=len(files))
    for name, (_, digest) in files.items():
        if sha256_of(folder / name) != digest:
            raise InputError.of("manifest.changed", file=folder / name)
    for name in _names(folder, contents):
        if name != MANIFEST_FILE and name not in files:
            raise InputError.of("manifest.added", file=folder / name)
