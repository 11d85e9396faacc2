"""Sparse bundle adjustment for optical images: pushbroom orientation through a factor graph.

The public names are loaded on first use (PEP 562), so that ``import fg_orient`` and the
command line start quickly and import gtsam only when something is adjusted::

    import fg_orient as fg

    block = fg.read_project("zonguldak/project.toml")
    solution = fg.adjust(block)
"""

from __future__ import annotations

from importlib.util import find_spec
from os.path import dirname, join
from typing import TYPE_CHECKING, Final

from fg_orient.model.public import on_first_use

if TYPE_CHECKING:
    from factors._contract import Argument, Equation, compiled
    from factors._contract import register as register_equation
    from factors.losses import Loss
    from factors.losses import register as register_loss
    from factors.losses.construct import loss_from_weight
    from factors.records import Record
    from fg_orient.adjustment.gauss_helmert import GeneralAdjustment, gauss_helmert, gauss_markov
    from fg_orient.adjustment.linear.kappa import KappaChoice, register_kappa_rule
    from fg_orient.adjustment.linear.registry import register_solver
    from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem
    from fg_orient.adjustment.regression import fit_curve
    from fg_orient.formats.project import read_project
    from fg_orient.formats.registry import Format, register_format
    from fg_orient.formats.sensor import read_sensor
    from fg_orient.model.block import Block, ExtraObservation, GroundPoints, Image, ImagePoints, Options
    from fg_orient.model.constraint import Constraint
    from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError, RankDeficientError
    from fg_orient.model.names import Role, Status
    from fg_orient.model.parameters import ImageParameters
    from fg_orient.orientation.factor_graph import FactorGraph
    from fg_orient.orientation.incremental import Incremental
    from fg_orient.orientation.orient import adjust, factor_graph
    from fg_orient.orientation.solution import Solution
    from fg_orient.result.record import Result, read_result
    from fg_orient.rpc.select import register_selection
    from fg_orient.sensors.base import Sensor
    from fg_orient.sensors.camera_conversion import convert_camera
    from fg_orient.sensors.initial import intersect
    from fg_orient.studies.comparison.compare import compare

__version__: Final = "0.2.0"


def _require_own_factors() -> None:
    """Refuse a package ``factors`` that does not belong to this version; a file found in its place is not run."""
    spec = find_spec("factors")
    found = None if spec is None else spec.origin
    if found is None or dirname(found) != join(dirname(dirname(__file__)), "factors"):
        from fg_orient.model.installation import clash, is_ours

        if found is None or not is_ours(found):
            raise clash(found, __version__)
    try:
        import factors

        other = getattr(factors, "FG_ORIENT_FACTORS", None)
    except (Exception, SystemExit):  # our package imports nothing, so the name refers to another package
        other = None
    if other != __version__:
        from fg_orient.model.installation import clash

        raise clash(found, __version__, other)


_require_own_factors()

#: For each public name the module that defines it; ``module:name`` if the object has another name in
#: the module.
_HOME: Final = {
    "Argument": "factors._contract",
    "Block": "fg_orient.model.block",
    "Constraint": "fg_orient.model.constraint",
    "Equation": "factors._contract",
    "ExtraObservation": "fg_orient.model.block",
    "FactorGraph": "fg_orient.orientation.factor_graph",
    "FgOrientError": "fg_orient.model.errors",
    "Format": "fg_orient.formats.registry",
    "GeneralAdjustment": "fg_orient.adjustment.gauss_helmert",
    "GroundPoints": "fg_orient.model.block",
    "Image": "fg_orient.model.block",
    "ImageParameters": "fg_orient.model.parameters",
    "ImagePoints": "fg_orient.model.block",
    "Incremental": "fg_orient.orientation.incremental",
    "InputError": "fg_orient.model.errors",
    "KappaChoice": "fg_orient.adjustment.linear.kappa",
    "LinearSolution": "fg_orient.adjustment.linear.system",
    "LinearSystem": "fg_orient.adjustment.linear.system",
    "Loss": "factors.losses",
    "NoSolutionError": "fg_orient.model.errors",
    "Options": "fg_orient.model.block",
    "RankDeficientError": "fg_orient.model.errors",
    "Record": "factors.records",
    "Result": "fg_orient.result.record",
    "Role": "fg_orient.model.names",
    "Sensor": "fg_orient.sensors.base",
    "Solution": "fg_orient.orientation.solution",
    "Status": "fg_orient.model.names",
    "adjust": "fg_orient.orientation.orient",
    "compare": "fg_orient.studies.comparison.compare",
    "compiled": "factors._contract",
    "convert_camera": "fg_orient.sensors.camera_conversion",
    "factor_graph": "fg_orient.orientation.orient",
    "fit_curve": "fg_orient.adjustment.regression",
    "gauss_helmert": "fg_orient.adjustment.gauss_helmert",
    "gauss_markov": "fg_orient.adjustment.gauss_helmert",
    "intersect": "fg_orient.sensors.initial",
    "loss_from_weight": "factors.losses.construct",
    "read_project": "fg_orient.formats.project",
    "read_result": "fg_orient.result.record",
    "read_sensor": "fg_orient.formats.sensor",
    "register_equation": "factors._contract:register",
    "register_format": "fg_orient.formats.registry",
    "register_kappa_rule": "fg_orient.adjustment.linear.kappa",
    "register_loss": "factors.losses:register",
    "register_selection": "fg_orient.rpc.select",
    "register_solver": "fg_orient.adjustment.linear.registry",
}

__all__ = [
    "Argument",
    "Block",
    "Constraint",
    "Equation",
    "ExtraObservation",
    "FactorGraph",
    "FgOrientError",
    "Format",
    "GeneralAdjustment",
    "GroundPoints",
    "Image",
    "ImageParameters",
    "ImagePoints",
    "Incremental",
    "InputError",
    "KappaChoice",
    "LinearSolution",
    "LinearSystem",
    "Loss",
    "NoSolutionError",
    "Options",
    "RankDeficientError",
    "Record",
    "Result",
    "Role",
    "Sensor",
    "Solution",
    "Status",
    "__version__",
    "adjust",
    "compare",
    "compiled",
    "convert_camera",
    "factor_graph",
    "fit_curve",
    "gauss_helmert",
    "gauss_markov",
    "intersect",
    "loss_from_weight",
    "read_project",
    "read_result",
    "read_sensor",
    "register_equation",
    "register_format",
    "register_kappa_rule",
    "register_loss",
    "register_selection",
    "register_solver",
]

__getattr__ = on_first_use(globals(), _HOME)


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted(set(globals()) | set(__all__))
