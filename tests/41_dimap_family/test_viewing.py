"""Footprints, sampling, angles and base-to-height ratio agree with plane geometry and with stated values."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Image
from fg_orient.sensors.base import OrientedSensor
from fg_orient.sensors.frame import FrameCamera, FrameSensor
from fg_orient.sensors.viewing import (
    SIDE,
    View,
    _area_m2,
    feature_collection,
    footprint,
    image_record,
    pair_record,
    polygon_geometry,
)
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

LON, LAT, HEIGHT = 31.0, 41.0, 2000.0


def camera(east_m: float, tilt_deg: float, name: str = "a") -> Image:
    """Return the frame image 2 km above (LON, LAT), moved to the East and tilted to look East.

    4000 x 4000 pixels, f = 8000.
    """
    axes = enu_from_ecef(LON, LAT)[0]
    t = np.radians(tilt_deg)
    across = np.array([np.cos(t), 0.0, np.sin(t)])
    ahead = np.array([0.0, -1.0, 0.0])
    inwards = np.cross(across, ahead)
    rotation = np.stack([across, ahead, inwards]) @ axes
    centre = geodetic_to_ecef(LON, LAT, HEIGHT)[0] + east_m * axes[0]
    cam = FrameCamera(
        rotation=rotation, centre_m=centre, focal_px=8000.0, principal_px=np.full(2, 1999.5), distortion=np.zeros(5)
    )
    return Image(name, FrameSensor(cam, 4000, 4000))


@pytest.mark.truth
def test_a_vertical_photo() -> None:
    """A vertical photo has a sampling of 0.25 m, an area of 1 km2 and no incidence at its centre."""
    record = image_record(View(camera(0.0, 0.0)))
    # the ground bends by 8 cm below a plane of 1 km
    assert record["gsd_line_m"] == pytest.approx(0.25, abs=1e-6)
    assert record["gsd_sample_m"] == pytest.approx(0.25, abs=1e-6)
    assert record["incidence_deg"] == pytest.approx(0.0, abs=1e-3)
    corner = np.degrees(np.arctan(np.hypot(1999.5, 1999.5) / 8000.0))
    assert record["incidence_range_deg"][1] == pytest.approx(corner, abs=0.01)  # and the Earth: 0.006 degrees
    assert record["area_km2"] == pytest.approx(1.0, rel=2e-4)
    assert (record["lon_deg"], record["lat_deg"]) == pytest.approx((LON, LAT), abs=1e-6)


@pytest.mark.truth
def test_two_photos_in_one_vertical_plane() -> None:
    """A pair with a base of 800 m at 2000 m has B/H = 0.4 and the angles of the rays.

    The ellipsoid bends by 0.004 degrees.
    """
    tilt = float(np.degrees(np.arctan(400.0 / 2000.0)))
    left, right = View(camera(-400.0, tilt, "a")), View(camera(400.0, -tilt, "b"))
    record = pair_record(left, right)
    assert record["images"] == ["a", "b"]
    assert record["base_to_height"] == pytest.approx(0.4, abs=5e-4)
    point = geodetic_to_ecef(record["lon_deg"], record["lat_deg"], 0.0)[0] - geodetic_to_ecef(LON, LAT, 0.0)[0]
    east, north, up = enu_from_ecef(LON, LAT)[0] @ point
    rays = np.array([[x - east, -north, HEIGHT - up] for x in (-400.0, 400.0)])
    a, b = rays / np.linalg.norm(rays, axis=1)[:, None]
    assert record["convergence_deg"] == pytest.approx(np.degrees(np.arccos(a @ b)), abs=1e-4)
    bisector = (a + b) / np.linalg.norm(a + b)
    assert record["bisector_elevation_deg"] == pytest.approx(np.degrees(np.arcsin(bisector[2])), abs=2e-3)
    # in the plane of the rays the vertical is their common normal to the base
    upright = np.cross([1.0, 0.0, 0.0], np.cross(a, b))
    cosine = abs(bisector @ upright) / np.linalg.norm(upright)
    assert record["asymmetry_deg"] == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.02)
    assert 0.8 < record["overlap"] <= 1.0
    # a camera to the East is seen in the East; it leans by its tilt
    east = image_record(right)
    assert east["azimuth_deg"] == pytest.approx(90.0, abs=0.1)
    assert east["incidence_deg"] == pytest.approx(tilt, abs=0.01)


@pytest.mark.behaviour
def test_no_common_ground() -> None:
    record = pair_record(View(camera(0.0, 0.0)), View(camera(50e3, 0.0, "b")))
    assert (record["overlap"], record["base_to_height"], record["lon_deg"]) == (0.0, None, None)


@pytest.mark.oracle
def test_area_is_that_of_the_ellipsoid() -> None:
    """The area between two parallels equals numerical integration on the ellipsoid within 1e-8."""
    lat = np.radians(np.linspace(40.0, 42.0, 20001))
    e2 = 0.0066943799901413165
    m = 6378137.0 * (1 - e2) / (1 - e2 * np.sin(lat) ** 2) ** 1.5
    r = 6378137.0 * np.cos(lat) / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    expected = np.trapezoid(m * r, lat) * np.radians(3.0)
    ring = np.array([[30.0, 40.0], [33.0, 40.0], [33.0, 42.0], [30.0, 42.0]])
    assert _area_m2(ring, None) == pytest.approx(expected, rel=1e-8)


@pytest.mark.consistency
def test_adjusted_orientation_moves_the_footprint() -> None:
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    image = block.images[0]
    plain = View(image, 300.0)
    turned = View(Image(image.id, OrientedSensor(image.sensor, truth.corrections[0])), 300.0)
    apart = (footprint(plain) - footprint(turned)) * [83e3, 111e3]
    assert 5.0 < np.linalg.norm(apart, axis=1).max() < 200.0
    assert str(turned.sensor.notes[-1]) == "the adjusted orientation is used"
    assert image_record(turned)["incidence_deg"] == pytest.approx(image_record(plain)["incidence_deg"], abs=0.01)


def shoelace(ring: list[list[float]]) -> float:
    x, y = np.array(ring).T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


@pytest.mark.behaviour
def test_geojson_of_a_twin_image() -> None:
    block, _ = zonguldak_block(ZonguldakOptions(seed=1))
    views = [View(image, 300.0) for image in block.images]
    records = [image_record(view) for view in views]
    collection = json.loads(json.dumps(feature_collection(views, records)))
    assert (collection["type"], [f["id"] for f in collection["features"]]) == ("FeatureCollection", ["left", "right"])
    for feature, view in zip(collection["features"], views, strict=True):
        (ring,) = feature["geometry"]["coordinates"]
        assert ring[0] == ring[-1] and len(ring) == 4 * (SIDE - 1) + 1
        assert shoelace(ring) > 0.0  # counter-clockwise, RFC 7946
        assert sorted(map(tuple, ring[:-1])) == sorted(map(tuple, footprint(view).tolist()))
        assert feature["properties"]["image"] == feature["id"]


@pytest.mark.oracle
def test_a_footprint_across_the_180th_meridian() -> None:
    """A footprint across the 180th meridian is cut into two polygons whose areas add up."""
    ring = np.array([[179.0, -10.0], [180.5, -10.0], [182.0, -9.0], [180.0, -8.0], [179.0, -8.5]])
    for turn in (0.0, -360.0, 720.0):
        geometry = polygon_geometry(ring + np.array([turn, 0.0]))
        assert geometry["type"] == "MultiPolygon"
        (west,), (east,) = geometry["coordinates"]
        assert max(x for x, _ in west) == 180.0 and min(x for x, _ in west) == 179.0
        assert min(x for x, _ in east) == -180.0 and max(x for x, _ in east) == -178.0
        assert shoelace(west) + shoelace(east) == pytest.approx(shoelace([*ring.tolist(), ring[0].tolist()]), rel=1e-12)
    assert polygon_geometry(ring - np.array([10.0, 0.0]))["type"] == "Polygon"


# --- real files ----------------------------------------------------------------------------------


@pytest.mark.truth
@pytest.mark.real_data
def test_incidence_angles_that_files_state(real_data: Path) -> None:
    """Incidence angles equal those of the files within 0.02 degrees (SPOT 6) and 0.005 degrees (PHR 1B).

    The producer uses another Earth for SPOT 6.
    """
    path = real_data / "geocosicorr3d/SPOT6.XML"
    view = View(Image("a", read_sensor(path)), 836.5)
    nodes = etree.parse(path).findall(".//Located_Geometric_Values")
    assert len(nodes) == 9
    for node in nodes:
        assert incidence(view, float(node.findtext("ROW")) - 1, float(node.findtext("COL")) - 1) == pytest.approx(
            float(node.findtext(".//INCIDENCE_ANGLE")), abs=0.02
        )
    path = real_data / "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML"
    view = View(Image("a", read_sensor(path)), 518.0)
    node = etree.parse(path).findall(".//Data_Strip/Geometric_Header_List/Located_Geometric_Header")[1]
    timing = view.sensor.metadata.timing
    seconds = 10 * 3600 + 48 * 60 + float(node.findtext("UTC_TIME")[17:-1])
    line = (seconds - timing.reference_time_s) / timing.line_period_s
    assert incidence(view, line, 19999.5) == pytest.approx(float(node.findtext(".//GLOBAL_INCIDENCE")), abs=0.005)


def incidence(view: View, line: float, sample: float) -> float:
    at = np.array([line]), np.array([sample])
    return float(np.degrees(np.arccos(view.to_image(*at, view.ground(*at))[0, 2])))


@pytest.mark.truth
@pytest.mark.real_data
def test_a_pair_by_rigorous_models_and_by_rpc(real_data: Path) -> None:
    """Angles and sampling by RPC equal those by the rigorous model, although an RPC has no projection centre."""
    path = real_data / "shareloc/PHRDIMAP_P1BP--2018122638935449CP.XML"
    both = [View(Image(kind, read_sensor(path, model=kind)), 550.0) for kind in ("rigorous", "rpc")]
    one, two = (image_record(view) for view in both)
    for key in ("incidence_deg", "azimuth_deg", "gsd_line_m", "gsd_sample_m"):
        assert two[key] == pytest.approx(one[key], abs=2e-3)
    same = pair_record(*both)
    assert same["convergence_deg"] < 2e-3 and same["overlap"] > 0.9
