"""The module runs the cases and keeps their outputs."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path

from tests.support.command import in_process

from .cases import CASES, INPUTS, SIMULATED, WRITERS, Case, real_data


def keep(folder: Path, chosen: Callable[[str], bool], told: Callable[[str], None]) -> int:
    """Run the inputs and the chosen cases into a new folder; give the number of cases."""
    folder.mkdir(parents=True)
    inputs = folder / INPUTS
    inputs.mkdir()
    for case in SIMULATED:
        told(case.name)
        _run(case, inputs, folder)
    for name, write in WRITERS.items():
        told(f"files {name}")
        (inputs / name).mkdir()
        write(inputs / name)
    cases = [case for case in CASES if chosen(case.name) and (real_data() or not case.needs_real_data)]
    for case in cases:
        told(case.name)
        place = folder / case.name
        place.mkdir()
        _run(case, place, folder)
    return len(cases)


def _run(case: Case, place: Path, folder: Path) -> None:
    """Run a command in its folder; write its output and exit code next to its files."""
    words = [word.replace("{real}", real_data()) for word in case.command.split()]
    with contextlib.chdir(place):
        ended = in_process(*words)
    texts = {"exit": f"{ended.code}\n", "stdout": ended.stdout, "stderr": ended.stderr}
    for name, text in texts.items():
        (place / f"{case.name}.{name}").write_text(text.replace(str(folder), "<folder>"), "utf-8")


def fresh(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that exists, or remove it."""
    if folder.exists() and not overwrite:
        raise SystemExit(f"{folder} exists; remove it, or say --overwrite")
    if folder.exists():
        shutil.rmtree(folder)
