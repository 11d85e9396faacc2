"""Declaration of options: each is one field of a dataclass.

The check of values, the project file's schema, the command line, the keyword arguments of
:func:`fg_orient.adjust` and the reference page (docs/options.md) are made from the field.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cache
from types import NoneType
from typing import Any, Final, Literal, TypeVar, get_args, get_origin

from fg_orient.errors import InputError, problem

#: Prior standard deviations of the constant, linear and quadratic coefficient of tau.
Three = tuple[float, float, float]
Names = tuple[str, ...]
Record = TypeVar("Record")
#: Longest metavar that stays readable in the help of a command.
_METAVAR_LENGTH: Final = 26


@dataclass(frozen=True)
class Group:
    """Heading of related options in the help and in the reference; ``table`` is their table of the project file."""

    title: str
    table: Literal["orientation", "adjustment"]


@dataclass(frozen=True, kw_only=True)
class Option:
    """One option.

    Parameters
    ----------
    name : str
    kind : type
        bool, int, float, str, ``Three``, ``Names`` or a Literal of words.
    optional : bool
        None is a value.
    default : object
    group : Group
    help : str
        The first sentence is the help of the command line; the reference page has all sentences.
    unit : str
    within : (float, float) or None
        Smallest and largest value. A float without it must be above zero.
    below : float
        Exclusive upper bound.
    zero : str
        Meaning of 0, if 0 is allowed below ``within``.
    such : str or tuple of str
        Example; of a number: name that is accepted in its place by all but ``Options``.
    left_out : str
        Meaning of None, or of no names.
    usual : tuple of str
        Names for which the command line has a flag; other names are given by ``--...-of``.
    spelled : str
        Name on the command line if it differs.
    """

    name: str
    kind: Any
    optional: bool
    default: Any
    group: Group
    help: str
    unit: str = ""
    within: tuple[float, float] | None = None
    below: float = math.inf
    zero: str = ""
    such: str | Names = ""
    left_out: str = ""
    usual: Names = ()
    spelled: str = ""

    @property
    def words(self) -> tuple[str, ...]:
        """Allowed words; none if any text or number is possible."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    @property
    def named(self) -> bool:
        """Whether a name may stand for the number."""
        return self.kind is int and bool(self.such)

    @property
    def flag(self) -> str:
        """Option of the command line."""
        return "--" + (self.spelled or self.name.replace("_", "-"))

    @property
    def metavar(self) -> str:
        """Placeholder of the value in the help of a command."""
        if words := "|".join(self.words):
            return words if len(words) <= _METAVAR_LENGTH else "NAME"
        if self.kind in (float, Three) and self.unit:
            return " ".join([self.unit.upper()] * (3 if self.kind is Three else 1))
        return {int: "N|NAME" if self.named else "N", float: "P", str: "NAME", Names: "NAME,NAME"}.get(self.kind, "")

    @property
    def short_help(self) -> str:
        """First sentence of the help, with words that the metavar has no room for."""
        first = self.help.partition(". ")[0].rstrip(".")
        return f"{first}: {', '.join(self.words)}." if self.words and self.metavar == "NAME" else f"{first}."

    @property
    def default_text(self) -> str:
        """Default in words."""
        if self.default in (None, ()):
            return self.left_out
        return toml(self.default) if isinstance(self.default, bool | tuple) else str(self.default)

    @property
    def expected(self) -> str:
        """Allowed values in words, for messages and the reference."""
        within, such, unit = self.within, self.such or self.usual, f" in {self.unit}" if self.unit else ""
        example = f", such as {toml(such)}" if such else ""
        text = " or ".join(f'"{word}"' for word in self.words)
        if self.kind is bool:
            text = "true or false"
        elif self.kind is Three:
            text = f"three numbers above zero{unit}: the sigmas of c0, c1, c2"
        elif self.kind is Names:
            text = f"names in brackets, each once{example}"
        elif self.kind is str:
            text = f"a name in quotes{example}"
        elif within is not None:
            text = f"a {'whole ' if self.kind is int else ''}number from {within[0]:g} to {within[1]:g}{unit}"
        elif not text:
            text = f"a number above zero{unit}" + (f" and below {self.below:g}" if self.below < math.inf else "")
        text += f", or 0 for {self.zero}" if self.zero else ""
        return text + (f"; leave it out for {self.left_out}" if self.left_out else "")

    def allows(self, value: Any) -> bool:
        """Whether the option can have this value."""
        if value is None:
            return self.optional
        if self.words:
            return isinstance(value, str) and value in self.words
        if self.kind is bool:
            import numpy as np  # not above: the help of a command needs no numpy

            return isinstance(value, bool | np.bool_)
        if self.kind is str:
            return isinstance(value, str) and bool(value)
        if self.kind in (Three, Names):
            is_list = isinstance(value, tuple | list)
            if self.kind is Three:
                return is_list and len(value) == 3 and all(self._in_range(v) for v in value)
            return is_list and all(isinstance(v, str) and v for v in value) and len(set(value)) == len(value)
        return self._in_range(value)

    def _in_range(self, value: Any) -> bool:
        kind = numbers.Integral if self.kind is int else numbers.Real
        if isinstance(value, bool) or not isinstance(value, kind):
            return False
        number = float(value)
        if self.within is None:
            return 0.0 < number < self.below
        return self.within[0] <= number <= self.within[1] or bool(self.zero and number == 0.0)


