import os
import re
import sys
from pathlib import Path

# Kernels are documented as plain Python functions.
os.environ["NUMBA_DISABLE_JIT"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpydoc.docscrape_sphinx as _numpydoc
from jinja2.sandbox import SandboxedEnvironment
from sphinx.domains.python import PythonDomain

import fg_orient

# one environment for all objects: numpydoc would compile its template for each of two thousand objects
_environments = {}
_numpydoc.SandboxedEnvironment = lambda loader: _environments.setdefault(
    type(loader), SandboxedEnvironment(loader=loader)
)

# sphinx compares each name of a signature with the end of every object's name; most names (float, Any) are not ours
_last_words = {}
_search_all = PythonDomain.find_obj


def _find_obj(self, env, modname, classname, name, *arguments):
    size = len(self.objects)
    if size not in _last_words:
        _last_words[size] = {key.rpartition(".")[2] for key in self.objects}
    if name.removesuffix("()").rpartition(".")[2] not in _last_words[size]:
        return []
    return _search_all(self, env, modname, classname, name, *arguments)


PythonDomain.find_obj = _find_obj

project = "fg_orient"
author = "the fg_orient developers"
copyright = "2026, the fg_orient developers"
release = version = fg_orient.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.apidoc", "mathml", "numpydoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
myst_update_mathjax = False
html_math_renderer = "mathml"
nitpicky = False

# Each build makes reference pages of the modules that users and extenders import: one page
# for each package. Modules of the command line, the loops inside the backends and the
# printed values have no page.
_ROOT = Path(__file__).resolve().parents[1]
_INTERNAL = """
    fg_orient/__main__.py fg_orient/model/public.py
    fg_orient/adjustment/*.py fg_orient/adjustment/parts/*
    fg_orient/cli fg_orient/closerange/*job.py fg_orient/closerange/importing.py
    fg_orient/closerange/report*.py fg_orient/formats/assemble.py fg_orient/formats/atomic.py
    fg_orient/formats/*_checks.py fg_orient/formats/gdal.py fg_orient/formats/toml.py
    fg_orient/formats/rpc/fields.py fg_orient/formats/schema.py fg_orient/kernels/batch*
    fg_orient/model/messages fg_orient/rectification/job.py fg_orient/rectification/record.py
    fg_orient/rectification/study.py fg_orient/rectification/grid.py
    fg_orient/rectification/ortho*.py fg_orient/report/*.py
    fg_orient/orientation/run.py fg_orient/orientation/replay.py
    fg_orient/result/s*.py fg_orient/result/tables.py fg_orient/result/provenance.py
    fg_orient/simulate/* fg_orient/studies/claims*.py fg_orient/studies/comparison/* fg_orient/studies/published
    fg_orient/studies/reproduce fg_orient/studies/tables_*.py
""".split()
_IMPORTED = """
    fg_orient/adjustment/problem.py fg_orient/adjustment/regression.py
    fg_orient/studies/comparison/compare.py fg_orient/studies/comparison/model.py fg_orient/studies/claims.py
    fg_orient/adjustment/parts/study.py
    fg_orient/report/chart.py fg_orient/report/figures.py fg_orient/report/geofiles.py fg_orient/report/html.py
    fg_orient/report/maps.py fg_orient/report/paper.py fg_orient/report/plots.py
    fg_orient/simulate/block.py fg_orient/simulate/options.py fg_orient/simulate/simulation.py
    fg_orient/simulate/zonguldak.py
""".split()


def _paths(patterns):
    """Return files and folders of the source tree.

    A pattern that finds nothing is an error: the module has probably moved.
    """
    found = {pattern: set(_ROOT.glob(pattern)) for pattern in patterns}
    if missing := [pattern for pattern, paths in found.items() if not paths]:
        raise ValueError(f"docs/conf.py names files that do not exist: {missing}")
    return set().union(*found.values())


def _left_out():
    paths = _paths(_INTERNAL) - _paths(_IMPORTED)
    return sorted(f"../{path.relative_to(_ROOT)}" for path in paths if path.name != "__init__.py")


_common = {
    "max_depth": 4,
    "include_private": True,
    "module_first": True,
    "exclude_patterns": _left_out(),
    "automodule_options": {"members", "show-inheritance"},
}
apidoc_modules = [
    {"path": "../factors", "destination": "api/factors", **_common},
    {"path": "../fg_orient", "destination": "api/fg_orient", **_common},
]
toc_object_entries = False  # with objects, the table of contents of each page took 100 of 170 s of a build
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False  # there are no type comments, and the search parses every function once more
smartquotes = False  # smart quotes take a twentieth of the build time
autosummary_generate = False  # numpydoc loads autosummary, but no page has such a table
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "furo"
html_static_path = ["_static"]
html_title = "fg_orient"

# Several classes have two names (fg_orient.Block is fg_orient.model.block.Block): both targets are right.
suppress_warnings = ["ref.python"]

_LITERAL = re.compile(r"(``.+?``|:math:`.+?`)")


def _plain_bars(app, what, name, obj, options, lines):
    """Read |V| in a docstring as a length, not as a substitution of reStructuredText."""
    for k, line in enumerate(lines):
        parts = _LITERAL.split(line)
        parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
        lines[k] = "".join(parts)


def setup(app):
    app.connect("autodoc-process-docstring", _plain_bars)
