"""Make the tables of a bundle from projects of other programs: cameras, poses, start points and marks.

Image coordinates and cameras have the unit of the model's camera. It is mm if the program
gives it (PhotoModeler), and pixels otherwise. x points right, and y points down. Programs
export coordinates in a shifted system. Therefore the coordinates of a project are shifted
into the system of its control points by the mean difference of these points. A rotated or
scaled system is not supported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.closerange.photo import Photo, PhotoInterior, photo_text
from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.formats.exchange.convert import require_usable
from fg_orient.formats.exchange.photomodeler import read_centres, read_control
from fg_orient.formats.frame_model import FrameModel
from fg_orient.formats.registry import Settings, format_named
from fg_orient.model.errors import InputError, as_record, finding
from fg_orient.result.plain import plain, rows_of, write_records
from fg_orient.sensors.frame import MEASURED_TO_IDEAL
from fg_orient.sensors.interior import Interior as FrameInterior

Record = dict[str, Any]

CONTENTS: Final = Contents("photos.toml", ("photos.toml", "image.csv", "control.csv", "start.csv", "stations.csv"))


def run_import(
    *export: Path,
    source: str = "photomodeler",
    control: Path | None = None,
    stations: Path | None = None,
    sigma_image_px: float | None = None,
    image_sizes: Mapping[str, tuple[int, int]] | None = None,
    out: Path,
    overwrite: bool = False,
) -> Record:
    """Write the tables of ``closerange bundle`` from a project of another program.

    Parameters
    ----------
    *export, source
        Files or folder of the project; name of a format with cameras and poses.
    control, stations : Path, optional
        Control points: lines of id, name, X, Y, Z and, unless exact, one or three
        standard deviations. Observed projection centres: lines of photo, X, Y, Z and one
        or three standard deviations. Control points that the project does not have are
        left out, with a note.
    sigma_image_px : float, optional
        Standard deviation of image coordinates, pixels, added to the table.
    image_sizes : mapping of str to (n_lines, n_samples), optional
        Sizes of photos whose size the project does not state.
    out, overwrite
        Folder of the tables; replace it.

    Raises
    ------
    InputError
        The file is invalid, or it has a camera whose distortion maps ideal to measured coordinates.
    """
    require_free(out, overwrite=overwrite, contents=CONTENTS)
    format_ = format_named(source, place="<from>")
    if format_.read_model is None:
        raise InputError.of("closerange.no_model", file=export[0], place="<from>", value=source)
    require_usable(export, format_, True)
    settings = Settings(image_sizes=image_sizes or {})
    model = format_.read_model(export, settings)
    settings.require_images([pose.name for pose in model.poses], export[0])
    stated, known = read_control(control) if control else ([], np.empty((0, 6)))
    present = np.isin(np.array(stated, str), model.point_ids)
    ids, known, missing = list(compress(stated, present)), known[present], list(compress(stated, ~present))
    if missing and not ids:
        raise InputError.of(
            "closerange.not_in_project", file=control, value=", ".join(missing), known=", ".join(model.point_ids[:10])
        )
    left_out = finding("closerange.control_left_out", file=control, n=len(missing), names=missing)
    notes = (*model.notes, left_out) if missing else model.notes
    weighted = np.isfinite(known[:, 3])
    if weighted.any() and not weighted.all():
        raise InputError.of("closerange.control_mixed", file=control, place=f"point {ids[int(np.argmin(weighted))]}")
    shift = _shift(model, ids, known)
    centres = read_centres(stations) if stations else {}
    tables = {"image.csv": _marks(model, sigma_image_px)}
    new = [k for k in np.unique(model.point).tolist() if model.point_ids[k] not in set(ids)]
    if new:
        tables["start.csv"] = {"id": [model.point_ids[k] for k in new], "{}_m": model.points_m[new] + shift}
    if ids:
        tables["control.csv"] = {"id": ids, **_spread(known[:, : 6 if weighted.all() else 3])}
    if centres:
        tables["stations.csv"] = {"photo": [*centres], **_spread(np.array([*centres.values()]))}
    photos = _photos(model, shift, export[0])
    with staged_folder(out, overwrite=overwrite, contents=CONTENTS) as folder, writing(out):
        (folder / "photos.toml").write_text("schema = 1\n\n" + "\n".join(photos), encoding="utf-8")
        for name, columns in tables.items():
            write_records(folder / name, plain(rows_of(columns)))
    return {
        "kind": "import",
        "format": source,
        "photos": len(model.poses),
        "points": len(np.unique(model.point)),
        "image_points": len(model.point),
        "control": len(ids),
        "stations": len(centres),
        "shift_m": shift.tolist(),
        "unit": "px" if _unit(model) == 1.0 else "mm",
        "files": ["photos.toml", *tables],
        "out": str(out),
        **as_record(notes),
    }


def _unit(model: FrameModel) -> float:
    """Return the number of pixels per unit of the image coordinates.

    This is the unit of the camera polynomials if all cameras have the same unit; otherwise it is 1 pixel.
    """
    units = {c.unit_px for c in model.cameras.values() if c.model == MEASURED_TO_IDEAL and c.unit_px}
    return units.pop() if len(units) == 1 else 1.0


def _shift(model: FrameModel, ids: Sequence[str], known: Array) -> Array:
    """Return the mean difference (3,) between control points and the project's points; 0 without control points."""
    if not len(ids):
        return np.zeros(3)
    place = {name: k for k, name in enumerate(model.point_ids)}
    return np.asarray((known[:, :3] - model.points_m[[place[name] for name in ids]]).mean(axis=0))


