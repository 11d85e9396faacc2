"""RPC of real products are compared with GDAL, rpcm, shareloc and Xing; the tests check pixel origins."""

from __future__ import annotations

import csv
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from rasterio.errors import TransformWarning
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from factors.cameras import rfm
from factors.geometry import ellipsoid
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.formats.rpc import read_rpc, rpc_format
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.rpc_model import reference_project

pytestmark = pytest.mark.real_data

#: Files with RPC in the folder of real data, by pattern, and how many there are.
PATTERNS = {
    "rpcm/*[!d]": 8, "sat-bundleadjust/*.rpc*": 4, "s2p/*.xml": 5, "otb/*.geom": 16, "shareloc/*.geom": 7,
    "shareloc/*.XML": 5, "micmac-*/RPC_*": 4, "asp/*.RPB": 1, "geocosicorr3d/*_RPC.txt": 1,
    "geoetrim-pleiades/*_RPC.txt": 2,
}  # fmt: skip
#: Lists of numbers of the GeoEtrim group are those of DIMAP files, counted from 1.
FIRST_PIXEL = {"PHR1A_img1_RPC.txt": 1.0, "SPOT6_other_image_RPC.txt": 1.0}
#: Denominators change their sign inside the image; numerators have nearly the same zeros.
WITH_POLES = "sample.RPB"
#: Made with a program from a sensor; its denominators change their sign beside the image.
POLES_BESIDE = "apTvPrGenerateRPCSensorModelGeomOutput.geom"
#: The vendor's own model to the ground disagrees by 135 px with that to the image (scene of 135312 lines).
CONTRADICTORY = "RPC_PHR1A_P_202503191043438_SEN_7342362101-1.XML"


def files(folder: Path) -> list[Path]:
    """Return all RPC files."""
    found = []
    for pattern, count in PATTERNS.items():
        some = sorted(p for p in folder.glob(pattern) if p.suffix != ".md")
        assert len(some) == count, (pattern, some)
        found += some
    return found


def read(path: Path) -> RpcModel:
    return read_rpc(path, first_pixel=FIRST_PIXEL.get(path.name))


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def pixels_and_heights(model: RpcModel, n: int = 9, layers: int = 3) -> list[np.ndarray]:
    v = model.validity
    ends = (np.linspace(*v.line, n), np.linspace(*v.sample, n), np.linspace(*v.height_m, layers))
    return [a.ravel() for a in np.meshgrid(*ends)]


def transformer(model: RpcModel) -> RPCTransformer:
    values: dict[str, object] = {"err_bias": None, "err_rand": None}
    for k, axis in enumerate(("line", "samp", "long", "lat", "height")):
        values |= {f"{axis}_off": model.offsets[k], f"{axis}_scale": model.scales[k]}
    for name, row in zip(("line_num", "line_den", "samp_num", "samp_den"), model.coefficients, strict=True):
        values[f"{name}_coeff"] = list(row)
    return RPCTransformer(RPC(**values))


def metres(lon: np.ndarray, lat: np.ndarray, lon_2: np.ndarray, lat_2: np.ndarray) -> np.ndarray:
    return np.hypot(np.radians(lon - lon_2) * 6378137.0 * np.cos(np.radians(lat)), np.radians(lat - lat_2) * 6371000.0)


@pytest.mark.truth
def test_every_file_is_read_and_equals_gdal(real_data: Path) -> None:
    """Each real RPC projects 2000 points of its range as GDAL does, within 1e-6 px.

    GDAL counts from the corner, 0.5 px.
    """
    rng = np.random.default_rng(1)
    worst = 0.0
    for path in files(real_data):
        assert rpc_format(path) is not None, path
        model = read(path)
        lon, lat, h = model.offsets[2:, None] + model.scales[2:, None] * rng.uniform(-1.0, 1.0, (3, 2000))
        if path.name == WITH_POLES:  # rounding grows without bound towards a pole
            u = np.stack([lon, lat, h], axis=1)
            n = (u - model.offsets[2:]) / model.scales[2:]
            far = np.abs(rfm.denominators(model.coefficients, n)).min(axis=1) > 0.01
            lon, lat, h = lon[far], lat[far], h[far]
        line, sample = model.project(lon, lat, h)
        with transformer(model) as peer:
            row, column = peer.rowcol(lon, lat, h, op=np.positive)
        off = max(np.abs(row - 0.5 - line).max(), np.abs(column - 0.5 - sample).max())
        assert off <= 1e-6, (path, off)
        worst = max(worst, off)
    print(f"largest difference from GDAL: {worst:.1e} px")


