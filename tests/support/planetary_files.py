"""The module writes a small block of frames above the Moon: ISD, labels, control network, project."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tests.support import jigsaw_twin as twin

Array = npt.NDArray[Any]
RADIUS_KM = 1737.4
SIZE = 2000


def isd(k: int, position_km: Array, camera: Array, body: Array) -> dict[str, Any]:
    """Return the ISD of a metric camera; the rotations lead to the camera and to the body from inertial axes."""

    def quaternion(turn: Array) -> list[float]:
        return np.roll(Rotation.from_matrix(turn).as_quat(), 1).tolist()  # type: ignore[no-any-return]

    time, own = [-1000.0 + 20.0 * k], "INS-915240"
    return {
        "name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL", "image_lines": SIZE, "image_samples": SIZE,
        "name_platform": "APOLLO 15", "name_sensor": "METRIC", "center_ephemeris_time": time[0],
        "radii": {"semimajor": RADIUS_KM, "semiminor": RADIUS_KM, "unit": "km"},
        "body_rotation": {"ephemeris_times": time, "quaternions": [quaternion(body)], "reference_frame": 1,
                          "constant_rotation": np.eye(3).ravel().tolist()},
        "instrument_pointing": {"ephemeris_times": time, "quaternions": [quaternion(camera)], "reference_frame": 1,
                                "constant_rotation": np.eye(3).ravel().tolist()},
        "instrument_position": {"ephemeris_times": time, "positions": [position_km.tolist()],
                                "velocities": [[1.4, -0.8, -0.2]], "reference_frame": 1},
        "naif_keywords": {"BODY301_RADII": [RADIUS_KM] * 3, f"{own}_FOCAL_LENGTH": 76.054,
                          f"{own}_PP": [-0.006, -0.002], f"{own}_OD_K": [-1.3361854e-06, 5.2261757e-10, -5.0728336e-14],
                          f"{own}_DECENTER": [-5.4958195e-07, -4.608942e-11, 2.965907]},
        "detector_sample_summing": 1, "detector_line_summing": 1, "focal_length_model": {"focal_length": 76.054},
        "detector_center": {"line": None, "sample": None}, "starting_detector_line": 0, "starting_detector_sample": 0,
        "focal2pixel_lines": [0.0, 0.0, 200.0], "focal2pixel_samples": [0.0, -200.0, 0.0],
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
    }  # fmt: skip


def label(k: int) -> str:
    """Return the label of an image: serial number, and a reduction by four."""
    return f"""Object = IsisCube
  Group = Instrument
    SpacecraftName = "APOLLO 15"
    InstrumentId   = METRIC
    StartTime      = 1971-07-31T14:00:{k:02d}.000
  End_Group
  Group = Kernels
    InstrumentPointing = (Table, $apollo15/kernels/ck/a_long_na-
                          me.bc)
  End_Group
  Group = AlphaCube
    AlphaSamples        = {4 * SIZE}
    AlphaLines          = {4 * SIZE}
    AlphaStartingSample = 0.5
    AlphaStartingLine   = 0.5
    AlphaEndingSample   = {4 * SIZE + 0.5}
    AlphaEndingLine     = {4 * SIZE + 0.5}
    BetaSamples         = {SIZE}
    BetaLines           = {SIZE}
  End_Group
