"""The module makes lattices of an invented pushbroom and evaluates them with numpy and scipy alone."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.interpolate import CubicSpline

from tests.support.changed_text import changed
from tests.support.isd_files import states

LINES, SAMPLES, PERIOD_S = 4200, 4100, 2.2e-3
ROWS, COLUMNS = np.arange(-400.0, 4801.0, 400.0), np.arange(0.0, 4101.0, 410.0)


def looks(sample: np.ndarray) -> np.ndarray:
    """Return the directions (n, 3) in the spacecraft of the invented camera: cubic distortion, 22 urad a pixel."""
    s = sample - 2000.0
    k = np.stack([1e-3 + 1e-10 * s**2, 2.2e-5 * s * (1.0 + 1e-9 * s**2), np.ones(len(s))], axis=1)
    return k / np.linalg.norm(k, axis=1, keepdims=True)


def exact(line: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (n, 3) m and directions (n, 3) of pixels, Earth-fixed."""
    p, _, turn = states(PERIOD_S * line)
    return p, turn.apply(looks(sample))


def lattice() -> tuple[np.ndarray, np.ndarray]:
    """Return the records (r c, 5) of line, sample and direction, and (r, 4) of line and position."""
    line, sample = (a.ravel() for a in np.meshgrid(ROWS, COLUMNS, indexing="ij"))
    _, direction = exact(line, sample)
    return np.column_stack([line, sample, direction]), np.column_stack([ROWS, exact(ROWS, 0.0 * ROWS)[0]])


def _rows(values: np.ndarray, separator: str) -> str:
    return "\n".join(separator.join(f"{x:.17g}" for x in row) for row in values)


def write_description(folder: Path, *changes: tuple[str, str, str]) -> Path:
    """Write a description with its tables; each change is a file, an old and a new text."""
    cells, rows = lattice()
    texts = {
        "directions.csv": "line,sample,x,y,z\n" + _rows(cells, ",") + "\n",
        "positions.csv": "line,x_m,y_m,z_m\n" + _rows(rows, ",") + "\n",
        "lattice.toml": f"""schema = 1
kind = "lattice"
mission = "EXAMPLE 2"
[image]
lines = {LINES}
samples = {SAMPLES}
[lattice]
directions = "directions.csv"
positions = "positions.csv"
line_period_s = {PERIOD_S}
""",
    }
    for name, old, new in changes:
        texts[name] = changed(texts[name], (old, new))
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "lattice.toml"


def write_aster(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the same lattice as an ASTER file of the Ames Stereo Pipeline."""
    cells, rows = lattice()
    text = f"""<isd>
<LATTICE_POINT>
{_rows(cells[:, [1, 0]], " ")}
</LATTICE_POINT>
<WORLD_SIGHT_VECTOR>
{_rows(cells[:, 2:], " ")}
</WORLD_SIGHT_VECTOR>
<SAT_POS>
{_rows(rows[:, 1:], " ")}
</SAT_POS>
<IMAGE_COLS>{SAMPLES}</IMAGE_COLS>
<IMAGE_ROWS>{LINES}</IMAGE_ROWS>
</isd>
"""
    path = folder / "band.xml"
    path.write_text(changed(text, *changes), encoding="utf-8")
    return path


class LatticeCamera:
    """Lines of sight of an ASTER file by cubic splines of each component, along lines and along samples."""

    def __init__(self, path: Path) -> None:
        root = ElementTree.parse(path).getroot()
        pixels = np.array(root.findtext("LATTICE_POINT").split(), float).reshape(-1, 2)
        self.rows, self.columns = np.unique(pixels[:, 1]), np.unique(pixels[:, 0])
        shape = len(self.rows), len(self.columns), 3
        self.directions = np.array(root.findtext("WORLD_SIGHT_VECTOR").split(), float).reshape(shape)
        self.positions = np.array(root.findtext("SAT_POS").split(), float).reshape(-1, 3)

    def rays(self, line: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions (n, 3) m and unit directions (n, 3)."""
        along = CubicSpline(self.rows, self.directions)(line)
        u = np.array([CubicSpline(self.columns, one)(s) for one, s in zip(along, sample, strict=True)])
        return CubicSpline(self.rows, self.positions)(line), u / np.linalg.norm(u, axis=1, keepdims=True)
