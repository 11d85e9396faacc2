"""The message catalogue: every error and warning a user can meet, in one place.

Each entry maps a stable code to message and remedy, and what stops nothing to its severity
(:class:`fg_orient.model.messages.entry.Entry`). Both are format strings of the keyword arguments given to
:func:`fg_orient.model.errors.finding`; ``<out>`` names an option. The code's first part is the domain (``xml``,
``dimap``, ``points``, ...). Tests hold the catalogue and the sources against each other: no code is unknown or unused,
no field of a message is missing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

from fg_orient.model.messages.entry import Entry

#: Modules with a table of entries each.
MODULES: Final = (
    "closerange", "dense", "earth", "files", "frame", "installation", "interchange", "parallel", "readers",
    "rectify", "rfm", "rpc", "solution", "statistics", "ties", "work",
)  # fmt: skip
CATALOGUE: Final[dict[str, Entry]] = {
    code: entry for name in MODULES for code, entry in import_module(f"{__name__}.{name}").WORDS.items()
}
