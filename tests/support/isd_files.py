"""The module writes DigitalGlobe ISD files of an invented satellite on a circle with a constant rate."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.changed_text import changed

STEP_S, N_STATES = 0.02, 160
LINES, SAMPLES = 20_000, 12_000
EARTH_RATE = 7.2921151467e-5
#: Pairs of line and seconds: the rate changes at line 8000.
TLC = ((0.0, 0.0), (8000.0, 0.4), (20_000.0, 1.18))
RADIUS_M, RATE_RAD_S = 6_378_137.0 + 617_000.0, 1.085e-3


def orbit(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Earth-fixed positions and velocities (n, 3) at times about 0."""
    angle = 0.7 + RATE_RAD_S * time_s
    plane = Rotation.from_euler("zx", [1.2, 1.7]).as_matrix()
    turn = np.array([Rotation.from_euler("z", -EARTH_RATE * t).as_matrix() for t in time_s])
    p = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) * RADIUS_M @ plane.T
    v = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1) * RADIUS_M * RATE_RAD_S @ plane.T
    p, v = np.einsum("nij,nj->ni", turn, p), np.einsum("nij,nj->ni", turn, v)
    return p, v - np.cross([0.0, 0.0, EARTH_RATE], p)


def states(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Return the orbit, and the rotations from spacecraft to Earth-fixed axes.

    The spacecraft looks near the ground point at time -1, and turns at a constant rate.
    """
    p, v = orbit(np.array([-1.0]))
    z, x = -p[0] / np.linalg.norm(p[0]), v[0] / np.linalg.norm(v[0])
    y = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
    start = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=1)) * Rotation.from_euler("xy", [0.2, -0.15])
    return *orbit(time_s), Rotation.from_rotvec(np.outer(time_s, [3e-4, -1.2e-3, 2e-4])) * start


@functools.cache
def isd_text() -> str:
    """Return a file whose camera is turned and shifted in the spacecraft, with an inclined detector line."""
    t = STEP_S * np.arange(N_STATES)
    p, v, turn = states(t - 1.0)
    numbers = [" ".join(f"{x:.17g}" for x in row) for row in np.hstack([p, v])]
    orbit = "\n".join(f"<EPHEMLIST>{k} {row} 1 0 0 1 0 1</EPHEMLIST>" for k, row in enumerate(numbers, 1))
    numbers = [" ".join(f"{x:.17g}" for x in row) for row in turn.as_quat()]
    zeros = " 0" * 10
    attitude = "\n".join(f"<ATTLIST>{k} {row}{zeros}</ATTLIST>" for k, row in enumerate(numbers, 1))
    camera = Rotation.from_euler("xyz", [2e-3, -1e-3, 3e-3]).as_quat()
    mounted = "".join(f"<QCS{k}>{x:.17g}</QCS{k}>" for k, x in enumerate(camera, 1))
    pairs = "\n".join(f"<TLCLIST>{line} {seconds}</TLCLIST>" for line, seconds in TLC)
    start = f"""<STARTTIME>2022-04-17T22:51:36.500000Z</STARTTIME>
<NUMPOINTS>{N_STATES}</NUMPOINTS>
<TIMEINTERVAL>{STEP_S}</TIMEINTERVAL>"""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<isd>
<IMD><BANDID>P</BANDID><NUMROWS>{LINES}</NUMROWS><NUMCOLUMNS>{SAMPLES}</NUMCOLUMNS>
<PRODUCTLEVEL>Stereo 1B</PRODUCTLEVEL>
<IMAGE><SATID>WV09</SATID>
<TLCTIME>2022-04-17T22:51:37.000000Z</TLCTIME>
<TLCLISTList>
{pairs}
</TLCLISTList>
<AVGLINERATE>18000</AVGLINERATE></IMAGE></IMD>
<EPH>
{start}
<EPHEMLISTList>
{orbit}
</EPHEMLISTList></EPH>
<ATT>
{start}
<ATTLISTList>
{attitude}
</ATTLISTList></ATT>
<GEO>
<PRINCIPAL_DISTANCE><PD>16000</PD></PRINCIPAL_DISTANCE>
<OPTICAL_DISTORTION><POLYORDER>-1</POLYORDER></OPTICAL_DISTORTION>
<PERSPECTIVE_CENTER><CX>1.5</CX><CY>-0.4</CY><CZ>0.8</CZ></PERSPECTIVE_CENTER>
<CAMERA_ATTITUDE>{mounted}</CAMERA_ATTITUDE>
<DETECTOR_MOUNTING><BAND_P><DETECTOR_ARRAY>
<DETORIGINX>12.5</DETORIGINX><DETORIGINY>48</DETORIGINY><DETROTANGLE>0.5</DETROTANGLE><DETPITCH>0.008</DETPITCH>
</DETECTOR_ARRAY></BAND_P></DETECTOR_MOUNTING>
</GEO>
</isd>
"""


def write_isd(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write a file with changes of its text."""
    path = folder / "scene.XML"
    path.write_text(changed(isd_text(), *changes), encoding="utf-8")
    return path
