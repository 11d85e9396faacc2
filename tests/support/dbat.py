"""Files of the Damped Bundle Adjustment Toolbox (Börlin, Grussenmeyer 2013, 2016) as blocks: a reader for tests.

Image points stand in pixels u right, v down, as in the file; x = u s - px, y = -(v s - py) in mm with s the format's
height over its pixels, so line is v and sample is u, and the polynomial's unit is 1 mm.
"""

from __future__ import annotations

import gzip
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factors.cameras.frame_camera import CAMERA
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.solve import Estimate
from fg_orient.closerange.photo import PhotoInterior
from fg_orient.closerange.resection import resect
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints, Options, WithheldCoordinates
from fg_orient.model.digits import last_digit
from fg_orient.model.names import Role
from fg_orient.quality.cofactors import Cofactors
from fg_orient.sensors.frame import (
    INTERIOR,
    MEASURED_TO_IDEAL,
    FrameCamera,
    FrameSensor,
    opk_of_rotation,
    rotation_of_opk,
)

NOTHING = WithheldCoordinates((), lambda: Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)))
ROTATION, CENTRE = ("rotation_x", "rotation_y", "rotation_z"), ("centre_x", "centre_y", "centre_z")
EXTERIOR = {**dict.fromkeys(ROTATION, 1e-2), **dict.fromkeys(CENTRE, 1e-2)}


@dataclass(frozen=True)
class Format:
    """Image size (px), its height (mm)."""

    width: int
    height: int
    height_mm: float

    @property
    def px_per_mm(self) -> float:
        return self.height / self.height_mm


def table(path: Path) -> np.ndarray:
    """Return the numbers of a file, comments left out."""
    raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    lines = [line for line in raw.decode().splitlines() if line.strip() and not line.startswith("#")]
    return np.array([[float(v) for v in re.sub(r"[A-Z]\w*", "0", line).split(",")] for line in lines])


def camera(
    form: Format,
    focal_mm: float,
    principal_mm: tuple[float, float],
    k: tuple[float, ...],
    pose: tuple,
    sigma: dict,
    aspect: float = 0.0,
) -> FrameCamera:
    """Return the camera of DBAT's interior orientation. All cameras share the whole interior orientation."""
    s = form.px_per_mm
    return FrameCamera(
        pose[0], pose[1], focal_mm * s, np.array([principal_mm[1], principal_mm[0]]) * s,
        np.array([*k, *([0.0] * (5 - len(k)))]), sigma, model=MEASURED_TO_IDEAL, unit_px=s, aspect=aspect,
        shared={name: "camera 1" for name in sigma if name in INTERIOR},
    )  # fmt: skip


def block(cameras: list[FrameCamera], form: Format, marks: np.ndarray, known: dict[int, list[float]], sigma_px: float,
          options: Options) -> Block:  # fmt: skip
    """Return the block of all image points; known points are fixed."""
    ids, point = np.unique(marks[:, 1].astype(int), return_inverse=True)
    xyz = np.array([known.get(i, [np.nan] * 3) for i in ids.tolist()])
    fixed = np.isfinite(xyz[:, 0])
    roles = tuple(Role.CONTROL if f else Role.TIE for f in fixed)
    points = GroundPoints(
        tuple(map(str, ids.tolist())), roles, Coordinates(xyz, np.full(xyz.shape, np.nan), fixed)
    )  # fmt: skip
    sigma = np.full(len(marks), sigma_px)
    seen = ImagePoints(marks[:, 0].astype(int) - 1, point, marks[:, 3], marks[:, 2], sigma, sigma)
    images = tuple(
        Image(str(k + 1), FrameSensor(c, form.height, form.width, georeferenced=False)) for k, c in enumerate(cameras)
    )
    return Block("dbat", images, points, seen, NOTHING, options)