@pytest.mark.truth
def test_located_points_equal_gdal_within_its_tolerance(real_data: Path) -> None:
    """Points located by GDAL project to their pixel within 0.1 px, GDAL's tolerance, and lie near ours.

    GDAL fails at some points near poles.
    """
    for path in files(real_data):
        model = read(path)
        line, sample, h = pixels_and_heights(model)
        with transformer(model) as peer, warnings.catch_warnings():
            if path.name in (WITH_POLES, POLES_BESIDE):
                warnings.simplefilter("ignore", TransformWarning)
            theirs = np.stack(peer.xy(line, sample, h, offset="center"))
        found = np.isfinite(theirs[0]) & np.isfinite(model.locate(line, sample, h)[0])
        line, sample, h, theirs = line[found], sample[found], h[found], theirs[:, found]
        off = np.abs(np.stack(model.project(*theirs, h)) - [line, sample]).max()
        metre = metres(*model.locate(line, sample, h), *theirs).max()
        print(f"{path.name}: GDAL's located points are off by {off:.3f} px, {metre:.1e} m ({found.mean():.0%} found)")
        assert off < 0.1, path
        assert metre < 2.0 or path.name == WITH_POLES  # 0.1 px of the coarsest product


@pytest.mark.oracle
def test_located_points_project_to_their_pixels(real_data: Path) -> None:
    """Located points of each real RPC project to their pixels within 1e-6 px over image and height range.

    The model with poles does so only for pixels that have ground.
    """
    worst = 0.0
    for path in files(real_data):
        model = read(path)
        line, sample, h = pixels_and_heights(model)
        lon, lat = model.locate(line, sample, h)
        back = np.array(reference_project(model, lon, lat, h), float) - [line, sample]
        if path.name == WITH_POLES:
            share = np.isfinite(lon).mean()
            print(f"{path.name}: {share:.0%} of the pixels located")
            assert share > 0.8
            back = back[:, np.isfinite(lon)]
        else:
            RpcSensor(model)
        assert np.abs(back).max() <= 1e-6, path
        worst = max(worst, float(np.abs(back).max()))
    print(f"largest round trip: {worst:.1e} px")


@pytest.mark.behaviour
def test_the_file_with_poles_is_refused_as_a_sensor(real_data: Path) -> None:
    with pytest.raises(InputError, match=r"denominator: the denominator is not positive everywhere"):
        read_sensor(real_data / "asp" / WITH_POLES)


@pytest.mark.truth
def test_rpcm_projects_alike(real_data: Path) -> None:
    """Each RPC projects as rpcm within the rounding of the printed points, and locates within 1e-6 m.

    The points are printed to 1e-10 degree and 0.1 mm; rpcm counts SPOT 6/7 from 1. The tolerance of rpcm's own located
    points is printed only.
    """
    rows = defaultdict(list)
    for r in read_rows(real_data / "reference-outputs" / "rpcm_projection.csv"):
        keys = ("lon", "lat", "h_m", "col", "row", "loc_lon", "loc_lat")
        rows[r["file"]].append([float(r[k]) for k in keys])
    assert len(rows) == 24
    for name, values in rows.items():
        model = read_rpc(real_data / name)
        lon, lat, h, column, row, their_lon, their_lat = np.array(values).T
        one = 1.0 if model.format.endswith(("S6_SENSOR", "S7_SENSOR")) else 0.0
        line, sample = model.project(lon, lat, h)
        n = (np.stack([lon, lat, h], axis=1) - model.offsets[2:]) / model.scales[2:]
        half_digit = np.array([0.5e-10, 0.5e-10, 0.5e-4]) / np.abs(model.scales[2:])
        c = model.coefficients
        by_ground = np.array([rfm.ground_derivatives(c, *at, *rfm.value(c, *at)) for at in n])
        limit = np.abs(by_ground) @ half_digit * np.abs(model.scales[:2]) + 1e-8
        off = np.stack([line - one - row, sample - one - column], axis=1)
        assert np.all(np.abs(off) <= limit), name
        back = metres(*model.locate(line, sample, h), lon, lat)
        assert back.max() < 1e-6
        print(f"{name}: rpcm's located points are off by {np.nanmax(metres(their_lon, their_lat, lon, lat)):.1e} m")


