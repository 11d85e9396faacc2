"""An independent bundle adjustment of frames in an inertial frame uses only numpy.

It knows nothing of ``fg_orient``: own reader of the ISD, labels and networks, own equations, own normal equations. The
conventions are those of ISIS jigsaw as the data set states them. Units: km, mm on the plane of the scan, degrees.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

PITCH_MM = 0.005
SIGMA_MM = 1.4 * PITCH_MM
SCALE = 4.0
RHO = 180.0 / np.pi


def rotation(q: Array) -> Array:
    """Return the rotation of a quaternion, scalar first, as SPICE q2m."""
    a, b, c, d = q
    return np.array([
        [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
    ])  # fmt: skip


def r1(a: Any) -> Array:
    """Return the rotation of the axes about the first axis."""
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def r3(a: Any) -> Array:
    """Return the rotation of the axes about the third axis."""
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def euler(angles_deg: Array) -> Array:
    """Return the camera axes from J2000, of right ascension, declination, twist."""
    ra, dec, twist = angles_deg / RHO
    return r3(twist) @ r1(np.pi / 2 - dec) @ r3(np.pi / 2 + ra)


def angles_of(c: Array) -> Array:
    """Return the right ascension, declination, twist (degrees) of a rotation."""
    return np.array([np.arctan2(c[2, 1], c[2, 0]), np.arcsin(c[2, 2]), np.arctan2(c[0, 2], c[1, 2])]) * RHO


@dataclass
class Frame:
    """One image."""

    name: str
    serial: str
    position_km: Array
    angles_deg: Array
    body: Array
    focal_mm: float
    principal_mm: Array
    radial: Array
    decentring: Array
    centre: float

    def ideal(self, sample: float, line: float) -> Array:
        """Return the ideal coordinates (mm) of an ISIS pixel."""
        a = (sample - 0.5) * SCALE + 0.5 - self.centre
        b = (line - 0.5) * SCALE + 0.5 - self.centre
        x, y = np.array([-PITCH_MM * a, PITCH_MM * b]) - self.principal_mm
        r2 = x * x + y * y
        k1, k2, k3 = self.radial
        j1, j2, t0 = self.decentring
        dr, dt = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), r2 * (j1 + r2 * j2)
        return np.array([dr * x - dt * np.sin(t0), dr * y + dt * np.cos(t0)])


def read_frame(isd: Path) -> Frame:
    """Read an ISD and the start time of its label."""
    d = json.loads(isd.read_text())
    keys = d["naif_keywords"]
    own = next(k[: -len("_OD_K")] for k in keys if k.endswith("_OD_K"))
    label = isd.with_suffix(".pvl").read_text()
    start = re.search(r"^\s+StartTime\s+= (\S+)", label, re.MULTILINE)
    assert start is not None
    rotated = d["body_rotation"]
    body = np.array(rotated["constant_rotation"]).reshape(3, 3) @ rotation(np.array(rotated["quaternions"][0]))
    camera = rotation(np.array(d["instrument_pointing"]["quaternions"][0]))
    return Frame(
        re.search(r"M-(\d+)", isd.name)[1], f"APOLLO15/METRIC/{start[1]}",  # type: ignore[index]
        np.array(d["instrument_position"]["positions"][0]), angles_of(camera), body,
        -keys[f"{own}_FOCAL_LENGTH"], np.array(keys[f"{own}_PP"]), np.array(keys[f"{own}_OD_K"]),
        np.array(keys[f"{own}_DECENTER"]), SCALE * d["image_samples"] / 2,
    )  # fmt: skip


@dataclass
class Point:
    """One ground point: latitude, longitude (rad), radius (km), sigmas in these units, measures."""

    name: str
    constrained: bool
    start: Array
    sigma: Array
    measures: list[tuple[str, float, float]] = field(default_factory=list)


def spherical(xyz: Array) -> Array:
    """Return the latitude, longitude (rad), radius."""
    return np.array([np.arctan2(xyz[2], np.hypot(xyz[0], xyz[1])), np.arctan2(xyz[1], xyz[0]), np.linalg.norm(xyz)])


def cartesian(s: Array) -> Array:
    """Return the inverse of :func:`spherical`."""
    return s[2] * np.array([np.cos(s[0]) * np.cos(s[1]), np.cos(s[0]) * np.sin(s[1]), np.sin(s[0])])


def slope(s: Array) -> Array:
    """Return the derivatives (3, 3) of :func:`cartesian`."""
    b, l, r = s  # noqa: E741
    return np.array([
        [-r * np.sin(b) * np.cos(l), -r * np.cos(b) * np.sin(l), np.cos(b) * np.cos(l)],
        [-r * np.sin(b) * np.sin(l), r * np.cos(b) * np.cos(l), np.cos(b) * np.sin(l)],
        [r * np.cos(b), 0.0, np.sin(b)],
    ])  # fmt: skip


def read_network(path: Path) -> list[Point]:
    """Read the points of a control network in PVL."""
    out = []
    for body in re.findall(r"Object = ControlPoint\n(.*?)\n  End_Object", path.read_text(), re.DOTALL):
        head = re.sub(r"#.*", "", body.split("Group = ControlMeasure")[0])
        value = dict(re.findall(r"^\s*(\w+)\s*=\s*(\(.*?\)|\S+)", head, re.MULTILINE | re.DOTALL))
        xyz = np.array([float(value[f"Apriori{c}"]) for c in "XYZ"]) / 1e3
        constrained, sigma = value["PointType"] == "Constrained", np.full(3, np.nan)
        if constrained:
            a, b, c, d, e, f = (float(v) * 1e-6 for v in re.findall(r"[-\d.eE+]+", value["AprioriCovarianceMatrix"]))
            inverse = np.linalg.inv(slope(spherical(xyz)))
            own = inverse @ np.array([[a, b, c], [b, d, e], [c, e, f]]) @ inverse.T
            sigma = np.sqrt(np.diag(own))
        point = Point(value["PointId"], constrained, spherical(xyz), sigma)
        for group in re.findall(r"Group = ControlMeasure(.*?)End_Group", body, re.DOTALL):
            v = dict(re.findall(r"^\s*(\w+)\s*=\s*(\S+)", group, re.MULTILINE))
            point.measures.append((v["SerialNumber"], float(v["Sample"]), float(v["Line"])))
        out.append(point)
    return out


@dataclass
class Bundle:
    """Result: unknowns of images (m, 6) km, degrees; points (n, 3) rad, km; cofactors without sigma0^2."""

    frames: list[Frame]
    points: list[Point]
    image: Array
    place: Array
    image_cofactors: Array
    point_cofactors: Array
    sigma0: float
    redundancy: int
    iterations: int

    def image_sigmas(self) -> Array:
        """Return the standard deviations (m, 6) of km, degrees."""
        return self.sigma0 * np.sqrt(np.diag(self.image_cofactors)).reshape(-1, 6)

    def point_sigmas(self) -> Array:
        """Return the standard deviations (n, 3) of latitude, longitude, radius in m."""
        s = self.sigma0 * np.sqrt(np.einsum("nii->ni", self.point_cofactors))
        r = self.place[:, 2]
        return 1e3 * s * np.column_stack([r, r * np.cos(self.place[:, 0]), np.ones(len(s))])

    def residuals(self) -> dict[tuple[str, str], Array]:
        """Return computed minus measured ideal coordinates of all measures, by point and image.

        They are in pixels of the scan.
        """
        row, out = {f.serial: i for i, f in enumerate(self.frames)}, {}
        for j, p in enumerate(self.points):
            for serial, sample, line in p.measures:
                frame = self.frames[row[serial]]
                value = project(frame, self.image[row[serial]], self.place[j])[0] - frame.ideal(sample, line)
                out[p.name, frame.name] = value / PITCH_MM
        return out


class Network:
    """Frames and points, and their state during an adjustment; ``held`` names images."""

    def __init__(
        self, frames: list[Frame], points: list[Point], held: tuple[str, ...] = (), position_sigma_km: float = 1.0,
        angle_sigma_deg: float = 2.0,
    ) -> None:  # fmt: skip
        self.frames, self.points = frames, points
        self.row = {f.serial: i for i, f in enumerate(frames)}
        self.image = np.array([[*f.position_km, *f.angles_deg] for f in frames])
        self.place = np.array([p.start for p in points])
        self.first, self.fixed = self.image.copy(), np.array([f.name in held for f in frames])
        self.prior = np.array([position_sigma_km] * 3 + [angle_sigma_deg] * 3)
        self.weights: dict[tuple[str, str], float] = {}
        self.without: frozenset[tuple[str, str]] = frozenset()
        self.sigma0, self.redundancy = np.nan, 0

    def step(self) -> float:
        """Return one iteration with the points eliminated; the largest step in its standard deviation before it."""
        m, n = len(self.frames), len(self.points)
        normal, right, chi2, rays = np.diag(np.tile(1 / self.prior**2, m)), np.zeros(6 * m), 0.0, 0
        w = np.where(self.fixed[:, None], 0.0, (self.image - self.first) / self.prior)
        right -= (w / self.prior).ravel()
        chi2 += float(np.sum(w * w))
        across, own, own_right = np.zeros((n, 6 * m, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3))
        for j, p in enumerate(self.points):
            if p.constrained:
                v = (self.place[j] - p.start) / p.sigma
                own[j] += np.diag(1 / p.sigma**2)
                own_right[j] -= v / p.sigma
                chi2 += float(v @ v)
            for serial, sample, line in p.measures:
                i = self.row[serial]
                if (p.name, self.frames[i].name) in self.without:
                    continue
                value, a, b = project(self.frames[i], self.image[i], self.place[j])
                v, a, b = (value - self.frames[i].ideal(sample, line)) / SIGMA_MM, a / SIGMA_MM, b / SIGMA_MM
                root = np.sqrt(self.weights.get((p.name, self.frames[i].name), 1.0))
                v, a, b = root * v, root * np.where(self.fixed[i], 0.0, a), root * b
                at = slice(6 * i, 6 * i + 6)
                normal[at, at] += a.T @ a
                across[j, at] += a.T @ b
                own[j] += b.T @ b
                right[at] -= a.T @ v
                own_right[j] -= b.T @ v
                chi2, rays = chi2 + float(v @ v), rays + 1
        inverse = np.linalg.inv(own)
        side = across @ inverse
        reduced = normal - np.einsum("jab,jcb->ac", side, across)
        scale = 1 / np.sqrt(np.diag(reduced))
        self.image_cofactors = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        d_image = self.image_cofactors @ (right - np.einsum("jab,jb->a", side, own_right))
        d_place = np.einsum("jab,jb->ja", inverse, own_right) - np.einsum("jab,a->jb", side, d_image)
        self.point_cofactors = inverse + np.einsum("jab,ac,jcd->jbd", side, self.image_cofactors, side)
        free = 6 * int((~self.fixed).sum())
        self.redundancy = 2 * rays + free + 3 * sum(p.constrained for p in self.points) - free - 3 * n
        self.sigma0 = float(np.sqrt(chi2 / self.redundancy))
        sizes = (np.abs(d_image) / np.sqrt(np.diag(self.image_cofactors)),
                 np.abs(d_place) / np.sqrt(np.einsum("jaa->ja", self.point_cofactors)))  # fmt: skip
        self.image += d_image.reshape(m, 6)
        self.place += d_place
        return float(max(size.max() for size in sizes))

    def solved(self, iterations: int) -> Bundle:
        """Return the result after the last step."""
        return Bundle(self.frames, self.points, self.image.copy(), self.place.copy(), self.image_cofactors,
                      self.point_cofactors, self.sigma0, self.redundancy, iterations)  # fmt: skip


def adjust(frames: list[Frame], points: list[Point], *, held: tuple[str, ...] = (), limit: float = 1e-9) -> Bundle:
    """Adjust until the largest step is below ``limit`` standard deviations."""
    network = Network(frames, points, held)
    for iteration in range(30):
        if network.step() < limit:
            return network.solved(iteration)
    raise AssertionError("no convergence")


def project(frame: Frame, x: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return the ideal coordinates (mm) and their derivatives by the image (km, degrees) and the point (rad, km)."""
    ra, dec, twist = x[3:] / RHO
    a, b, c = r3(twist), r1(np.pi / 2 - dec), r3(np.pi / 2 + ra)
    turn = a @ b @ c
    d = frame.body.T @ cartesian(s) - x[:3]
    q = turn @ d
    f = frame.focal_mm
    by_q = f / q[2] * np.array([[1.0, 0.0, -q[0] / q[2]], [0.0, 1.0, -q[1] / q[2]]])
    e3, e1 = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]]), np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]])
    by_angles = np.column_stack([a @ b @ e3 @ c @ d, -(a @ e1 @ b @ c @ d), e3 @ turn @ d]) / RHO
    by_image = by_q @ np.hstack([-turn, by_angles])
    return f * q[:2] / q[2], by_image, by_q @ turn @ frame.body.T @ slope(s)


