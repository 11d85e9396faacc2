"""Declaration of options: each option is one field of a dataclass.

The field defines the check of values, the schema of the project file, the command line, the keyword arguments of
:func:`fg_orient.adjust` and the reference page (docs/options.md).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cache
from types import NoneType
from typing import Any, Final, Literal, TypeVar, get_args, get_origin

from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import LARGEST, SMALLEST

Three = tuple[float, float, float]
Names = tuple[str, ...]
Record = TypeVar("Record")
#: Longest placeholder of a value that is readable in the help of a command.
_METAVAR_LENGTH: Final = 26


@dataclass(frozen=True)
class Group:
    """Heading of related options, with their table of the project file (if any) and the page that explains them."""

    title: str
    table: str = ""
    page: str = ""


@dataclass(frozen=True, kw_only=True)
class Option:
    """Declaration of one option.

    Parameters
    ----------
    name, unit : str
    kind : type
        bool, int, float, str, ``Three``, ``Names`` or a Literal of words.
    optional : bool
        True if None is allowed.
    default : object
    group : Group
    help : str
        The help of the command line shows the first sentence, the reference page all sentences.
    within : (float, float) or None
        Smallest and largest value. Without it an int must be above zero, and a float is ``SMALLEST`` .. ``LARGEST``:
        the squares of other numbers overflow in weights.
    below : float
        Exclusive upper bound.
    zero, left_out : str
        Meaning of 0, if 0 is allowed below ``within``; meaning of None or of an empty list of names.
    such : str or tuple of str
        Example of a value. For a number: a name that the command line accepts instead of the number
        (``Options`` does not).
    usual : tuple of str
        Names for which the command line has a flag; ``--...-of`` sets the value of any other name.
    spelled : str
        Name on the command line, if it differs from the name without its unit.
    iterates : bool
        True if the option changes an iteration: a checkpoint is then useless with another value.
    recorded : bool
        True if ``result.json`` lists the option among its figures.
    component : str
        Group of observations whose standard deviation is this option, for variance components.
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
    iterates: bool = True
    recorded: bool = False
    component: str = ""

    @property
    def words(self) -> tuple[str, ...]:
        """Allowed words; empty if any text or number is possible."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    @property
    def named(self) -> bool:
        """True if a name can be given instead of the number."""
        return self.kind is int and bool(self.such)

    @property
    def flag(self) -> str:
        """Flag on the command line."""
        suffix = f"_{self.unit.lower().replace('/', '_')}"
        return "--" + (self.spelled or self.name.removesuffix(suffix).replace("_", "-"))

    @property
    def metavar(self) -> str:
        """Placeholder for the value in the help of a command."""
        if words := "|".join(self.words):
            return words if len(words) <= _METAVAR_LENGTH else "NAME"
        if self.kind in (float, Three) and self.unit:
            return ",".join([self.unit.upper()] * (3 if self.kind is Three else 1))
        return {int: "N|NAME" if self.named else "N", float: "P", str: "NAME", Names: "NAME,NAME"}.get(self.kind, "")

    @property
    def short_help(self) -> str:
        """First sentence of the help, followed by the allowed words if the placeholder has no room for them."""
        first = self.help.partition(". ")[0].rstrip(".")
        return f"{first}: {', '.join(self.words)}." if self.words and self.metavar == "NAME" else f"{first}."

    @property
    def default_text(self) -> str:
        """Default as text."""
        if self.default in (None, ()):
            return self.left_out
        return toml(self.default) if isinstance(self.default, bool | tuple) else str(self.default)

    @property
    def expected(self) -> str:
        """Description of the allowed values, for messages and the reference page."""
        within, such, unit = self.within, self.such or self.usual, f" in {self.unit}" if self.unit else ""
        example = f", such as {toml(such)}" if such else ""
        if within is None:
            within = (1, math.inf) if self.kind is int else (SMALLEST, LARGEST)
        below = f" and below {self.below:g}" if self.below < math.inf else ""
        bounds = f"from {within[0]:g}" + (below or (f" to {within[1]:g}" if within[1] < math.inf else ""))
        text = (
            " or ".join(f'"{word}"' for word in self.words)
            or {
                bool: "true or false",
                int: f"a whole number {bounds}{unit}",
                float: f"a number {bounds}{unit}",
                Three: f"three numbers {bounds}{unit}",
                Names: f"names in brackets, each once{example}",
                str: f"a name in quotes{example}",
            }[self.kind]
        )
        text += f", or 0 for {self.zero}" if self.zero else ""
        return text + (f"; leave it out for {self.left_out}" if self.left_out else "")

    def allows(self, value: Any) -> bool:
        """Return whether the option can have this value."""
        if value is None:
            return self.optional
        if self.words:
            return isinstance(value, str) and value in self.words
        if self.kind is bool:
            import numpy as np  # imported here because the help of a command needs no numpy

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
        import numpy as np  # imported here for the same reason as in ``allows``

        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not whole and (self.kind is int or not isinstance(value, float | np.floating)):
            return False
        least, most = self.within or ((1, math.inf) if self.kind is int else (SMALLEST, LARGEST))
        inside = least <= value <= most and value < self.below
        return bool(inside or (self.zero and value == 0))


def option(default: Any, group: Group, help: str, **more: Any) -> Any:
    """Return a dataclass field that declares an option; ``more`` contains further parameters of :class:`Option`."""
    return field(default=default, metadata={"group": group, "help": help, **more})


def declared(*records: type) -> Mapping[str, Option]:
    """Return all options that these dataclasses declare, by name, in the order of declaration."""
    return _declared(records)


@cache
def _declared(records: tuple[type, ...]) -> Mapping[str, Option]:
    found = {}
    for f in (f for record in records for f in fields(record)):
        optional = NoneType in get_args(f.type)
        kind = get_args(f.type)[0] if optional else f.type
        found[f.name] = Option(name=f.name, kind=kind, optional=optional, default=f.default, **f.metadata)
    return found


def require_allowed(record: Any) -> None:
    """Check all values of a record; the InputError contains one problem per value that is not allowed."""
    wrong = [one for name, one in declared(type(record)).items() if not one.allows(getattr(record, name))]
    if wrong:
        raise InputError(
            *(
                finding("options.value", option=one.name, value=repr(getattr(record, one.name)), expected=one.expected)
                for one in wrong
            )
        )


def require_finite(values: Mapping[str, Any]) -> None:
    """Refuse an option without a declaration whose number, or one of whose numbers, is not finite."""
    for name, value in values.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(one) for one in numbers if isinstance(one, float)):
            shown = " ".join(map(str, numbers))
            raise InputError.of("options.value", option=name, value=shown, expected="finite numbers")


class Checked:
    """Base class for dataclasses of options: it checks the values of a record at its creation."""

    def __post_init__(self) -> None:
        require_allowed(self)


def require_declared(names: Iterable[str], caller: str, *records: type, only: Collection[str] = ()) -> None:
    """Raise TypeError for an option name that is not declared or not in ``only``; suggest the most similar name."""
    known = [name for name in declared(*records) if not only or name in only]
    for name in sorted(set(names) - set(known)):
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
        raise TypeError(f"{caller}() has no option {name!r}; {hint}")


def documented(record: type[Record]) -> type[Record]:
    """Decorate a dataclass of options: add them to its docstring as parameters."""
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
    """Return the TOML text of a str, bool, int, float, or tuple of such values."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(toml(v) for v in value)}]"
    if not isinstance(value, str):
        return repr(value)
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