@pytest.mark.truth
def test_shareloc_locates_alike(real_data: Path) -> None:
    """Located points agree with shareloc's RPC within 2e-6 m and with the physical grid within 2 cm.

    Its file has 11 digits; shareloc counts from the corner, 0.5 px.
    """
    model = read_rpc(real_data / "shareloc" / "PHRDIMAP_P1BP--2018122638935449CP.XML")
    rows = read_rows(real_data / "reference-outputs" / "shareloc_P1BP--2018122638935449CP.csv")
    keys = ("row", "col", "h_m", "rpc_lon", "rpc_lat", "grid_lon", "grid_lat")
    row, column, h, lon, lat, grid_lon, grid_lat = np.array([[float(r[k]) for k in keys] for r in rows]).T
    found = model.locate(row - 0.5, column - 0.5, h)
    assert metres(*found, lon, lat).max() < 2e-6
    grid = metres(*found, grid_lon, grid_lat).max()
    direct = metres(*model.locate_directly(row - 0.5, column - 0.5, h), lon, lat).max()
    print(f"shareloc's physical grid: {grid:.4f} m; the file's model to the ground: {direct:.4f} m")
    assert grid < 0.02
    assert direct < 0.02


@pytest.mark.truth
@pytest.mark.parametrize("image", ["1A", "1B"])
def test_spot7_equals_xing(real_data: Path, image: str) -> None:
    """The SPOT 7 RPC projects 18 points as IGN's program Xing within 1e-3 px, at heights of 922 and 2190 m.

    Xing uses the pixels of the file unchanged.
    """
    model = read_rpc(real_data / "micmac-spot7-rpc" / f"RPC_{image}.xml")
    text = (real_data / "micmac-spot7-rpc" / f"verif_{image}.txt").read_text("latin-1")
    rows = [line.split()[1:] for line in text.splitlines() if line.startswith("<Pt>")]
    row, column, lon, lat, h = np.array(rows, float).T
    assert len(row) == 18
    line, sample = model.project(lon, lat, h)
    assert max(np.abs(line - row).max(), np.abs(sample - column).max()) < 1e-3
    assert metres(*model.locate(row, column, h), lon, lat).max() < 0.01


@pytest.mark.truth
def test_dimap_models_agree_with_their_own_model_to_the_ground(real_data: Path) -> None:
    """Both directions of each DIMAP RPC agree within 0.03 px; the file that differs by over 100 px has a note."""
    checked = 0
    for path in files(real_data):
        model = read(path)
        if model.direct is None:
            continue
        line, sample, h = pixels_and_heights(model)
        back = np.stack(model.project(*model.locate_directly(line, sample, h), h)) - [line, sample]
        worst = np.abs(back).max(axis=1)
        print(f"{path.name}: line {worst[0]:.4f}, sample {worst[1]:.4f} px")
        assert any("differ by up to" in str(note) for note in model.notes) == (path.name == CONTRADICTORY)
        if path.name == CONTRADICTORY:
            assert worst.max() > 100.0
        else:
            assert worst.max() < 0.03, path
            checked += 1
    assert checked == 15


# --- pixel origins (docs/rpc.md) -------------------------------------------------------------


@pytest.mark.truth
def test_origin_of_pleiades_is_that_of_the_rigorous_model(real_data: Path) -> None:
    """The Pléiades RPC counted from 1 agrees with the rigorous model within 0.01 px at 86 points."""
    folder = real_data / "geoetrim-pleiades"
    rigorous = PushbroomSensor(read_dimap(folder / "DIM_PHR1A_derived_img1.XML"))
    rpc = RpcSensor(read(folder / "PHR1A_img1_RPC.txt"))
    rows = read_rows(folder / "points_img1.csv")
    ground = np.array([[float(r[f"{axis}_ecef_m"]) for axis in "XYZ"] for r in rows])
    assert len(ground) == 86
    off = np.stack(rpc.project(ground)) - np.stack(rigorous.project(ground))
    assert np.abs(off).max() <= 0.01


def spot6_frame(path: Path) -> list[tuple[float, float, float, float]]:
    """Return line and sample (from 0), longitude and latitude of the corners that the product states."""
    cells = dict(line.split(":", 1) for line in path.read_text("latin-1").splitlines() if ":" in line)
    lines, samples = (float(cells[k]) - 1.0 for k in ("number_lines", "number_samples"))
    corners = {"ul": (0.0, 0.0), "ur": (0.0, samples), "lr": (lines, samples), "ll": (lines, 0.0)}
    points = []
    for name, (line, sample) in corners.items():
        lat, lon = (float(v) for v in cells[f"support_data.{name}_ground_point"].split()[:2])
        points.append((line, sample, lon, lat))
    return points