End_Object
End
"""


def network(points: Sequence[dict[str, Any]]) -> str:
    """Return a control network as text.

    Points have ``name``, ``xyz`` m, ``kind``, ``sigma`` (lat, lon, radius) m and ``measures``.
    """
    out = ["Object = ControlNetwork", "  NetworkId = Test", "  TargetName = Moon", "  Version = 5"]
    for p in points:
        out += ["  Object = ControlPoint", f"    PointType = {p['kind']}", f"    PointId = {p['name']}"]
        out += [
            f"    # Apriori{n} = {v} <meters>\n    Apriori{n} = {v!r} <meters>"
            for n, v in zip("XYZ", p["xyz"], strict=True)
        ]
        if p["kind"] == "Constrained":
            own = twin.spherical(np.array(p["xyz"]))
            c = twin.slope(own) / np.array([own[2], own[2] * np.cos(own[0]), 1.0])
            v = c @ np.diag(np.array(p["sigma"]) ** 2) @ c.T
            numbers = ", ".join(repr(float(v[i, j])) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
            out.append(f"    AprioriCovarianceMatrix = ({numbers})")
        for serial, sample, line in p["measures"]:
            out += [f"    Group = ControlMeasure\n      SerialNumber = {serial}\n      MeasureType = RegisteredPixel",
                    f"      Sample = {sample!r}\n      Line = {line!r}\n    End_Group"]  # fmt: skip
        out.append("  End_Object")
    return "\n".join([*out, "End_Object", "End", ""])


def project(images: Sequence[str], *, held: Sequence[str] = (), latitudinal: bool = True, more: str = "") -> str:
    """Return the project file with the settings of jigsaw; pixels of the image are four pixels of the scan."""
    parts = ['schema = 1\nname = "moon"\nbody = "Moon"']
    for name in images:
        parts.append(f'[[images]]\nid = "{name}"\nmetadata = "{name}.isd"\nheld = {str(name in held).lower()}')
    table = 'file = "net.pvl"\nformat = "isis-network"\n'
    parts += [
        f"[points]\n{table}latitudinal = {str(latitudinal).lower()}", f"[observations]\n{table}sigma_px = [0.35, 0.35]",
        "[orientation]\nposition_sigma_m = [1000.0, 1.0, 1.0]",
        "attitude_sigma_rad = [0.034906585039886591, 1e-5, 1e-6]", more,
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def write_block(folder: Path, *, seed: int = 1, n_images: int = 3, n_points: int = 40, gross: int = 0) -> list[str]:
    """Write all files of a block with random errors of position, angles, points and measures; the ids of the images.

    ``gross``: so many measures have an error of some ten pixels.
    """
    rng = np.random.default_rng(seed)
    body = Rotation.random(random_state=seed).as_matrix()
    names, frames, truth = [f"M-{k:04d}" for k in range(n_images)], [], []
    for k, name in enumerate(names):
        lon, lat = 0.1 + 0.008 * k, 0.4 + 0.002 * k
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        position = body.T @ (up * (RADIUS_KM + 105.0))
        east = np.cross([0.0, 0.0, 1.0], up) / np.cos(lat)
        turn = Rotation.from_rotvec(rng.normal(scale=0.05, size=3)).as_matrix()
        camera = turn @ np.stack([east, np.cross(up, east), up]) @ body  # it looks along -Z
        given = Rotation.from_rotvec(rng.normal(scale=0.003, size=3)).as_matrix() @ camera
        (folder / f"{name}.isd").write_text(json.dumps(isd(k, position + rng.normal(scale=0.3, size=3), given, body)))
        (folder / f"{name}.pvl").write_text(label(k))
        frames.append(twin.read_frame(folder / f"{name}.isd"))
        truth.append(np.array([*position, *twin.angles_of(camera)]))
    points, rays = [], []
    while len(points) < n_points:
        place = np.array([0.4 + rng.uniform(-0.015, 0.02), 0.1 + rng.uniform(-0.015, 0.01 * n_images), RADIUS_KM])
        place[2] += rng.normal(scale=1.0)
        seen = [(f.serial, *_pixel(f, x, place)) for f, x in zip(frames, truth, strict=True)]
        measures = [[s, a + rng.normal(scale=0.35), b + rng.normal(scale=0.35)] for s, a, b in seen
                    if 1.0 < a < SIZE and 1.0 < b < SIZE]  # fmt: skip
        if len(measures) < 2:
            continue
        kind, sigma = ("Constrained", [300.0, 250.0, 500.0]) if len(points) % 4 == 0 else ("Free", [np.nan] * 3)
        noise = rng.normal(size=3) * (0.3 if kind == "Constrained" else 1.0)
        xyz = (1e3 * (twin.cartesian(place) + noise)).tolist()
        points.append({"name": f"P{len(points)}", "xyz": xyz, "kind": kind, "sigma": sigma, "measures": measures})
        rays += measures
    for k in rng.permutation(len(rays))[:gross]:
        rays[k][1] += 20.0
    (folder / "net.pvl").write_text(network(points))
    (folder / "project.toml").write_text(project(names))
    return names


def _pixel(frame: twin.Frame, x: Array, place: Array) -> tuple[float, float]:
    """Return the sample and line of ISIS whose ideal coordinates are those of a point."""
    wanted, pixel = twin.project(frame, x, place)[0], np.array([SIZE / 2.0, SIZE / 2.0])
    for _ in range(20):
        here = frame.ideal(*pixel)
        slopes = np.column_stack([frame.ideal(*(pixel + e)) - here for e in np.eye(2)])
        pixel = pixel + np.linalg.solve(slopes, wanted - here)
    return float(pixel[0]), float(pixel[1])
