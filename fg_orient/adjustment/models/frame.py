"""Frame image: collinearity with exterior and interior orientation as unknowns, as the camera names them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.frame import FRAME_BROWN_IDEAL_TO_MEASURED, N_UNKNOWNS
from fg_orient.block import ImagePoints, Options
from fg_orient.errors import InputError
from fg_orient.parameters import ImageParameters, require_unknowns
from fg_orient.sensors.frame import UNKNOWNS, FrameCamera, FrameSensor

Array = npt.NDArray[np.float64]

_UNITS: Final = ("rad",) * 3 + ("m",) * 3 + ("px",) * 3 + ("",) * 5
_WORDS: Final = (
    "rotation about the camera's X (rad)", "rotation about the camera's Y (rad)",
    "rotation about the camera's Z (rad)", "projection centre X (m)", "projection centre Y (m)",
    "projection centre Z (m)", "focal length (px)", "sample of the principal point (px)",
    "line of the principal point (px)", "radial distortion k1", "radial distortion k2", "radial distortion k3",
    "decentring distortion p1", "decentring distortion p2",
)  # fmt: skip


def camera_parameters(camera: FrameCamera, only: tuple[str, ...] = ()) -> ImageParameters:
    """Unknowns of a frame image: what the camera gives a prior sigma, or the named ones of them, by code."""
    codes = tuple(k for k, name in enumerate(UNKNOWNS) if name in camera.sigma and (not only or name in only))
    sigma = np.array([camera.sigma[UNKNOWNS[k]] for k in codes])
    names = tuple(UNKNOWNS[k] for k in codes)
    return ImageParameters(codes, sigma, names, tuple(_UNITS[k] for k in codes), tuple(_WORDS[k] for k in codes))


class FrameImageModel:
    """See ``fg_orient.adjustment.models.contract.ImageModel``.

    Parameters
    ----------
    sensor : FrameSensor
    options : Options
        The unknowns and their prior sigmas are those of the camera; ``image_unknowns`` may leave some out.

    Raises
    ------
    InputError
        The camera names no unknown, or ``image_unknowns`` leaves none.
    """

    equation: Equation = FRAME_BROWN_IDEAL_TO_MEASURED

    def __init__(self, sensor: FrameSensor, options: Options) -> None:
        if not sensor.camera.sigma:
            raise InputError.of("frame.nothing_unknown", file=sensor.file, place="sigma")
        self.sensor = sensor
        self.parameters = camera_parameters(sensor.camera, options.image_unknowns)
        require_unknowns(options, self.parameters.codes, sensor.file, sensor.camera.sigma)

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whiten with the pixel sigmas."""
        out = self.sensor.records(points.line, points.sample, origin_m)
        out[:, 2], out[:, 3] = 1.0 / points.sigma_line_px, 1.0 / points.sigma_sample_px
        return out

    def correction(self, x: Array) -> Array:
        """Corrections (14,) in physical units, in the order of :data:`fg_orient.sensors.frame.UNKNOWNS`."""
        out = np.zeros(N_UNKNOWNS)
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out

    def silent_directions(self) -> list[tuple[str, Array]]:
        """None: every unknown moves the image."""
        return []

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """None: all lines are exposed at once."""
        return np.full(len(self.parameters), np.nan), ("",) * len(self.parameters)

    def is_valid(self, ground_m: Array) -> npt.NDArray[np.bool_]:
        """In front of the camera as it was given."""
        return np.isfinite(self.sensor.project(ground_m)[0])

    def facts(self) -> dict[str, Any]:
        """What is known of a frame image."""
        return {
            "model": "frame", "mission": "frame camera", "instrument": "", "format": "camera",
            "metadata_polynomials": [],
        }  # fmt: skip
