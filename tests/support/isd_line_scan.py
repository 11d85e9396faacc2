"""A second evaluator of DigitalGlobe ISD files and their RPC uses numpy and scipy alone.

Positions are cubic Hermite polynomials of positions and velocities, attitudes are slerp. Pixels are (line, sample) with
(0, 0) = centre of the first pixel. Nothing of the package is imported.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

C_M_S, EARTH_RATE = 299_792_458.0, 7.2921151467e-5
A, B = 6_378_137.0, 6_356_752.314245179
E2 = 1.0 - (B / A) ** 2


def instant(text: str) -> float:
    """Return the seconds of a UTC time since 1970."""
    return (datetime.fromisoformat(text.replace("Z", "")) - datetime(1970, 1, 1)).total_seconds()


class IsdCamera:
    """Line-scan camera of an ISD file."""

    def __init__(self, path: Path) -> None:
        root = ElementTree.parse(path).getroot()
        self.shape = tuple(int(root.findtext(f"IMD/{name}")) for name in ("NUMROWS", "NUMCOLUMNS"))
        self.start = instant(root.findtext("EPH/STARTTIME"))
        states = np.array([e.text.split() for e in root.iter("EPHEMLIST")], float)
        t = float(root.findtext("EPH/TIMEINTERVAL")) * np.arange(len(states))
        self.orbit = CubicHermiteSpline(t, states[:, 1:4], states[:, 4:7])
        turns = np.array([e.text.split() for e in root.iter("ATTLIST")], float)[:, 1:5]
        t = float(root.findtext("ATT/TIMEINTERVAL")) * np.arange(len(turns))
        t += instant(root.findtext("ATT/STARTTIME")) - self.start
        self.attitude = Slerp(t, Rotation.from_quat(turns))
        image = root.find("IMD/IMAGE")
        lines, seconds = np.array([e.text.split() for e in image.iter("TLCLIST")], float).T
        self.lines, self.times = lines, instant(image.findtext("TLCTIME")) - self.start + seconds
        geo = root.find("GEO")
        array = geo.find("DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY")
        self.origin = np.array([float(array.findtext(f"DETORIGIN{axis}")) for axis in "XY"])
        self.pitch = float(array.findtext("DETPITCH"))
        self.angle = np.radians(float(array.findtext("DETROTANGLE")))
        self.distance = float(geo.findtext("PRINCIPAL_DISTANCE/PD"))
        self.mounting = Rotation.from_quat([float(geo.findtext(f"CAMERA_ATTITUDE/QCS{k}")) for k in (1, 2, 3, 4)])
        self.centre = np.array([float(geo.findtext(f"PERSPECTIVE_CENTER/C{axis}")) for axis in "XYZ"])
        rpb = root.find("RPB/IMAGE")
        if rpb is None:
            return
        self.rpc = {name: np.array(rpb.findtext(f"{name}List/{name}").split(), float)
                    for name in ("LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF")}  # fmt: skip
        self.scale = {name: (float(rpb.findtext(f"{name}OFFSET")), float(rpb.findtext(f"{name}SCALE")))
                      for name in ("LINE", "SAMP", "LAT", "LONG", "HEIGHT")}  # fmt: skip

    def rays(self, line: np.ndarray, sample: np.ndarray, aberration: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions (n, 3) m and unit directions (n, 3), Earth-fixed."""
        k = np.clip(np.searchsorted(self.lines, line, side="right") - 1, 0, len(self.lines) - 2)
        rate = (self.times[k + 1] - self.times[k]) / (self.lines[k + 1] - self.lines[k])
        t = self.times[k] + rate * (line - self.lines[k])
        x = self.origin[0] + self.pitch * sample * np.sin(self.angle)
        y = self.origin[1] - self.pitch * sample * np.cos(self.angle)
        turn = self.attitude(t)
        u = turn.apply(self.mounting.apply(np.stack([x, y, np.full(len(x), self.distance)], axis=1)))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        p = self.orbit(t) + turn.apply(np.tile(self.centre, (len(t), 1)))
        if aberration:
            v = self.orbit(t, 1) + np.cross([0.0, 0.0, EARTH_RATE], p)
            u = u - (v - np.sum(u * v, axis=1, keepdims=True) * u) / C_M_S  # first order in v/c
            u /= np.linalg.norm(u, axis=1, keepdims=True)
        return p, u

    def to_ground(self, line: np.ndarray, sample: np.ndarray, height_m: float, aberration: bool) -> np.ndarray:
        """Return the ground points (n, 3) m at an ellipsoidal height."""
        p, u = self.rays(line, sample, aberration)
        h = np.full(len(p), height_m)
        for _ in range(6):  # the ellipsoid of raised axes is not the surface of equal height: correct its height
            axes = np.stack([A + h, A + h, B + h], axis=1)
            a, b = np.sum((u / axes) ** 2, axis=1), np.sum(u / axes * (p / axes), axis=1)
            c = np.sum((p / axes) ** 2, axis=1) - 1.0
            ground = p + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * u
            h = h + height_m - geodetic(ground)[2]
        return ground

    def rpc_pixels(self, ground: np.ndarray) -> np.ndarray:
        """Return the lines and samples (n, 2) of the RPC."""
        lon, lat, height = geodetic(ground)
        given = {"LAT": np.degrees(lat), "LONG": np.degrees(lon), "HEIGHT": height}
        P, L, H = ((v - self.scale[name][0]) / self.scale[name][1] for name, v in given.items())
        terms = np.array([
            np.ones(len(L)), L, P, H, L * P, L * H, P * H, L * L, P * P, H * H, P * L * H, L**3, L * P * P, L * H * H,
            L * L * P, P**3, P * H * H, L * L * H, P * P * H, H**3,
        ])  # fmt: skip
        return np.stack([
            self.rpc[f"{name}NUMCOEF"] @ terms / (self.rpc[f"{name}DENCOEF"] @ terms) * self.scale[name][1]
            + self.scale[name][0] for name in ("LINE", "SAMP")
        ], axis=1)  # fmt: skip


def geodetic(ground: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the longitude, latitude (rad) and ellipsoidal height (m), by iteration."""
    x, y, z = ground.T
    r = np.hypot(x, y)
    lat = np.arctan2(z, r * (1.0 - E2))
    for _ in range(8):
        n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + E2 * n * np.sin(lat), r)
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return np.arctan2(y, x), lat, r * np.cos(lat) + z * np.sin(lat) - n * (1.0 - E2 * np.sin(lat) ** 2)
