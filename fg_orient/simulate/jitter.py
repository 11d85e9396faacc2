"""Simulate the true jitter of images as sine waves of roll and pitch, and write the table of these waves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from fg_orient.model.errors import InputError
from fg_orient.model.names import ATTITUDE, COMPONENTS
from fg_orient.sensors.correction import Correction, Wave
from fg_orient.simulate.options import Jittered
from fg_orient.simulate.scene import DETECTOR_M, FOCAL_LENGTH_M

#: Angle of one detector element, rad; it converts amplitudes in pixels to angles.
PIXEL_RAD: Final = DETECTOR_M / FOCAL_LENGTH_M
#: Columns of ``truth/jitter``.
JITTER_COLUMNS: Final = ("image", "component", "amplitude_px", "amplitude_rad", "cycles", "phase_rad")
ROLL, PITCH, _ = ATTITUDE
_AXES: Final = {"roll": (ROLL,), "pitch": (PITCH,), "both": (ROLL, PITCH)}


def jitter_waves(options: Jittered, images: Sequence[str], rng: np.random.Generator) -> tuple[tuple[Wave, ...], ...]:
    """Return the waves of each image.

    Random phases are drawn for roll and pitch of every image, so that a phase does not
    depend on the other options.

    Raises
    ------
    InputError
        ``jitter_images`` names another image.
    """
    if other := [name for name in options.jitter_images if name not in images]:
        raise InputError.of(
            "options.value", option="jitter_images", value=other[0], expected=f"ids among {', '.join(images)}"
        )
    drawn, axes, out = rng.uniform(-math.pi, math.pi, (len(images), 2)), _AXES[options.jitter_axis], []
    for name, phases in zip(images, drawn.tolist(), strict=True):
        waved = options.jitter_px > 0.0 and name in (options.jitter_images or images)
        given = options.jitter_phase_deg
        out.append(tuple(
            Wave(
                axis, options.jitter_px * PIXEL_RAD, options.jitter_cycles,
                phases[axis - ROLL] if given is None else math.radians(given),
            )
            for axis in axes if waved
        ))  # fmt: skip
    return tuple(out)


def jitter_rows(image: str, correction: Any) -> list[tuple[object, ...]]:
    """Return the rows of ``truth/jitter`` of one image; none for an image without waves."""
    waves = correction.waves if isinstance(correction, Correction) else ()
    return [
        (image, COMPONENTS[w.component], w.amplitude / PIXEL_RAD, w.amplitude, w.cycles, w.phase_rad) for w in waves
    ]
