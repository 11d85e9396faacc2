"""Command ``new``: make a project from images and the tables of an office."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from fg_orient.cli.command import (
    CheckIds,
    Height,
    Overwrite,
    Several,
    SigmaGround,
    SigmaImage,
    argument,
    command,
    option,
)
from fg_orient.cli.log import session
from fg_orient.cli.output import answer, flag, note, say, tell
from fg_orient.model.errors import InputError, finding

if TYPE_CHECKING:
    from fg_orient.formats.heights import ZeroLevel
    from fg_orient.formats.office.decisions import Assumption, Decisions, Office, Question

_PAIR: Final = re.compile(r",(?=\s*[A-Za-z]\w*\s*=)")


def _office(
    columns: str, heights: str, units: str, decimal: str, role_column: str, first_pixel: float | None
) -> Office:
    """Return the user's statements about tables of unknown form.

    Raise InputError for invalid values.
    """
    from fg_orient.formats.office.decisions import Office
    from fg_orient.formats.office.pixels import FIRST_PIXELS
    from fg_orient.formats.office.words import ANGLES, LENGTHS
    from fg_orient.geodesy.crs import vertical_code

    own = _pairs(units, "units")
    wrong = next((f"{key}={unit}" for key, unit in own.items() if unit not in LENGTHS and unit not in ANGLES), "")
    for name, value, is_wrong, expected in (
        ("decimal", decimal, decimal not in ("", "comma", "point"), "comma or point"),
        ("first_pixel", first_pixel, first_pixel not in (None, *FIRST_PIXELS), "0, 1 or 0.5"),
        ("units", wrong, bool(wrong), "E=km,H=ft or lon=gon"),
    ):
        if is_wrong:
            raise InputError.of("office.value", option=name, value=value, expected=expected)
    if heights not in ("", "ellipsoidal"):
        try:
            heights = vertical_code(heights)
        except InputError as error:
            raise InputError(*(replace(problem, place="", option="heights") for problem in error.problems)) from None
    return Office(_pairs(columns, "columns"), "", heights, decimal, own, role_column, first_pixel)


def _pairs(text: str, name: str) -> dict[str, str]:
    """Read pairs such as ``E=Doğu,N=Kuzey`` and return values by key."""
    out = {}
    for part in _PAIR.split(text) if text else []:
        key, equals, value = (word.strip() for word in part.partition("="))
        if not equals or not key or not value:
            raise InputError.of("office.value", option=name, value=part, expected="KEY=VALUE,KEY=VALUE")
        out[key] = value
    return out


def crs_code(crs: str, option: str = "crs") -> str:
    """Replace the names of a CRS by codes; "" is accepted.

    InputError: the CRS cannot be used; the message names the option.
    """
    from fg_orient.geodesy import crs_kind
    from fg_orient.geodesy.crs import with_codes

    try:
        crs = with_codes(crs)
        if crs:
            crs_kind(crs)
    except InputError as error:
        raise InputError(*(replace(problem, place="", option=option) for problem in error.problems)) from None
    return crs


#: These options about tables of unknown form replace the parameter ``office`` of a command.
OFFICE: Final = {"office": Several({
    "columns": (
        Annotated[str, option("Headers of columns (without header: #1, #2).", "E=HEADER,N=HEADER,...")], ""
    ),
    "heights": (
        Annotated[str, option("Heights: ellipsoidal, or a vertical CRS.", "ellipsoidal|EPSG:N|NAME")], ""
    ),
    "units": (Annotated[str, option("Units that the headers do not name.", "E=km,H=ft")], ""),
    "decimal": (Annotated[str, option("Decimal sign, if both signs are possible.", "comma|point")], ""),
    "role_column": (Annotated[str, option("Column of roles; none: all points are control points.", "HEADER")], ""),
    "first_pixel": (
        Annotated[float | None, option("Coordinate of the centre of the first pixel: 0, 1 or 0.5.", "NUMBER")], None
    ),
}, _office)}  # fmt: skip


def _level(geoid: Path | None, undulation_m: float | None, both_heights: Path | None) -> ZeroLevel:
    from fg_orient.formats.heights import ZeroLevel

    return ZeroLevel(geoid, undulation_m, both_heights)


#: These options about the zero level of heights replace the parameter ``level`` of a command.
LEVEL: Final = {"level": Several({
    "geoid": (
        Annotated[Path | None, option("Geoid file, to convert heights of the table to ellipsoidal heights.")], None
    ),
    "undulation_m": (
        Annotated[float | None, option("Constant undulation of the heights, m.", "METRES", flag="--undulation")],
        None,
    ),
    "both_heights": (
        Annotated[Path | None, option("Table id,height_m,ellipsoidal_height_m, to estimate the constant undulation.")],
        None,
    ),
}, _level)}  # fmt: skip
#: Flags of these options that differ from the names of the library's arguments.
LEVEL_FLAGS: Final = {"undulation_m": "--undulation"}


@command(several=OFFICE | LEVEL, named=LEVEL_FLAGS)
def new(
    sources: Annotated[
        list[Path], argument("FOLDER_OR_FILES...", "Images or their metadata, tables, or their folder.")
    ],
    out: Annotated[Path, option("Folder of the new project.", "PROJECT")],
    office: Any = None,
    level: Any = None,
    crs: Annotated[str, option("CRS of the ground points.", "EPSG:N[+M]")] = "",
    sigma_ground: SigmaGround = None,
    sigma_image: SigmaImage = None,
    height: Height = None,
    check: CheckIds = None,
    image: Annotated[
        list[str] | None, option("Image that a name in the tables stands for; may be repeated.", "NAME=IMAGE")
    ] = None,
    yes: Annotated[bool, option("Accept the listed assumptions.", flag="--yes")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Make a project from images and tables of any form.

    The command finds columns, units, CRS and pixel origin by names and by projecting the points into
    the images. It lists each assumption and writes it into project.toml. On a terminal the command asks
    about properties that the data do not determine; elsewhere it ends and names the option.
    """
    from fg_orient.formats.office.decisions import Decisions
    from fg_orient.formats.office.project import Given, draft, write_draft

    office = replace(office, crs=crs_code(crs), images=_named_images(image or []))
    terminal = sys.stdin.isatty() and sys.stdout.isatty() and not session().as_json
    decisions = Decisions(office.given, _ask if terminal else None)
    values = Given(sigma_ground, sigma_image, height, tuple(check or ()), level)
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
    if not record["image_points"]:
        say(f"next: measure tie points (fg-orient match {record['project']}), or add a table [observations]")


