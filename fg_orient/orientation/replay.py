"""Repetition of a run from its record, and comparison of all values of both results.

The project file is read again with the recorded options. Inputs are identified by their SHA-256. Times, memory and
names of folders are not compared; all other values must agree to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.formats.atomic import RESULT_TABLES
from fg_orient.formats.recorded_run import require_repeatable
from fg_orient.formats.table_write import is_binary
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.installation import versions
from fg_orient.orientation.run import run_project
from fg_orient.result.plain import read_table
from fg_orient.result.provenance import relative
from fg_orient.result.record import RESULT_FILE, read_record

if TYPE_CHECKING:
    from fg_orient.adjustment.loop import Callback
    from fg_orient.model.block import Block
    from fg_orient.orientation.orient import Stage
    from fg_orient.sensors.surface import RasterDem

Record = dict[str, Any]
#: Entries of ``result.json`` that differ between runs: times, memory, folders, continuation of an interrupted run.
OCCASION: Final = (
    "seconds",
    "memory",
    "us_per_observation_iteration",
    "resumed_at_iteration",
    "out",
    "provenance",
    "pixels",
    "ground",
)
#: Maximum number of folders beside a result that are searched for its project file.
_BESIDE: Final = 1000
#: Files of both results that are compared.
TABLES: Final = (*RESULT_TABLES, "rpc/*_RPC.TXT")


@dataclass(frozen=True)
class Replay:
    """Result of a repeated run.

    ``out`` is its result folder, or None without solution. ``inputs`` are inputs that changed, are missing or new, if
    this is allowed; ``n_inputs`` counts the inputs of the first run. ``n_compared`` values of ``result.json`` are
    compared; ``differences`` have ``key``, ``then`` and ``now`` of each value that differs, None for a missing value.
    ``tables`` contains for each table whether its bytes are equal. ``versions`` have ``name``, ``then`` and ``now`` of
    software and platform, if these differ. ``notes`` are warnings of the DEM.
    """

    out: str | None
    status: str
    inputs: tuple[Finding, ...]
    n_inputs: int
    n_compared: int
    differences: tuple[Record, ...]
    tables: dict[str, bool]
    versions: tuple[Record, ...]
    notes: tuple[Finding, ...] = ()

    @property
    def equal(self) -> bool:
        """True if all values and tables are equal."""
        return not self.differences and all(self.tables.values())

    def as_dict(self) -> Record:
        """Return the record of the command ``replay``."""
        return {
            "equal": self.equal,
            "status": self.status,
            "out": self.out,
            "n_inputs": self.n_inputs,
            "inputs": [p.as_dict() for p in self.inputs],
            "versions": list(self.versions),
            "n_compared": self.n_compared,
            "differences": list(self.differences),
            "tables": self.tables,
            "notes": [p.as_dict() for p in self.notes],
        }


def replay(
    folder: Path,
    out: Path | None = None,
    *,
    project: Path | None = None,
    allow_changed: bool = False,
    overwrite: bool = False,
    callback: Callback | None = None,
    stage: Stage | None = None,
) -> Replay:
    """Repeat the run of a result folder into another folder, and compare.

    Parameters
    ----------
    folder : Path
        Result folder of ``adjust``; it is only read.
    out : Path, optional
        New result folder; default: ``folder`` with "-replay" added to its name.
    project : Path, optional
        Project file; default: the recorded name in the parent of ``folder``.
    allow_changed : bool
        Continue with changed inputs if the project can be read.
    overwrite : bool
        Replace an existing folder ``out``.
    callback, stage : callable, optional
        See :func:`fg_orient.orientation.run.run_project`.

    Raises
    ------
    InputError
        The record is incomplete, inputs are missing or changed, or ``out`` cannot be written.
    """
    old, repeat = _read(folder)
    folder = folder if folder.name not in ("", "..") else folder.resolve()
    out = out or folder.with_name(f"{folder.name}-replay")
    path = _project_file(folder, old, project)
    if out.absolute() == folder.absolute() or (out.exists() and out.samefile(folder)):
        raise InputError.of("replay.same_folder", file=out, option="out")
    recorded = {entry["file"]: entry["sha256"] for entry in old["provenance"]["inputs"]}
    dem = repeat["dem_control"]
    known = recorded if dem is None else {**recorded, dem["file"]: dem["sha256"]}
    start = repeat.get("start")
    if start is not None:
        known = known | {f"{start['folder']}/{name}": digest for name, digest in start["files"].items()}
    changes = dict(_changed_files(path.parent, known))
    _refuse(changes, allow_changed)

    def check(block: Block) -> None:
        changes.update(changed_sources(block, path.parent, recorded))
        _refuse(changes, allow_changed)

    surface = None if dem is None else _open(path.parent, dem, repeat["options"].get("memory_limit_gb"))
    new = run_project(
        path,
        out,
        overwrite=overwrite,
        options=repeat["options"],
        execution=_execution(repeat),
        check=check,
        command=old["provenance"]["command"],
        callback=callback,
        stage=stage,
        dem_control=None if surface is None else (surface, dem["sigma_m"]),
        start=None if start is None else path.parent / start["folder"],
        start_prior=start is not None and start["prior"],
    )
    n, differences = compare_records(old, read_record(out) if new["out"] else new)
    return Replay(
        new["out"],
        new["status"],
        tuple(changes.values()),
        len(known),
        n,
        differences,
        compare_tables(folder, out) if new["out"] else {},
        _versions(old["provenance"]),
        () if surface is None else surface.notes,
    )


def _read(folder: Path) -> tuple[Record, Record]:
    """Return the record of a result, and its entry for the repetition."""
    record = read_record(folder)
    require_repeatable(record, folder / RESULT_FILE)
    return record, record["provenance"]["repeat"]


def _project_file(folder: Path, old: Mapping[str, Any], given: Path | None) -> Path:
    """Return the project file, which is the first input of a run.

    The file is usually in the folder above the result. Otherwise a file with the recorded
    content is searched in a folder above or beside the result.
    """
    first = old["provenance"]["inputs"][0]
    name, path = first["file"], folder.parent / first["file"] if given is None else given
    if given is None and not path.is_file():
        above = list(folder.resolve().parents)
        beside = sorted(one for one in above[0].iterdir() if one.is_dir())[:_BESIDE]
        same = (one / name for one in (*above[1:], *beside) if (one / name).is_file())
        path = next((one for one in same if sha256_of(one) == first["sha256"]), path)
    if not path.is_file():
        raise InputError.of("replay.project", file=path, option="project", name=name)
    return path


def _changed_files(folder: Path, recorded: Mapping[str, str]) -> Iterator[tuple[str, Finding]]:
    """Yield the inputs in the project's folder with changed content; their values are not read."""
    for name, digest in recorded.items():
        path = folder / name
        if path.is_file() and (now := sha256_of(path)) != digest:
            yield name, _changed(path, digest, now)


