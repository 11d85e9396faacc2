"""Write docs/options.md, the reference of all options, from their declaration.

python docs/options.py
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fg_orient.model.declaration import Option, declared  # noqa: E402
from fg_orient.model.options import Options, Reading  # noqa: E402

PAGE = ROOT / "docs" / "options.md"
HEAD = """\
# Options

<!-- made by docs/options.py from fg_orient/model/options.py -->

Every option has one declaration, in `fg_orient.model.options`, and can be given in three places. If it
is given in several places, the last place of this list applies:

1. project file: an entry of `[orientation]` or `[adjustment]`, for instance `datum = "inner"`;
2. command line: `fg-orient adjust project.toml --datum inner`. Options that are true or false have two flags: `--gnc`,
   `--no-gnc`. Names and three numbers: with commas between them;
3. Python: `fg.read_project("project.toml", datum="inner")`, `fg.adjust(block, datum="inner")`. A name that is not an
   option is a `TypeError`, a value that is not allowed an `InputError`. `fg.adjust(block, options=fg.Options(...))`
   replaces all.

{reading} are used when a project is read: `read_project` accepts them, `adjust` of a block does not.

tau runs from -1 at the first line of an image to +1 at the last; c0, c1, c2 are the constant, linear and quadratic
coefficient of tau.
"""


def row(option: Option) -> str:
    """Give the row of an option."""
    more = f", `{option.flag}-of`" if option.usual else ""
    allowed = option.expected.partition("; leave")[0]
    cells = (f"`{option.name}`", f"`{option.flag}`{more}", option.default_text, allowed, option.help)
    return f"| {' | '.join(cell.replace('|', ',') for cell in cells)} |"


def page(*records: type) -> str:
    """Give the page of the options that dataclasses declare."""
    options = declared(*records).values()
    lines = [HEAD.format(reading=" and ".join(f"`{name}`" for name in declared(Reading)))]
    for group in dict.fromkeys(one.group for one in options):
        more = f" More: [{group.title.lower()}]({group.page})." if group.page else ""
        lines += [
            f"## {group.title}\n",
            f"Table `[{group.table}]` of the project file.{more}\n",
            "| option | command line | default | allowed | meaning |",
            "|---|---|---|---|---|",
            *(row(one) for one in options if one.group == group),
            "",
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(Options, Reading), "utf-8")
    print(PAGE.relative_to(ROOT))
