"""PhotoModeler exports as DBAT reads them, and the runs of Börlin, Grussenmeyer (2016) on them: a reader for tests.

An export holds one camera, photos (centre, kappa, phi, omega in degrees), known and all points in a shifted system, and
the marks. DBAT takes image points, camera and start values from it, and control points from a file of its own.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factors.constraints import OBSERVED_ELEMENT
from fg_orient.block import Block, Coordinates, ExtraObservation, GroundPoints, Image, ImagePoints, Options
from fg_orient.names import Role
from fg_orient.sensors.frame import FrameSensor, rotation_of_opk
from tests.support.dbat import EXTERIOR, NOTHING, Format, camera


@dataclass(frozen=True, eq=False)
class Export:
    """What a PhotoModeler text export says.

    Parameters
    ----------
    form : Format
    camera : (10,) array
        Focal length, principal point, format, k1 to k3, p1, p2; mm.
    names : list of str
        Files of the photos.
    poses : list of tuple
        Rotation and projection centre by photo.
    points : dict
        Start coordinates of all points by id.
    marks : (n, 4) array
        Photo (from 1), point, x, y in pixels.
    """

    form: Format
    camera: np.ndarray
    names: list[str]
    poses: list[tuple[np.ndarray, np.ndarray]]
    points: dict[int, np.ndarray]
    marks: np.ndarray


def read_export(path: Path) -> Export:
    """Read a text export: paragraphs of photos, known points, all points, marks."""
    text = path.read_text()
    size, _, inner = (_numbers(line) for line in text.splitlines()[1:4])
    found = re.findall(r"^ *\d+ \S*/(\S+)\n(.+)$", text, re.MULTILINE)
    stations = [_numbers(row) for _, row in found]
    poses = [(rotation_of_opk(*np.radians(s[:3:-1])), s[1:4]) for s in stations]
    tables = [rows for rows in map(_table, text.split("\n\n")) if rows is not None]
    points = next(t for t in reversed(tables) if t.shape[1] == 7)
    marks = next(t for t in tables if t.shape[1] == 6)
    return Export(
        Format(int(size[2]), int(size[3]), float(inner[4])), inner, [name for name, _ in found], poses,
        {int(row[0]): row[1:4] for row in points}, marks[:, :4] + [1.0, 0.0, 0.0, 0.0],
    )  # fmt: skip


def _numbers(line: str) -> np.ndarray:
    return np.array([float(word) for word in line.split()])


def _table(paragraph: str) -> np.ndarray | None:
    """Numbers of a paragraph without words."""
    if re.search("[A-Za-df-z]", paragraph):
        return None
    rows = [_numbers(line) for line in paragraph.splitlines() if line.strip()]
    return np.array(rows) if rows and len({len(row) for row in rows}) == 1 else None


def read_control(path: Path) -> dict[int, np.ndarray]:
    """Rows of a control point file by id: X, Y, Z, then sigmas where there are any."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {int(row[0]): np.array([float(word) for word in row[2:]]) for row in rows}


def read_centres(path: Path) -> dict[str, np.ndarray]:
    """X, Y, Z and sigma of projection centres by photo."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {row[0]: np.array([float(word) for word in row[1:]]) for row in rows}


def shift_of(export: Export, control: dict[int, np.ndarray]) -> np.ndarray:
    """What leads from the export's system to that of the control points: mean difference of the control points."""
    return np.mean([control[i][:3] - export.points[i] for i in control], axis=0)


def block(export: Export, control: dict[int, np.ndarray], sigma_px: float, centres: dict[str, np.ndarray]) -> Block:
    """Block of a run: the camera held; control points held or with their sigmas, and so observed centres by photo.

    Coordinates are those of the export's system, as in the reports.
    """
    shift = shift_of(export, control)
    f, x, y, _, _, k1, k2, k3, p1, p2 = export.camera
    polynomial = (k1, k2, k3, -p2, p1)  # y down
    cameras = [camera(export.form, f, (x, y), polynomial, pose, EXTERIOR) for pose in export.poses]
    images = tuple(
        Image(name, FrameSensor(c, export.form.height, export.form.width, georeferenced=False))
        for name, c in zip(export.names, cameras, strict=True)
    )
    ids, at = np.unique(export.marks[:, 1].astype(int), return_inverse=True)
    seen = export.marks
    sigma = np.full(len(seen), sigma_px)
    measured = ImagePoints(seen[:, 0].astype(int) - 1, at, seen[:, 3], seen[:, 2], sigma, sigma)
    options = Options(priors=False, datum="control", optimizer="gauss-newton", max_iterations=20)
    return Block("dbat", images, _points(export, ids, control, shift), measured, NOTHING, options,
                 extra=_observed(images, centres, shift))  # fmt: skip


def _points(export: Export, ids: np.ndarray, control: dict[int, np.ndarray], shift: np.ndarray) -> GroundPoints:
    """Control points held, or observed with sigmas; the others begin at the export's coordinates."""
    xyz, sigma = np.array([export.points[i] for i in ids.tolist()]), np.full((len(ids), 3), np.nan)
    fixed = np.zeros(len(ids), bool)
    for k, i in enumerate(ids.tolist()):
        if i in control:
            xyz[k] = control[i][:3] - shift
            fixed[k] = len(control[i]) == 3
            sigma[k] = np.nan if fixed[k] else control[i][3:6]
    roles = tuple(Role.CONTROL if i in control else Role.TIE for i in ids.tolist())
    return GroundPoints(tuple(map(str, ids.tolist())), roles, Coordinates(xyz, sigma, fixed))


def _observed(
    images: tuple[Image, ...], centres: dict[str, np.ndarray], shift: np.ndarray
) -> tuple[ExtraObservation, ...]:
    """Observations of projection centres: X, Y, Z, sigma by photo; unknowns stand in units of their prior sigmas."""
    out = []
    for image in images:
        if image.id in centres:
            *at, sigma = centres[image.id]
            unit = EXTERIOR["centre_x"]
            for j, value in enumerate((np.array(at) - shift - image.sensor.camera.centre_m) / unit):
                record = np.array([unit / sigma, value, 3.0 + j])
                out.append(ExtraObservation(OBSERVED_ELEMENT, (f"image:{image.id}",), record, np.zeros((2, 0)), 1, ""))
    return tuple(out)
