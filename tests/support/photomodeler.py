"""Blocks of the runs of Börlin and Grussenmeyer (2016) are read from exports of PhotoModeler.

DBAT takes image points, camera and start values from the export, and control points from a file of its own.
:func:`write_projects` writes small projects of our own under the names of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from factors.conditions.constraints import OBSERVED_ELEMENT
from fg_orient.closerange.photo import Photo, PhotoInterior, aerial_from_rotation, rotation_from_aerial
from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.block import Block, Coordinates, ExtraObservation, GroundPoints, Image, ImagePoints, Options
from fg_orient.model.names import Role
from fg_orient.sensors.frame import FrameSensor
from tests.support.dbat import EXTERIOR, NOTHING


def read_control(path: Path) -> dict[int, np.ndarray]:
    """Return the rows of a control point file by id: X, Y, Z, then sigmas where there are any."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {int(row[0]): np.array([float(word) for word in row[2:]]) for row in rows}


def read_centres(path: Path) -> dict[str, np.ndarray]:
    """Return X, Y, Z and sigma of projection centres by photo."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {row[0]: np.array([float(word) for word in row[1:]]) for row in rows}


def points_of(export: FrameModel) -> dict[int, np.ndarray]:
    """Return the start coordinates of all points by number."""
    return {int(name): at for name, at in zip(export.point_ids, export.points_m, strict=True)}


def shift_of(export: FrameModel, control: dict[int, np.ndarray]) -> np.ndarray:
    """Return the shift from the export's system to that of the control points, their mean difference."""
    points = points_of(export)
    return np.mean([control[i][:3] - points[i] for i in control], axis=0)


def block(export: FrameModel, control: dict[int, np.ndarray], sigma_px: float, centres: dict[str, np.ndarray]) -> Block:
    """Return the block of a run.

    The camera is held, control points are held or have their sigmas, and so have observed centres by photo. Coordinates
    are those of the export's system, as in the reports.
    """
    shift = shift_of(export, control)
    (interior,) = export.cameras.values()
    cameras = [interior.camera(pose.rotation, pose.centre_m, EXTERIOR) for pose in export.poses]
    images = tuple(
        Image(pose.name, FrameSensor(c, interior.n_lines, interior.n_samples, georeferenced=False))
        for pose, c in zip(export.poses, cameras, strict=True)
    )
    seen, at = np.unique(export.point, return_inverse=True)
    ids = np.array([int(export.point_ids[k]) for k in seen.tolist()])
    sigma = np.full(len(at), sigma_px)
    measured = ImagePoints(export.image, at, export.line, export.sample, sigma, sigma)
    options = Options(priors=False, datum="control", optimizer="gauss-newton", max_iterations=20)
    return Block("dbat", images, _points(export, ids, control, shift), measured, NOTHING, options,
                 extra=_observed(images, centres, shift))  # fmt: skip


def _points(export: FrameModel, ids: np.ndarray, control: dict[int, np.ndarray], shift: np.ndarray) -> GroundPoints:
    """Return the ground points with control points held or with their sigmas.

    The others begin at the export's coordinates.
    """
    start = points_of(export)
    xyz, sigma = np.array([start[i] for i in ids.tolist()]), np.full((len(ids), 3), np.nan)
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
    """Return the observations of projection centres: X, Y, Z, sigma by photo.

    Unknowns stand in units of their prior sigmas.
    """
    out = []
    for image in images:
        if image.id in centres:
            *at, sigma = centres[image.id]
            unit = EXTERIOR["centre_x"]
            for j, value in enumerate((np.array(at) - shift - image.sensor.camera.centre_m) / unit):
                record = np.array([unit / sigma, value, 3.0 + j])
                out.append(ExtraObservation(OBSERVED_ELEMENT, (f"image:{image.id}",), record, np.zeros((2, 0)), 1, ""))
    return tuple(out)


#: Where the projects of :func:`write_projects` stand, beside those of DBAT: system of the control points, focal length.
SHIFT = np.array([100.0, 200.0, 10.0])
PLACES = ((-1.5, -1.0, 3.0), (1.5, -1.0, 3.2), (1.5, 1.0, 3.1), (-1.5, 1.0, 2.9), (0.0, 0.0, 3.6))
FOCAL, SIDE_MM = 8.0, 8.0


