"""Declared options (``fg_orient.model.options``) as options of commands."""

from __future__ import annotations

import contextlib
import functools
import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any, Final

import typer

from fg_orient.cli.output import flag
from fg_orient.model.declaration import Names, Option, Three, declared
from fg_orient.model.errors import InputError

#: Keyword argument of a command that receives the options that were given, by name.
GIVEN = "options"
_NAMED: Final = re.compile("`([a-z_]+)`")


def with_options(*records: type, only: Collection[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: give a command the options that the dataclasses declare.

    Parameters
    ----------
    *records : type
        Dataclasses of declared options.
    only : collection of str
        Names of the options; default: all.
    """
    options = [one for name, one in declared(*records).items() if not only or name in only]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)

        @functools.wraps(command)
        def run(**values: Any) -> None:
            given = {one.name: _value(one, values) for one in options}
            command(**values, **{GIVEN: {name: value for name, value in given.items() if value is not None}})

        made: list[inspect.Parameter] = []
        for name, own in signature.parameters.items():
            made += [p for one in options for p in _parameters(one)] if name == GIVEN else [own]
        run.__signature__ = signature.replace(parameters=made)  # type: ignore[attr-defined]
        return run

    return decorate


def _parameters(option: Option) -> Iterator[inspect.Parameter]:
    """Parameters of a command for an option; None: not given."""
    kind: Any = option.kind if option.kind in (int, float) and not option.named else str
    name, flag = option.name, option.flag
    if option.kind is bool:
        yield _parameter(option, name, bool, f"{flag}/--no-{flag[2:]}")
    elif option.usual:
        yield _parameter(option, _usual(option), bool, flag)
        yield _parameter(
            option, name, kind, f"{flag}-of", help=f"The same for these only, such as {','.join(option.usual[:2])}."
        )
    else:
        yield _parameter(option, name, kind, flag)


def _parameter(option: Option, name: str, kind: Any, flag: str, help: str = "") -> inspect.Parameter:
    info = typer.Option(
        flag, metavar=None if kind is bool else option.metavar, help=help or _help(option), show_default=False,
        rich_help_panel=option.group.title,
    )  # fmt: skip
    either = inspect.Parameter.POSITIONAL_OR_KEYWORD
    return inspect.Parameter(name, either, default=None, annotation=Annotated[kind | None, info])


def _help(option: Option) -> str:
    """First sentence of the help, options as flags, and the default as it is typed."""
    own = {option.name: option.flag}
    text = _NAMED.sub(lambda found: own.get(found[1]) or flag(found[1]), option.short_help)
    default = ",".join(map(str, option.default)) if option.kind is Three else option.default_text
    if option.kind is bool:
        default = option.flag if option.default else ""
    return f"{text[:-1]}; default: {default}." if default else text


def _usual(option: Option) -> str:
    """Name of the parameter that chooses the usual names of an option."""
    return f"usual_{option.name}"


def _value(option: Option, values: dict[str, Any]) -> Any:
    """Take the value of an option out of the arguments of a command; None: not given."""
    value, usual = values.pop(option.name), values.pop(_usual(option), None)
    if value is None:
        return option.usual if usual else None
    if option.kind not in (Names, Three):
        return value
    parts = tuple(part.strip() for part in value.split(",") if part.strip())
    try:
        return parts if option.kind is Names else tuple(map(float, parts))
    except ValueError:
        return parts  # no numbers: refused with all other values


@contextlib.contextmanager
def named_as_typed(flags: Mapping[str, str]) -> Iterator[None]:
    """Replace the places of errors that belong to no file by the options of the command line."""
    try:
        yield
    except InputError as error:
        problems = []
        for found in error.problems:
            name, bracket, rest = found.place.partition("[")
            typed = not found.file and name in flags
            problems.append(replace(found, place=flags[name] + bracket + rest) if typed else found)
        raise InputError(*problems) from None


def flags(*records: type) -> dict[str, str]:
    """Names of options on the command line."""
    return {name: one.flag for name, one in declared(*records).items()}
