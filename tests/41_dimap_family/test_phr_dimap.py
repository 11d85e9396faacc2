"""PHR_DIMAP: a small file is compared with its content, the real file with RPC and physical grid."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.formats.rpc import read_rpc
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors.metadata import LookAnglePolynomial, QuaternionPolynomial
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.changed_text import change_file

PHR = "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML"
QUATERNIONS = ((0.5, 1e-3, -1e-5), (0.5, -1e-3), (-0.5, 2e-3, 1e-5), (0.5, 2e-3))


def point(k: int) -> str:
    x, y, z = 5447304.949 + 4.7e3 * k, 277507.888 - 1.1e3 * k, 4502106.749 - 5.7e3 * k
    return (
        f"<Point><LOCATION_VALUES unit='m'>{x} {y} {z}</LOCATION_VALUES><VELOCITY_VALUES unit='m/s'>4769.7 -1144.9 "
        f"-5684.7</VELOCITY_VALUES><UTC_TIME>2018-12-26T10:48:{10 + 10 * k:02d}.000000Z</UTC_TIME></Point>"
    )


def document() -> str:
    """Return a PHR_DIMAP of 4001 lines of 0.0735 ms and 24 columns that also states the acquisition's line period."""
    models = "".join(
        f"<Q{j}><DEGREE>{len(row) - 1}</DEGREE><COEFFICIENTS>{' '.join(map(repr, row))}</COEFFICIENTS></Q{j}>"
        for j, row in enumerate(QUATERNIONS)
    )
    vertices = "".join(
        f"<Vertex><LON>{2 + c / 100}</LON><LAT>{31 - r / 1e5}</LAT><COL>{c}</COL><ROW>{r}</ROW></Vertex>"
        for r, c in ((1, 1), (1, 24), (4001, 24), (4001, 1))
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<PHR_Dimap_Document>
<Metadata_Identification><METADATA_PROFILE version="1.4">PHR_SYSTEM_RECTIFIED_PRODUCT</METADATA_PROFILE>
<METADATA_FORMAT>DIMAP_PHR</METADATA_FORMAT></Metadata_Identification>
<Product_Frame><Dataset_Frame>{vertices}</Dataset_Frame><PIXEL_ORIGIN>1</PIXEL_ORIGIN></Product_Frame>
<Product_Characteristics><PROCESSING_LEVEL>SENSOR</PROCESSING_LEVEL></Product_Characteristics>
<Raster_Dimensions><NROWS>4001</NROWS><NCOLS>24</NCOLS></Raster_Dimensions>
<Data_Strip><Data_Strip_Identification><PLATFORM_NAME>PHR</PLATFORM_NAME>
<PLATFORM_SERIAL_NUMBER>1B</PLATFORM_SERIAL_NUMBER></Data_Strip_Identification>
<Sensor_Configuration><Time_Stamp><PA_LINE_PERIOD unit="ms">0.1034</PA_LINE_PERIOD></Time_Stamp>
</Sensor_Configuration></Data_Strip>
<Geometric_Data><Sensor_Model_Characteristics>
<UTC_Sensor_Model_Range><START>2018-12-26T10:48:55.4490000Z</START><END>2018-12-26T10:48:55.7430000Z</END>
</UTC_Sensor_Model_Range>
<Sensor_Ephemeris><Point_List>{"".join(map(point, range(5)))}</Point_List></Sensor_Ephemeris>
<Sensor_Attitudes><Polynomial_Models>{models}</Polynomial_Models><OFFSET>38935.5</OFFSET><SCALE>1.625</SCALE>
</Sensor_Attitudes>
<SENSOR_LINE_PERIOD>0.0735</SENSOR_LINE_PERIOD>
<Sensor_Viewing_Model><Position_In_Retina><FIRST_COL>1</FIRST_COL><LAST_COL>24</LAST_COL></Position_In_Retina>
<Viewing_Directions><PsiX_Model><DEGREE>1</DEGREE><COEFFICIENTS>-0.01422 7.11e-07</COEFFICIENTS></PsiX_Model>
<PsiY_Model><DEGREE>0</DEGREE><COEFFICIENTS>8e-05</COEFFICIENTS></PsiY_Model></Viewing_Directions>
</Sensor_Viewing_Model>
</Sensor_Model_Characteristics></Geometric_Data>
</PHR_Dimap_Document>"""


@pytest.fixture
def phr(tmp_path: Path) -> Path:
    path = tmp_path / "PHRDIMAP.XML"
    path.write_text(document(), encoding="utf-8")
    return path


@pytest.mark.behaviour
def test_values_are_those_of_the_text(phr: Path) -> None:
    m = read_dimap(phr)
    assert (m.mission, m.instrument, m.format, str(m.epoch)) == ("PHR 1B", "PHR 1B", "PHR_DIMAP 1.4", "2018-12-26")
    assert (m.n_lines, m.n_samples, m.timing.reference_line) == (4001, 24, 0.0)
    assert m.timing.reference_time_s == 10 * 3600 + 48 * 60 + 55.449
    assert m.timing.line_period_s == pytest.approx(7.35e-5, rel=1e-15, abs=0.0)  # not the acquisition's 0.1034 ms
    assert isinstance(m.attitude, QuaternionPolynomial) and isinstance(m.look, LookAnglePolynomial)
    assert (m.attitude.offset_s, m.attitude.scale_s) == (38935.5, 1.625)
    assert [row[row != 0.0].tolist() for row in m.attitude.coefficients] == [list(row) for row in QUATERNIONS]
    # PsiX is across (XLOS of DIMAP 2), PsiY along
    assert (m.look.tan_psi_x.tolist(), m.look.tan_psi_y.tolist()) == ([8e-05], [-0.01422, 7.11e-07])
    assert m.ephemeris.time_s.tolist() == [38890.0, 38900.0, 38910.0, 38920.0, 38930.0]
    assert m.ephemeris.position_m[1].tolist() == [5447304.949 + 4.7e3, 277507.888 - 1.1e3, 4502106.749 - 5.7e3]
    frame = [(p.line, p.sample, p.height_m) for p in m.frame_points]
    assert frame == [(0.0, 0.0, None), (0.0, 23.0, None), (4000.0, 23.0, None), (4000.0, 0.0, None)]
    assert "height of each frame point is estimated" in str(m.frame_note)


FAULTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "another level": (lambda p: change_file(p, (">SENSOR<", ">ORTHO<")), "dimap.other_level"),
    "line period in seconds": (
        lambda p: change_file(p, ("<SENSOR_LINE_PERIOD>0.0735", "<SENSOR_LINE_PERIOD unit='s'>0.0735")),
        "xml.out_of_range"),
    "acquisition's line period": (
        lambda p: change_file(p, ("PERIOD>0.0735<", "PERIOD>0.2<")), "dimap.duration"),
    "time of another day": (lambda p: change_file(p, ("<OFFSET>38935.5", "<OFFSET>1.5")), "dimap.quaternion_span"),
    "no unit quaternion": (lambda p: change_file(p, ("-0.5 0.002", "-0.9 0.002")), "dimap.quaternion_norm"),
    "look angle in degrees": (lambda p: change_file(p, ("-0.01422", "-1.422")), "dimap.look_angle"),
    "kilometres": (lambda p: change_file(p, ("unit='m'>5447304.949", "unit='km'>5447304.949")), "dimap.radius"),
    "pixel origin 0": (lambda p: change_file(p, ("<PIXEL_ORIGIN>1", "<PIXEL_ORIGIN>0")), "dimap.pixel_origin"),
    "repeated time": (lambda p: change_file(p, ("10:48:20.", "10:48:10.")), "dimap.time_order"),
    "missing coefficient": (lambda p: change_file(p, ("-0.01422 7.11e-07", "-0.01422")), "xml.wrong_count"),
}  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named(phr: Path, fault: str) -> None:
    make, code = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        read_dimap(make(phr))
    (found,) = caught.value.problems
    assert (found.code, found.file) == (code, str(phr))
    assert found.remedy


@pytest.mark.behaviour
def test_a_file_with_rpc_only_says_so(phr: Path) -> None:
    text = phr.read_text("utf-8").replace("Sensor_Model_Characteristics>", "Something_Else>")
    phr.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_dimap(phr)
    assert [p.code for p in caught.value.problems] == ["dimap.rpc_file"]
    with pytest.raises(InputError) as caught:
        read_sensor(phr, model="rigorous")
    assert [p.code for p in caught.value.problems] == ["sensor.only_rpc"]


@pytest.mark.behaviour
def test_kinds_of_models(phr: Path) -> None:
    with pytest.raises(InputError, match="choose one of auto, rigorous, rpc"):
        read_sensor(phr, model="exact")


# --- the real file -------------------------------------------------------------------------------


@pytest.mark.truth
@pytest.mark.real_data
def test_rigorous_model_equals_the_rpc_of_the_file(real_data: Path) -> None:
    """Rigorous model and RPC of the PHR_DIMAP file agree within 1 cm on the ground; 0.7 mm are measured."""
    rigorous, rpc = read_sensor(real_data / PHR), read_sensor(real_data / PHR, model="rpc")
    assert isinstance(rigorous, PushbroomSensor) and isinstance(rpc, RpcSensor)
    line, sample, height = grid(rigorous, rpc.model.validity.height_m)
    ground = rigorous.locate(line, sample, height_m=height)
    assert np.linalg.norm(ground - rpc.locate(line, sample, height_m=height), axis=1).max() <= 0.01
    there = rigorous.project(rpc.locate(line, sample, height_m=height))
    # 0.01 m of ground at 0.5 m per pixel
    assert np.abs(np.array(there) - [line, sample]).max() <= 0.02


@pytest.mark.truth
@pytest.mark.real_data
def test_rigorous_model_equals_the_physical_grid(real_data: Path) -> None:
    """The rigorous model agrees with the physical grid within 2 cm at all 38 025 nodes; 0.2 mm are measured.

    The nodes have heights from -30 to 4900 m.
    """
    rasterio = pytest.importorskip("rasterio")
    sensor = read_sensor(real_data / PHR)
    worst, nodes = 0.0, 0
    with rasterio.open(real_data / "shareloc/GRID_P1BP--2018122638935449CP.tif") as source:
        t, tags = source.transform, source.tags()
        rows, columns = np.mgrid[: source.height, : source.width]
        # the raster's origin is a node, and pixel centres lie at 0.5
        line, sample = (t.f - 0.5 + t.e * rows).ravel(), (t.c - 0.5 + t.a * columns).ravel()
        for band in range(0, source.count, 2):
            height = float(tags[f"ALTITUDE_B{band}"])
            lon, lat = (source.read(band + k).ravel() for k in (1, 2))
            expected = geodetic_to_ecef(lon, lat, np.full(len(lon), height))
            apart = np.linalg.norm(sensor.locate(line, sample, height_m=height) - expected, axis=1)
            worst, nodes = max(worst, float(apart.max())), nodes + len(apart)
    assert (nodes, worst <= 0.02) == (38025, True)


@pytest.mark.truth
@pytest.mark.real_data
def test_pleiades_image_equals_its_rpc_on_the_ground(real_data: Path) -> None:
    """The rigorous model of PHR1A image 1 agrees with its RPC within 1 cm over the image and the RPC's heights."""
    folder = real_data / "geoetrim-pleiades"
    rigorous = PushbroomSensor(read_dimap(folder / "DIM_PHR1A_derived_img1.XML"))
    model = read_rpc(folder / "PHR1A_img1_RPC.txt", first_pixel=1.0)
    low, high = model.offsets[4] - model.scales[4], model.offsets[4] + model.scales[4]
    line, sample, height = grid(rigorous, (low, high))
    ground = RpcSensor(model).locate(line, sample, height_m=height)
    assert np.linalg.norm(rigorous.locate(line, sample, height_m=height) - ground, axis=1).max() <= 0.01


def grid(sensor: PushbroomSensor, heights: tuple[float, float]) -> list[np.ndarray]:
    """Return the pixels over the whole image at five heights."""
    axes = [np.linspace(0, sensor.n_lines - 1, 21), np.linspace(0, sensor.n_samples - 1, 21), np.linspace(*heights, 5)]
    return [a.ravel() for a in np.meshgrid(*axes, indexing="ij")]