def write_projects(folder: Path) -> None:
    """Write projects under the names that docs/how-to/photomodeler.md gives DBAT's, and one under another name."""
    aerial = [f"{n}.jpg" for n in (8811, 8936, 8937, 8938, 9111)]
    control = [317, 375, 403, 410]
    # the noise exceeds the stated sigma where it does so in DBAT's files: these results are not trustworthy
    for name, files, others, noise_px in (
        ("cam/{}/fixed", ("fixed", 3), range(24), 0.2), ("cam/{}/weighted", ("weighted", 6), range(24), 0.2),
        ("sxb/{}/f-op0", ("fixed", 3), (), 0.1), ("sxb/{}/w-op0", ("weighted", 6), (), 0.1),
        ("sxb/{}/w-op1", ("weighted", 6), range(1), 0.1), ("sxb/{}/wsmart", ("weighted", 6), range(24), 1.5),
    ):  # fmt: skip
        where = folder / "prague2016" / name.partition("/")[0]
        path = folder / "prague2016" / f"{name.format('pmexports')}-with-orient-pmexport.txt"
        write_project(
            path, where / "ref" / f"ctrlpts-{files[0]}.txt", [*control, *others], files[1], aerial, noise_px=noise_px
        )
    positions = folder / "prague2016" / "sxb" / "ref" / "fake-camera-positions.txt"
    sheet = [f"P825002{k}.JPG" for k in range(1, 6)]
    write_positions(positions, aerial[:4])
    write_project(folder / "dbat" / "pmexports" / "camcal-pmexport.txt", folder / "dbat" / "ref" / "camcal-fixed.txt",
                  [1001, 1002, 1003, 1004, 13, 60, 88, *range(100, 140)], 3, sheet, noise_px=0.2)  # fmt: skip
    write_project(folder / "pmexport.txt", folder / "ctrlpts.txt", [*control, *range(24)], 6, aerial)
    write_positions(folder / "positions.txt", aerial[:4])


def write_positions(path: Path, photos: Sequence[str]) -> None:
    """Write observed projection centres as DBAT keeps them."""
    rows = [
        f"{n},{x:.4f},{y:.4f}, {z:.4f},0.0020" for n, (x, y, z) in zip(photos, np.array(PLACES) + SHIFT, strict=False)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["#Label,X,Y,Z,Accuracy_X/Y/Z_(m)", *rows, ""]), "utf-8")


def write_project(
    path: Path,
    control: Path,
    ids: Sequence[int],
    columns: int,
    names: Sequence[str],
    off_m: float = 0.01,
    noise_px: float = 0.1,
) -> None:
    """Write an export of five photos of points of which the first four are control.

    Parameters
    ----------
    path, control : Path
        Export, and file of control points.
    ids : sequence of int
        Of the points.
    columns : int
        3: control points are exact, 6: they have standard deviations.
    names : sequence of str
        Files of the photos.
    off_m : float
        Errors of the exported projection centres, along each axis.
    noise_px : float
        Standard deviation of the marks.
    """
    rng = np.random.default_rng(7)
    n, px = len(ids), 1000.0 / SIDE_MM
    known = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.3], [1.0, 1.0, 0.0], [-1.0, 1.0, -0.2]])
    points = np.vstack(
        [known, np.column_stack([rng.uniform(-1.0, 1.0, (max(n - 4, 0), 2)), rng.uniform(-0.4, 0.4, n - 4)])]
    )
    interior = PhotoInterior(FOCAL, np.array([4.05, 3.95]), np.array([1e-3, 0.0, 0.0, 1e-4, 5e-5, 0.0, 0.0]), "down")
    head = f" {FOCAL} 4.05 3.95 {SIDE_MM} {SIDE_MM} 1e-3 0.0 0.0 1e-4 -5e-5"
    text, marks = ["Bundle Soln a project", " 0.000500 20 1000 1000", " 1.0 0.1", head], []
    for k, (place, name) in enumerate(zip(PLACES, names, strict=True)):
        kappa = 0.5 * np.pi * k
        lean = np.array([np.arctan2(place[1], place[2]), -np.arctan2(place[0], place[2])]) * 0.8
        rotation = rotation_from_aerial(lean[0], lean[1], kappa)
        at = Photo.of(name, interior, rotation, place).project(points) * px + rng.normal(0.0, noise_px, (n, 2))
        marks += [f"   {k}    {i} {x:.4f} {y:.4f} 1.0 1.0" for i, (x, y) in zip(ids, at.tolist(), strict=True)]
        omega, phi, turn = np.degrees(aerial_from_rotation(rotation))
        begin = np.array(place) + off_m
        if k:
            text += ["", f"   {k}{head}"]
        text += ["   0.0 0.0 0.0 0.5 0.5 0.001 0.0001 0.0001 0.001 0.001", f"   {k} photos/{name}",
                 f"   {k} {begin[0]} {begin[1]} {begin[2]} {turn:.3f} {phi:.3f} {omega:.3f}",
                 f"   {k} 0.1 0.1 0.1 0.1 0.1 0.1"]  # fmt: skip
    rows = [f"    {i} {x:.4f} {y:.4f} {z:.4f} 0.1 0.1 0.1" for i, (x, y, z) in zip(ids, points.tolist(), strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*text, "", *rows, "", *marks, ""]), "utf-8")
    more = ", 0.002, 0.002, 0.003" * (columns == 6)
    control.parent.mkdir(parents=True, exist_ok=True)
    control.write_text("# Id, Name, X, Y, Z, sigmaX, sigmaY, sigmaZ\n" + "".join(
        f"{i}, CP{i}, {x:.4f}, {y:.4f}, {z:.4f}{more}\n" for i, (x, y, z) in zip(ids, known + SHIFT, strict=False)
    ), "utf-8")  # fmt: skip
