"""The message catalogue: every error and warning a user can meet, in one place.

Each entry maps a stable code to ``(message, remedy)``. Both are format strings; the
fields are the keyword arguments given to :func:`fg_orient.errors.problem`. The code's
first part is the domain (``xml``, ``dimap``, ``points``, ...). Tests raise every code.
"""

from __future__ import annotations

from typing import Final

XML: Final = {
    "xml.missing_file": ("the file does not exist", "check the path; it is taken relative to {base}"),
}

OUTPUT: Final = {
    "output.exists": ("the output folder exists already", "give another --out or add --overwrite"),
}

CATALOGUE: Final[dict[str, tuple[str, str]]] = {**XML, **OUTPUT}
