"""Schemas of the output with ``--json`` are made from records of a test run and check a record.

``FG_ORIENT_RECORDS=folder python -m pytest ...`` keeps what the commands of the tests print, then
``python -m tests.support.json_schemas folder`` adds it to the schemas, which are not narrowed.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fg_orient.cli.app import COMMANDS

SCHEMAS = Path(__file__).resolve().parents[2] / "fg_orient" / "cli" / "schemas"
GROUPS = ("rpc", "camera", "rectify", "closerange", "simulate")
#: Names given by a programmer; objects with other keys are maps, for instance from ids to values.
NAME = re.compile(r"[a-z_][a-z0-9_]*")
#: Objects with more keys are maps if no key is in all of them.
FEW = 3
_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", type(None): "null"}

Schema = dict[str, Any]


def command_of(words: list[str]) -> str:
    """Return the name of the schema for the command of a command line.

    Options of the program come before the command.
    """
    first = next(k for k, word in enumerate(words) if word in COMMANDS)
    return "_".join(words[first : first + (2 if words[first] in GROUPS else 1)])


def joined(one: Schema | None, other: Schema) -> Schema:
    """Return the narrowest schema that allows what either allows."""
    if not one or not other:
        return {} if one == {} or other == {} else one or other
    types = sorted({*_types(one), *_types(other)})
    out: Schema = {"type": [name for name in types if name != "integer" or "number" not in types]}
    if "items" in one or "items" in other:
        out["items"] = _either(one.get("items"), other.get("items"))
    maps = [s["additionalProperties"] for s in (one, other) if isinstance(s.get("additionalProperties"), dict)]
    known = [s for s in (one, other) if "properties" in s]
    if maps:
        for own in (*maps, *(value for s in known for value in s["properties"].values())):
            out["additionalProperties"] = joined(out.get("additionalProperties"), own)
    elif known:
        names = dict.fromkeys(name for s in known for name in s["properties"])
        out["properties"] = {name: _either(*(s["properties"].get(name) for s in known)) for name in names}
        out["required"] = [name for name in names if all(name in s["required"] for s in known)]
        if not out["required"] and len(names) > FEW:
            return _as_map(out)
    return out


def _types(schema: Schema) -> list[str]:
    return [schema["type"]] if isinstance(schema["type"], str) else list(schema["type"])


def _either(*schemas: Schema | None) -> Schema:
    out: Schema | None = None
    for own in schemas:
        out = out if own is None else joined(out, own)
    return {} if out is None else out


def _as_map(schema: Schema) -> Schema:
    return {"type": schema["type"], "additionalProperties": _either(*schema["properties"].values())}


def schema_of(value: Any) -> Schema:
    """Return the schema of one value; numbers can be null, as nan is written."""
    if isinstance(value, dict):
        own = {"type": ["object"], "properties": {k: schema_of(v) for k, v in value.items()}, "required": list(value)}
        if {"code", "severity", "data"} <= set(value):
            # of a finding: other keys for each code
            own["properties"]["data"] = {"type": ["object"], "additionalProperties": {}}
        return own if all(NAME.fullmatch(name) for name in value) else _as_map(own)
    if isinstance(value, list):
        return {"type": ["array"], **({"items": _either(*map(schema_of, value))} if value else {})}
    kind = _TYPES[type(value)]
    return {"type": sorted({kind, "null"})} if kind == "number" else {"type": [kind]}


def faults(value: Any, schema: Schema, place: str = "$") -> Iterator[str]:
    """Yield the places where a value contradicts its schema; a key that the schema does not name is one, too."""
    if not schema:
        return
    kind = "object" if isinstance(value, dict) else "array" if isinstance(value, list) else _TYPES[type(value)]
    allowed = _types(schema)
    if kind not in allowed and not (kind == "integer" and "number" in allowed):
        yield f"{place}: {kind}, not {' or '.join(allowed)}"
    elif kind == "array":
        for k, one in enumerate(value):
            yield from faults(one, schema.get("items", {}), f"{place}[{k}]")
    elif kind == "object":
        known = schema.get("properties", {})
        for name in schema.get("required", ()):
            if name not in value:
                yield f"{place}: no {name}"
        for name, one in value.items():
            if name not in known and "additionalProperties" not in schema:
                yield f"{place}: unknown key {name}"
            yield from faults(one, known.get(name, schema.get("additionalProperties", {})), f"{place}.{name}")


def opened(schema: Schema) -> Schema:
    """Return the schema with everything allowed where only null was seen, because null shows no type."""
    if schema.get("type") == ["null"]:
        return {}
    out = {key: opened(schema[key]) for key in ("items", "additionalProperties") if key in schema}
    named = {name: opened(value) for name, value in schema.get("properties", {}).items()}
    return schema | out | ({"properties": named} if "properties" in schema else {})


def main(folder: Path) -> None:
    """Add the records of a folder to the schemas."""
    schemas: dict[str, Schema] = {path.stem: json.loads(path.read_text("utf-8")) for path in SCHEMAS.glob("*.json")}
    for path in sorted(folder.glob("*.json")):
        one = json.loads(path.read_text("utf-8"))
        try:
            record = json.loads(one["out"])
        except ValueError:
            continue
        name = "errors" if set(record) == {"errors"} else command_of(one["words"])
        own = schemas.get(name)
        if own is not None:
            own = {key: value for key, value in own.items() if not key.startswith("$") and key != "title"}
        schemas[name] = joined(own, schema_of(record))
    SCHEMAS.mkdir(exist_ok=True)
    for name, schema in schemas.items():
        words = "an error" if name == "errors" else "fg-orient " + name.replace("_", " ", 1)
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"{words} --json"}
        text = json.dumps(head | opened(schema), separators=(",", ":"))
        (SCHEMAS / f"{name}.json").write_text(f"{text}\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