def _marks(model: FrameModel, sigma_px: float | None) -> dict[str, Any]:
    """Return the columns of the table of image points."""
    unit = _unit(model)
    columns: dict[str, Any] = {
        "id": [model.point_ids[j] for j in model.point],
        "photo": [model.poses[k].name for k in model.image],
        "{}": np.column_stack([model.sample, model.line]) / unit,
    }
    return columns if sigma_px is None else columns | {"sigma_{}": np.full((len(model.point), 2), sigma_px / unit)}


def _spread(values: Array) -> dict[str, Array]:
    """Return the columns of coordinates (n, 3) and, if there are six numbers, their standard deviations."""
    return {"{}_m": values[:, :3]} | ({"sigma_{}_m": values[:, 3:]} if values.shape[1] > 3 else {})


def _photos(model: FrameModel, shift: Array, file: Path) -> list[str]:
    """Return the photo tables.

    Raise InputError for two photos of one name, or a camera that a photo file cannot contain.
    """
    names = [pose.name for pose in model.poses]
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise InputError.of("closerange.bundle", file=file, place="photos", value=twice, expected="different names")
    interiors = {key: _interior(c, _unit(model), file) for key, c in model.cameras.items()}
    return [
        photo_text(
            Photo.of(p.name, interiors[p.camera], p.rotation, p.centre_m + shift), interiors[p.camera], p.rotation
        )
        for p in model.poses
    ]


def _interior(camera: FrameInterior, unit_px: float, file: Path) -> PhotoInterior:
    """Convert a camera to the unit of the image coordinates.

    The coefficients k1 k2 k3 P1 P2 refer to x right, y down, and convert measured to ideal coordinates.
    """
    if camera.model != MEASURED_TO_IDEAL and np.any(camera.distortion):
        raise InputError.of("closerange.direction", file=file, place=f"camera {camera.name}", value=camera.model)
    stretch = 1.0 + camera.aspect  # factor of x; the principal distance refers to x, and B compresses y
    if camera.aspect and np.any(camera.distortion):
        raise InputError.of(
            "closerange.camera",
            file=file,
            place=f"camera {camera.name}",
            value=f"aspect {camera.aspect:g}",
            expected="aspect 0 with distortion",
        )
    # ratio of the polynomial's unit to the unit of the coordinates
    ratio = (camera.unit_px or camera.focal_px) / unit_px
    k1, k2, k3, first, second = camera.distortion.tolist()
    corrections = np.array([k1 / ratio**2, k2 / ratio**4, k3 / ratio**6, second / ratio, first / ratio, 0.0,
                            1.0 / stretch - 1.0])  # fmt: skip
    principal = np.array([camera.principal_px[1], camera.principal_px[0]]) / unit_px
    return PhotoInterior(camera.focal_px / stretch / unit_px, principal, corrections, "down")
