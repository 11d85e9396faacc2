"""Camera models of COLMAP, in its text models and its databases.

Pixels are (x, y) with (0.5, 0.5) in the centre of the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.errors import InputError
from fg_orient.sensors.conventions import CONVENTIONS, Image, interior_parameters
from fg_orient.sensors.frame import IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

#: Models that are read, and their conventions; the smallest sufficient one is written.
CONVENTION: Final = {
    model: CONVENTIONS[f"colmap-{model.lower().replace('_', '-')}"]
    for model in (
        "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV",
    )
}  # fmt: skip
#: Names of their parameters, in the order of the files.
MODELS: Final = {model: convention.names for model, convention in CONVENTION.items()}
#: Coordinate of the centre of the first pixel in COLMAP's files.
FIRST_PIXEL: Final = CONVENTION["PINHOLE"].first_pixel


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
    absent = CONVENTION[model].absent.split()
    beyond = [f"{key} {v:g}" for key, v in zip(MODELS[model], parameters, strict=True) if key in absent and v != 0.0]
    if beyond:
        raise InputError.of("colmap.camera", file=file, place=place, value=" ".join(beyond))
    return CONVENTION[model].interior(parameters, Image(size[1], size[0]), name)


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
    own = interior_parameters(fitted.interior)
    model = next(name for name, c in CONVENTION.items() if c.is_of(fitted.interior) and c.has(own != 0.0))
    values = [*CONVENTION[model].values(own, Image()).tolist(), *(0.0 for _ in CONVENTION[model].absent.split())]
    return model, tuple(values), fitted.max_px


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
