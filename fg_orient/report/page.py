"""Common parts of all HTML reports: environment of the templates, and the only script with its hash.

A page is one file that needs no other file. The content security policy of ``templates/base.html.j2``
allows only inline styles, pictures inside the page, and the script whose hash it names. A report is
readable without that script.
"""

from __future__ import annotations

import base64
import hashlib
import re
from contextlib import suppress
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from factors._compile import cache_folder
from fg_orient.report.svg import svg
from fg_orient.report.words import number, printable, scientific

if TYPE_CHECKING:
    import jinja2

#: Package of the templates that others extend.
SHELL: Final = "fg_orient.report"


@cache
def script() -> str:
    """Return the text of the script without its tags.

    Raises
    ------
    ValueError
        The text would end the script element.
    """
    text = resources.files(SHELL).joinpath("templates/report.js").read_text("utf-8")
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError("report.js would end its own element")
    return f"\n{text}"


@cache
def script_hash() -> str:
    """Return the source expression of the script for a content security policy: ``'sha256-...'``."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()}'"


def environment(package: str = SHELL) -> jinja2.Environment:
    """Return the environment of a report: its own templates first, then the shared templates.

    Parameters
    ----------
    package : str
        Package with the report's own template in its folder ``templates``.

    Returns
    -------
    jinja2.Environment
        Autoescaped, strict about names that do not exist; with the macros of ``macros.html.j2`` and the filters
        ``number``, ``scientific``, ``printable``, ``svg`` and ``headings``.
    """
    import jinja2

    class Cache(jinja2.FileSystemBytecodeCache):
        """Cache of compiled templates, next to the compiled kernels.

        A folder that cannot be written is not an error.
        """

        def dump_bytecode(self, bucket: Any) -> None:
            with suppress(OSError):
                super().dump_bytecode(bucket)

    folder = cache_folder()
    loaders = [jinja2.PackageLoader(name) for name in dict.fromkeys((package, SHELL))]
    shell = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, bytecode_cache=None if folder is None else Cache(str(folder), "%s.template"),
    )  # fmt: skip
    shell.filters |= {
        "number": number, "scientific": scientific, "printable": printable, "svg": svg, "headings": headings,
    }  # fmt: skip
    shell.globals |= {"script": Markup(script()), "script_hash": Markup(script_hash())}
    macros = shell.get_template("macros.html.j2").module
    shell.globals |= {name: macro for name, macro in vars(macros).items() if isinstance(macro, jinja2.runtime.Macro)}
    return shell


def headings(content: Markup) -> list[tuple[str, Markup]]:
    """Return ids and headings of the sections of a page, for its links."""
    found = re.findall(r'<section id="([^"]+)"><h2>(.*?)</h2>', content)
    return [(name, Markup(words)) for name, words in found]
