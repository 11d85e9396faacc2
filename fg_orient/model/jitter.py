"""Read the option ``jitter_curves``, which names the jitter curves of single images."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from fg_orient.model.errors import InputError

#: Smallest and largest number of intervals, as in ``factors.geometry.polynomials``, which loads the compiler.
FEWEST, MOST = 2, 32
#: Angles that may have jitter. Yaw is left out: 1e-5 rad moves the ends of a line of 12000 pixels by 0.06 px only.
ANGLES: Final = ("roll", "pitch")
_FORM: Final = f"IMAGE:ANGLE:INTERVALS:SIGMA with angle roll or pitch, {FEWEST} to {MOST} intervals, sigma in rad"


@dataclass(frozen=True)
class JitterCurve:
    """Jitter of one angle of one image.

    Parameters
    ----------
    image : str
        Id of the image.
    angle : str
        "roll" or "pitch".
    intervals : int
        Number of intervals of the spline.
    sigma_rad : float
        Prior standard deviation, root mean square over the image.
    """

    image: str
    angle: str
    intervals: int
    sigma_rad: float

    def __str__(self) -> str:
        return f"{self.image}:{self.angle}:{self.intervals}:{self.sigma_rad!r}"

    @classmethod
    def parse(cls, text: str) -> JitterCurve:
        """Return the curve of a text.

        Raises
        ------
        InputError
            The text has another form, or a value is not allowed.
        """
        try:
            image, angle, intervals, sigma = text.rsplit(":", 3)  # an id may contain colons
            curve = cls(image, angle, int(intervals), float(sigma))
        except ValueError:
            raise _refused(text) from None
        in_range = FEWEST <= curve.intervals <= MOST and 0.0 < curve.sigma_rad < math.inf
        if not image or curve.angle not in ANGLES or not in_range:
            raise _refused(text)
        return curve


def _refused(text: str) -> InputError:
    return InputError.of("options.value", option="jitter_curves", value=text, expected=_FORM)


def jitter_by_image(texts: Iterable[str], images: Sequence[str]) -> dict[str, tuple[JitterCurve, ...]]:
    """Return the curves of each image that has some, in the order of their angles.

    Raises
    ------
    InputError
        A text is wrong, an image is not in the block, an angle is named twice, or the
        curves of an image have different numbers of intervals.
    """
    out: dict[str, tuple[JitterCurve, ...]] = {}
    for text in texts:
        curve = JitterCurve.parse(text)
        own = out.get(curve.image, ())
        if curve.image not in images:
            raise InputError.of("jitter.image", option="jitter_curves", value=text, known=", ".join(images))
        if any(curve.angle == one.angle or curve.intervals != one.intervals for one in own):
            raise InputError.of("jitter.twice", option="jitter_curves", value=text, id=curve.image)
        out[curve.image] = tuple(sorted((*own, curve), key=lambda one: ANGLES.index(one.angle)))
    return out
