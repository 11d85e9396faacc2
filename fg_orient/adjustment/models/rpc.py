"""RPC image: rational function with image-space compensation (Grodecki & Dial 2003) as unknowns.

Compensation, pixels, with l, s the model's own normalised line and sample in [-1, 1]::

    line   += line_0   + line_l1 l   + line_s1 s
    sample += sample_0 + sample_l1 l + sample_s1 s

"shift" has the first column, "shift_drift" the first two, "affine" all three. A shift is the effect of an error of
position, roll or pitch in a narrow field of view; drift and affine terms model changes along and across the image.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.cameras.rfm_equation import COMPENSATION, COMPENSATIONS, RATIONAL_FUNCTION, RECORD
from factors.cameras.rfm_project import RANGE
from factors.geometry import ellipsoid
from fg_orient.model.block import ImagePoints, Options
from fg_orient.model.parameters import ImageParameters, require_unknowns
from fg_orient.sensors.rpc_sensor import RpcSensor

Array = npt.NDArray[np.float64]

#: Names of option ``rpc_compensation`` in the terms of the equation.
_TERMS: Final = {"shift": "shift", "shift_drift": "drift", "affine": "affine"}
#: Name and words of each code of the equation.
_NAMES: Final = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
_WORDS: Final = (
    "line shift (px)", "sample shift (px)", "line drift along the lines (px)", "sample drift along the lines (px)",
    "line change across the samples (px)", "sample change across the samples (px)",
)  # fmt: skip


def compensation_parameters(options: Options, file: str = "") -> ImageParameters:
    """Unknowns of an RPC image: the named ones, else the compensation of the options; prior sigmas in pixels.

    Raises
    ------
    InputError
        ``image_unknowns`` names none of them.
    """
    codes = COMPENSATIONS[_TERMS[options.rpc_compensation]]
    if options.image_unknowns:
        codes = tuple(code for code, name in enumerate(_NAMES) if name in options.image_unknowns)
        require_unknowns(options, codes, file, _NAMES)
    sigma = np.array([options.rpc_shift_sigma_px if code < 2 else options.rpc_linear_sigma_px for code in codes])
    return ImageParameters(
        codes, sigma, tuple(_NAMES[c] for c in codes), ("px",) * len(codes), tuple(_WORDS[c] for c in codes)
    )


class RpcImageModel:
    """See ``fg_orient.adjustment.models.contract.ImageModel``.

    Parameters
    ----------
    sensor : RpcSensor
    options : Options
        Kind of the compensation and its prior sigmas.
    """

    equation: Equation = RATIONAL_FUNCTION

    def __init__(self, sensor: RpcSensor, options: Options) -> None:
        self.sensor = sensor
        self.parameters = compensation_parameters(options, sensor.file)

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whiten with the pixel sigmas; minus, because the equation gives adjusted minus observed."""
        out = self.sensor.records(points.line, points.sample, ground_m, origin_m)
        out[:, RECORD.a11], out[:, RECORD.a22] = -1.0 / points.sigma_line_px, -1.0 / points.sigma_sample_px
        return out

    def correction(self, x: Array) -> Array:
        """Compensation (6,) in pixels, codes of ``factors.cameras.rfm``."""
        out = np.zeros(COMPENSATION.size)
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out

    def silent_directions(self) -> list[tuple[str, Array]]:
        """None: every term moves the image."""
        return []

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Factors of drifts per line and of shifts; nan for terms of the sample."""
        scale = float(self.sensor.model.scales[RANGE.line])
        table = ((1.0, "px"), (1.0 / scale, "px/line"), (np.nan, ""))
        rows = [table[code // 2] for code in self.parameters.codes]
        return np.array([factor for factor, _ in rows]), tuple(unit for _, unit in rows)

    def is_valid(self, ground_m: Array) -> npt.NDArray[np.bool_]:
        """Whether points lie in the ranges of longitude, latitude and height of the file: outside, cubics diverge."""
        lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(ground_m)).T
        return self.sensor.model.inside(np.degrees(lon), np.degrees(lat), height)

    def facts(self) -> dict[str, Any]:
        """Format of the file; an RPC has neither mission nor orientation."""
        return {
            "model": "RPC", "mission": "RPC", "instrument": "", "format": self.sensor.model.format,
            "metadata_polynomials": [],
        }  # fmt: skip