def option(default: Any, group: Group, help: str, **more: Any) -> Any:
    """Field of a dataclass that declares an option; ``more`` are further parameters of :class:`Option`."""
    return field(default=default, metadata={"group": group, "help": help, **more})


@cache
def _options_of(record: type) -> dict[str, Option]:
    found = {}
    for f in fields(record):
        kinds: Any = [kind for kind in get_args(f.type) if kind is not NoneType]
        optional = NoneType in get_args(f.type)
        kind = kinds[0] if optional else f.type
        found[f.name] = Option(name=f.name, kind=kind, optional=optional, default=f.default, **f.metadata)
    return found


def declared(*records: type) -> dict[str, Option]:
    """Options of dataclasses by name, in the order of their declaration."""
    return {name: one for record in records for name, one in _options_of(record).items()}


def require_allowed(record: Any) -> None:
    """Check all values of a record.

    Raises
    ------
    InputError
        One problem per value that is not allowed.
    """
    values = [(one, getattr(record, name)) for name, one in declared(type(record)).items()]
    problems = [
        problem("options.value", place=one.name, value=repr(value), expected=one.expected)
        for one, value in values
        if not one.allows(value)
    ]
    if problems:
        raise InputError(*problems)


def require_declared(names: Iterable[str], caller: str, *records: type) -> None:
    """Refuse names that no record declares.

    Raises
    ------
    TypeError
        As for any unknown keyword argument, with the most similar name.
    """
    known = declared(*records)
    for name in sorted(set(names) - set(known)):
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
        raise TypeError(f"{caller}() has no option {name!r}; {hint}")


def documented(record: type[Record]) -> type[Record]:
    """Decorate a dataclass: add its options to the docstring as parameters."""
    lines = [f"{record.__doc__}\n\nParameters\n----------"]
    for name, one in declared(record).items():
        kind = " or ".join(f'"{word}"' for word in one.words) or _KIND_NAMES[one.kind]
        lines += [f"{name} : {kind}{' or None' if one.optional else ''}", f"    {one.help}"]
    record.__doc__ = "\n".join([*lines, "\nRaises\n------\nInputError\n    One problem per value that is not allowed."])
    return record


_KIND_NAMES: Final[dict[Any, str]] = {
    bool: "bool", int: "int", float: "float", str: "str", Three: "tuple of 3 floats", Names: "tuple of str",
}  # fmt: skip


def toml(value: object) -> str:
    """TOML text of a str, bool, int, float or tuple of these."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(toml(v) for v in value)}]"
    if not isinstance(value, str):
        return repr(value)
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
