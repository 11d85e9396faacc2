"""Effects on light that the user can choose, and their sizes on the ground and in the image."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.metadata import LightEffects

if TYPE_CHECKING:
    from fg_orient.sensors.general import GeneralPushbroom

EFFECTS: Final = tuple(asdict(LightEffects()))
#: Name that selects no effect.
NONE: Final = "none"
#: Number of lines, and of samples, of the grid on which sizes are computed.
SIDE: Final = 3


def chosen(names: tuple[str, ...], usual: LightEffects) -> LightEffects:
    """Return the effects with these names, or ``usual`` if there are no names.

    Raise InputError for unknown names.
    """
    if not names:
        return usual
    wrong = [name for name in names if name not in (*EFFECTS, NONE)]
    if wrong or (NONE in names and len(names) > 1):
        raise InputError.of(
            "light.name (failure): unknown effect on light, or an effect in addition to none -> give some of {known}, "
            "or none", option="light", value=", ".join(wrong or names), known=", ".join(EFFECTS),
        )  # fmt: skip
    return LightEffects(**{name: name in names for name in EFFECTS})


def light_sizes(sensor: GeneralPushbroom) -> list[dict[str, Any]]:
    """Compute the size of each single effect over a grid of 3 x 3 pixels at the mean height.

    Returns
    -------
    list of dict
        ``effect``, ``applied``; ``ground_m``: mean shift of the ground point of a pixel;
        ``line_px``, ``sample_px``: mean shift of the pixel of a ground point;
        ``largest_px``: largest length of this shift.
    """
    without = sensor.with_effects(LightEffects())
    line, sample = sensor.grid(SIDE)
    plain = _ground(without, line, sample)
    towards_line, towards_sample = _inwards(line), _inwards(sample)
    by_pixel = np.stack([(_ground(without, line + towards_line, sample) - plain) * towards_line[:, None],
                         (_ground(without, line, sample + towards_sample) - plain) * towards_sample[:, None]],
                        axis=2)  # fmt: skip
    inverse = np.linalg.pinv(by_pixel)
    out = []
    for name in EFFECTS:
        shift = _ground(sensor.with_effects(LightEffects(**{name: True})), line, sample) - plain
        pixel = -np.einsum("nij,nj->ni", inverse, shift)
        out.append({
            "effect": name, "applied": bool(getattr(sensor.metadata.effects, name)),
            "ground_m": float(np.linalg.norm(shift, axis=1).mean()), "line_px": float(pixel[:, 0].mean()),
            "sample_px": float(pixel[:, 1].mean()), "largest_px": float(np.linalg.norm(pixel, axis=1).max()),
        })  # fmt: skip
    return out


def _inwards(at: Array) -> Array:
    """Return steps of one pixel towards the middle of the image."""
    return np.where(at > at.mean(), -1.0, 1.0)


def _ground(sensor: GeneralPushbroom, line: Array, sample: Array) -> Array:
    return sensor.locate(line, sample, height_m=sensor.mean_height_m)


def noted(sensor: GeneralPushbroom) -> GeneralPushbroom:
    """Return the sensor with a note on the sizes of the effects.

    Only images of the Earth get the note.
    """
    if sensor.body is None:
        sensor.notes = (*sensor.notes, light_note(sensor.light_sizes))
    return sensor


def light_note(sizes: list[dict[str, Any]]) -> Finding:
    """Return a note that lists the sizes of the effects on light: first those that are applied, then the others."""
    words = [[f"{one['effect'].replace('_', ' ')} {one['largest_px']:.2f} px ({one['ground_m']:.2f} m)"
              for one in sizes if one["applied"] == applied] for applied in (True, False)]  # fmt: skip
    return finding("image.light (note): effects on light: applied: {applied}; not applied: {left_out}",
                   applied=words[0] or ["none"], left_out=words[1] or ["none"])  # fmt: skip