def flagged(solved: Bundle, out: frozenset[tuple[str, str]], multiplier: float = 3.0) -> frozenset[tuple[str, str]]:
    """Return the measures that the rule of jigsaw rejects after a state with the rejected measures ``out``."""
    every = {key: float(np.linalg.norm(v)) for key, v in solved.residuals().items()}
    accepted = np.array([size for key, size in every.items() if key not in out])
    median = np.median(accepted)
    limit = median + multiplier * 1.4826 * np.median(np.abs(accepted - median))
    new = {key for key in out if every[key] > limit}
    for p in solved.points:
        keys = [(p.name, f.name) for f in solved.frames if (p.name, f.name) in every]
        above = [key for key in keys if key not in new and every[key] > limit]
        if above and len(keys) - sum(key in new for key in keys) > 2:
            new.add(max(above, key=every.__getitem__))
    return frozenset(new)


def rejected(network: Network) -> frozenset[tuple[str, str]]:
    """Return the measures that are rejected when sigma0 and the set come to rest.

    The rule is applied after each iteration.
    """
    before = np.inf
    for _ in range(50):
        network.step()
        if abs(network.sigma0 - before) <= 1e-10:
            return network.without
        before, network.without = network.sigma0, flagged(network.solved(0), network.without)
    raise AssertionError("the rule does not come to rest")
