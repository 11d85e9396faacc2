"""The shell of every HTML report: environment of the templates, the one script and its hash.

A page is one file that asks nothing of any other: the content security policy of
``templates/base.html.j2`` forbids every source but inline styles, pictures inside the page, and the script whose hash
it names. A report is readable without that script.
"""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Final

from fg_orient.report.words import number, printable, scientific

if TYPE_CHECKING:
    import jinja2

#: Package of the templates that others extend.
SHELL: Final = "fg_orient.report"


@cache
def script() -> str:
    """Give the text of the script, as it stands between its tags.

    Raises
    ------
    ValueError
        It holds what would end the script element.
    """
    text = resources.files(SHELL).joinpath("templates/report.js").read_text("utf-8")
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError("report.js would end its own element")
    return f"\n{text}"


@cache
def script_hash() -> str:
    """Give the source expression of the script for a content security policy: ``'sha256-...'``."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()}'"


def environment(package: str = SHELL) -> jinja2.Environment:
    """Give the environment of a report: its own templates first, then those shared here.

    Parameters
    ----------
    package : str
        Package whose folder ``templates`` holds the report's own template.

    Returns
    -------
    jinja2.Environment
        Autoescaped, strict about names that do not exist; filters ``number``, ``scientific``, ``printable``.
    """
    import jinja2
    from markupsafe import Markup

    loaders = [jinja2.PackageLoader(name) for name in dict.fromkeys((package, SHELL))]
    found = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    found.filters |= {"number": number, "scientific": scientific, "printable": printable}
    found.globals |= {"script": Markup(script()), "script_hash": Markup(script_hash())}
    return found
