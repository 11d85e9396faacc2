"""The module makes a small valid project folder, which a test may change, and a substitute sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

PROJECT = """\
schema = 1
name = "small"

[[images]]
id = "left"
metadata = "left.DIM"

[[images]]
id = "right"
metadata = "right.DIM"

[points]
file = "points.csv"
crs = "EPSG:4979"

[observations]
file = "observations.csv"

[orientation]
eop_set = 15

[adjustment]
max_iterations = 50
"""

POINTS = """\
# measured values
id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m
01,control,31.60,41.20,12.5,0.06,0.06,1.0
1,control,32.05,41.22,250.0,0.06,0.07,1.0
c3,control,31.62,41.45,830.0,fixed,fixed,fixed
c4,control,32.00,41.44,1500.0,0.06,0.06,1.0
k1,check,31.80,41.30,640.0,0.10,0.10,0.5
k2,check,31.85,41.35,700.0,0.10,0.10,0.5
t1,tie,,,,,,
"""

_PIXELS = {
    "01": (1000, 1200), "1": (9000.5, 900), "c3": (1100, 10800), "c4": (9200, 11000.25),
    "k1": (5000, 5200), "k2": (6000, 6300), "t1": (7000, 2100),
}  # fmt: skip

OBSERVATIONS = "image,id,line,sample,sigma_line_px,sigma_sample_px\n" + "".join(
    f"{image},{name},{line},{sample},0.3,0.3\n"
    for image in ("left", "right")
    for name, (line, sample) in _PIXELS.items()
)


@dataclass
class StandInSensor:
    """The substitute has what reading a project requires of a sensor: its size and where it looks."""

    n_lines: int = 12000
    n_samples: int = 12000
    orients: bool = False
    body: None = None
    serial: str = ""
    notes: tuple[str, ...] = ()
    corners: np.ndarray = field(
        default_factory=lambda: np.array([[31.5, 41.5], [32.2, 41.5], [32.2, 41.0], [31.5, 41.0]])
    )

    def footprint(self) -> np.ndarray:
        return self.corners


def install_stand_in(monkeypatch: pytest.MonkeyPatch, **size: int) -> None:
    """Replace the reader of metadata files by one that returns a stand-in sensor, of a size if it is given."""
    import fg_orient.formats.sensor

    monkeypatch.setattr(fg_orient.formats.sensor, "read_sensor", lambda path, **options: StandInSensor(**size))


class ProjectFolder:
    """Writes the files and lets a test change a piece of text in one of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.project = folder / "project.toml"
        self.points = folder / "points.csv"
        self.observations = folder / "observations.csv"
        self.project.write_text(PROJECT, encoding="utf-8")
        self.points.write_text(POINTS, encoding="utf-8")
        self.observations.write_text(OBSERVATIONS, encoding="utf-8")
        for name in ("left.DIM", "right.DIM"):
            (folder / name).write_text("stand-in", encoding="utf-8")

    def change(self, file: str, old: str, new: str) -> None:
        """Replace a piece of text that must be there, once."""
        path = self.folder / file
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {file}"
        path.write_text(text.replace(old, new), encoding="utf-8")
