"""Camera models of COLMAP, in its text models and its databases.

Pixels are (x, y) with (0.5, 0.5) in the centre of the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

#: Coordinate of the centre of the first pixel in COLMAP's files.
FIRST_PIXEL: Final = 0.5
#: Names of the parameters of the models that are read, in the order of the files.
MODELS: Final = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
FISHEYE: Final = "OPENCV_FISHEYE"
#: Coefficients in the order of ``Interior.distortion``.
_BROWN: Final = ("k1", "k2", "k3", "p1", "p2")


def interior_of(
    model: str, size: tuple[int, int], parameters: Sequence[float], name: str, *, file: str = "", place: str = ""
) -> Interior:  # fmt: skip
    """Camera of COLMAP as an interior orientation.

    Parameters
    ----------
    model : str
        Name as in cameras.txt.
    size : (int, int)
        Width and height, px.
    parameters : sequence of float
        In COLMAP's order, px.
    name : str
    file, place : str
        For messages.

    Raises
    ------
    InputError
        The model or a parameter has no counterpart, the number of parameters is wrong, or a value is impossible.
    """
    if model not in MODELS:
        raise InputError.of("colmap.model", file=file, place=place, value=model, known=", ".join(MODELS))
    if len(parameters) != len(MODELS[model]):
        needed = f"{model} with {' '.join(MODELS[model])}"
        raise InputError.of(
            "interchange.cells", file=file, place=place, value=f"{len(parameters)} numbers", needed=needed
        )
    value = dict(zip(MODELS[model], parameters, strict=True))
    focal = value.get("f", value.get("fy", 0.0))
    stretch = value.get("fx", focal) / focal - 1.0 if focal != 0.0 else 0.0
    principal, lens = np.array([value["cy"], value["cx"]]) - FIRST_PIXEL, dict[str, float]()
    if model == FISHEYE:
        lens = {f"fisheye_{k}": value.pop(f"k{k}") for k in range(1, 5)}
    beyond = {key: value[key] for key in ("k4", "k5", "k6") if value.get(key, 0.0) != 0.0}
    if beyond:
        shown = " ".join(f"{key} {number:g}" for key, number in beyond.items())
        raise InputError.of("colmap.camera", file=file, place=place, value=shown)
    distortion = np.array([value.get(key, 0.0) for key in _BROWN])
    return Interior(size[1], size[0], focal, principal, distortion, aspect=stretch, name=name, further=lens,
                    is_fisheye=model == FISHEYE)  # fmt: skip


def parameters_of(interior: Interior) -> tuple[str, tuple[float, ...], float]:
    """Camera for COLMAP by the smallest sufficient model.

    Returns
    -------
    model : str
    parameters : tuple of float
        In COLMAP's order, px.
    error_px : float
        Largest error. It is 0 unless the polynomial leads from measured to ideal coordinates: then a polynomial of the
        other direction is fitted (``fg_orient.sensors.interior.converted``).
    """
    others = any(v != 0.0 and not name.startswith("fisheye_") for name, v in interior.further.items())
    others |= interior.is_fisheye and bool(interior.distortion.any())
    fitted = converted(interior, IDEAL_TO_MEASURED, brown=others)  # COLMAP has neither shear nor further terms
    own = fitted.interior
    value = dict(zip(_BROWN, own.distortion.tolist(), strict=True))
    cy, cx = (own.principal_px + FIRST_PIXEL).tolist()
    focal = float(own.focal_px)
    value |= {"f": focal, "fx": focal * (1.0 + own.aspect), "fy": focal, "cx": cx, "cy": cy}
    needed = {key for key in _BROWN if value[key] != 0.0} | ({"fx"} if own.aspect != 0.0 else set())
    names: tuple[str, ...] = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
    if own.is_fisheye:
        names, value = (FISHEYE,), value | {f"k{k}": own.further.get(f"fisheye_{k}", 0.0) for k in range(1, 5)}
        needed = set()
    model = next(name for name in names if needed <= set(MODELS[name]))
    return model, tuple(value.get(key, 0.0) for key in MODELS[model]), fitted.max_px


def camera_lines(model: FrameModel) -> tuple[list[str], tuple[str, ...]]:
    """Lines of cameras.txt, and information that they cannot hold, in words."""
    lines, lost = [], []
    for k, (name, interior) in enumerate(model.cameras.items(), start=1):
        kind, values, error = parameters_of(interior)
        size = f"{interior.n_samples} {interior.n_lines}"
        lines.append(f"{k} {kind} {size} {' '.join(map(repr, values))}")
        if error > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {error:.2g} px in the image")
    return lines, tuple(lost)