def changed_sources(block: Block, folder: Path, recorded: Mapping[str, str]) -> Iterator[tuple[str, Finding]]:
    """Yield the differences between the sources of a block and the inputs of the run."""
    now = {relative(source.path, folder): source for source in block.sources}
    for name, source in now.items():
        if name not in recorded:
            yield name, finding("replay.new", file=source.path)
        elif source.sha256 != recorded[name]:
            yield name, _changed(Path(source.path), recorded[name], source.sha256)
    for name in recorded:
        if name not in now:
            yield name, finding("replay.missing", file=folder / name)


def _changed(path: Path, then: str, now: str) -> Finding:
    return finding("replay.changed", file=path, then=f"{then[:12]}...", now=f"{now[:12]}...")


def _refuse(changes: Mapping[str, Finding], allowed: bool) -> None:
    if changes and not allowed:
        raise InputError(*changes.values())


def _execution(repeat: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same parts, in one process: results do not depend on the workers."""
    return {"parts": repeat["parts"], "workers": 1} if repeat["in_parts"] else {}


def _open(folder: Path, dem: Mapping[str, Any], memory_limit_gb: float | None) -> RasterDem:
    path = folder / dem["file"]
    if not path.is_file():
        raise InputError.of("replay.dem", file=path)
    from fg_orient.sensors.surface import RasterDem

    return RasterDem(path, vertical_crs=dem["vertical_crs"], memory_limit_gb=memory_limit_gb)


def _versions(kept: Mapping[str, Any]) -> tuple[Record, ...]:
    then, now = kept["versions"], versions()
    return tuple({"name": n, "then": then.get(n), "now": now.get(n)} for n in then | now if then.get(n) != now.get(n))


def compare_records(then: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[int, tuple[Record, ...]]:
    """Compare two records ``result.json`` except for :data:`OCCASION`.

    Returns
    -------
    int, tuple of dict
        Number of compared values; ``key``, ``then``, ``now`` of values that differ in any bit.
    """
    one, other = (dict(_leaves({k: v for k, v in r.items() if k not in OCCASION})) for r in (then, now))
    keys = list(one | other)
    differences = [
        {"key": key, "then": one.get(key), "now": other.get(key)}
        for key in keys
        # repr distinguishes 0.0 from -0.0, and 1 from 1.0
        if key not in one or key not in other or repr(one[key]) != repr(other[key])
    ]
    return len(keys), tuple(differences)


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers, strings, booleans, and empty lists and objects of a record, with their keys."""
    if isinstance(value, Mapping) and value:
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value:
        for k, item in enumerate(value):
            yield from _leaves(item, f"{key}[{k}]")
    else:
        yield key, value


def compare_tables(then: Path, now: Path) -> dict[str, bool]:
    """Compare the tables of two result folders: texts byte by byte, others bit by bit; a missing table differs."""
    names = {p.relative_to(folder).as_posix() for folder in (then, now) for t in TABLES for p in folder.glob(t)}
    return {name: _content(then / name) == _content(now / name) is not None for name in sorted(names)}


def _content(path: Path) -> object:
    """Return the bytes of a text table.

    Return names and values of other tables, because their bytes depend on pyarrow's version.
    """
    if not path.is_file():
        return None
    if not is_binary(path):
        return path.read_bytes()
    columns = read_table(path).columns.items()
    return [(name, v.tobytes() if isinstance(v, np.ndarray) else v) for name, v in columns]