def camcal(folder: Path) -> Block:
    """Return the block of camcaldemo without its results.

    Four control points give the resection, then points are intersected. Four points of a plane have two poses; in all
    21 photos the one with the smaller misfit is the true one.
    """
    form, marks = Format(2272, 1704, 5.43764), table(folder / "measurements" / "markpts.txt")
    control = {int(r[0]): r[2:5].tolist() for r in table(folder / "reference" / "camcal-fixed.txt")}
    width_mm = form.width / form.px_per_mm
    principal = (width_mm / 2.0, form.height_mm / 2.0)
    sigma = {**EXTERIOR, "focal": 1.0, "principal_sample": 1.0, "principal_line": 1.0, "k1": 1e-4, "k2": 1e-5,
             "k3": 1e-6, "p1": 1e-5, "p2": 1e-5, "aspect": 1e-4}  # fmt: skip
    interior = PhotoInterior(7.5, np.array(principal), y_axis="down")
    options = Options(priors=False, datum="control", optimizer="gauss-newton", max_iterations=20)
    cameras = [
        camera(form, 7.5, principal, (0.0,), pose, sigma)
        for pose in (_oriented(interior, marks[marks[:, 0] == k], control, form) for k in range(1, 22))
    ]
    return block(cameras, form, marks, control, 0.1, options)


def _oriented(interior: PhotoInterior, marks: np.ndarray, ground: dict[int, list[float]], form: Format) -> tuple:
    """Return the rotation and projection centre of a photo by the points that are known so far."""
    own = marks[np.isin(marks[:, 1], list(ground))]
    found = resect(interior, [ground[int(i)] for i in own[:, 1]], own[:, 2:4] / form.px_per_mm)
    return found.rotation, found.centre_m


def roma(folder: Path, *, calibrate: bool = True, aspect: float = 0.0) -> Block:
    """Return the block of romabundledemo.

    Photo 1 is held, and the Y of the projection centre of photo 19 (the longest base).
    """
    form = Format(5616, 3744, 24.0)
    marks = table(folder / "measurements" / "markpts.txt.gz")
    start = table(folder / "prior" / "initial_eo.txt")
    interior = {"focal": 1.0, "principal_sample": 1.0, "principal_line": 1.0, "k1": 1e-5, "k2": 1e-8}
    interior = interior if calibrate else {}
    cameras = []
    for number, x, y, z, *angles in start:
        sigma = {**EXTERIOR, **interior}
        if number == 1:
            sigma = interior
        if number == 19:
            sigma = {name: s for name, s in sigma.items() if name != "centre_y"}
        pose = (rotation_of_opk(*np.radians(angles)), np.array([x, y, z]))
        cameras.append(camera(form, 24.3581, (18.1143, 12.0), (2.174e-4, -1.518e-7), pose, sigma, aspect))
    options = Options(priors=False, datum="control", optimizer="gauss-newton", max_iterations=20, backend="schur")
    return block(cameras, form, marks, {}, 1.0, options)


def report(path: Path) -> tuple[dict[str, str], dict[str, dict[str, tuple[str, str]]]]:
    """Return the figures of a report, as printed.

    Figures of the bundle have names; others have value and deviation by camera or photo and
    name.
    """
    figures: dict[str, str] = {}
    values: dict[str, dict[str, tuple[str, str]]] = {}
    where, name, value = "", "", ""
    for line in path.read_text().splitlines():
        text = line.strip()
        if found := re.match(r"(Sigma0:|Redundancy|Number of params:)\s+(\S+)", text):
            figures[found[1].rstrip(":")] = found[2]
        elif found := re.match(r"(Camera1|Photo (\d+))\b", text):
            where = found[2] or "camera"
            values.setdefault(where, {})
        elif found := re.match(r"Value:\s+(\S+)", text):
            value = found[1]
            values.get(where, {})[name] = (value, "")
        elif found := re.match(r"Deviation:\s+(\S+)", text):
            values.get(where, {})[name] = (value, found[1])
        elif text.endswith(":"):
            name = text[:-1].split(" - ")[0]
    return figures, values


