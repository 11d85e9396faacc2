"""The rigorous sensor is tested on real metadata files: frame points, vendor RPC, programs, round trips."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from factors.geometry import ellipsoid
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.sensors.correction import Correction, fit_eop, metadata_eop
from fg_orient.sensors.pushbroom import PushbroomSensor
from tests.support.published_rays import misses_m

GEODETIC = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)

pytestmark = pytest.mark.real_data

#: Metres by which frame points may be missed: SPOT 5 print resolution; the others the model of their files.
FRAME_LIMIT_M = {"SPOT5.DIM": 0.15, "SPOT1.DIM": 9.0, "SPOT2.DIM": 5.0, "SP2_METADATA.DIM": 3.0, "SPOT4.DIM": 26.0}
V1_FILES = sorted(FRAME_LIMIT_M)
PLEIADES = ["DIM_PHR1A_derived_img1.XML", "DIM_PHR1A_derived_img3.XML"]


def sensor(folder: Path, name: str) -> PushbroomSensor:
    return PushbroomSensor(read_dimap(folder / name))


def horizontal_m(ground: np.ndarray, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(ground)).T
    east = np.radians(lon - lon_deg) * 6378137.0 * np.cos(np.radians(lat))
    return np.hypot(east, np.radians(lat - lat_deg) * 6371000.0)


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.truth
@pytest.mark.parametrize("name", V1_FILES)
def test_frame_points(real_data: Path, name: str) -> None:
    s = sensor(real_data / "geocosicorr3d", name)
    points = s.metadata.frame_points[:5] if name == "SPOT5.DIM" else s.metadata.frame_points[:4]
    assert len(points) == (5 if name == "SPOT5.DIM" else 4)
    assert (points[0].line, points[0].sample) == (0.0, 0.0)  # FRAME_ROW 1, FRAME_COL 1
    ground = s.locate([p.line for p in points], [p.sample for p in points], height_m=0.0)
    missed = horizontal_m(ground, np.array([p.lon_deg for p in points]), np.array([p.lat_deg for p in points]))
    assert missed.max() <= FRAME_LIMIT_M[name]


@pytest.mark.oracle
@pytest.mark.parametrize("height_m", [0.0, 5000.0])
@pytest.mark.parametrize(
    "name", [f"geocosicorr3d/{n}" for n in [*V1_FILES, "SPOT6.XML"]] + [f"geoetrim-pleiades/{n}" for n in PLEIADES]
)
def test_round_trip_over_the_whole_scene(real_data: Path, name: str, height_m: float) -> None:
    """Located pixels lie on independent rays and project back within 1e-6 px, also with a correction."""
    s = sensor(real_data, name)
    line, sample = (
        a.ravel() for a in np.meshgrid(np.linspace(0, s.n_lines - 1, 25), np.linspace(0, s.n_samples - 1, 25))
    )
    rng = np.random.default_rng(3)
    sigma = np.repeat([[10.0, 1.0, 0.1], [1e-2, 1e-3, 1e-4], [5e-5, 1e-5, 2e-6]], 3, axis=0)
    for correction in (None, Correction(rng.normal(size=(9, 3)) * sigma, rng.normal(size=(2, 3)) * 1e-4)):
        ground = s.locate(line, sample, height_m=height_m, correction=correction)
        assert misses_m(s.metadata, line, sample, ground, correction).max() < 1e-7
        assert np.abs(GEODETIC.transform(*ground.T)[2] - height_m).max() < 1e-4
        l_back, s_back = s.project(ground, correction)
        assert np.abs(l_back - line).max() <= 1e-6
        assert np.abs(s_back - sample).max() <= 1e-6


@pytest.mark.truth
def test_spot5_equals_two_independent_programs(real_data: Path) -> None:
    """Located SPOT 5 pixels agree with Rugged within 1 cm and geoCosiCorr3D within 5 cm on the ellipsoid.

    The limits are explained in docs/equations.md 2.
    """
    s = sensor(real_data / "geocosicorr3d", "SPOT5.DIM")
    for name, limit, keys in (
        ("rugged_SPOT5_h0.csv", 0.01, ("line_1based", "col_1based", "lon_deg", "lat_deg")),
        ("geocosicorr3d_h0.csv", 0.05, ("row_1based", "col_1based", "lon", "lat")),
    ):
        rows = [
            r for r in read_rows(real_data / "reference-outputs" / name) if r.get("file", "SPOT5.DIM") == "SPOT5.DIM"
        ]
        line, sample, lon, lat = (np.array([float(r[k]) for r in rows]) for k in keys)
        assert len(rows) >= 8
        assert horizontal_m(s.locate(line - 1, sample - 1, height_m=0.0), lon, lat).max() <= limit


@pytest.mark.truth
def test_spot6_equals_an_independent_program(real_data: Path) -> None:
    """16 located SPOT 6 pixels agree with geoCosiCorr3D within 1 cm.

    They depend on sampled quaternions, times from START and the band calibration.
    """
    s = sensor(real_data / "geocosicorr3d", "SPOT6.XML")
    rows = [r for r in read_rows(real_data / "reference-outputs" / "geocosicorr3d_h0.csv") if r["file"] == "SPOT6.XML"]
    line, sample, lon, lat = (np.array([float(r[k]) for r in rows]) for k in ("row_1based", "col_1based", "lon", "lat"))
    assert len(rows) == 16
    assert horizontal_m(s.locate(line - 1, sample - 1, height_m=0.0), lon, lat).max() <= 0.01


RPC00B = ("1 L P H LP LH PH LL PP HH PLH LLL LPP LHH LLP PPP PHH LLH PPH HHH").split()


def rpc_project(
    path: Path, lon_deg: np.ndarray, lat_deg: np.ndarray, height_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the vendor RPC, written out here independently of the package: 1-based line and sample."""
    values = [float(text) for text in path.read_text().split()]
    offsets, scales, coefficients = values[:5], values[5:10], np.array(values[10:90]).reshape(4, 20)
    n = {
        "P": (lat_deg - offsets[2]) / scales[2], "L": (lon_deg - offsets[3]) / scales[3],
        "H": (height_m - offsets[4]) / scales[4],
    }  # fmt: skip
    terms = np.stack([np.prod([n[c] for c in term if c != "1"] + [np.ones_like(lon_deg)], axis=0) for term in RPC00B])
    line = coefficients[0] @ terms / (coefficients[1] @ terms) * scales[0] + offsets[0]
    sample = coefficients[2] @ terms / (coefficients[3] @ terms) * scales[1] + offsets[1]
    return line, sample


