"""Rational function model (RPC): converts longitude, latitude (degrees) and ellipsoidal height (m) to pixels.

``fg_orient.sensors.rpc_sensor`` uses it for ECEF coordinates. Pixels are (line, sample);
(0, 0) is the centre of the first pixel. Readers convert the pixel origin of the file
(docs/rpc.md). A compensation in image space has 6 terms in pixels
(``factors.cameras.rfm_project``). Iteration inverts all models. If a vendor gives inverse
coefficients, they are used for start values only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from factors.cameras import rfm, rfm_project
from factors.cameras.rfm_project import COMPENSATION, RANGE
from fg_orient.model.errors import Finding, InputError
from fg_orient.sensors.base import same_length

Range = tuple[float, float]

COORDINATES = ("line", "sample", "longitude", "latitude", "height")
POLYNOMIALS = ("line numerator", "line denominator", "sample numerator", "sample denominator")
#: The constant of a denominator must be 1 within this tolerance; files print it as 1.
CONSTANT_PRINT = 1e-12
#: Denominators are checked at this number of pixels and heights per axis.
POLE_GRID = 11
#: Limit of normalised ground coordinates. If the ground point of a corner exceeds it, it
#: lies on another branch of the model, behind a pole. Real products reach 1.45.
OTHER_BRANCH = 2.0
#: A denominator below this value counts as near zero. In fitted models of satellite images, it is 0.9 to 1.1.
NEAR_ZERO = 0.1
NO_COMPENSATION = np.zeros(COMPENSATION.size)
#: Names of the ground coordinates in messages.
_GROUND = "lon_deg, lat_deg, height_m"


class RpcValidity(NamedTuple):
    """Ranges in which a model may be used: pixels (counted from 0), degrees, m."""

    line: Range
    sample: Range
    lon_deg: Range
    lat_deg: Range
    height_m: Range


@dataclass(frozen=True, eq=False)
class RpcModel:
    """Rational function model; its arrays are copied and read-only.

    Parameters
    ----------
    offsets, scales : (5,) arrays
        Offsets and scales of line, sample (pixels), longitude, latitude (degrees), height (m).
    coefficients : (4, 20) array
        Coefficients of the line's numerator and denominator, and of the sample's
        numerator and denominator, in RPC00B order.
    stated_validity : RpcValidity, optional
        Ranges that the file states. Without them, ``validity`` is offset -+ scale and the image's size.
    n_lines, n_samples : int, optional
        Size of the image, if the file contains it.
    err_bias_m, err_rand_m : float, optional
        Error estimates in the file (RPC00B: horizontal, 68 %, m).
    direct : (4, 20) array, optional
        Vendor's model from image to ground: numerator and denominator of the longitude,
        then of the latitude, as functions of normalised (sample, line, height).
    file, format : str
        File from which the model was read, and its format.
    notes : tuple of Finding
        Remarks for the user.

    Raises
    ------
    InputError
        The number of coefficients is wrong, a value is not finite, a scale is zero, or
        the constant of a denominator is not 1.
    """

    offsets: Array
    scales: Array
    coefficients: Array
    stated_validity: RpcValidity | None = None
    n_lines: int | None = None
    n_samples: int | None = None
    err_bias_m: float | None = None
    err_rand_m: float | None = None
    direct: Array | None = None
    file: str = ""
    format: str = ""
    notes: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        for name, shape in (("offsets", (5,)), ("scales", (5,)), ("coefficients", (4, 20)), ("direct", (4, 20))):
            if getattr(self, name) is None:
                continue
            values = np.array(getattr(self, name), dtype=float, order="C")
            if values.shape != shape:
                shown = f"shape {values.shape}"
                raise InputError.of("rpc.shape", file=self.file, place=name, value=shown, shape=str(shape))
            if not np.isfinite(values).all():
                raise InputError.of("rpc.not_finite", file=self.file, place=name)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        for name, scale in zip(COORDINATES, self.scales, strict=True):
            if scale == 0.0:
                raise InputError.of("rpc.zero_scale", file=self.file, place=f"scale of {name}", value="0")
        for k in (1, 3):
            constant = self.coefficients[k, 0]
            if abs(constant - 1.0) > CONSTANT_PRINT:
                place = f"{POLYNOMIALS[k]}, coefficient 1"
                raise InputError.of("rpc.denominator_constant", file=self.file, place=place, value=f"{constant:.15g}")

    @cached_property
    def validity(self) -> RpcValidity:
        """Return the ranges in which the model may be used."""
        if self.stated_validity is not None:
            return self.stated_validity
        low, high = self.offsets - np.abs(self.scales), self.offsets + np.abs(self.scales)
        ranges = list(zip(low.tolist(), high.tolist(), strict=True))
        for k, n in enumerate((self.n_lines, self.n_samples)):
            if n is not None:
                ranges[k] = (0.0, n - 1.0)
        return RpcValidity(*ranges)

    # --- ground to image ---------------------------------------------------------------------

    def project(
        self, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, height_m: npt.ArrayLike,
        compensation: npt.ArrayLike | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return line and sample (pixels) of N points as two arrays (N,); nan where a denominator is zero."""
        lon, lat, h = same_length(lon_deg, lat_deg, height_m, place=_GROUND)
        return rfm_project.project(
            self.coefficients, self.offsets, self.scales, checked_compensation(compensation), lon, lat, h
        )

    def inside(self, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, height_m: npt.ArrayLike) -> Mask:
        """Return a mask (N,) of the ground points in the validity range."""
        lon, lat, h = same_length(lon_deg, lat_deg, height_m, place=_GROUND)
        lon = lon - 360.0 * np.round((lon - self.offsets[RANGE.lon]) / 360.0)
        ranges = zip((lon, lat, h), self.validity[2:], strict=True)
        return np.asarray(np.all([(values >= low) & (values <= high) for values, (low, high) in ranges], axis=0))

    def require_valid(
        self, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, height_m: npt.ArrayLike, names: Sequence[str] = ()
    ) -> None:
        """Raise InputError if ground points lie outside the validity range; it names the first one and the range.

        The message uses the ``names`` of the points; by default, they are numbered from 1.
        """
        bad = np.flatnonzero(~self.inside(lon_deg, lat_deg, height_m))
        if len(bad):
            all_lon, all_lat, all_h = (a[bad] for a in same_length(lon_deg, lat_deg, height_m, place=_GROUND))
            lon, lat, h = all_lon[0], all_lat[0], all_h[0]
            v = self.validity
            only_height = self.inside(all_lon, all_lat, v.height_m[0]).all()
            raise InputError.of(
                "rpc.outside", file=self.file, place=f"point {names[bad[0]] if names else bad[0] + 1}",
                value=f"longitude {lon:.6f}, latitude {lat:.6f}, height {h:.1f}; {len(bad)} such point(s)",
                lon=span(v.lon_deg), lat=span(v.lat_deg), height=span(v.height_m),
                check="only the height is outside: check that heights are ellipsoidal and in m" if only_height
                else "check the order of the coordinates",
            )  # fmt: skip

    # --- image to ground ---------------------------------------------------------------------

    def locate(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, height_m: npt.ArrayLike,
        compensation: npt.ArrayLike | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return longitude and latitude (degrees) of N pixels at ellipsoidal heights as two arrays (N,).

        Newton's method inverts the projection with analytic derivatives, to 1e-11 pixels.
        The result is nan if it does not converge within 1e-7 pixels.
        """
        line, sample, h = same_length(line, sample, height_m, place="line, sample, height_m")
        image = self._without_compensation(line, sample, checked_compensation(compensation))
        z = (h - self.offsets[RANGE.height]) / self.scales[RANGE.height]
        origin = np.zeros_like(image)
        start = origin
        if self.direct is not None:
            start = rfm.values(self.direct, np.stack([image[:, 1], image[:, 0], z], axis=1))
            start = np.where(np.isfinite(start).all(axis=1, keepdims=True), start, origin)
        xy = rfm_project.locate(self.coefficients, self.scales, image, z, start)
        lost = np.isnan(xy[:, 0])
        if self.direct is not None and lost.any():  # the vendor's start value may be the reason: try without it
            xy[lost] = rfm_project.locate(self.coefficients, self.scales, image[lost], z[lost], origin[lost])
        lon = self.offsets[RANGE.lon] + self.scales[RANGE.lon] * xy[:, 0]
        return lon - 360.0 * np.round(lon / 360.0), self.offsets[RANGE.lat] + self.scales[RANGE.lat] * xy[:, 1]

    def _without_compensation(self, line: Array, sample: Array, b: Array) -> Array:
        """Remove the compensation from pixels and normalise them: line and sample (N, 2)."""
        matrix = np.array([
            [self.scales[RANGE.line] + b[COMPENSATION.line_l], b[COMPENSATION.line_s]],
            [b[COMPENSATION.sample_l], self.scales[RANGE.sample] + b[COMPENSATION.sample_s]],
        ])  # fmt: skip
        line_0, sample_0 = self.offsets[RANGE.image]
        rest = np.stack([line - line_0 - b[COMPENSATION.line], sample - sample_0 - b[COMPENSATION.sample]], axis=0)
        return np.ascontiguousarray(np.linalg.solve(matrix, rest).T)

    def locate_directly(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, height_m: npt.ArrayLike
    ) -> tuple[Array, Array]:
        """Return longitude and latitude (degrees) by the vendor's image-to-ground coefficients as two arrays (N,).

        InputError: the file does not contain these coefficients.
        """
        if self.direct is None:
            raise InputError.of("rpc.no_direct", file=self.file)
        line, sample, h = same_length(line, sample, height_m, place="line, sample, height_m")
        axes = [RANGE.sample, RANGE.line, RANGE.height]
        xy = rfm.values(self.direct, (np.stack([sample, line, h], axis=1) - self.offsets[axes]) / self.scales[axes])
        _, _, lon, lat, _ = self.offsets
        return lon + self.scales[RANGE.lon] * xy[:, 0], lat + self.scales[RANGE.lat] * xy[:, 1]

    def require_no_pole(self) -> None:
        """Refuse a model if a denominator is zero or changes its sign inside the image.

        Points between the located corners of the image are checked at heights of the
        validity range. Near a zero of the denominator, the model is wrong by many pixels.
        This is also true if the numerator has nearly the same zeros and the model is
        accurate on both sides.

        Raises
        ------
        InputError
            A denominator is zero; the message names it and a ground point.
        """
        if np.all(np.abs(self.coefficients[1::2, 1:]).sum(axis=1) < 1.0 - 1e-6) and self._cube_covers_the_image():
            return  # the denominators are positive in the whole cube of normalised coordinates
        ground = self._ground_grid()
        below = rfm.denominators(self.coefficients, ground)
        bad = np.argwhere(~(below > 0.0))
        if len(bad):
            row, which = bad[0]
            lon, lat, h = self.offsets[RANGE.ground] + self.scales[RANGE.ground] * ground[row]
            raise InputError.of(
                "rpc.pole", file=self.file, place=POLYNOMIALS[1 + 2 * which],
                value=f"{below[row, which]:.3g} at longitude {lon:.5f}, latitude {lat:.5f}, height {h:.0f} m",
            )  # fmt: skip

    def _cube_covers_the_image(self) -> bool:
        ends = np.array(self.validity[2:]).T - self.offsets[RANGE.ground]
        return bool((np.abs(ends) <= (1.0 + 1e-9) * np.abs(self.scales[RANGE.ground])).all())

    def _ground_grid(self) -> Array:
        """Return normalised ground points (N, 3) between the corners of the image at several heights."""
        v = self.validity
        line, sample = np.repeat(v.line, 2), np.tile(v.sample, 2)
        t = np.linspace(0.0, 1.0, POLE_GRID)
        u, w = (a.ravel()[:, None] for a in np.meshgrid(t, t))
        layers = []
        for h in np.linspace(*v.height_m, POLE_GRID):
            z = np.full(4, (h - self.offsets[RANGE.height]) / self.scales[RANGE.height])
            image = self._without_compensation(line, sample, NO_COMPENSATION)
            corner = rfm_project.locate(self.coefficients, self.scales, image, z, np.zeros((4, 2)))
            looked_at = [corner] if np.isfinite(corner).all() else []
            if not np.abs(corner).max() <= OTHER_BRANCH:
                # a pole prevents the location of a corner: also check the whole cube
                looked_at.append(np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]))
            for c in looked_at:
                xy = (1 - w) * ((1 - u) * c[0] + u * c[1]) + w * ((1 - u) * c[2] + u * c[3])
                layers.append(np.column_stack([xy, np.full(len(xy), z[0])]))
        return np.ascontiguousarray(np.vstack(layers))


def checked_compensation(values: npt.ArrayLike | None) -> Array:
    """Return the compensation (6,) in pixels; zero if there is none."""
    if values is None:
        return NO_COMPENSATION
    out = np.ascontiguousarray(values, dtype=float)
    if out.shape != NO_COMPENSATION.shape or not np.isfinite(out).all():
        raise InputError.of("rpc.compensation", value=out.tolist(), count=len(NO_COMPENSATION))
    return out


def span(ends: Range) -> str:
    """Format a range as text."""
    return f"{ends[0]:.9g} .. {ends[1]:.9g}"
