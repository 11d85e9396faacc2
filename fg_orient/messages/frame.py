"""Messages about frame cameras and bundle files."""

from __future__ import annotations

from typing import Final

FRAME: Final = {
    "frame.camera": ("this value of the camera is not possible", "give {expected}"),
    "frame.unknown": ("the camera has no such unknown, or its prior sigma is not above zero", "known: {known}"),
    "frame.nothing_unknown": (
        "the camera has no unknown, so its image cannot be adjusted",
        "name some with their prior sigmas, small ones to hold it",
    ),
    "frame.pixel_outside": (
        "pixel outside the image",
        "lines run from {first_line:g} to {last_line:g}, samples from {first_sample:g} to {last_sample:g}",
    ),
    "frame.no_direction": (
        "the distortion of the camera cannot be inverted at this pixel",
        "check k1, k2, k3, p1, p2: the polynomial folds inside the image",
    ),
    "frame.local": (
        "the image stands in a local coordinate system: there is no height above the ellipsoid to locate at",
        "intersect the point from two images, or give the camera in Earth-fixed coordinates",
    ),
    "frame.mixed": (
        "images in a local coordinate system and Earth-fixed ones cannot stand in one block",
        "transform them to one system",
    ),
}
