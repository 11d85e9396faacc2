"""Collect the faults of one file and report them together; also remarks and hints.

Faults are listed in the order of the lines. Each entry names file, line, column, value
and remedy (``docs/file-formats.md``).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.arrays import name_fault
from fg_orient.model.errors import Finding, InputError, finding

#: Maximum number of faults that are listed for a file; the other faults are only counted.
MAX_FAULTS: Final = 20
#: Maximum number of characters of a text in a cell, and characters that it must not contain.
LONGEST: Final = 10_000
BREAKS: Final = "\n\r\0"


class Faults:
    """Faults of one file: the first 20 are kept, the others are counted.

    Parameters
    ----------
    file : str
        Name of the file in messages.

    Attributes
    ----------
    codes : set of str
        Codes of all faults, also of those that are only counted.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self._problems: list[Finding] = []
        self._dropped = 0
        self.codes: set[str] = set()

    def add(self, code: str, *, place: object = "", value: object = "", **fields: object) -> None:
        """Note a fault; its text comes from the message catalogue."""
        if len(self._problems) >= MAX_FAULTS and ": " not in code:
            self.count(code, 1)  # only counted: a file may have millions of faults
            return
        self.take(finding(code, file=self.file, place=place, value=value, **fields))

    def take(self, *faults: Finding) -> None:
        """Note faults that other code has built."""
        room = MAX_FAULTS - len(self._problems)
        self._problems.extend(faults[:room])
        self.codes.update(fault.code for fault in faults)
        self._dropped += max(0, len(faults) - room)

    def count(self, code: str, n: int) -> None:
        """Count ``n`` further faults without listing them."""
        self.codes.add(code)
        self._dropped += n

    def __bool__(self) -> bool:
        return bool(self._problems)

    @property
    def problems(self) -> tuple[Finding, ...]:
        """Return the listed faults, and one line with the number of the others."""
        if not self._dropped:
            return tuple(self._problems)
        more = finding("table.more_faults", file=self.file, value=f"{self._dropped} more")
        return (*self._problems, more)

    def raise_if_any(self) -> None:
        """Raise one InputError with all faults, if there are any."""
        if self:
            raise InputError(*self.problems)


def is_id(text: str) -> bool:
    """Return whether a text can be the id of a point or image in a table: a reader neither changes nor refuses it."""
    return len(text) <= LONGEST and not name_fault(text)


def sigma_remarks(
    code: str, file: str, sigma: Array, limits: tuple[float, float], place_of: Callable[[int], str]
) -> tuple[Finding, ...]:
    """Return remarks on standard deviations (n, k) outside plausible limits; ``place_of`` names the place of a row."""
    low, high = limits
    odd = np.flatnonzero(((sigma < low) | (sigma > high)).any(axis=1))
    if not len(odd):
        return ()
    place, value = f"{place_of(int(odd[0]))}, sigma", " ".join(f"{s:g}" for s in sigma[odd[0]])
    return (finding(code, file=file, place=place, value=value, low=low, high=high, count=len(odd)),)


def _plain(name: str) -> str:
    """Return a name without the differences that programs make: capitals, separators, zeros before numbers."""
    return re.sub(r"(?<![0-9])0+(?=[0-9])", "", re.sub(r"[\W_]+", "", name.casefold()))


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return the hint "did you mean X?"; without a similar word, return the list of known words, shortened."""
    if not known:
        return "there is none"
    alike = _plain(word)
    close = [name for name in known if _plain(name) == alike] or difflib.get_close_matches(word, known, n=1)
    if close:
        return f"did you mean {close[0]}?"
    more = " ..." if len(known) > 10 else ""
    return f"known: {', '.join(known[:10])}{more}"
