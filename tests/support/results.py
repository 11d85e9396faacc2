"""The module changes result folders on purpose."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fg_orient.result.manifest import MANIFEST_FILE, write_manifest
from fg_orient.result.record import RESULT_FILE


def sealed(folder: Path) -> Path:
    """Write the manifest of a folder again, as if its run had written the present files; give the folder."""
    write_manifest(folder, json.loads((folder / RESULT_FILE).read_text("utf-8")))
    return folder


def of_version_0_1(folder: Path, change: Callable[[dict[str, Any]], object] = lambda record: None) -> Path:
    """Make a folder one of a version without manifest, and change its record; give the folder."""
    (folder / MANIFEST_FILE).unlink()
    record = json.loads((folder / RESULT_FILE).read_text("utf-8"))
    del record["provenance"]["manifest"]
    record["provenance"]["versions"]["fg_orient"] = "0.1.0"
    change(record)
    (folder / RESULT_FILE).write_text(json.dumps(record, indent=1), "utf-8")
    return folder
