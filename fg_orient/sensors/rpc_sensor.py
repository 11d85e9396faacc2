"""Sensor of an image with a rational function model; it has the same methods as ``PushbroomSensor``.

Ground points are ECEF, m. Pixels are (line, sample); (0, 0) is the centre of the first
pixel. The unknowns are the 6 terms of a compensation in image space, in pixels (Grodecki
& Dial 2003; ``factors.cameras.rfm_project``). l and s are the normalised line and sample
of the model, in [-1, 1]::

    line   += line_0   + line_l1 l   + line_s1 s
    sample += sample_0 + sample_l1 l + sample_s1 s

"shift" has the first column, "shift_drift" the first two columns, and "affine" all three.
In a narrow field of view, an error of position, roll or pitch causes a shift. Drift and
affine terms model changes along and across the image.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.cameras.rfm_equation import COMPENSATION, COMPENSATIONS, RATIONAL_FUNCTION, RECORD
from factors.cameras.rfm_project import RANGE
from factors.geometry import ellipsoid
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import ImageParameters, require_unknowns
from fg_orient.sensors.base import ImageModel, Sensor, ground_rows, placed, same_length
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.rpc import RpcModel, span
from fg_orient.sensors.surface import levels_below, on_surface

if TYPE_CHECKING:
    from fg_orient.model.block import ImagePoints, Options

#: The start point of a ray lies at this distance up the line of sight, m, because an RPC has no projection centre.
RAY_START_M = 5e5
#: Margins, m, above and below the heights between which a line of sight is replaced by a
#: chord. The first one is for all heights of the DEM, the second one for the height of
#: the first hit.
DEM_MARGINS_M = (50.0, 5.0)
#: Values of the option ``rpc_compensation``, and the corresponding terms of the equation.
_TERMS: Final = {"shift": "shift", "shift_drift": "drift", "affine": "affine"}
#: Name of each code of the equation.
_NAMES: Final = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
#: Description of each code of the equation.
_WORDS: Final = (
    "line shift (px)", "sample shift (px)", "line drift along the lines (px)", "sample drift along the lines (px)",
    "line change across the samples (px)", "sample change across the samples (px)",
)  # fmt: skip


class RpcSensor(Sensor):
    """Sensor of an image with a rational function model.

    Parameters
    ----------
    model : RpcModel
        Model from a file, or fitted model.
    poles : bool
        Whether to accept a model if a denominator changes its sign inside the image.

    Raises
    ------
    InputError
        A denominator is not positive somewhere inside the image, and ``poles`` is False.
    """

    def __init__(self, model: RpcModel, *, poles: bool = False) -> None:
        if not poles:
            model.require_no_pole()
        self.model = model
        (self.first_line, self.last_line), (self.first_sample, self.last_sample), *_ = model.validity
        self.n_lines = model.n_lines or math.floor(self.last_line) + 1
        self.n_samples = model.n_samples or math.floor(self.last_sample) + 1
        self.notes, self.file = model.notes, model.file
        self.mean_height_m = float(model.offsets[RANGE.height])

    def records(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, reference_m: Array, origin_m: Array | None = None
    ) -> Array:
        """Return the constants (N, 104) of the equation ``rational_function`` for N image points without whitening.

        ``reference_m`` (N, 3) or (3,) are ECEF points near the observed points.
        Differences are relative to them. ``origin_m`` (3,) is the local origin of the
        ground unknowns, ECEF (default 0).
        """
        line, sample = same_length(line, sample)
        reference = np.ascontiguousarray(np.broadcast_to(np.asarray(reference_m, float), (len(line), 3)))
        geodetic = ellipsoid.geodetic_array(reference)
        m, (lon, lat, height) = self.model, geodetic.T
        offsets, scales = m.offsets[RANGE.ground], m.scales[RANGE.ground]
        degrees = np.column_stack([np.degrees(lon), np.degrees(lat), height])
        degrees[:, 0] -= 360.0 * np.round((degrees[:, 0] - m.offsets[RANGE.lon]) / 360.0)
        return RECORD.pack(
            line=line, sample=sample, whitening=np.eye(2).ravel(), line_offset=m.offsets[RANGE.line],
            sample_offset=m.offsets[RANGE.sample], line_scale=m.scales[RANGE.line], sample_scale=m.scales[RANGE.sample],
            normalised=(degrees - offsets) / scales, scales=[*np.radians(scales[RANGE.image]), m.scales[RANGE.height]],
            reference=reference if origin_m is None else reference - origin_m,
            frame=np.column_stack([np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), height]),
            coefficients=m.coefficients.ravel(),
        )  # fmt: skip

    # --- image to ground ---------------------------------------------------------------------

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: npt.ArrayLike | None = None,
        heights_m: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return points (N, 3), m, 500 km up the lines of sight, and unit viewing directions (N, 3), ECEF.

        A line of sight joins the ground points at two heights. By default, these are the
        lowest and the highest valid height. InputError: there are no valid heights.
        """
        ends = []
        for height in heights_m or self.model.validity.height_m:
            lines, samples, h = same_length(line, sample, height)
            ends.append(self._at_height(lines, samples, h, correction))
        low, high = ends
        direction = low - high
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return high - RAY_START_M * direction, direction

    def _at_height(self, line: Array, sample: Array, h: Array, correction: npt.ArrayLike | None) -> Array:
        """Return ground points (N, 3), ECEF m, at ellipsoidal heights."""
        lon, lat = self.model.locate(line, sample, h, correction)
        if np.isnan(lon).any():
            bad = int(np.flatnonzero(np.isnan(lon))[0])
            place, value = f"line {line[bad]:g}, sample {sample[bad]:g}", f"height {h[bad]:g} m"
            valid = span(self.model.validity.height_m)
            raise InputError.of("rpc.no_ground", file=self.file, place=place, value=value, height=valid)
        return geodetic_to_ecef(lon, lat, h)

    def _located(
        self, line: Array, sample: Array, height_m: npt.ArrayLike | None, dem: HeightSurface | None, correction: Any
    ) -> Array:
        """Return ground points (N, 3), ECEF m.

        The lines of sight of a rational function are curved. On a DEM, a ray first
        follows the chord over all heights of the DEM below it, then the chord about the
        height of its first hit. The model computes the ground point at the final height,
        so that its pixel is exact.
        """
        height = 0.0 if height_m is None else height_m
        line, sample, h = same_length(line, sample, height, place="line, sample, height_m")
        if dem is not None:
            valid = self.model.validity.height_m
            levels = levels_below(*self.rays(line, sample, correction), dem)
            low, high = (np.where(np.isfinite(level), level, end) for level, end in zip(levels, valid, strict=True))
            for margin in DEM_MARGINS_M:
                p, u = self.rays(line, sample, correction, (low - margin, high + margin))
                h = np.ascontiguousarray(ellipsoid.geodetic_array(on_surface(p, u, dem, self.file))[:, 2])
                low = high = h
        return self._at_height(line, sample, h, correction)

    # --- ground to image ---------------------------------------------------------------------

    def project(self, ground_m: npt.ArrayLike, correction: npt.ArrayLike | None = None) -> tuple[Array, Array]:
        """Return line and sample of N ECEF points (N, 3), m; nan at a pole of the model.

        The rational function is also evaluated outside the image and outside the validity
        range; see :meth:`is_inside` and ``model.inside``.
        """
        lon, lat, h = ellipsoid.geodetic_array(ground_rows(ground_m)).T
        return self.model.project(np.degrees(lon), np.degrees(lat), h, correction)

    def footprint(self) -> Array:
        """Return the corners at the model's mean height in the order of the image, clockwise.

        The array (4, 2) contains longitude and latitude, degrees.
        """
        return np.stack(self.model.locate(*self.corners(), self.mean_height_m), axis=1)

    # --- adjustment --------------------------------------------------------------------------

    def image_model(self, options: Options) -> ImageModel:
        """See :class:`RpcImageModel`."""
        return RpcImageModel(self, options)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Array:
        """Make a compensation (6,) from its terms by name; see :meth:`Sensor.correction_of`."""
        return placed(values, _NAMES)


