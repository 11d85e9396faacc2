"""A sensor with its adjusted orientation: what takes a sensor takes this, and gets the corrected geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.correction import HeightSurface

Array = npt.NDArray[np.float64]


class OrientedSensor:
    """A sensor bound to a correction; everything else is the sensor's own.

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or FrameSensor
    correction : Correction or array
        As the sensor's methods take it, for instance ``solution.correction("left")``.
    """

    def __init__(self, sensor: Any, correction: Any) -> None:
        self.sensor, self.correction = sensor, correction
        self.notes: tuple[Finding, ...] = (*sensor.notes, finding("image.adjusted"))

    def __getattr__(self, name: str) -> Any:
        """Give what the sensor has."""
        return getattr(self.sensor, name)

    def rays(self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Points on the lines of sight (N, 3) m and unit directions (N, 3), ECEF."""
        centre, direction = self.sensor.rays(line, sample, self.correction)
        return centre, direction

    def locate(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, *, height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None,
    ) -> Array:  # fmt: skip
        """Ground points (N, 3) ECEF m at ellipsoidal heights or on a DEM; errors as of the sensor."""
        word = "compensation" if hasattr(self.sensor, "model") else "correction"
        how: dict[str, Any] = {"height_m": height_m, "dem": dem, word: self.correction}
        return np.asarray(self.sensor.locate(line, sample, **how))

    def project(self, ground_m: npt.ArrayLike, correction: None = None) -> tuple[Array, Array]:
        """Line and sample (N,) of ECEF points (N, 3)."""
        line, sample = self.sensor.project(ground_m, self.correction)
        return line, sample
