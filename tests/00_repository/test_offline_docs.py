"""The built documentation loads nothing from the network: formulas are MathML, and no page loads another address."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.repository

for needed in ("sphinx", "myst_parser", "numpydoc", "latex2mathml"):
    pytest.importorskip(needed)

#: A page with many formulas, and extensions that are enough to build it alone.
PAGE, EXTENSIONS = "equations", "myst_parser,mathml,sphinx.ext.autodoc"
#: What a browser loads by itself: of links only those that name a resource of the page.
LOADED = re.compile(r'<(?:script|img|iframe|link|source|object)\b[^>]*?\b(?:src|href|data)="((?:https?:)?//[^"]*)"')
STYLE = re.compile(r"(?:@import\s+|url\()[\"']?((?:https?:)?//[^\"')]+)")


@pytest.fixture(scope="module")
def built(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page, built by the configuration of the documentation."""
    out = tmp_path_factory.mktemp("html")
    chosen = (f"root_doc={PAGE}", f"include_patterns={PAGE}.md", f"extensions={EXTENSIONS}")
    words = ["-q", "-b", "html", "-d", str(out / "trees"), *(w for c in chosen for w in ("-D", c))]
    command = [sys.executable, "-m", "sphinx", *words, str(repository / "docs"), str(out / "html")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stderr
    return out / "html"


def test_no_page_loads_from_another_address(built: Path) -> None:
    pages = sorted(built.glob("*.html"))
    assert built / f"{PAGE}.html" in pages
    for page in pages:
        assert LOADED.findall(page.read_text("utf-8")) == [], page.name
    styles = sorted(built.rglob("*.css"))
    assert {"custom.css", "furo.css"} <= {style.name for style in styles}
    for style in styles:
        assert STYLE.findall(style.read_text("utf-8")) == [], style.name


def test_formulas_are_mathml(built: Path, repository: Path) -> None:
    text = (built / f"{PAGE}.html").read_text("utf-8")
    source = (repository / "docs" / f"{PAGE}.md").read_text("utf-8")
    shown = len(re.findall(r"\$\$.+?\$\$", source, re.DOTALL))
    assert text.count('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">') == shown > 5
    assert "\\(" not in text and "mathjax" not in text.lower()


def test_lines_of_a_formula_are_rows_and_unknown_commands_are_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository / "docs"))
    from mathml import mathml

    text = mathml(r"\begin{aligned} a &= b \\ c &= \tfrac{d}{2} \end{aligned}", "block")
    assert text.count("<mtr>") == 2 and text.count('<mtd columnalign="left">') == 2 and "&<" not in html.unescape(text)
    for wrong in (r"\nosuchcommand x", r"a &= b"):
        with pytest.raises(ValueError, match="no MathML for"):
            mathml(wrong)
