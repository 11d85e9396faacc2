"""Message catalogue: entries of errors, warnings and notes by code.

Each entry gives the message, remedy and severity of a stable code (:class:`fg_orient.model.messages.entry.Entry`).
Message and remedy are format strings of the keyword arguments of :func:`fg_orient.model.errors.finding`; ``<out>``
names an option. The first part of the code is the domain (``xml``, ``dimap``, ``points``, ...). Entries that one place
raises may stand there instead: ``finding`` takes them in the same notation and adds them. Tests compare catalogue and
sources: no code is unknown or unused, no field of a message is missing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

from fg_orient.model.messages.entry import Entry

#: Modules with a table of entries each.
MODULES: Final = (
    "adjustment", "closerange", "exchange", "files", "match", "office", "planetary", "program", "rectify", "sensors",
    "studies",
)  # fmt: skip
CATALOGUE: Final[dict[str, Entry]] = {
    code: entry for name in MODULES for code, entry in import_module(f"{__name__}.{name}").WORDS.items()
}
