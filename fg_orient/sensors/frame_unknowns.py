"""Unknowns of a frame image: names, units and descriptions.

The code of an unknown is its position in :data:`NAMES`, as in ``factors.cameras.frame_extended``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from factors.cameras import frame_corrections
from fg_orient.model.parameters import ImageParameters

if TYPE_CHECKING:
    from fg_orient.sensors.frame import FrameCamera

#: Names of the exterior orientation, and of the interior orientation with Brown's distortion
#: (``factors.cameras.frame``).
UNKNOWNS: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "principal_sample",
    "principal_line", "k1", "k2", "k3", "p1", "p2", "aspect",
)  # fmt: skip
#: Names of the unknowns of a receiver and an inertial unit on board
#: (``factors.conditions.navigation``). Image points do not depend on them. They are shift
#: and drift of the position in the axes of the strip, shift and drift of the attitude
#: about the axes of the body, lever arm, and boresight.
NAVIGATION: Final = (
    "gnss_shift_east", "gnss_shift_north", "gnss_shift_up", "gnss_drift_east", "gnss_drift_north", "gnss_drift_up",
    "ins_shift_roll", "ins_shift_pitch", "ins_shift_heading", "ins_drift_roll", "ins_drift_pitch", "ins_drift_heading",
    "lever_x", "lever_y", "lever_z", "boresight_x", "boresight_y", "boresight_z",
)  # fmt: skip
#: Names of further coefficients of the interior orientation
#: (``factors.cameras.frame_corrections``): shear, fisheye lens, affinity, Brown's
#: additional parameters, alternative terms.
FURTHER: Final = frame_corrections.NAMES
#: Names of the unknowns of the interior orientation. Images of one camera may share them.
INTERIOR: Final = (*UNKNOWNS[6:], *FURTHER)
NAMES: Final = (*UNKNOWNS, *NAVIGATION, *FURTHER)
UNITS: Final = (
    *("rad",) * 3, *("m",) * 3, *("px",) * 3, *("",) * 6, *("m",) * 6, *("rad",) * 6, *("m",) * 3, *("rad",) * 3,
    *("",) * len(FURTHER),
)  # fmt: skip
#: Descriptions of the unknowns in messages, in the order of NAMES.
WORDS: Final = (
    "rotation about the camera's X (rad)", "rotation about the camera's Y (rad)",
    "rotation about the camera's Z (rad)", "projection centre X (m)", "projection centre Y (m)",
    "projection centre Z (m)", "focal length (px)", "sample of the principal point (px)",
    "line of the principal point (px)", "radial distortion k1", "radial distortion k2", "radial distortion k3",
    "decentring distortion p1", "decentring distortion p2", "aspect",
    *(f"{kind} of the receiver {axis} (m)" for kind in ("shift", "drift") for axis in ("East", "North", "Up")),
    *(f"{kind} of the attitude, {axis} (rad)" for kind in ("shift", "drift") for axis in ("roll", "pitch", "heading")),
    *(f"lever arm {axis} (m)" for axis in "XYZ"),
    *(f"boresight about the camera's {axis} (rad)" for axis in "XYZ"),
    *(f"coefficient {name.replace('_', ' ')}" for name in FURTHER),
)  # fmt: skip


def camera_parameters(camera: FrameCamera, only: tuple[str, ...] = ()) -> ImageParameters:
    """Return the unknowns of a frame image by code: all with a prior sigma that are also in ``only``."""
    codes = tuple(k for k, name in enumerate(NAMES) if name in camera.sigma and (not only or name in only))
    sigma = np.array([camera.sigma[NAMES[k]] for k in codes])
    names = tuple(NAMES[k] for k in codes)
    shared = tuple(camera.shared.get(name, "") for name in names) if camera.shared else ()
    return ImageParameters(codes, sigma, names, tuple(UNITS[k] for k in codes), tuple(WORDS[k] for k in codes), shared)
