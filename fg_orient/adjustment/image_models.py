"""Image models of a block, from the sensors (``fg_orient.sensors.base``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.sensors.base import ImageModel

if TYPE_CHECKING:
    from fg_orient.model.block import Image, Options


def image_models(images: Sequence[Image], options: Options) -> tuple[ImageModel, ...]:
    """Model of each image.

    InputError: a sensor has no image model; approximate values of a shared unknown differ; ``image_unknowns`` names an
    unknown that no image has, or no unknown of an image.
    """
    starts: dict[tuple[str, str], float] = {}
    for image in images:
        if not hasattr(image.sensor, "image_model"):
            raise InputError.of("adjust.no_model", place=f"image {image.id}", value=type(image.sensor).__name__)
        for (shared, part), value in image.sensor.shared_starts().items():
            if starts.setdefault((shared, part), value) != value:
                raise InputError.of("frame.shared", place=f"image {image.id}, {part}", value=value, id=shared)
    models = tuple(image.sensor.image_model(options) for image in images)
    every = {known for model in models for known in model.parameters.names}
    wrong = [unknown for unknown in options.image_unknowns if unknown not in every]
    if wrong:
        raise InputError.of("parameters.unknown", place="image_unknowns", value=", ".join(wrong))
    return models


def local_origin(images: Sequence[Image]) -> npt.NDArray[np.float64]:
    """Origin (3,) of the ground unknowns, ECEF m: mean of the image centres on the ground."""
    return np.asarray(np.mean([image.sensor.centre_m for image in images], axis=0))


def groups(models: Sequence[ImageModel]) -> list[list[int]]:
    """Images with the same equation and the same unknowns, by number, in the order of their first image."""
    out: dict[tuple[str, bytes], list[int]] = {}
    for k, model in enumerate(models):
        out.setdefault((model.equation.name, model.parameters.setup.tobytes()), []).append(k)
    return list(out.values())
