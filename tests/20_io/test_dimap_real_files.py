"""The tests check what the readers take from the real files, and the ground points that follow."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factors.geometry import ellipsoid
from fg_orient.formats.dimap_write import write_dimap1
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.model.errors import InputError
from fg_orient.sensors.metadata import (
    AngleAttitude,
    LookAnglePolynomial,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)
from fg_orient.sensors.pushbroom import PushbroomSensor

pytestmark = pytest.mark.real_data

COSI = "geocosicorr3d"
# mission, instrument, lines, samples, ephemeris points, kind of attitude, its length, day
FILES = {
    f"{COSI}/SPOT1.DIM": ("SPOT 1", "HRV 1", 6000, 6000, 8, AngleAttitude, 74, "1998-07-12"),
    f"{COSI}/SPOT2.DIM": ("SPOT 2", "HRV 2", 6000, 6000, 8, AngleAttitude, 74, "1998-03-14"),
    f"{COSI}/SP2_METADATA.DIM": ("SPOT 2", "HRV 1", 6000, 6000, 8, AngleAttitude, 74, "1998-02-20"),
    f"{COSI}/SPOT4.DIM": ("SPOT 4", "HRVIR 2", 6000, 6000, 8, AngleAttitude, 74, "2012-01-15"),
    f"{COSI}/SPOT5.DIM": ("SPOT 5", "HRG 1", 12000, 12000, 11, AngleAttitude, 233, "2005-03-13"),
    f"{COSI}/SPOT6.XML": ("SPOT 6", "SPOT 6", 25533, 25669, 48, QuaternionList, 188, "2018-09-15"),
    "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML": (
        "PHR 1B", "PHR 1B", 38248, 40000, 10, QuaternionPolynomial, 4, "2018-12-26"),
    "asp/spot5_hrs1_segment.xml": ("SPOT 5", "HRS 1", 96168, 300, 13, AngleAttitude, 578, "2008-03-04"),
    "geoetrim-pleiades/DIM_PHR1A_derived_img1.XML": (
        "PHR", "PHR", 40068, 40000, 10, QuaternionPolynomial, 4, "2012-01-01"),
    "geoetrim-pleiades/DIM_PHR1A_derived_img3.XML": (
        "PHR", "PHR", 39260, 40000, 10, QuaternionPolynomial, 4, "2012-01-01"),
}  # fmt: skip


def ecef(lon_deg: np.ndarray, lat_deg: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Convert geodetic coordinates to ECEF (docs/equations.md 5), independent of the code under test."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    n = ellipsoid.A_M / np.sqrt(1.0 - ellipsoid.E2 * np.sin(lat) ** 2)
    return np.stack([
        (n + height_m) * np.cos(lat) * np.cos(lon), (n + height_m) * np.cos(lat) * np.sin(lon),
        (n * (1.0 - ellipsoid.E2) + height_m) * np.sin(lat),
    ], axis=1)  # fmt: skip


def frame_distances_m(metadata: PushbroomMetadata, height_m: float) -> np.ndarray:
    points = metadata.frame_points
    ground = PushbroomSensor(metadata).locate(
        [p.line for p in points], [p.sample for p in points], height_m=np.full(len(points), height_m)
    )
    lon, lat = (np.array([getattr(p, name) for p in points]) for name in ("lon_deg", "lat_deg"))
    return np.linalg.norm(ground - ecef(lon, lat, np.full(len(points), height_m)), axis=1)


def reference_distances_m(metadata: PushbroomMetadata, rows: np.ndarray) -> np.ndarray:
    """Return the distances of our ground points from reference rows: line, column (1-based), lon, lat, height."""
    ground = PushbroomSensor(metadata).locate(rows[:, 0] - 1, rows[:, 1] - 1, height_m=rows[:, 4])
    return np.linalg.norm(ground - ecef(rows[:, 2], rows[:, 3], rows[:, 4]), axis=1)


def cosi_rows(real_data: Path, name: str) -> np.ndarray:
    with (real_data / "reference-outputs/geocosicorr3d_h0.csv").open(encoding="utf-8") as stream:
        rows = [r for r in csv.DictReader(stream) if r["file"] == name]
    keys = ("row_1based", "col_1based", "lon", "lat", "h_back_m")
    return np.array([[float(row[key]) for key in keys] for row in rows])


@pytest.mark.truth
@pytest.mark.parametrize("name", FILES)
def test_every_file_gives_what_stands_in_it(real_data: Path, name: str) -> None:
    mission, instrument, n_lines, n_samples, n_points, kind, n_attitudes, day = FILES[name]
    m = read_dimap(real_data / name)
    assert (m.mission, m.instrument, m.n_lines, m.n_samples) == (mission, instrument, n_lines, n_samples)
    assert str(m.epoch) == day
    assert m.ephemeris.position_m.shape == m.ephemeris.velocity_m_s.shape == (n_points, 3)
    assert isinstance(m.attitude, kind)
    length = len(m.attitude.coefficients) if isinstance(m.attitude, QuaternionPolynomial) else len(m.attitude.time_s)
    assert length == n_attitudes
    if isinstance(m.look, LookAngleTable):
        np.testing.assert_array_equal(m.look.sample, np.arange(n_samples))
    else:
        assert isinstance(m.look, LookAnglePolynomial) and m.look.origin_sample == 0.0


@pytest.mark.truth
def test_spot5_values_are_those_of_the_text(real_data: Path) -> None:
    m = read_dimap(real_data / COSI / "SPOT5.DIM")
    assert (m.timing.reference_line, m.timing.line_period_s) == (6000.0, 7.5199643612e-04)
    assert m.timing.reference_time_s == 5 * 3600 + 21 * 60 + 7.332158
    np.testing.assert_array_equal(m.ephemeris.position_m[0], [-1.7083710059e05, 3.7037608668e06, 6.1685538417e06])
    assert m.ephemeris.time_s[0] == 5 * 3600 + 18 * 60 + 28
    assert isinstance(m.attitude, AngleAttitude) and isinstance(m.look, LookAngleTable)
    np.testing.assert_array_equal(m.attitude.angles_rad[0], [1.6065982461e-04, 7.2429929770e-04, 8.9593176499e-04])
    assert (m.look.psi_x_rad[1], m.look.psi_y_rad[1]) == (8.9596714215e-03, -1.2735641554e-02)
    assert m.notes == ()


@pytest.mark.truth
@pytest.mark.parametrize(("name", "period_s"), [
    (f"{COSI}/SPOT6.XML", 229.110269e-6), ("geoetrim-pleiades/DIM_PHR1A_derived_img1.XML", 0.0735e-3),
])  # fmt: skip
def test_line_periods_follow_the_unit_attribute(real_data: Path, name: str, period_s: float) -> None:
    assert read_dimap(real_data / name).timing.line_period_s == pytest.approx(period_s, rel=1e-15, abs=0.0)


@pytest.mark.truth
def test_spot5_frame_points_are_met_to_the_print(real_data: Path) -> None:
    """The SPOT 5 model locates the five frame points of the file within 0.15 m.

    The file prints 1e-6 degree = 0.1 m; the measured differences are 0.005 to 0.053 m.
    """
    assert frame_distances_m(read_dimap(real_data / COSI / "SPOT5.DIM"), 0.0).max() <= 0.15


@pytest.mark.truth
@pytest.mark.parametrize(("name", "limit_m"), [
    ("SPOT1.DIM", 9.0), ("SPOT2.DIM", 5.0), ("SP2_METADATA.DIM", 3.0), ("SPOT4.DIM", 26.0),
])  # fmt: skip
def test_spot124_frame_points(real_data: Path, name: str, limit_m: float) -> None:
    """Models of SPOT 1, 2 and 4 locate corners and centre within the limit of each file, with three notes.

    With the attitudes set to zero all five points agree to 3 m, because the producer left the attitudes out.
    """
    m = read_dimap(real_data / COSI / name)
    distances = frame_distances_m(m, 0.0)
    print(name, distances.round(2))
    assert [p.id for p in m.frame_points] == ["corner 1", "corner 2", "corner 3", "corner 4", "centre"]
    assert distances.max() <= limit_m
    assert isinstance(m.attitude, AngleAttitude)
    level = replace(m, attitude=AngleAttitude(m.attitude.time_s, 0.0 * m.attitude.angles_rad))
    assert frame_distances_m(level, 0.0).max() <= 3.0
    held, closing, frame = map(str, m.notes)
    assert "held" in held and "differ from" in closing and "without attitudes" in frame


@pytest.mark.truth
def test_spot6_frame_points_lie_at_terrain_height(real_data: Path) -> None:
    """The SPOT 6 model locates all five frame points within 2 m at a height of 830 m, which the file does not state."""
    m = read_dimap(real_data / COSI / "SPOT6.XML")
    assert all(p.height_m is None for p in m.frame_points)
    assert frame_distances_m(m, 830.0).max() <= 2.0


@pytest.mark.truth
@pytest.mark.parametrize(("name", "limit_m"), [
    ("SPOT5.DIM", 0.03),  # documented difference of that program on SPOT 5: 3 cm
    ("SPOT6.XML", 0.01),  # its print of 1e-11 degree and 0.1 mm of height; measured 1.3 mm
    ("SPOT1.DIM", 2.0), ("SPOT2.DIM", 2.0), ("SPOT4.DIM", 2.0),  # other rule for the speeds (1.4 m), pixel 10 m
])  # fmt: skip
def test_an_independent_program_finds_the_same_ground(real_data: Path, name: str, limit_m: float) -> None:
    rows = cosi_rows(real_data, name)
    assert len(rows) == 16
    assert reference_distances_m(read_dimap(real_data / COSI / name), rows).max() <= limit_m


@pytest.mark.truth
def test_rugged_finds_the_same_ground_for_spot5(real_data: Path) -> None:
    """The SPOT 5 model agrees with Rugged within 0.01 m.

    The documented difference is 5 mm, rounded to the millimetre by its print; 6.1 mm are measured.
    """
    rows = np.loadtxt(real_data / "reference-outputs/rugged_SPOT5_h0.csv", delimiter=",", skiprows=1)
    distances = reference_distances_m(read_dimap(real_data / COSI / "SPOT5.DIM"), rows[:, [0, 1, 3, 4, 2]])
    assert distances.max() <= 0.01


REFUSED = [
    ("shareloc/RPC_P1BP--2017092838284574CP.XML", "dimap.rpc_file", "2.15"),
    ("micmac-spot7-rpc/RPC_1A.xml", "dimap.rpc_file", "SPOT 7"),
    ("micmac-pneo-pair/RPC_PNEO3_202309051055014_PAN_SEN_PWOI_000129104_1_1_F_1.XML", "dimap.rpc_file", "Neo"),
    ("rpcm/rpc_WV2.xml", "dimap.other_format", "DigitalGlobe"),
    ("rpcm/rpc_unsupported.xml", "dimap.other_format", "GDAL"),
    ("rpcm/rpc_PLEIADES.xml", "dimap.rpc_file", "PHR_SENSOR"),
    ("rpcm/rpc_SPOT6.xml", "dimap.rpc_file", "SPOT 6"),
    ("s2p/pair_rpc_01.xml", "dimap.rpc_file", "PHR_SENSOR"),
    ("geoetrim-pleiades/points_img1.csv", "xml.malformed", ""),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("name", "code", "value"), REFUSED)
def test_other_real_files_are_named_and_refused(real_data: Path, name: str, code: str, value: str) -> None:
    with pytest.raises(InputError) as caught:
        read_dimap(real_data / name)
    (problem,) = caught.value.problems
    assert problem.code == code
    assert value in problem.value
    assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.consistency
def test_the_real_spot5_file_survives_writing_and_reading(real_data: Path, tmp_path: Path) -> None:
    first = read_dimap(real_data / COSI / "SPOT5.DIM")
    write_dimap1(tmp_path / "copy.dim", first)
    second = read_dimap(tmp_path / "copy.dim")
    assert isinstance(first.attitude, AngleAttitude) and isinstance(second.attitude, AngleAttitude)
    assert isinstance(first.look, LookAngleTable) and isinstance(second.look, LookAngleTable)
    assert (first.timing, first.frame_points, first.epoch) == (second.timing, second.frame_points, second.epoch)
    for a, b in (
        (first.ephemeris.time_s, second.ephemeris.time_s),
        (first.ephemeris.position_m, second.ephemeris.position_m),
        (first.ephemeris.velocity_m_s, second.ephemeris.velocity_m_s),
        (first.attitude.time_s, second.attitude.time_s),
        (first.attitude.angles_rad, second.attitude.angles_rad),
        (first.look.psi_x_rad, second.look.psi_x_rad),
        (first.look.psi_y_rad, second.look.psi_y_rad),
    ):
        np.testing.assert_array_equal(a, b)
