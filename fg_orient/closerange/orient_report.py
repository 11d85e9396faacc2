"""HTML report of a relative or an absolute orientation: one self-contained page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fg_orient.closerange.job import Output, Record
from fg_orient.closerange.report import MANY, PACKAGE
from fg_orient.closerange.report_verdict import problems, verdict
from fg_orient.closerange.report_words import significant
from fg_orient.formats.atomic import outputs, write_text
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.installation import stamp
from fg_orient.report.page import environment


def write_page(record: Record, inputs: list[Path], output: Output) -> str | None:
    """Write the report of a plain record if ``output`` names a file, and return its name."""
    path = output.report
    if path is None:
        return None
    stamped = record | {
        "input": [{"file": one.name, "sha256": sha256_of(one)} for one in inputs],
        **stamp(output.command),
    }
    with outputs(path, overwrite=output.overwrite and not path.is_dir(), option="report"):
        write_text(path, render(stamped))
    return str(path)


def render(record: dict[str, Any]) -> str:
    """Return the HTML text of a record of :mod:`fg_orient.closerange.orient_job` with its inputs."""
    shell = environment(PACKAGE)
    shell.filters |= {"significant": significant}
    absolute = record["kind"] == "absolute"
    rows = record["control"] if absolute else record["points"]
    return shell.get_template("orientation.html.j2").render(
        r=record,
        verdict=verdict(record),
        problems=problems(record),
        absolute=absolute,
        rows=rows[:MANY],
        n=len(rows),
        many=MANY,
    )
