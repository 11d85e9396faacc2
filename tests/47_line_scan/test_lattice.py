"""Lattices of lines of sight are compared with the exact directions and with independent code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.quality.accuracy import y_parallaxes
from fg_orient.sensors.general import GeneralPushbroom
from tests.support.lattice_files import LINES, SAMPLES, LatticeCamera, exact, write_aster, write_description

BANDS = ("out-Band3N.xml", "out-Band3B.xml")


def inside(n_lines: int, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels between the points of the lattice, to the border."""
    sides = np.linspace(-0.5, n_lines - 0.5, 12), np.linspace(0.0, n_samples - 1.0, 14)
    line, sample = np.meshgrid(*sides, indexing="ij")
    return line.ravel(), sample.ravel()


def along(p: np.ndarray, u: np.ndarray, distance_m: float = 7e5) -> np.ndarray:
    """Return the points on rays (n, 3), near the ground."""
    return p + distance_m * u


@pytest.mark.oracle
@pytest.mark.parametrize("write", [write_description, write_aster])
def test_invented_pushbroom(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    """A lattice of lines of sight gives the exact pixels within 1e-4 px, and a note states the fit of one camera.

    The splines have columns 410 samples apart; the cubic distortion is exact, its normalisation is not.
    """
    sensor = read_sensor(write(tmp_path))
    assert isinstance(sensor, GeneralPushbroom) and (sensor.n_lines, sensor.n_samples) == (LINES, SAMPLES)
    line, sample = inside(LINES, SAMPLES)
    got = np.stack(sensor.project(along(*exact(line, sample))), axis=1)
    assert np.abs(got - np.stack([line, sample], axis=1)).max() < 1e-4
    assert any("one camera to 0.0000 px" in str(note) for note in sensor.notes)


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize("name", BANDS)
def test_aster_equals_independent_code(real_data: Path, name: str) -> None:
    """The ASTER model agrees with independent code within 0.01 px.

    The directions of the file have six digits, 0.05 px, and one camera fits them to 0.005 px.
    """
    path = real_data / "aster" / name
    sensor = read_sensor(path)
    line, sample = inside(sensor.n_lines, sensor.n_samples)
    got = np.stack(sensor.project(along(*LatticeCamera(path).rays(line, sample))), axis=1)
    assert np.abs(got - np.stack([line, sample], axis=1)).max() < 0.01


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize(("name", "sd_px", "most_px"), [(BANDS[0], (1.5, 1.3), 3.2), (BANDS[1], (0.8, 2.0), 5.2)])
def test_aster_against_the_rpc_of_the_file(
    real_data: Path, name: str, sd_px: tuple[float, float], most_px: float
) -> None:
    """The ASTER model fits the RPC as independent code does: mean below 0.2 px, border below 3.2 or 5.2 px."""
    path = real_data / "aster" / name
    sensor, rpc = read_sensor(path), read_sensor(path, model="rpc")
    line, sample = (a.ravel() for a in np.meshgrid(
        np.linspace(0.0, sensor.n_lines - 1.0, 15), np.linspace(0.0, sensor.n_samples - 1.0, 15), indexing="ij"
    ))  # fmt: skip
    pixel, p_u = np.stack([line, sample], axis=1), LatticeCamera(path).rays(line, sample)
    for height_m in (0.0, 2000.0):
        ground = sensor.locate(line, sample, height_m=height_m)
        apart = np.stack(rpc.project(ground), axis=1) - pixel
        assert np.abs(apart.mean(axis=0)).max() < 0.2 and np.abs(apart).max() < most_px
        assert apart.std(axis=0) == pytest.approx(sd_px, abs=0.1)
        distance = np.linalg.norm(ground - p_u[0], axis=1)[:, None]
        other = np.stack(rpc.project(p_u[0] + distance * p_u[1]), axis=1) - pixel
        for figure in (np.mean, np.std, np.max):
            assert np.abs(figure(other, axis=0) - figure(apart, axis=0)).max() < 0.01


@pytest.mark.truth
@pytest.mark.real_data
def test_aster_pair_is_adjusted(real_data: Path, tmp_path: Path) -> None:
    """The adjustment reduces the median y-parallax of the bands 3N and 3B from over 1.5 px to below 0.5 px.

    Another program found the matches.
    """
    folder = real_data / "aster"
    matches = np.loadtxt(folder / "run-out-Band3N__out-Band3B.csv", skiprows=1)
    rows = [f"{image},{k},{y},{x},0.4,0.4" for k, row in enumerate(matches) for image, x, y in (
        ("3N", row[0], row[1]), ("3B", row[2], row[3]))]  # fmt: skip
    (tmp_path / "observations.csv").write_text(
        "\n".join(["image,id,line,sample,sigma_line_px,sigma_sample_px", *rows]) + "\n", encoding="utf-8"
    )
    images = "".join(f'[[images]]\nid = "{name[8:10]}"\nmetadata = "{folder / name}"\n' for name in BANDS)
    (tmp_path / "project.toml").write_text(
        f'schema = 1\nname = "aster"\n{images}[observations]\nfile = "observations.csv"\n'
        '[adjustment]\ndatum = "priors"\n', encoding="utf-8",
    )  # fmt: skip
    solution = fg.adjust(fg.read_project(tmp_path / "project.toml"))
    before, after = (np.abs(y_parallaxes(solution.problem, state)[1])
                     for state in (solution.problem.start, solution.state))  # fmt: skip
    assert len(after) == len(matches) and 1.5 < np.median(before) < 2.0
    assert np.median(after) <= 0.5


@pytest.mark.oracle
def test_effects_on_light_of_a_lattice(tmp_path: Path) -> None:
    """The description switches the aberration on, the option overrides it, and the ground moves by distance * v / c."""
    path = write_description(tmp_path, ("lattice.toml", "[lattice]", "[light]\naberration = true\n[lattice]"))
    with_effect, without = read_sensor(path), read_sensor(path, light=("none",))
    assert with_effect.metadata.effects.aberration and not without.metadata.effects
    at = np.array([2000.0]), np.array([2000.0])
    shift = float(np.linalg.norm(with_effect.locate(*at, height_m=0.0) - without.locate(*at, height_m=0.0)))
    ground = without.locate(*at, height_m=0.0)
    p, _ = exact(*at)
    distance = float(np.linalg.norm(ground - p))
    assert shift == pytest.approx(distance * 7.6e3 / 299_792_458.0, rel=0.1)


BAD = [
    (("lattice.toml", "lines = 4200", "lines = 42000"), "lattice.cover"),
    (("lattice.toml", "lines = 4200", "lines = 1"), "project.value"),
    (("lattice.toml", "line_period_s = 0.0022", ""), "project.missing"),
    (("lattice.toml", "line_period_s = 0.0022", "line_period_s = 1e-320"), "project.value"),
    (("lattice.toml", "positions.csv", "position.csv"), "table.missing_file"),
    (("directions.csv", "\n-400,410,", "\n-400,411,"), "lattice.grid"),
    (("directions.csv", "\n-400,410,", "\n-400,0,"), "lattice.grid"),
    (("directions.csv", "\n-400,410,", "\n-400,410,9"), "lattice.unit"),
    (("directions.csv", "\n-400,410,", "\n-400,410,x"), "table.not_a_number"),
    (("positions.csv", "\n-400,", "\n-401,"), "lattice.rows"),
    (("positions.csv", "\n-400,-", "\n-400,9"), "earth.state"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("change", "code"), BAD)
def test_damaged_descriptions_are_one_clear_line(tmp_path: Path, change: tuple[str, str, str], code: str) -> None:
    path = write_description(tmp_path, change)
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    (problem,) = caught.value.problems
    assert problem.code == code and "\n" not in str(problem) and str(tmp_path) in problem.file


@pytest.mark.behaviour
@pytest.mark.parametrize(("change", "code"), [
    (("<IMAGE_ROWS>4200</IMAGE_ROWS>", ""), "xml.missing_element"),
    (("</SAT_POS>", " 1</SAT_POS>"), "lattice.columns"),
    (("</SAT_POS>", " 1 2 3</SAT_POS>"), "lattice.count"),
    (("</WORLD_SIGHT_VECTOR>", " 1 2 3</WORLD_SIGHT_VECTOR>"), "lattice.count"),
    (("<WORLD_SIGHT_VECTOR>", "<WORLD_SIGHT_VECTOR>nan "), "lattice.columns"),
    (("<IMAGE_COLS>4100", "<IMAGE_COLS>4200"), "lattice.cover"),
])  # fmt: skip
def test_damaged_aster_files_are_one_clear_line(tmp_path: Path, change: tuple[str, str], code: str) -> None:
    with pytest.raises(InputError) as caught:
        read_sensor(write_aster(tmp_path, change))
    (problem,) = caught.value.problems
    assert problem.code == code and "\n" not in str(problem) and problem.place


@pytest.mark.behaviour
def test_directions_of_two_cameras_are_refused(tmp_path: Path) -> None:
    """A lattice in which one direction is off by 1e-4 rad (5 px) is refused: it is not one camera."""
    path = write_description(tmp_path)
    table = tmp_path / "directions.csv"
    rows = table.read_text(encoding="utf-8").splitlines()
    cells = rows[60].split(",")
    cells[2] = repr(float(cells[2]) + 2e-4)
    table.write_text("\n".join([*rows[:60], ",".join(cells), *rows[61:]]) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="one rotating camera"):
        read_sensor(path)