@pytest.mark.truth
def test_frame_points_of_spot6_lie_at_one_height_and_count_from_1(real_data: Path) -> None:
    """The SPOT 6 model locates the file's vertices within 5 cm at 836.49 m if (1, 1) is the first pixel."""
    s = PushbroomSensor(read_dimap(real_data / "geocosicorr3d" / "SPOT6.XML"))
    points = s.metadata.frame_points
    assert (points[0].line, points[0].sample) == (0.0, 0.0)
    ground = s.locate([p.line for p in points], [p.sample for p in points], height_m=836.49)
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(ground)).T
    missed = metres(lon, lat, np.array([p.lon_deg for p in points]), np.array([p.lat_deg for p in points]))
    assert len(missed) >= 5
    assert missed.max() < 0.05  # 0.02 px


@pytest.mark.truth
@pytest.mark.parametrize("name", ["spot6-1.geom", "spot6-2.geom"])
def test_origin_of_spot6_is_the_first_pixel_as_0(real_data: Path, name: str) -> None:
    """The corners of a SPOT 6 product fit its RPC with a shift below 0.05 px if the first pixel is 0.

    One common height and one shift are unknowns. Counting from 1 would give 1 px.
    """
    model = read_rpc(real_data / "otb" / name)
    line, sample, lon, lat = np.array(spot6_frame(real_data / "otb" / name)).T
    x = np.array([200.0, 0.0, 0.0])  # height, shift of line and sample
    for _ in range(5):
        r = np.concatenate(model.project(lon, lat, x[0])) - np.concatenate([line, sample]) - np.repeat(x[1:], 4)
        by_height = np.concatenate(model.project(lon, lat, x[0] + 1.0)) - np.concatenate(model.project(lon, lat, x[0]))
        a = np.stack([-by_height, np.repeat([1.0, 0.0], 4), np.repeat([0.0, 1.0], 4)], axis=1)
        x = x + np.linalg.lstsq(a, r, rcond=None)[0]
    assert np.abs(r).max() < 0.01
    print(f"{name}: height {x[0]:.2f} m, shift {x[1]:.4f}, {x[2]:.4f} px")
    assert np.abs(x[1:]).max() < 0.05


@pytest.mark.truth
def test_origin_of_pleiades_neo_by_its_own_domain(real_data: Path) -> None:
    """The valid lines of Pléiades Neo start at 0, and -1 .. 1 of the model spans first to last centre."""
    for path in sorted((real_data / "micmac-pneo-pair").glob("RPC_*")):
        model = read_rpc(path)
        assert model.validity.line == (0.0, 2.0 * model.scales[0])
        assert model.offsets[:2].tolist() == model.scales[:2].tolist()
        assert model.n_lines is None


@pytest.mark.truth
def test_ossim_lists_of_pleiades_count_from_0(real_data: Path) -> None:
    """The RPC of one Pléiades product as DIMAP and as OSSIM list are equal after the origin is subtracted."""
    folder = real_data / "shareloc"
    ours = read_rpc(folder / "RPC_PHR1B_P_201308051042194_SEN_690908101-001.XML")
    ossim = read_rpc(folder / "left_image.geom")
    assert np.allclose(ours.offsets, ossim.offsets, rtol=1e-12)
    assert np.allclose(ours.coefficients, ossim.coefficients, rtol=1e-12, atol=1e-18)


# --- a model that does not belong to its points -----------------------------------------------


@pytest.mark.truth
def test_rpc_of_another_image_shows_by_its_misfit(real_data: Path) -> None:
    """The RPC of another SPOT 6 image misfits by over 200 px per kilometre of height.

    A shift or drift of the image could not do that: the RPC looks from another direction.
    """
    folder = real_data / "geoetrim-pleiades"
    model = read(folder / "SPOT6_other_image_RPC.txt")
    rows = np.loadtxt(folder / "SPOT6_201805150822087_GCP_WGS84_blh.gcp")
    assert rows.shape == (99, 6)
    row, column, lat, lon, h = rows.T[1:]
    misfit = np.stack(model.project(lon, lat, h)) - [row, column]
    design = np.stack([np.ones(99), row / 1e4, column / 1e4, h / 1e3], axis=1)
    per_km = np.linalg.lstsq(design, misfit.T, rcond=None)[0][3]
    print(
        f"median misfit {np.median(np.hypot(*misfit)):.0f} px, with the height {per_km.round(0)} px/km (line, sample)"
    )
    assert np.hypot(*per_km) > 200.0
