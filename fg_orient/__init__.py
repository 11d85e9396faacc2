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
    from fg_orient.adjustment.linear.registry import register_solver
    from fg_orient.adjustment.linear.system import LinearSystem
    from fg_orient.adjustment.models.contract import register_model
    from fg_orient.adjustment.regression import fit_curve
    from fg_orient.formats.project import read_project
    from fg_orient.formats.registry import Format, register_format
    from fg_orient.formats.sensor import read_sensor
    from fg_orient.model.block import Block, ExtraObservation, GroundPoints, Image, ImagePoints, Options
    from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError, RankDeficientError
    from fg_orient.model.names import Role, Status
    from fg_orient.orientation.orient import adjust
    from fg_orient.orientation.solution import Solution
    from fg_orient.result.record import Result, read_result
    from fg_orient.sensors.initial import intersect
    from fg_orient.studies.comparison.compare import compare

__version__: Final = "0.1.0"


def _require_own_factors() -> None:
    """Refuse a package ``factors`` that is not the one of this version; a file found in its place is not run."""
    spec = find_spec("factors")
    found = None if spec is None else spec.origin
    if found is None or dirname(found) != join(dirname(dirname(__file__)), "factors"):
        from fg_orient.model.installation import clash, is_ours

        if found is None or not is_ours(found):
            raise clash(found, __version__)
    try:
        import factors

        other = getattr(factors, "FG_ORIENT_FACTORS", None)
    except (Exception, SystemExit):  # ours imports nothing, so that another one lies here
        other = None
    if other != __version__:
        from fg_orient.model.installation import clash

        raise clash(found, __version__, other)


_require_own_factors()

#: Public name -> module that defines it.
_HOME: Final[dict[str, str]] = {
    "Block": "fg_orient.model.block",
    "ExtraObservation": "fg_orient.model.block",
    "Format": "fg_orient.formats.registry",
    "FgOrientError": "fg_orient.model.errors",
    "GroundPoints": "fg_orient.model.block",
    "Image": "fg_orient.model.block",
    "ImagePoints": "fg_orient.model.block",
    "InputError": "fg_orient.model.errors",
    "LinearSystem": "fg_orient.adjustment.linear.system",
    "NoSolutionError": "fg_orient.model.errors",
    "Options": "fg_orient.model.block",
    "RankDeficientError": "fg_orient.model.errors",
    "Result": "fg_orient.result.record",
    "Role": "fg_orient.model.names",
    "Solution": "fg_orient.orientation.solution",
    "Status": "fg_orient.model.names",
    "adjust": "fg_orient.orientation.orient",
    "compare": "fg_orient.studies.comparison.compare",
    "fit_curve": "fg_orient.adjustment.regression",
    "intersect": "fg_orient.sensors.initial",
    "read_project": "fg_orient.formats.project",
    "read_result": "fg_orient.result.record",
    "read_sensor": "fg_orient.formats.sensor",
    "register_format": "fg_orient.formats.registry",
    "register_model": "fg_orient.adjustment.models.contract",
    "register_solver": "fg_orient.adjustment.linear.registry",
}

__all__ = [
    "Block",
    "ExtraObservation",
    "FgOrientError",
    "Format",
    "GroundPoints",
    "Image",
    "ImagePoints",
    "InputError",
    "LinearSystem",
    "NoSolutionError",
    "Options",
    "RankDeficientError",
    "Result",
    "Role",
    "Solution",
    "Status",
    "__version__",
    "adjust",
    "compare",
    "fit_curve",
    "intersect",
    "read_project",
    "read_result",
    "read_sensor",
    "register_format",
    "register_model",
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
