"""The contract of an image model, and the table that finds the model of an image by its sensor.

An image model binds a sensor to one registered observation equation with the arguments (image unknowns, ground point).
A further sensor is one file with a class of this contract and one row in :data:`MODELS`: backends, observability,
covariance, tables and report use this contract only. :func:`register_model` adds the model of a user's own sensor.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.model.parameters import ImageParameters

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from factors._contract import Equation
    from fg_orient.model.block import Image, ImagePoints, Options

Array = npt.NDArray[np.float64]

#: Module and class of the model by the name of the sensor's class, so that only sensors in use are loaded.
MODELS: Final[dict[str, tuple[str, str]]] = {
    "PushbroomSensor": ("fg_orient.adjustment.models.pushbroom", "PushbroomModel"),
    "GeneralPushbroom": ("fg_orient.adjustment.models.pushbroom", "PushbroomModel"),
    "RpcSensor": ("fg_orient.adjustment.models.rpc", "RpcImageModel"),
    "FrameSensor": ("fg_orient.adjustment.models.frame", "FrameImageModel"),
}


#: Models of users' own sensors, by the name of the sensor's class.
_OWN: dict[str, Callable[[Any, Options], ImageModel]] = {}


def register_model(sensor: type, model: Callable[[Any, Options], ImageModel]) -> None:
    """Add the image model of a sensor of your own; see docs/extending/sensor.md.

    Parameters
    ----------
    sensor : type
        Class of the sensor, with a unique name.
    model : callable
        ``model(sensor, options)`` gives an :class:`ImageModel`; a class of that contract.

    Raises
    ------
    ValueError
        Another sensor has this name.
    """
    name, present = sensor.__name__, _OWN.get(sensor.__name__)
    taken = present is not None and getattr(present, "__qualname__", "") != getattr(model, "__qualname__", "")
    if name in MODELS or taken:
        raise ValueError(f"a sensor named {name!r} has a model already")
    _OWN[name] = model


def own_model(sensor: Any, options: Options) -> ImageModel | None:
    """Model of an image of a user's own sensor; None for the sensors of fg_orient."""
    make = _OWN.get(type(sensor).__name__)
    return None if make is None else make(sensor, options)


class ImageModel(Protocol):
    """One image in the adjustment."""

    equation: Equation
    parameters: ImageParameters

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whitened constants (n, d) of image points of this image; a unit of the residual is one sigma.

        The residual is observed minus adjusted pixel to first order. ``ground_m`` (n, 3) ECEF m near the
        observed points; ``origin_m`` (3,): local origin of the ground unknowns.
        """
        ...

    def correction(self, x: Array) -> Any:
        """Correction for ``rays``, ``project`` and ``locate`` of the sensor, from unknowns (k,) in prior sigmas."""
        ...

    def silent_directions(self) -> list[tuple[str, Array]]:
        """Directions without effect on the image: sentence and unit vector (k,) in prior sigmas."""
        ...

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Factors (k,) from the unknowns in physical units to coefficients per line (nan without), and units."""
        ...

    def is_valid(self, ground_m: Array) -> npt.NDArray[np.bool_]:
        """Whether the sensor's model may be used at ground points (n, 3) ECEF m: (n,)."""
        ...

    def facts(self) -> dict[str, Any]:
        """Mission, instrument, format and further metadata for the record of a run."""
        ...


def image_models(images: Sequence[Image], options: Options) -> tuple[ImageModel, ...]:
    """Model of each image, by the class of its sensor.

    Raises
    ------
    InputError
        An image has a sensor without a model; ``image_unknowns`` names unknowns of no image, or none of an image.
    """
    models: list[ImageModel] = []
    for image in images:
        kind = type(image.sensor).__name__
        own = own_model(image.sensor, options)
        if own is not None:
            models.append(own)
            continue
        if kind not in MODELS:
            known = ", ".join((*MODELS, *_OWN))
            raise InputError.of("adjust.no_model", place=f"image {image.id}", value=kind, known=known)
        module, name = MODELS[kind]
        models.append(getattr(import_module(module), name)(image.sensor, options))
    if any(not model.parameters.own.all() for model in models):
        from fg_orient.adjustment.models.frame import require_common_start

        require_common_start({i.id: i.sensor.camera for i in images if hasattr(i.sensor, "camera")})
    every = {known for model in models for known in model.parameters.names}
    wrong = [unknown for unknown in options.image_unknowns if unknown not in every]
    if wrong:
        raise InputError.of("parameters.unknown", option="image_unknowns", value=", ".join(wrong))
    return tuple(models)


def groups(models: Sequence[ImageModel]) -> list[list[int]]:
    """Images with the same equation and the same unknowns, by number, in the order of their first image."""
    found: dict[tuple[str, bytes], list[int]] = {}
    for k, model in enumerate(models):
        found.setdefault((model.equation.name, model.parameters.setup.tobytes()), []).append(k)
    return list(found.values())
