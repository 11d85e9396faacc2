"""Command ``new``: a project from images and the tables of an office."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fg_orient.cli.command import Overwrite, argument, command, option
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, flag, note, say, tell
from fg_orient.model.errors import InputError, finding

if TYPE_CHECKING:
    from fg_orient.formats.office.decisions import Assumption, Decisions, Question

_PAIR = re.compile(r",(?=\s*[A-Za-z]\w*\s*=)")
Columns = Annotated[str, option("Headers of columns (#2: the second one).", "E=HEADER,N=HEADER,...")]
RoleColumn = Annotated[str, option("Header of the column of roles; none: all are control.", "HEADER")]
FirstPixel = Annotated[
    float | None, option("Coordinate of the centre of the first pixel in the table: 0, 1 or 0.5.", "NUMBER")
]
Units = Annotated[str, option("Units that the headers do not name.", "E=km,H=ft")]
Decimal = Annotated[str, option("Decimal sign, where the numbers can be read with both.", "comma|point")]
Heights = Annotated[str, option("Heights of the table: ellipsoidal, or the vertical CRS.", "ellipsoidal|EPSG:N")]


@command()
def new(
    sources: Annotated[
        list[Path], argument("FOLDER_OR_FILES...", "Images or their metadata, tables, or their folder.")
    ],
    out: Annotated[Path, option("Folder of the project to make.", "PROJECT")],
    columns: Columns = "",
    crs: Annotated[str, option("CRS of the ground points.", "EPSG:N[+M]")] = "",
    heights: Heights = "",
    units: Units = "",
    decimal: Decimal = "",
    sigma_ground: Annotated[
        tuple[float, float, float] | None,
        option("Standard deviations of ground points without any, m.", "EAST NORTH UP"),
    ] = None,
    sigma_image: Annotated[
        tuple[float, float] | None, option("Standard deviations of image points without any, pixels.", "LINE SAMPLE")
    ] = None,
    height: Annotated[float | None, option("Height of points without one, m.")] = None,
    role_column: RoleColumn = "",
    check: Annotated[list[str] | None, option("Make this a check point; may be repeated.", "ID")] = None,
    first_pixel: FirstPixel = None,
    image: Annotated[list[str] | None, option("Image of a name in the tables; may be repeated.", "NAME=IMAGE")] = None,
    yes: Annotated[bool, option("Accept the assumptions, which are listed.", flag="--yes")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Make a project from images and tables of any form.

    Columns, units, CRS and pixel origin are found out by names and by projecting the points into the images. Each
    assumption is listed, and written into project.toml. What nothing decides is asked on a terminal; elsewhere the
    command ends and names the option.
    """
    from fg_orient.formats.office.decisions import Decisions
    from fg_orient.formats.office.project import Given, draft, write_draft

    office = office_of(columns, crs, heights, units, decimal, role_column, first_pixel, image or [])
    terminal = sys.stdin.isatty() and sys.stdout.isatty() and not session().as_json
    given = {"crs": office.crs, "decimal": office.decimal, "columns": office.columns}
    decisions = Decisions(given, _ask if terminal else None)
    values = Given(sigma_ground, sigma_image, height, tuple(check or ()))
    made = draft(sources, out, office, values, decisions, overwrite=overwrite)
    if not session().as_json:
        tell_assumptions(decisions)
    if not yes:
        _confirm(decisions, terminal)
    remarks = write_draft(made, out, decisions, overwrite=overwrite)
    survey = made.survey
    counts = {
        "images": len(made.images), "points": len(survey.ids) if survey else 0,
        "image_points": len(survey.observed) if survey else 0,
        **({str(role): survey.roles.count(role) for role in dict.fromkeys(survey.roles)} if survey else {}),
    }  # fmt: skip
    record = {
        "project": str(out / "project.toml"), "crs": survey.crs if survey else "", **counts,
        "assumptions": [one.as_dict() for one in decisions.assumed], "remarks": [p.as_dict(flag) for p in remarks],
    }  # fmt: skip
    answer(record, lambda _: _show(record, counts, remarks))