def _named_images(words: list[str]) -> dict[str, str]:
    """Read texts ``NAME=IMAGE`` and return the images by their names in tables."""
    images = {}
    for word in (part for one in words for part in (one.split(",") if one.count("=") > 1 else [one])):
        name, _, found = word.rpartition("=")
        if not name or not found:
            raise InputError.of("office.value", option="image", value=word, expected="NAME=IMAGE")
        images[name] = found
    return images


def tell_assumptions(decisions: Decisions) -> None:
    """Print the assumptions on standard error."""
    for one in decisions.assumed:
        tell("assumed", _words(one))


def _words(one: Assumption) -> str:
    return f"{one.subject}: {one.value} ({one.reason})" + (f" [{flag(one.option)}]" if one.option else "")


def _confirm(decisions: Decisions, terminal: bool) -> None:
    """Ask whether to write the project.

    Without a terminal, the option ``yes`` is required if there are assumptions that an option could state.
    """
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
    """Ask a question on the terminal and return the answer."""
    from rich.prompt import Prompt

    note(f"{question.subject}: {question.reason} [{flag(question.option)}]")
    for k, one in enumerate(question.choices, start=1):
        note(f"  {k}  {one.value}" + (f"  {one.words}" if one.words else ""))
    if not question.choices:
        return Prompt.ask(f"value, such as {question.example}").strip()
    numbers = [str(k) for k in range(1, len(question.choices) + 1)]
    return question.choices[int(Prompt.ask("number", choices=numbers)) - 1].value