# --- image model ---------------------------------------------------------------------------------


def compensation_parameters(options: Options, file: str = "") -> ImageParameters:
    """Return the unknowns of an RPC image with prior sigmas in pixels.

    The option ``image_unknowns`` names them; otherwise the option ``rpc_compensation`` does.
    """
    codes = COMPENSATIONS[_TERMS[options.rpc_compensation]]
    if options.image_unknowns:
        codes = tuple(code for code, name in enumerate(_NAMES) if name in options.image_unknowns)
        require_unknowns(options, codes, file, _NAMES)
    sigma = np.array([options.rpc_shift_sigma_px if code < 2 else options.rpc_linear_sigma_px for code in codes])
    return ImageParameters(
        codes, sigma, tuple(_NAMES[c] for c in codes), ("px",) * len(codes), tuple(_WORDS[c] for c in codes)
    )


class RpcImageModel(ImageModel):
    """See ``fg_orient.sensors.base.ImageModel``.

    Parameters
    ----------
    sensor : RpcSensor
    options : Options
        Options with the kind of the compensation and its prior sigmas.
    """

    equation = RATIONAL_FUNCTION

    def __init__(self, sensor: RpcSensor, options: Options) -> None:
        self.sensor = sensor
        self.parameters = compensation_parameters(options, sensor.file)

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Return constants that are whitened with the standard deviations of the pixels."""
        out = self.sensor.records(points.line, points.sample, ground_m, origin_m)
        out[:, RECORD.a11], out[:, RECORD.a22] = 1.0 / points.sigma_line_px, 1.0 / points.sigma_sample_px
        return out

    def correction(self, x: Array) -> Array:
        """Return the compensation (6,) in pixels, in the order of the codes of ``factors.cameras.rfm``."""
        out = np.zeros(COMPENSATION.size)
        out[list(self.parameters.codes)] = x * self.parameters.sigma
        return out

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Return the factors of drifts per line and of shifts; nan for terms of the sample."""
        scale = float(self.sensor.model.scales[RANGE.line])
        table = ((1.0, "px"), (1.0 / scale, "px/line"), (np.nan, ""))
        rows = [table[code // 2] for code in self.parameters.codes]
        return np.array([factor for factor, _ in rows]), tuple(unit for _, unit in rows)

    def is_valid(self, ground_m: Array) -> Mask:
        """Return a mask of the points in the validity range of the file.

        Outside it, the cubic polynomials diverge.
        """
        lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(ground_m)).T
        return self.sensor.model.inside(np.degrees(lon), np.degrees(lat), height)

    def facts(self) -> dict[str, Any]:
        """Return the format of the file; an RPC has neither mission nor orientation."""
        return {
            "model": "RPC", "mission": "RPC", "instrument": "", "format": self.sensor.model.format,
            "metadata_polynomials": [],
        }  # fmt: skip
