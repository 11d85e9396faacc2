"""Message catalogue: entries for errors, warnings and notes, by code.

Each entry gives the message, remedy and severity of a stable code
(:class:`fg_orient.model.messages.entry.Entry`). Message and remedy are format strings of the keyword
arguments of :func:`fg_orient.model.errors.finding`;
``<out>`` names an option. The first part of the code is the domain (``xml``, ``dimap``, ``points``, ...). A
message that is used in only one place may be declared there: ``finding`` accepts the same notation and adds
the entry. Tests compare the catalogue with the sources: every code is known and used, and no field of a
message is missing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

from fg_orient.model.messages.entry import Entry

#: Modules that each contain a table of entries.
MODULES: Final = (
    "adjustment",
    "closerange",
    "exchange",
    "files",
    "match",
    "office",
    "planetary",
    "program",
    "rectify",
    "sensors",
    "studies",
)
CATALOGUE: Final[dict[str, Entry]] = {
    code: entry for name in MODULES for code, entry in import_module(f"{__name__}.{name}").WORDS.items()
}