@pytest.mark.truth
def test_pleiades_equals_the_vendor_rpc(real_data: Path) -> None:
    """The rigorous model of Pléiades image 1 projects all 86 points as the vendor's RPC within 0.01 px."""
    folder = real_data / "geoetrim-pleiades"
    s = sensor(folder, PLEIADES[0])
    rows = read_rows(folder / "points_img1.csv")
    assert len(rows) == 86
    ground = np.array([[float(r[f"{axis}_ecef_m"]) for axis in "XYZ"] for r in rows])
    line, sample = s.project(ground)
    lon, lat, h = ellipsoid.geodetic_array(ground).T
    rpc_line, rpc_sample = rpc_project(folder / "PHR1A_img1_RPC.txt", np.degrees(lon), np.degrees(lat), h)
    assert np.abs(line + 1 - rpc_line).max() <= 0.01
    assert np.abs(sample + 1 - rpc_sample).max() <= 0.01
    observed = np.array([[float(r["line"]), float(r["col"])] for r in rows])
    assert abs(np.mean(rpc_sample - observed[:, 1])) == pytest.approx(16.3, abs=0.2)  # the known vendor bias


@pytest.mark.oracle
def test_eop_polynomials_and_their_residuals(real_data: Path) -> None:
    """EOP polynomials are numpy's fit, and a parabola leaves below 0.1 m of position and 1e-4 m/s of velocity."""
    s = sensor(real_data / "geocosicorr3d", "SPOT5.DIM")
    per_tau, residuals = fit_eop(s)
    largest = np.abs(residuals).max(axis=0)
    tau = np.linspace(-1.0, 1.0, 601)
    values = metadata_eop(s, (tau + 1.0) * (s.n_lines - 1) / 2)
    expected = np.polynomial.polynomial.polyfit(tau, values, 2)
    left = values - np.polynomial.polynomial.polyval(tau, expected).T
    assert np.abs(per_tau - expected.T).max() <= 1e-12 * np.abs(values).max()
    # a coordinate of 7e6 m has 1e-9 m
    assert np.abs(residuals - left).max() < 1e-8
    assert largest[:3].max() < 0.10
    assert largest[3:6].max() < 1e-4
    centre = metadata_eop(s, np.array([(s.n_lines - 1) / 2]))[0]
    assert np.abs(per_tau[:3, 0] - centre[:3]).max() < 0.10
    # the attitude of 8 Hz is not a parabola, so that its residual is not zero
    assert 1e-8 < largest[6:].max() < 1e-4


@pytest.mark.oracle
def test_v2_attitude_angles_rebuild_the_mounting(real_data: Path) -> None:
    s = sensor(real_data / "geoetrim-pleiades", PLEIADES[1])
    line = np.linspace(0, s.n_lines - 1, 7)
    roll, pitch, yaw = metadata_eop(s, line)[:, 6:].T
    turned = Rotation.from_euler("XYZ", np.stack([pitch, roll, yaw], axis=1)).as_matrix()
    assert np.abs(turned - s.states(line).mount).max() < 1e-12
