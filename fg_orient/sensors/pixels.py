"""Pixels of an image: the range that every sensor knows, and arrays of the same length."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import OutOfImage, finding

Array = npt.NDArray[np.float64]


class PixelRange(ABC):
    """Centres of the first and last line and sample of an image; each sensor is one.

    Parameters
    ----------
    file : str
        Metadata file, for messages.
    """

    first_line: float
    last_line: float
    first_sample: float
    last_sample: float

    @property
    @abstractmethod
    def file(self) -> str:
        """Name of the metadata file."""

    def is_inside(self, line: Array, sample: Array) -> npt.NDArray[np.bool_]:
        """Tell which pixels lie in the image, half a pixel of border included."""
        inside = (line >= self.first_line - 0.5) & (line <= self.last_line + 0.5)
        return np.asarray(inside & (sample >= self.first_sample - 0.5) & (sample <= self.last_sample + 0.5))

    def require_inside(self, line: Array, sample: Array) -> None:
        """Refuse pixels outside the image.

        Raises
        ------
        OutOfImage
            Names the first one and the image's range.
        """
        bad = np.flatnonzero(~self.is_inside(line, sample))
        if len(bad):
            raise OutOfImage(finding(
                "sensor.pixel_outside", file=self.file, place=f"line {line[bad[0]]:g}, sample {sample[bad[0]]:g}",
                value=f"{len(bad)} pixel(s)", first_line=self.first_line - 0.5, last_line=self.last_line + 0.5,
                first_sample=self.first_sample - 0.5, last_sample=self.last_sample + 0.5,
            ))  # fmt: skip

    def corners(self) -> tuple[Array, Array]:
        """Lines and samples (4,) of the corners in image order, clockwise."""
        line = np.array([self.first_line, self.first_line, self.last_line, self.last_line])
        return line, np.array([self.first_sample, self.last_sample, self.last_sample, self.first_sample])


def same_length(*values: npt.ArrayLike) -> list[Array]:
    """Give arrays (N,) in C order of scalars and arrays."""
    return [
        np.ascontiguousarray(a) for a in np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in values))
    ]
