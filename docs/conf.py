import os
import re
import sys
from pathlib import Path

# The kernels are documented as the plain functions they are written as.
os.environ["NUMBA_DISABLE_JIT"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpydoc.docscrape_sphinx as _numpydoc
from jinja2.sandbox import SandboxedEnvironment

import fg_orient

# numpydoc makes an environment, and compiles its one template, for each of two thousand objects
_environments = {}
_numpydoc.SandboxedEnvironment = lambda loader: _environments.setdefault(
    type(loader), SandboxedEnvironment(loader=loader)
)

project = "fg_orient"
author = "the fg_orient developers"
copyright = "2026, the fg_orient developers"
release = version = fg_orient.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.apidoc", "sphinx.ext.mathjax", "numpydoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nitpicky = False

# Reference pages of every module, made at each build.
_common = {
    "max_depth": 4,
    "separate_modules": True,
    "include_private": True,
    "module_first": True,
    "automodule_options": {"members", "show-inheritance"},
}
apidoc_modules = [
    {"path": "../factors", "destination": "api/factors", **_common},
    {"path": "../fg_orient", "destination": "api/fg_orient", **_common},
]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "alabaster"
html_static_path = ["_static"]
html_theme_options = {"description": "Orientation of optical satellite images", "fixed_sidebar": True}

# Several classes stand under two names (fg_orient.Block is fg_orient.block.Block): either target is right.
suppress_warnings = ["ref.python"]

_LITERAL = re.compile(r"(``.+?``|:math:`.+?`)")


def _plain_bars(app, what, name, obj, options, lines):
    """Let |V| in a docstring mean a length, not a substitution of reStructuredText."""
    for k, line in enumerate(lines):
        parts = _LITERAL.split(line)
        parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
        lines[k] = "".join(parts)


def setup(app):
    app.connect("autodoc-process-docstring", _plain_bars)
