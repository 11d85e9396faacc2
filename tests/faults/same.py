"""The comparison of folders ignores what differs between runs: times, measured memory, drawings, resumption."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import sqlite3
from pathlib import Path
from typing import Any

#: Keys and columns of such values.
TIMES = re.compile(
    r"seconds|processor_s|peak_bytes|allowed_bytes|us_per_observation_iteration|date_time_utc|elapsed_s|began|ended"
    r"|last_change|update_time|timestamp|resumed_at_iteration"
)
#: Drawings of them.
DRAWN = ("seconds.svg", "seconds.pdf")


def contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file below a folder, without times, and "folder" for every folder.

    AssertionError: a manifest does not fit the files in its folder.
    """
    return {
        path.relative_to(folder).as_posix(): "folder" if path.is_dir() else _digest(path, str(folder).encode())
        for path in sorted(folder.rglob("*"))
    }


def _digest(path: Path, place: bytes) -> str:
    data = path.read_bytes()
    try:
        data = _without_times(path, data)
    except (ValueError, sqlite3.Error) as error:  # it is not whole
        data += repr(error).encode()
    return hashlib.sha256(data.replace(place, b"FOLDER")).hexdigest()


def _without_times(path: Path, data: bytes) -> bytes:
    if path.name in DRAWN:
        return str(data.rstrip()[-8:]).encode()
    if path.suffix == ".gpkg":
        return _database(path)
    if path.suffix == ".html":
        text = re.sub(r"<svg.*?</svg>| --overwrite| --resume", "", data.decode("utf-8"), flags=re.DOTALL)
        return re.sub(r"[\d.,]+(e[+−-]?\d+)?", "0", text).encode()
    if path.name == "manifest.json":
        return _manifest(path, json.loads(data))
    if path.suffix in (".json", ".jsonl"):
        lines = data.splitlines() if path.suffix == ".jsonl" else [data]
        return "\n".join(json.dumps(_masked(json.loads(line))) for line in lines).encode()
    if path.suffix == ".csv":
        rows = list(csv.reader(io.StringIO(data.decode("utf-8"), newline="")))
        kept = [k for k, name in enumerate(rows[0] if rows else ()) if not TIMES.fullmatch(name)]
        if len(kept) < len(rows[0] if rows else ()):
            return repr([len(rows), *([row[k] for k in kept] for row in rows)]).encode()
    return data


def _masked(value: Any) -> Any:
    if isinstance(value, dict) and isinstance(value.get("command"), list):
        words = [word for word in value["command"] if word not in ("--overwrite", "--resume")]
        return _masked({**value, "command": " ".join(words)})
    if isinstance(value, dict):
        return {key: "TIME" if TIMES.fullmatch(key) else _masked(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_masked(entry) for entry in value]
    return re.sub(r"\d[\d.e+-]* s\b", "TIME", value) if isinstance(value, str) else value


def _manifest(path: Path, content: dict[str, Any]) -> bytes:
    """Return the schema and file names of a manifest; check the digests, which depend on times."""
    for name, entry in content["files"].items():
        data = (path.parent / name).read_bytes()
        assert entry["sha256"] == hashlib.sha256(data).hexdigest(), f"{path}: {name} has another digest"
    return json.dumps([content["schema"], *content["files"]]).encode()


def _database(path: Path) -> bytes:
    """Return the definitions and rows of an SQLite file but for times."""
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as database:
        found: list[Any] = database.execute("SELECT type, name, sql FROM sqlite_master ORDER BY type, name").fetchall()
        for table in [row[1] for row in found if row[0] == "table" and not row[1].startswith("rtree_")]:
            cursor = database.execute(f'SELECT * FROM "{table}"')
            kept = [k for k, column in enumerate(cursor.description) if not TIMES.fullmatch(column[0])]
            found += [table, *sorted(repr([row[k] for k in kept]) for row in cursor)]
    database.close()
    return repr(found).encode()
