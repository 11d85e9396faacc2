"""Sensor descriptions of the twin's images are written from their DIMAP 1 metadata in each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.geometry import orbital, rotations
from fg_orient.sensors.earth_rotation import EarthRotation
from fg_orient.sensors.metadata import AngleAttitude, PushbroomMetadata
from fg_orient.sensors.pushbroom import PushbroomSensor
from tests.support.rugged_replay import quaternion_of


def write_table(path: Path, columns: str, values: np.ndarray) -> None:
    rows = [",".join(f"{v:.17g}" for v in row) for row in values]
    path.write_text("\n".join([columns, *rows]) + "\n", encoding="utf-8")


def angles_a(angles_rad: np.ndarray) -> np.ndarray:
    """Return the roll, pitch, yaw of convention A of those of convention B."""
    b = rotations.attitude_matrices(np.ascontiguousarray(angles_rad), False)
    m = orbital.B_FROM_A.T @ b @ orbital.B_FROM_A
    return np.stack(
        [np.arctan2(-m[:, 1, 2], m[:, 2, 2]), np.arcsin(m[:, 0, 2]), np.arctan2(-m[:, 0, 1], m[:, 0, 0])], 1
    )


def describe(sensor: PushbroomSensor, folder: Path, *, orbit: str = "ITRF", attitude: str = "orbital", extra: str = "",
             c04: str = "") -> Path:  # fmt: skip
    """Write description and tables; inertial frames by the Earth's rotation without a C04 file."""
    folder.mkdir(parents=True, exist_ok=True)
    meta: PushbroomMetadata = sensor.metadata
    e, a, t = meta.ephemeris, meta.attitude, meta.timing
    assert isinstance(a, AngleAttitude)
    p, v = e.position_m, e.velocity_m_s
    if orbit != "ITRF":
        earth = EarthRotation(meta.epoch, (e.time_s[0], e.time_s[-1]), orbit)  # type: ignore[arg-type]
        back = np.swapaxes(earth.matrices(e.time_s), 1, 2)
        v = v + np.cross([0.0, 0.0, earth.rate_rad_s(0.0)], p)
        p, v = np.einsum("nij,nj->ni", back, p), np.einsum("nij,nj->ni", back, v)
    write_table(folder / "orbit.csv", "time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s", np.column_stack([e.time_s, p, v]))
    if attitude == "orbital":
        write_table(folder / "attitude.csv", "time_s,roll_deg,pitch_deg,yaw_deg",
                    np.column_stack([a.time_s, np.degrees(angles_a(a.angles_rad))]))  # fmt: skip
    else:
        lines = np.linspace(-0.5, sensor.n_lines - 0.5, 801)
        times = t.reference_time_s + t.line_period_s * (lines - t.reference_line)
        s = sensor.states(lines)
        m = rotations.orbital_frames(s.position_m, s.velocity_m_s)
        m = m @ rotations.attitude_matrices(s.angles_rad, False) @ orbital.B_FROM_A
        if attitude != "ITRF":
            m = np.swapaxes(EarthRotation(meta.epoch, (times[0], times[-1]), attitude).matrices(times), 1, 2) @ m  # type: ignore[arg-type]
        write_table(folder / "attitude.csv", "time_s,q0,q1,q2,q3",
                    np.column_stack([times, [quaternion_of(one) for one in m]]))  # fmt: skip
    sample = np.arange(sensor.n_samples, dtype=float)
    psi_x, psi_y = sensor.look_angles(sample)
    write_table(folder / "directions.csv", "sample,tan_forward,tan_left",
                np.column_stack([sample, np.tan(psi_x), np.tan(psi_y)]))  # fmt: skip
    path = folder / "sensor.toml"
    path.write_text(f"""
schema = 1
kind = "pushbroom"
mission = "{meta.mission}"
[image]
lines = {sensor.n_lines}
samples = {sensor.n_samples}
[time]
day = "{meta.epoch}"
reference_line = {float(t.reference_line)!r}
reference_time_s = {float(t.reference_time_s)!r}
line_period_s = {float(t.line_period_s)!r}
[camera]
directions = "directions.csv"
[orbit]
frame = "{orbit}"
file = "orbit.csv"
[attitude]
frame = "{attitude}"
file = "attitude.csv"
{f'[earth]{chr(10)}orientation = "{c04}"' if c04 else ""}
{extra}
""", encoding="utf-8")  # fmt: skip
    return path