def _show(record: dict[str, Any], counts: dict[str, int], remarks: Any) -> None:
    for one in remarks:
        tell("remark", one)
    say(", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items()))
    say(f"written: {record['project']}")


def office_of(
    columns: str = "", crs: str = "", heights: str = "", units: str = "", decimal: str = "", role_column: str = "",
    first_pixel: float | None = None, image: list[str] | None = None,
) -> Any:  # fmt: skip
    """Options about tables of unknown form; InputError for values that are not understood."""
    from fg_orient.formats.office.pixels import FIRST_PIXELS
    from fg_orient.formats.office.survey import Office
    from fg_orient.formats.office.words import ANGLES, LENGTHS
    from fg_orient.geodesy import crs_kind

    if crs:
        try:
            crs_kind(crs)
        except InputError as error:
            raise InputError.of("office.value", option="crs", value=crs, expected=error.problems[0].message) from None
    if heights and heights != "ellipsoidal" and not re.fullmatch(r"EPSG:[0-9]{4,5}", heights):
        raise InputError.of(
            "office.value", option="heights", value=heights, expected="ellipsoidal or EPSG:N, such as EPSG:5773"
        )
    if decimal not in ("", "comma", "point"):
        raise InputError.of("office.value", option="decimal", value=decimal, expected="comma or point")
    if first_pixel is not None and first_pixel not in FIRST_PIXELS:
        raise InputError.of("office.value", option="first_pixel", value=first_pixel, expected="0, 1 or 0.5")
    own = _pairs(units, "units")
    for key, unit in own.items():
        if unit not in LENGTHS and unit not in ANGLES:
            raise InputError.of("office.value", option="units", value=f"{key}={unit}", expected="E=km,H=ft or lon=gon")
    images = {}
    for word in image or []:
        name, equals, found = word.rpartition("=")
        if not equals or not name or not found:
            raise InputError.of("office.value", option="image", value=word, expected="NAME=IMAGE")
        images[name] = found
    return Office(_pairs(columns, "columns"), crs, heights, decimal, own, role_column, first_pixel, images)


def _pairs(text: str, name: str) -> dict[str, str]:
    """Values by key of ``E=Doğu,N=Kuzey``."""
    out = {}
    for part in _PAIR.split(text) if text else []:
        key, equals, value = (word.strip() for word in part.partition("="))
        if not equals or not key or not value:
            raise InputError.of("office.value", option=name, value=part, expected="KEY=VALUE,KEY=VALUE")
        out[key] = value
    return out


def tell_assumptions(decisions: Decisions) -> None:
    """List the assumptions on standard error."""
    for one in decisions.assumed:
        tell("assumed", _words(one))


def _words(one: Assumption) -> str:
    return f"{one.subject}: {one.value} ({one.reason})" + (f" [{flag(one.option)}]" if one.option else "")


def _confirm(decisions: Decisions, terminal: bool) -> None:
    """Ask whether to write; without a terminal, assumptions that an option could state need ``yes``."""
    open_ = [one for one in decisions.assumed if one.option and one.reason != "answered"]
    if not open_:
        return
    if not terminal:
        raise InputError(finding("office.unconfirmed", option="yes", count=len(open_)))
    from rich.prompt import Confirm

    if not Confirm.ask("Write the project with these assumptions?", default=True):
        note("nothing was written")
        raise typer.Exit(InputError.exit_code)


def _ask(question: Question) -> str:
    """Ask a question on the terminal."""
    from rich.prompt import Prompt

    note(f"{question.subject}: {question.reason} [{flag(question.option)}]")
    for k, one in enumerate(question.choices, start=1):
        note(f"  {k}  {one.value}" + (f"  {one.words}" if one.words else ""))
    if not question.choices:
        return Prompt.ask(f"value, such as {question.example}").strip()
    numbers = [str(k) for k in range(1, len(question.choices) + 1)]
    return question.choices[int(Prompt.ask("number", choices=numbers)) - 1].value
