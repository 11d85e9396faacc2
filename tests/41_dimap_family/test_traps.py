"""The tests show each error that a reader of the DIMAP family can make with real files, and its size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient.cli.command import Extrapolate
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError, OutOfImage, OutOfTimeRange
from fg_orient.sensors.ground import frame_records
from fg_orient.sensors.metadata import AngleAttitude, FramePoint, LookAnglePolynomial, PushbroomMetadata
from fg_orient.sensors.pushbroom import MAX_EXTRAPOLATION_S, PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.published_rays import misses_m

HRS = "asp/spot5_hrs1_segment.xml"
PHR = "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML"


def worst_frame_m(metadata: PushbroomMetadata) -> float:
    """Return the largest misfit of the frame points."""
    return max(r["misfit_m"] for r in frame_records(PushbroomSensor(metadata)))


@pytest.fixture(scope="module")
def twin() -> PushbroomMetadata:
    return zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor.metadata


# --- SPOT 5: lines, signs ------------------------------------------------------------------------


@pytest.mark.truth
@pytest.mark.real_data
def test_the_central_line_is_that_of_the_file(real_data: Path) -> None:
    """The reference line is SCENE_CENTER_LINE; NROWS / 2 would be wrong by one line, 4 to 6 m."""
    m = read_dimap(real_data / "geocosicorr3d/SPOT5.DIM")
    assert (m.timing.reference_line, m.n_lines) == (6000.0, 12000)
    half = replace(m, timing=replace(m.timing, reference_line=m.n_lines / 2 - 1))
    assert worst_frame_m(m) <= 0.15
    assert 4.0 < worst_frame_m(half) < 6.0


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize(
    "signs", [(1, 1, 1), (-1, -1, -1), (1, -1, 1), (-1, 1, 1), (1, 1, -1), (-1, 1, -1), (1, -1, -1)]
)
def test_other_signs_of_the_attitude_are_far_off(real_data: Path, signs: tuple[int, int, int]) -> None:
    """The signs of the attitude angles fit the frame points within 0.15 m; other signs miss them by over 50 m."""
    m = read_dimap(real_data / "geocosicorr3d/SPOT5.DIM")
    assert isinstance(m.attitude, AngleAttitude)
    if signs == (1, 1, 1):
        assert worst_frame_m(m) <= 0.15
    else:
        turned = AngleAttitude(m.attitude.time_s, m.attitude.angles_rad * signs)
        assert worst_frame_m(replace(m, attitude=turned)) > 50.0


# --- HRS: look angles and attitudes that do not cover the image ----------------------------------


@pytest.mark.behaviour
@pytest.mark.real_data
def test_hrs_lines_without_attitude_are_refused(real_data: Path) -> None:
    """The first 22 and the last 235 lines of the HRS image are refused, and no others. Two notes name them."""
    sensor = read_sensor(real_data / HRS)
    assert (sensor.first_line, sensor.last_line, sensor.n_lines) == (22.0, 95932.0, 96168)
    refused = 0
    for line in (*range(40), *range(95900, 96168)):
        try:
            sensor.locate(float(line), 5.0, height_m=0.0)
        except OutOfTimeRange as error:
            refused += 1
            assert line < 22 or line > 95932
            (found,) = error.problems
            assert "45063.206912 .. 45135.331747 s" in found.message and "option extrapolate_attitude" in found.remedy
    assert refused == 22 + 235
    assert tuple(map(str, sensor.notes[-2:])) == (
        "the attitudes do not cover lines 0 to 21, so these lines cannot be used",
        "the attitudes do not cover lines 95933 to 96167, so these lines cannot be used",
    )


@pytest.mark.truth
@pytest.mark.real_data
def test_hrs_corners_with_extrapolated_attitude(real_data: Path) -> None:
    """With extrapolated attitudes both HRS corners of column 1 fit within 0.15 m.

    Measured are 0.027 and 0.037 m, and 2.6 m if the last angles are held.
    """
    sensor = read_sensor(real_data / HRS, extrapolate_attitude_s=0.2)
    corners = [r for r in frame_records(sensor) if r["sample"] == 0.0]
    assert [r["line"] for r in corners] == [0.0, 96167.0]
    assert max(r["misfit_m"] for r in corners) <= 0.15
    assert [str(note).rsplit(" by ", 1)[1] for note in sensor.notes[-2:]] == [
        "0.016 s with the last rate",
        "0.176 s with the last rate",
    ]


@pytest.mark.behaviour
@pytest.mark.real_data
def test_hrs_columns_beyond_the_look_angles_are_refused(real_data: Path) -> None:
    sensor = read_sensor(real_data / HRS)
    sensor.locate(100.0, 299.0, height_m=0.0)
    with pytest.raises(OutOfImage, match=r"sample 300: the pixel is outside .* samples from -0\.5 to 299\.5"):
        sensor.locate(100.0, 300.0, height_m=0.0)


@pytest.mark.behaviour
def test_the_option_ends_where_the_sensor_does() -> None:
    assert Extrapolate.__metadata__[0].max == MAX_EXTRAPOLATION_S


# --- SPOT 6: lists that end with the image -------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.real_data
@pytest.mark.parametrize("height_m", [0.0, 5000.0])
def test_spot6_first_and_last_lines_round_trip(real_data: Path, height_m: float) -> None:
    """SPOT 6 lines up to half a line outside the image are located and projected back within 1e-6 px.

    Ephemeris and quaternions start and end with the image.
    """
    sensor = read_sensor(real_data / "geocosicorr3d/SPOT6.XML")
    assert sensor.notes == ()
    last = sensor.n_lines - 1.0
    line, sample = (
        a.ravel() for a in np.meshgrid([-0.5, 0.0, 1.0, last - 1, last, last + 0.5], np.linspace(0, 25668, 9))
    )
    ground = sensor.locate(line, sample, height_m=height_m)
    listed = (line >= 0.0) & (line <= last)
    assert misses_m(sensor.metadata, line[listed], sample[listed], ground[listed]).max() < 1e-7
    back = sensor.project(ground)
    assert np.abs(np.array(back) - [line, sample]).max() <= 1e-6
    # neighbouring lines lie 1.6 m apart on the ground, at the ends as in the middle
    steps = np.linalg.norm(np.diff(sensor.locate([0.0, 1.0, last - 1, last], [9.0] * 4), axis=0), axis=1)[[0, 2]]
    assert np.abs(steps - 1.585).max() < 0.01


@pytest.mark.oracle
@pytest.mark.real_data
@pytest.mark.parametrize("height_m", [0.0, 2500.0, 5000.0])
@pytest.mark.parametrize("name", [PHR, HRS])
def test_round_trip_over_the_usable_image(real_data: Path, name: str, height_m: float) -> None:
    """Pixels of PHR_DIMAP and HRS located at 0 to 5000 m lie on independent rays and return within 1e-6 px."""
    sensor = read_sensor(real_data / name)
    axes = np.linspace(sensor.first_line, sensor.last_line, 21), np.linspace(sensor.first_sample, sensor.last_sample, 9)
    line, sample = (a.ravel() for a in np.meshgrid(*axes))
    ground = sensor.locate(line, sample, height_m=height_m)
    assert misses_m(sensor.metadata, line, sample, ground).max() < 1e-7
    assert np.abs(np.array(sensor.project(ground)) - [line, sample]).max() <= 1e-6


# --- elements with and without unit, elements that are missing -----------------------------------


@pytest.mark.behaviour
@pytest.mark.real_data
def test_a_missing_ylos_1_is_a_constant(real_data: Path) -> None:
    """A file without YLOS_1 has a constant tangent of psi_x, and a linear one of psi_y."""
    look = read_dimap(real_data / "geoetrim-pleiades/DIM_PHR1A_derived_img1.XML").look
    assert isinstance(look, LookAnglePolynomial)
    assert (len(look.tan_psi_y), len(look.tan_psi_x)) == (2, 1)


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize(("name", "period_s"), [
    ("geocosicorr3d/SPOT5.DIM", 7.5199643612e-4), ("geocosicorr3d/SPOT6.XML", 229.110269e-6), (PHR, 7.35e-5),
])  # fmt: skip
def test_three_units_of_line_periods(real_data: Path, name: str, period_s: float) -> None:
    """The line period is read as seconds (SPOT 5), microseconds (SPOT 6) or milliseconds (PHR_DIMAP).

    Only SPOT 6 states the unit by an attribute.
    """
    assert read_dimap(real_data / name).timing.line_period_s == pytest.approx(period_s, rel=1e-15, abs=0.0)


@pytest.mark.behaviour
@pytest.mark.real_data
@pytest.mark.parametrize("name", [
    "micmac-spot7-rpc/RPC_1A.xml",
    "micmac-pneo-pair/RPC_PNEO3_202309051055014_PAN_SEN_PWOI_000129104_1_1_F_1.XML",
])  # fmt: skip
def test_a_rigorous_model_that_is_not_there(real_data: Path, name: str) -> None:
    """A request for the rigorous model of a file that has only an RPC is refused and names the remedy."""
    assert np.isfinite(read_sensor(real_data / name, model="rpc").centre_m).all()
    with pytest.raises(InputError, match=r"contains an RPC and not a rigorous model .*option model rpc"):
        read_sensor(real_data / name, model="rigorous")
    with pytest.raises(InputError, match="contains RPC, not the rigorous model"):
        read_dimap(real_data / name)


# --- frame points without heights ----------------------------------------------------------------


def without_heights(metadata: PushbroomMetadata, heights_m: list[float]) -> PushbroomMetadata:
    """Return the metadata with frame points on a terrain whose heights are not stated."""
    sensor = PushbroomSensor(metadata)
    line, sample = sensor.corners()
    records = sensor.locate(line, sample, height_m=np.array(heights_m))
    from fg_orient.geodesy import ecef_to_geodetic

    lon, lat, _ = ecef_to_geodetic(records)
    points = tuple(
        FramePoint(f"corner {k + 1}", *map(float, row), None)
        for k, row in enumerate(zip(line, sample, lon, lat, strict=True))
    )
    return replace(metadata, frame_points=points, frame_note=None)


@pytest.mark.oracle
def test_heights_of_frame_points_are_solved(twin: PushbroomMetadata) -> None:
    """Frame points without heights get the heights of their rays within 1 mm, with a misfit below 1 mm."""
    heights = [120.0, 2300.0, -40.0, 850.0]
    metadata = without_heights(twin, heights)
    found = frame_records(PushbroomSensor(metadata))
    assert [r["height_from"] for r in found] == ["solved"] * 4
    # steps end below 0.1 mm of height
    assert [r["height_m"] for r in found] == pytest.approx(heights, abs=1e-3)
    assert max(r["misfit_m"] for r in found) < 1e-3
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    for point, record in zip(metadata.frame_points, found, strict=True):  # the places of the file, by PROJ, on the rays
        ground = np.array(to_ecef.transform(point.lon_deg, point.lat_deg, record["height_m"]))
        assert misses_m(metadata, point.line, point.sample, ground[None])[0] < 2e-3
    given = frame_records(PushbroomSensor(metadata), 500.0)
    assert {r["height_from"] for r in given} == {"given"}
    assert min(r["misfit_m"] for r in given) > 100.0


@pytest.mark.oracle
def test_the_solved_height_is_the_best_one(twin: PushbroomMetadata) -> None:
    """For a frame point that no height meets the solved height has a smaller misfit than heights around it."""
    metadata = without_heights(twin, [300.0] * 4)
    moved = tuple(replace(p, lat_deg=p.lat_deg + 1e-4) for p in metadata.frame_points)
    sensor = PushbroomSensor(replace(metadata, frame_points=moved))
    for r in frame_records(sensor):
        around = [frame_records(sensor, r["height_m"] + d) for d in (-5.0, -0.5, 0.5, 5.0)]
        others = [next(o["misfit_m"] for o in rows if o["id"] == r["id"]) for rows in around]
        assert 1.0 < r["misfit_m"] < min(others)


@pytest.mark.behaviour
def test_a_vertical_ray_decides_no_height(twin: PushbroomMetadata) -> None:
    """A frame point on a vertical ray gets the height 0, and its record states that no height was solved.

    No height moves the point sideways.
    """
    down = replace(twin, look=LookAnglePolynomial(6000.0, np.array([0.0]), np.array([0.0, 1e-7])))
    metadata = without_heights(down, [700.0] * 4)
    found = frame_records(PushbroomSensor(metadata))
    assert [(r["height_from"], abs(r["height_m"]) < 1e-6) for r in found] == [("none", True)] * 4


@pytest.mark.truth
@pytest.mark.real_data
def test_real_frame_points_without_heights(real_data: Path) -> None:
    """Frame points of SPOT 6 have the height 836.49 m and fit within 1 cm; corners of PHR 1B fit within 3 cm."""
    spot6 = frame_records(read_sensor(real_data / "geocosicorr3d/SPOT6.XML"))
    assert len(spot6) == 5
    assert [r["height_m"] for r in spot6] == pytest.approx([836.49] * 5, abs=0.01)
    assert max(r["misfit_m"] for r in spot6) <= 0.01
    phr = frame_records(read_sensor(real_data / PHR))
    assert max(r["misfit_m"] for r in phr if r["id"] != "centre") <= 0.03
    # the file's terrain: 464 to 597 m above the geoid, which is 43 to 52 m above the ellipsoid here
    assert all(464.0 < r["height_m"] < 650.0 for r in phr)
