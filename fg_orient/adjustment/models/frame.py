"""Frame image: collinearity with exterior and interior orientation as unknowns, as the camera names them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.cameras.frame import FRAME_BROWN_IDEAL_TO_MEASURED, N_UNKNOWNS, RECORD
from factors.cameras.frame_camera import CAMERA
from factors.cameras.frame_measured import FRAME_BROWN_MEASURED_TO_IDEAL
from fg_orient.model.block import ImagePoints, Options
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import ImageParameters, require_unknowns
from fg_orient.sensors.frame import INTERIOR, NAVIGATION, UNKNOWNS, FrameCamera, FrameSensor

Array = npt.NDArray[np.float64]

_UNITS: Final = (
    ("rad",) * 3 + ("m",) * 3 + ("px",) * 3 + ("",) * 6 + ("m",) * 6 + ("rad",) * 6 + ("m",) * 3 + ("rad",) * 3
)  # fmt: skip
_WORDS: Final = (
    "rotation about the camera's X (rad)", "rotation about the camera's Y (rad)",
    "rotation about the camera's Z (rad)", "projection centre X (m)", "projection centre Y (m)",
    "projection centre Z (m)", "focal length (px)", "sample of the principal point (px)",
    "line of the principal point (px)", "radial distortion k1", "radial distortion k2", "radial distortion k3",
    "decentring distortion p1", "decentring distortion p2", "aspect",
    *(f"{kind} of the receiver {axis} (m)" for kind in ("shift", "drift") for axis in ("East", "North", "Up")),
    *(f"{kind} of the attitude, {axis} (rad)" for kind in ("shift", "drift") for axis in ("roll", "pitch", "heading")),
    *(f"lever arm {axis} (m)" for axis in "XYZ"),
    *(f"boresight about the camera's {axis} (rad)" for axis in "XYZ"),
)  # fmt: skip
#: Names by code.
_NAMES: Final = (*UNKNOWNS, *NAVIGATION)


def camera_parameters(camera: FrameCamera, only: tuple[str, ...] = ()) -> ImageParameters:
    """Unknowns of a frame image: those with a prior sigma of the camera, or the named ones of them, by code."""
    codes = tuple(k for k, name in enumerate(_NAMES) if name in camera.sigma and (not only or name in only))
    sigma = np.array([camera.sigma[_NAMES[k]] for k in codes])
    names = tuple(_NAMES[k] for k in codes)
    shared = tuple(camera.shared.get(name, "") for name in names) if camera.shared else ()
    return ImageParameters(
        codes, sigma, names, tuple(_UNITS[k] for k in codes), tuple(_WORDS[k] for k in codes), shared
    )


def require_common_start(cameras: Mapping[str, FrameCamera]) -> None:
    """Refuse cameras (by image id) that share an unknown but begin with different values of it.

    Raises
    ------
    InputError
        Names the first image that differs from those before it.
    """
    known: dict[tuple[str, str], float] = {}
    for image, camera in cameras.items():
        at, unit = camera.corrected(), float(camera.unit_px or 0.0) if camera.corrects_measured else 0.0
        interior = at[CAMERA.focal], *at[CAMERA.principal], *at[CAMERA.distortion]
        values = dict(zip(INTERIOR, [*interior, camera.aspect], strict=True))
        for name, with_whom in camera.shared.items():
            for part, value in ((name, values.get(name, 0.0)), ("unit", unit), ("model", camera.corrects_measured)):
                if known.setdefault((with_whom, part), float(value)) != value:
                    raise InputError.of("frame.shared", place=f"image {image}, {part}", value=value, id=with_whom)


class FrameImageModel:
    """See ``fg_orient.adjustment.models.contract.ImageModel``.

    Parameters
    ----------
    sensor : FrameSensor
    options : Options
        The unknowns and their prior sigmas are those of the camera; ``image_unknowns`` may select some. A camera
        without unknowns is held fixed: its images are the datum.

    Raises
    ------
    InputError
        ``image_unknowns`` selects none of the camera's unknowns.
    """

    def __init__(self, sensor: FrameSensor, options: Options) -> None:
        self.sensor = sensor
        self.equation: Equation = (
            FRAME_BROWN_MEASURED_TO_IDEAL if sensor.camera.corrects_measured else FRAME_BROWN_IDEAL_TO_MEASURED
        )
        self.parameters = camera_parameters(sensor.camera, options.image_unknowns)
        if sensor.camera.sigma:
            require_unknowns(options, self.parameters.codes, sensor.file, sensor.camera.sigma)

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whiten with the pixel sigmas."""
        out = self.sensor.records(points.line, points.sample, origin_m)
        out[:, RECORD.a_line], out[:, RECORD.a_sample] = 1.0 / points.sigma_line_px, 1.0 / points.sigma_sample_px
        return out

    def correction(self, x: Array) -> Array:
        """Corrections (15,) in physical units that change pixels, ordered as the codes of ``cameras.frame``."""
        out = np.zeros(len(_NAMES))
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out[:N_UNKNOWNS]

    def silent_directions(self) -> list[tuple[str, Array]]:
        """None: every unknown moves the image."""
        return []

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """None: all lines are exposed at once."""
        return np.full(len(self.parameters), np.nan), ("",) * len(self.parameters)

    def is_valid(self, ground_m: Array) -> npt.NDArray[np.bool_]:
        """Whether points lie in front of the camera at its approximate orientation."""
        return np.isfinite(self.sensor.project(ground_m)[0])

    def facts(self) -> dict[str, Any]:
        """Metadata of a frame image."""
        return {
            "model": "frame", "mission": "frame camera", "instrument": "", "format": "camera",
            "metadata_polynomials": [],
        }  # fmt: skip
