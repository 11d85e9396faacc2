"""Sparse bundle adjustment for optical images: pushbroom orientation through a factor graph.

The public names are loaded on first use (PEP 562), so that ``import fg_orient`` and the
command line start quickly and import gtsam only when something is adjusted::

    import fg_orient as fg

    block = fg.read_project("zonguldak/project.toml")
    solution = fg.adjust(block)
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from os.path import dirname, join
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from fg_orient.adjustment.models.contract import register_model
    from fg_orient.adjustment.regression import fit_curve
    from fg_orient.block import Block, ExtraObservation, GroundPoints, Image, ImagePoints, Options
    from fg_orient.comparison.compare import compare
    from fg_orient.errors import FgOrientError, InputError, NoSolutionError, RankDeficientError
    from fg_orient.initial import intersect
    from fg_orient.io.project import read_project
    from fg_orient.io.sensor import read_sensor, register_reader
    from fg_orient.linear.registry import register_solver
    from fg_orient.linear.system import LinearSystem
    from fg_orient.names import Role, Status
    from fg_orient.orient import adjust
    from fg_orient.solution import Solution

__version__: Final = "0.1.0"


def _require_own_factors() -> None:
    """Refuse a package ``factors`` that is not the one of this version; a file found in its place is not run."""
    spec = find_spec("factors")
    found = None if spec is None else spec.origin
    if found is None or dirname(found) != join(dirname(dirname(__file__)), "factors"):
        from fg_orient.clash import clash, is_ours

        if found is None or not is_ours(found):
            raise clash(found, __version__)
    try:
        import factors

        other = getattr(factors, "FG_ORIENT_FACTORS", None)
    except (Exception, SystemExit):  # ours imports nothing, so that another one lies here
        other = None
    if other != __version__:
        from fg_orient.clash import clash

        raise clash(found, __version__, other)


_require_own_factors()

#: Public name -> module that defines it.
_HOME: Final[dict[str, str]] = {
    "Block": "fg_orient.block",
    "ExtraObservation": "fg_orient.block",
    "FgOrientError": "fg_orient.errors",
    "GroundPoints": "fg_orient.block",
    "Image": "fg_orient.block",
    "ImagePoints": "fg_orient.block",
    "InputError": "fg_orient.errors",
    "LinearSystem": "fg_orient.linear.system",
    "NoSolutionError": "fg_orient.errors",
    "Options": "fg_orient.block",
    "RankDeficientError": "fg_orient.errors",
    "Role": "fg_orient.names",
    "Solution": "fg_orient.solution",
    "Status": "fg_orient.names",
    "adjust": "fg_orient.orient",
    "compare": "fg_orient.comparison.compare",
    "fit_curve": "fg_orient.adjustment.regression",
    "intersect": "fg_orient.initial",
    "read_project": "fg_orient.io.project",
    "read_sensor": "fg_orient.io.sensor",
    "register_model": "fg_orient.adjustment.models.contract",
    "register_reader": "fg_orient.io.sensor",
    "register_solver": "fg_orient.linear.registry",
}

__all__ = [
    "Block",
    "ExtraObservation",
    "FgOrientError",
    "GroundPoints",
    "Image",
    "ImagePoints",
    "InputError",
    "LinearSystem",
    "NoSolutionError",
    "Options",
    "RankDeficientError",
    "Role",
    "Solution",
    "Status",
    "__version__",
    "adjust",
    "compare",
    "fit_curve",
    "intersect",
    "read_project",
    "read_sensor",
    "register_model",
    "register_reader",
    "register_solver",
]


def __getattr__(name: str) -> Any:
    """Import the module that defines a public name, on first use."""
    if name in _HOME:
        value = globals()[name] = getattr(import_module(_HOME[name]), name)
        return value
    raise AttributeError(f"module 'fg_orient' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted(set(globals()) | set(__all__))
