"""Each fault of a sensor description, its tables or a C04 file is refused with its code and place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.metadata.pushbroom import read_earth_orientation
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError, OutOfTimeRange
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.changed_text import change_file
from tests.support.sensor_description import describe

pytestmark = pytest.mark.behaviour


@pytest.fixture(scope="module")
def sensor() -> PushbroomSensor:
    return zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor


#: Text of the description, what stands in its place, the code.
DESCRIPTION = [
    ('kind = "pushbroom"', 'kind = "frame"', "project.value"),
    ("[image]", "[picture]", "project.unknown_key"),
    ('file = "attitude.csv"', 'file = "none.csv"', "table.missing_file"),
    ('day = "', 'day = "the ', "earth.day"),
    ("line_period_s = ", "line_period_s = 0.0 # ", "earth.period"),
    ('directions = "directions.csv"', "focal_length_m = 1.0", "earth.camera"),
    ("directions =", "focal_length_m = 1.0\ndirections =", "earth.camera"),
    ('directions = "directions.csv"', "focal_length_m = 1.0\npitch_m = 1.0\nprincipal_sample = 0.0", "earth.wide"),
    ("[orbit]", "[mounting]\nmatrix = [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n[orbit]", "earth.matrix"),
    ("samples = ", "samples = 9", "earth.directions"),
    ("reference_time_s = ", "reference_time_s = 1.0 # ", "earth.list_span"),
]


@pytest.mark.parametrize(("old", "new", "code"), DESCRIPTION)
def test_description(sensor: PushbroomSensor, tmp_path: Path, old: str, new: str, code: str) -> None:
    path = change_file(describe(sensor, tmp_path), (old, new))
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    assert code in {p.code for p in caught.value.problems}
    assert isinstance(caught.value, OutOfTimeRange) == (code == "earth.list_span")


#: Table, column, factor of its first value, frames of orbit and attitude, the code.
TABLES = [
    ("orbit.csv", 1, 1e3, "ITRF", "orbital", "earth.state"),
    ("orbit.csv", 5, 1e3, "ITRF", "orbital", "earth.state"),
    ("orbit.csv", 0, 2.0, "ITRF", "orbital", "earth.order"),
    ("attitude.csv", 0, 2.0, "ITRF", "orbital", "earth.order"),
    ("attitude.csv", 1, 1.5, "ITRF", "ITRF", "earth.quaternion"),
    ("directions.csv", 0, np.nan, "ITRF", "orbital", "table.not_a_number"),
]


@pytest.mark.parametrize(("name", "column", "factor", "orbit", "attitude", "code"), TABLES)
def test_tables(
    sensor: PushbroomSensor, tmp_path: Path, name: str, column: int, factor: float, orbit: str, attitude: str, code: str
) -> None:
    path = describe(sensor, tmp_path, orbit=orbit, attitude=attitude)
    lines = (tmp_path / name).read_text("utf-8").splitlines()
    cells = lines[1].split(",")
    cells[column] = str(factor * float(cells[column]))
    (tmp_path / name).write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    assert {p.code for p in caught.value.problems} == {code}
    assert name in str(caught.value)


def test_two_inertial_frames(sensor: PushbroomSensor, tmp_path: Path) -> None:
    path = describe(sensor, tmp_path, orbit="GCRS", attitude="EME2000")
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    assert [p.code for p in caught.value.problems] == ["earth.two_frames"]


def test_days_of_another_epoch(sensor: PushbroomSensor, tmp_path: Path) -> None:
    path = describe(sensor, tmp_path, orbit="GCRS")
    rows = (tmp_path / "orbit.csv").read_text("utf-8").splitlines()
    late = [f"{float(r.split(',')[0]) + 1e6!r},{r.split(',', 1)[1]}" for r in rows[1:]]
    (tmp_path / "orbit.csv").write_text("\n".join([rows[0], *late]), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_sensor(path)
    assert [p.code for p in caught.value.problems] == ["earth.seconds"]


def c04(folder: Path, *rows: str) -> Path:
    path = folder / "eopc04.txt"
    path.write_text("# a header\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


OLD = "2012   1   {}  {}   0.1187   0.2632  -0.4190   0.0012   0.00052  -0.00006"
NEW = "2012   1   {}   0  {}.00   0.1187   0.2632  -0.4190   0.00052  -0.00006   0.0  0.0  0.0012"


@pytest.mark.parametrize("form", [OLD, NEW])
def test_both_forms_of_c04_are_read(tmp_path: Path, form: str) -> None:
    found = read_earth_orientation(c04(tmp_path, *(form.format(d, 55926 + d) for d in (1, 2, 3))))
    second = np.radians(1.0 / 3600.0)
    assert found.mjd.tolist() == [55927.0, 55928.0, 55929.0]
    assert found.pole_rad[0] == pytest.approx([0.1187 * second, 0.2632 * second])
    assert found.ut1_utc_s[2] == -0.4190
    assert found.offset_rad[1] == pytest.approx([0.00052 * second, -0.00006 * second])


@pytest.mark.parametrize(("rows", "code"), [
    ((), "earth.no_records"),
    ((OLD.format(1, 55927), OLD.format(3, 55929)), "earth.gap"),
    ((OLD.format(1, 55927), OLD.format(2, 55928).replace("0.1187", "1.1187")), "earth.value"),
    ((OLD.format(1, 55927), OLD.format(2, 55928).replace("0.1187", "x")), "earth.record"),
    (None, "earth.unreadable"),
])  # fmt: skip
def test_c04(tmp_path: Path, rows: tuple[str, ...] | None, code: str) -> None:
    with pytest.raises(InputError) as caught:
        read_earth_orientation(tmp_path / "none" if rows is None else c04(tmp_path, *rows))
    assert [p.code for p in caught.value.problems] == [code]