def camera_values(solved: Problem, state: State, q: Cofactors, form: Format) -> dict[str, tuple[float, float]]:
    """Return the camera parameters of the report in its units, and their cofactor roots.

    They come from the first image that has them.
    """
    k = next(i for i, p in enumerate(solved.parameters) if "focal" in p.names)
    names, sigma = solved.parameters[k].names, solved.parameters[k].sigma
    camera = solved.block.images[k].sensor.camera
    x = dict(zip(names, solved.unknowns(state, k) * sigma, strict=True))
    root = dict(zip(names, np.sqrt(np.diag(q.image(k))) * sigma, strict=True))
    s, (line, sample) = form.px_per_mm, camera.principal_px
    k1, k2, k3, p1, p2 = camera.distortion
    start = {"focal": (camera.focal_px, s), "principal_sample": (sample, s), "principal_line": (line, s),
             "k1": (k1, 1.0), "k2": (k2, 1.0), "k3": (k3, 1.0), "p2": (p2, 1.0), "p1": (p1, -1.0),
             "aspect": (camera.aspect, 1.0)}  # fmt: skip
    theirs = dict(zip(start, ("Camera Constant", "px", "py", "K1", "K2", "K3", "P1", "P2", "as"), strict=True))
    return {
        theirs[name]: ((value + x[name]) / unit, root[name] / abs(unit))
        for name, (value, unit) in start.items() if name in x
    }  # fmt: skip


def photo_values(solved: Problem, state: State, q: Cofactors, k: int) -> dict[str, tuple[float, float]]:
    """Return the angles (deg) and projection centre of a photo with their cofactor roots."""
    p, sensor = solved.parameters[k], solved.block.images[k].sensor
    correction = solved.models[k].correction(solved.unknowns(state, k))
    found = sensor.camera.corrected(correction)
    angles, turns = opk_of_rotation(found[CAMERA.rotation].reshape(3, 3))
    values = [*np.degrees(angles), *found[CAMERA.centre]]
    of = np.zeros((6, len(p)))  # rows: omega, phi, kappa (deg), X, Y, Z; the camera's J leads from unknowns to turns
    by = np.degrees(turns @ found[CAMERA.jacobian].reshape(3, 3))
    for j, (name, sigma) in enumerate(zip(p.names, p.sigma, strict=True)):
        if name in ROTATION:
            of[:3, j] = by[:, ROTATION.index(name)] * sigma
        if name in CENTRE:
            of[3 + CENTRE.index(name), j] = sigma
    roots = np.sqrt(np.einsum("ij,jk,ik->i", of, q.image(k), of))
    names = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
    return {n: (float(v), float(r)) for n, v, r in zip(names, values, roots, strict=True)}


def same_figures(problem: Problem, estimate: Estimate, figures: dict[str, str]) -> float:
    """Return our sigma0; number of unknowns, redundancy and sigma0 must be those of the report."""
    sigma0 = float(np.sqrt(estimate.chi2 / problem.redundancy))
    assert (problem.n_unknowns, problem.redundancy) == (int(figures["Number of params"]), int(figures["Redundancy"]))
    assert abs(sigma0 - float(figures["Sigma0"])) <= 0.5 * last_digit(figures["Sigma0"])
    return sigma0


def units_apart(
    ours: dict[str, dict[str, tuple[float, float]]], theirs: dict[str, dict[str, tuple[str, str]]], sigma0: float,
    unfinished: float = 0.0,
) -> list[float]:  # fmt: skip
    """Return the differences of values and deviations in units of the last printed digit.

    ``unfinished``: share of a deviation by which a value of theirs may miss the minimum.
    """
    out = []
    for where, values in theirs.items():
        for name in set(values) & set(ours.get(where, {})):
            value, root = ours[where][name]
            slack = unfinished * root * sigma0
            for found, text, free in zip((value, root * sigma0), values[name], (slack, 0.0), strict=True):
                if text:
                    turn = 360.0 if name in ("Omega", "Phi", "Kappa") else np.inf
                    apart = abs(found - float(text))
                    out.append(max(min(apart, abs(apart - turn)) - free, 0.0) / last_digit(text))
    return out
