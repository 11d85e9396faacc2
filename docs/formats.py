"""Write the table of formats in docs/formats/index.md from the registration records.

python docs/formats.py
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fg_orient.formats.registry import Format, formats  # noqa: E402

PAGE = ROOT / "docs" / "formats" / "index.md"
HEAD = """\
| format | files | centre of the first pixel (line, sample) | ground coordinates | tried on |
|---|---|---|---|---|
"""
_TABLE = re.compile(rf"{re.escape(HEAD)}(?:\|.*\n)*")


def row(one: Format) -> str:
    """Return the row of a format. Its name is a link to the page of the format, if there is one."""
    pixel = "-" if one.first_pixel is None else "{:g}, {:g}".format(*one.first_pixel)
    name = f"[{one.name}]({one.name}.md)" if (PAGE.parent / f"{one.name}.md").is_file() else one.name
    cells = name, ", ".join(one.files), pixel, one.ground_axes, one.evidence or "**unverified**"
    return f"| {' | '.join(cells)} |\n"


def page(text: str) -> str:
    """Return the page with the table of all formats of points and frame models."""
    return _TABLE.sub(lambda _: HEAD + "".join(map(row, formats().values())), text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text("utf-8")), "utf-8")
    print(PAGE.relative_to(ROOT))
