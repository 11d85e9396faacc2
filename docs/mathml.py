"""Write formulas as MathML. Browsers draw MathML themselves, so a page loads no script from another address.

This is an extension of Sphinx; latex2mathml converts the formulas. A command without MathML is an error of the page.
"""

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.errors import ExtensionError
from sphinx.util.math import get_node_equation_number

#: Output for a command that latex2mathml does not know, or for a column separator outside a table.
_UNKNOWN = re.compile(r"<m[ion][^>]*>(\\|&(?!#))[^<]*<")


def mathml(latex, display="inline"):
    """Return the ``<math>`` element of a formula; ``display`` is "inline" or "block".

    Raises
    ------
    ValueError
        The formula contains a command that has no MathML.
    """
    latex = latex.replace("{aligned}", "{align*}")  # latex2mathml only knows this name of the same environment
    text = convert(latex, display=display)
    if found := _UNKNOWN.search(text):
        raise ValueError(f"no MathML for {found[0]} in the formula {latex}")
    return text


def _drawn(node, display):
    try:
        return mathml(node.astext(), display)
    except Exception as error:
        raise ExtensionError(f"{node.source or 'a docstring'}, line {node.line}: {error}") from error


def _inline(self, node):
    self.body.append(f'<span class="math">{_drawn(node, "inline")}</span>')
    raise nodes.SkipNode


def _block(self, node):
    self.body.append(self.starttag(node, "div", CLASS="math"))
    if node["number"]:
        number = get_node_equation_number(self, node)
        self.body.append(f'<span class="eqno">({number})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append(f"{_drawn(node, 'block')}</div>\n")
    raise nodes.SkipNode


def setup(app):
    """Register MathML as the renderer of formulas in HTML."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
