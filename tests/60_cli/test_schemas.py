"""Each command has a schema of its JSON output, and its output follows the schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fg_orient.cli.app import COMMANDS, built
from tests.support.command import Ended, Run
from tests.support.json_schemas import SCHEMAS, faults, joined, schema_of

#: Commands that print no record of their own.
WITHOUT = {"completion", "schema"}


def names() -> list[str]:
    """Return all commands as they are in the names of schemas."""
    found = []
    for name in COMMANDS:
        group = getattr(built(name), "commands", None)
        found += [f"{name}_{one}" for one in group] if group else [name]
    return [name for name in found if name not in WITHOUT]


def schema(name: str) -> Any:
    return json.loads((SCHEMAS / f"{name}.json").read_text("utf-8"))


@pytest.mark.repository
def test_each_command_has_a_schema() -> None:
    assert {path.stem for path in SCHEMAS.glob("*.json")} == {*names(), "errors"}


@pytest.mark.behaviour
def test_schemas_are_printed(run: Run) -> None:
    listed = run("schema").stdout.split("\n")
    assert {"adjust", "rpc convert", "errors"} <= set(listed)
    printed = run("schema", "rpc", "convert").json
    assert printed == schema("rpc_convert") and printed["$schema"].endswith("2020-12/schema")
    wrong = run("schema", "adjsut")
    assert wrong.code == 2 and "did you mean adjust?" in wrong.stderr


@pytest.mark.behaviour
def test_what_is_printed_is_as_the_schema_says(
    run: Run, adjusted: tuple[Path, Ended], twin_source: Path, tmp_path: Path
) -> None:
    """The JSON output of each command follows its schema: every key is named, each value has an allowed type."""
    out, adjust = adjusted
    project, image = twin_source / "project.toml", twin_source / "left.DIM"
    rpc = tmp_path / "scene_RPC.TXT"
    records = {
        "adjust": adjust,
        "validate": run("validate", project, "--json"),
        "doctor": run("doctor", "--json"),
        "locate": run("locate", image, "--line", 6000, "--sample", 6000, "--height", 300, "--json"),
        "footprint": run("footprint", project, "--height", 300, "--json"),
        "report": run("report", out, "--json"),
        "dsm-points": run("dsm-points", out, "--out", tmp_path / "a.laz", "--json"),
        "rpc_fit": run("rpc", "fit", image, "--heights", 0, 3000, "--out", rpc, "--json"),
        "rpc_check": run("rpc", "check", rpc, "--json"),
        "rpc_convert": run("rpc", "convert", rpc, "--for", "otb", "--out", tmp_path / "otb", "--json"),
        "convert": run("convert", twin_source / "points.csv", "--from", "csv", "--to", "geojson", "--out",
                       tmp_path / "a.geojson", "--crs", "EPSG:4979", "--json"),
        "errors": run("adjust", tmp_path / "none.toml", "--json"),
    }  # fmt: skip
    for name, ended in records.items():
        assert (ended.code == 0) == (name != "errors"), (name, ended.stdout)
        assert list(faults(ended.json, schema(name))) == [], name


@pytest.mark.behaviour
def test_joined_schemas_allow_what_each_allowed() -> None:
    """A joined schema allows what each schema allowed, and names types, keys and missing keys that it refuses.

    Cases are an optional key, an integer that is a number elsewhere, null and a map of ids.
    """
    both = joined(schema_of({"a": 1, "b": None, "m": {"P 1": 2.0}}), schema_of({"a": 1.5, "m": {"P 2": 3.0}}))
    assert both["required"] == ["a", "m"]
    assert both["properties"]["a"]["type"] == ["null", "number"]
    assert both["properties"]["m"] == {"type": ["object"], "additionalProperties": {"type": ["null", "number"]}}
    assert list(faults({"a": 1, "m": {"other": None}}, both)) == []
    assert list(faults({"a": "1", "m": {}, "c": 1}, both)) == ["$.a: string, not null or number", "$: unknown key c"]
    assert list(faults({"a": 1}, both)) == ["$: no m"]
