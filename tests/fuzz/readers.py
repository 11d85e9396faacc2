"""The module lists public readers with the files that fuzzing begins with."""

from __future__ import annotations

import os
import re
import shutil
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

UTM: Final = "EPSG:32636"
Make = Callable[[Path], object]


@dataclass(frozen=True)
class Reader:
    """Reader of a folder of files.

    Parameters
    ----------
    name : str
    make : callable
        Writes the files into an empty folder.
    read : callable
        Reads them from the folder.
    only : str
        Pattern of the names of the files that are changed.
    """

    name: str
    make: Make
    read: Callable[[Path], object]
    only: str = ""

    def changes(self, name: str) -> bool:
        """Return whether a file is one of those that are changed."""
        return re.search(self.only, name) is not None


@cache
def _form(name: str) -> Any:
    """Return the format of points; a search through all modules would take most of the time."""
    from fg_orient.formats.registry import formats

    return formats()[name]


# --- points and bundles -------------------------------------------------------------------------------


def _exchange(
    name: str, paths: Sequence[str], makes: Iterable[Make], crs: str = "", sized: Sequence[str] = ()
) -> Reader:  # fmt: skip
    """Return the reader of a format of points or bundles, and of its frame model; ``sized``: images without a size."""

    def read(folder: Path) -> None:
        from fg_orient.formats.exchange.convert import read_survey
        from fg_orient.formats.registry import Holds, Settings
        from fg_orient.model.errors import FgOrientError

        form = _form(name)
        files = tuple(folder / path for path in paths)
        image = "left.tif" if Holds.IMAGE in form.holds and Holds.IMAGES not in form.holds else ""
        sizes = dict.fromkeys(sized, (3000, 4000))
        settings = Settings(crs=crs, image=image, image_sizes=sizes, incomplete=True)
        try:
            if form.read_model is not None:
                form.read_model(files, settings)
        except FgOrientError:
            pass
        read_survey(files, form, settings, accept_unverified=True)

    def make(folder: Path) -> None:
        for one in makes:
            one(folder)

    return Reader(name, make, read)


def _written(name: str, suffix: str, crs: str = UTM) -> Make:
    """Write a random survey in a format."""

    def make(folder: Path) -> None:
        from fg_orient.formats.exchange.convert import write_survey
        from fg_orient.formats.registry import Settings
        from tests.support.survey import random_survey

        form = _form(name)
        survey = random_survey(np.random.default_rng(1), form, form.crs or crs, plain=True)
        sizes = dict.fromkeys(survey.images, (12000, 12000))
        write_survey(survey, [folder / f"seed{suffix}"], form, Settings(image_sizes=sizes), overwrite=True)

    return make


def _page(page: str) -> Make:
    def make(folder: Path) -> None:
        from tests.support.format_files import FORMAT_FILES

        for one in FORMAT_FILES[page]:
            one(folder)

    return make


def _bal(folder: Path) -> None:
    """Write a problem plain and packed."""
    import gzip

    _page("bal")(folder)
    packed = folder / "problem-49-7776-pre.txt.gz"
    (folder / "plain.txt").write_bytes(gzip.decompress(packed.read_bytes()))


def _planetary(folder: Path) -> None:
    """Write image support data, labels, states and a network of frames above the Moon."""
    from fg_orient.formats.metadata.csm_frame import write_state
    from fg_orient.formats.metadata.isd import read_isd
    from tests.support.planetary_files import write_block

    names = write_block(folder, n_images=2, n_points=4)
    write_state(folder / "state.json", read_isd(folder / f"{names[0]}.isd"))


def _mars(folder: Path) -> None:
    """Write image support data of a line-scan image of Mars."""
    import json

    from tests.support.isd_lines import simulated

    (folder / "lines.json").write_text(json.dumps(simulated(lines=200, samples=50)), encoding="utf-8")


def _points() -> list[Reader]:
    return [
        _exchange("asp-gcp", ["points.gcp"], [_page("asp-gcp")], "EPSG:4979"),
        _exchange("asp-match", ["run"], [_page("asp-match")]),
        replace(_exchange("bal", ["plain.txt"], [_bal], sized="01"), only="plain"),
        replace(_exchange("bal", ["problem-49-7776-pre.txt.gz"], [_bal], sized="01"), name="bal-packed", only="gz"),
        _exchange("bundler", ["bundle.out", "list.txt"], [_page("bundler")], sized=["left.jpg", "right.jpg"]),
        _exchange("colmap-database", ["database.db"], [_page("colmap-database")]),
        _exchange("colmap-text", ["sparse/0"], [_page("colmap-text")]),
        _exchange("csv", ["points.csv", "observations.csv"], [_page("csv")], UTM),
        _exchange("dbat", ["markpts.txt", "control.txt"], [_page("dbat")], UTM),
        _exchange("geojson", ["seed.geojson"], [_written("geojson", ".geojson")]),
        _exchange("gpkg", ["seed.gpkg"], [_written("gpkg", ".gpkg")], UTM),
        replace(_exchange("isis-network", ["net.pvl"], [_planetary]), only="net"),
        _exchange("libmv", ["problem_01.bin"], [_page("libmv")]),
        _exchange("metashape-csv", ["markers.csv"], [_page("metashape-csv")]),
        _exchange("metashape-xml", ["markers.xml"], [_page("metashape-xml")]),
        _exchange("micmac", ["gcp.txt", "gcp_images.txt"], [_page("micmac")], UTM),
        _exchange("micmac-ties", ["MulTieP/V1"], [_page("micmac-ties")]),
        _exchange("odm", ["gcp_list.txt"], [_page("odm")]),
        _exchange("photomodeler", ["pmexport.txt"], [_page("photomodeler")]),
        _exchange("pix4d", ["gcp.csv", "marks.csv"], [_page("pix4d")], UTM),
        _exchange("qgis-points", ["scene.tif.points"], [_page("qgis-points")]),
        _exchange("sba", ["7cams.txt", "7pts.txt", "calib.txt"], [_page("sba")]),
    ]


# --- RPC and image metadata ----------------------------------------------------------------------------


def _rpc(name: str, file: str, make: Make | None = None) -> Reader:
    def write(folder: Path) -> None:
        from fg_orient.formats.rpc import write_rpc
        from tests.support.rpc_model import synthetic_model

        write_rpc(folder / file, synthetic_model())

    def read(folder: Path) -> None:
        from fg_orient.formats.rpc import read_rpc
        from fg_orient.formats.sensor import read_sensor

        read_rpc(folder / file, first_pixel=0.0)
        if file != "rpc.txt":
            read_sensor(folder / file, model="rpc")

    return Reader(name, make or write, read, only=re.escape(file))


def _tags(folder: Path) -> None:
    """Write a small GeoTIFF with RPC tags, and a virtual raster of it."""
    from fg_orient.formats.rpc.gdal import write_rpc_copy, write_rpc_raster
    from tests.support.page_files import write_image
    from tests.support.rpc_model import synthetic_model

    model = replace(synthetic_model(), n_lines=64, n_samples=64)
    write_image(folder / "scene.tif", 64, 64)
    write_rpc_raster(folder / "scene.tif", model)
    write_rpc_copy(folder / "scene.vrt", model, folder / "scene.tif")


def _list(folder: Path) -> None:
    """Write the numbers of a model, one a line."""
    from fg_orient.formats.rpc.fields import texts_of
    from tests.support.rpc_model import synthetic_model

    words = " ".join(text for name, text in texts_of(synthetic_model()).items() if not name.startswith("ERR")).split()
    (folder / "rpc.txt").write_text("\n".join(words) + "\n", "utf-8")


def _geom(folder: Path) -> None:
    from fg_orient.formats.registry import formats
    from tests.support.rpc_model import synthetic_model

    write = formats("rpc")["ossim-geom"].write_rpc
    assert write is not None
    write(folder / "scene.geom", synthetic_model())


def _real(*patterns: str) -> Make:
    """Copy a real file, the first that is there; without the folder of real data there is none."""

    def make(folder: Path) -> None:
        root = Path(os.environ.get("FG_ORIENT_REAL_DATA", ""))
        for k, pattern in enumerate(patterns):
            for path in sorted(root.glob(pattern))[:1] if root.is_dir() else ():
                shutil.copyfile(path, folder / f"real{k}{path.suffix}")
                (folder / f"real{k}{path.suffix}").chmod(0o644)

    return make


def _sensor_file(name: str, make: Make, only: str, file: str) -> Reader:
    def read(folder: Path) -> None:
        from fg_orient.formats.metadata.dimap import read_dimap
        from fg_orient.formats.sensor import read_sensor

        if file.startswith("DIM_"):
            read_dimap(folder / file)
        sensor = read_sensor(folder / file)
        if not file.startswith("frame"):
            sensor.locate(np.array([1.0]), np.array([2.0]), height_m=100.0)

    return Reader(name, make, read, only=only)


def _dimap1(folder: Path) -> None:
    from fg_orient.formats.dimap_write import write_dimap1
    from tests.support.small_metadata import spot5

    write_dimap1(folder / "METADATA.DIM", spot5())


def _dimap2(folder: Path) -> None:
    from tests.support.dimap2_files import write_dimap2
    from tests.support.small_metadata import pleiades

    write_dimap2(folder / "DIM_PHR.XML", _wide(pleiades()))


def _wide(metadata: Any) -> Any:
    """Return the metadata with a field of view of 1.6e-4 rad: that of 24 real detectors is refused as too small."""
    return replace(metadata, look=replace(metadata.look, tan_psi_y=np.array([-0.014222, 7.113e-6])))


def _dimap6(folder: Path) -> None:
    from tests.support.dimap2_files import write_dimap2
    from tests.support.small_metadata import spot6

    metadata = _wide(spot6())
    x = 0.01 * np.arange(-2.0, 3.0)  # the rays of small_metadata.spot6 do not meet the Earth: these look down
    q = np.stack([0.5 + 0.1 * x, 0.5 - 0.1 * x, -0.5 + 0.2 * x, 0.5 + 0.2 * x], axis=1)
    q /= np.linalg.norm(q, axis=1)[:, None]
    write_dimap2(folder / "DIM_SPOT6.XML", replace(metadata, attitude=replace(metadata.attitude, quaternion=q)))


def _pushbroom(folder: Path) -> None:
    from fg_orient.sensors.pushbroom import PushbroomSensor
    from tests.support.sensor_description import describe
    from tests.support.small_metadata import spot5

    path = describe(PushbroomSensor(spot5()), folder)
    if path.name != "sensor.toml":
        path.rename(folder / "sensor.toml")


def _frame(folder: Path) -> None:
    from fg_orient.formats.metadata.frame import write_camera, write_frame_file
    from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
    from fg_orient.sensors.frame import FrameSensor
    from fg_orient.sensors.interior import Interior

    inside = Interior(
        3000, 4000, 4000.0, np.array([1510.0, 1990.0]), np.array([-0.04, 0.01, 0.0, 2e-4, -1e-4]), name="one"
    )
    write_camera(folder / "camera.toml", inside)
    turn, centre = enu_from_ecef(31.8, 41.4)[0], geodetic_to_ecef(31.8, 41.4, 1500.0)[0]
    write_frame_file(folder / "frame.toml", FrameSensor(inside.camera(turn, centre), 3000, 4000), "camera.toml")


def _isd(folder: Path) -> None:
    from tests.support.isd_files import write_isd

    write_isd(folder)


def _aster(folder: Path) -> None:
    from tests.support.lattice_files import write_aster

    write_aster(folder)


def _lattice(folder: Path) -> None:
    from tests.support.lattice_files import write_description

    write_description(folder)


def _line_scan(folder: Path) -> None:
    from fg_orient.formats.csm_write import write_state
    from fg_orient.formats.sensor import read_sensor
    from tests.support.isd_files import write_isd

    source = write_isd(folder)
    write_state(folder / "state.json", read_sensor(source))
    source.unlink()


def _metashape_camera(folder: Path) -> None:
    text = """<document version="2.0"><chunk><sensors><sensor id="0" label="camera" type="frame">
<resolution width="6000" height="4000"/><property name="pixel_width" value="0.004"/>
<property name="pixel_height" value="0.004"/><calibration type="frame" class="adjusted">
<resolution width="6000" height="4000"/>
<f>8000.5</f><cx>1.5</cx><cy>-2.5</cy><k1>-0.05</k1><k2>0.01</k2><p1>1e-4</p1><p2>-1e-4</p2></calibration>
<covariance><params>f cx cy k1</params><coeffs>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</coeffs></covariance>
</sensor></sensors></chunk></document>"""
    (folder / "cameras.xml").write_text(text, "utf-8")


def _read_metashape_camera(folder: Path) -> None:
    from fg_orient.formats.metadata.metashape_camera import read_metashape_camera

    read_metashape_camera(folder / "cameras.xml")


def _metadata() -> list[Reader]:
    return [
        _rpc("rpc-txt", "scene_RPC.TXT"), _rpc("rpb", "scene.RPB"), _rpc("rpc-dimap", "RPC_PHR.XML"),
        _rpc("rpc-list", "rpc.txt", _list), _rpc("ossim-geom", "scene.geom", _geom),
        _rpc("rpc-tiff", "scene.tif", _tags), _rpc("rpc-vrt", "scene.vrt", _tags),
        _sensor_file("dimap1", _dimap1, "", "METADATA.DIM"), _sensor_file("dimap2", _dimap2, "", "DIM_PHR.XML"),
        _sensor_file("dimap-spot6", _dimap6, "", "DIM_SPOT6.XML"),
        _sensor_file("pushbroom", _pushbroom, "", "sensor.toml"), _sensor_file("frame", _frame, "", "frame.toml"),
        _sensor_file("isd", _planetary, "M-0000", "M-0000.isd"),
        _sensor_file("isd-lines", _mars, "", "lines.json"),
        _sensor_file("csm-frame", _planetary, "state", "state.json"),
        _sensor_file("digitalglobe", _isd, "", "scene.XML"), _sensor_file("aster", _aster, "", "band.xml"),
        _sensor_file("lattice", _lattice, "", "lattice.toml"),
        _sensor_file("csm-line-scan", _line_scan, "", "state.json"),
        Reader("metashape-camera", _metashape_camera, _read_metashape_camera),
    ]  # fmt: skip


# --- projects and tables ---------------------------------------------------------------------------------


def _project(folder: Path) -> None:
    """Write a block of two RPC images with all tables that a project can have."""
    from tests.support.rpc_block import rpc_twin, write_folder

    path = write_folder(folder / "project", rpc_twin("shift"))
    for name in ("points.csv", "observations.csv"):
        lines = (path.parent / name).read_text("utf-8").splitlines()
        ids = {f"{k:02d}" for k in range(1, 9)}
        kept = [
            line for line in lines if line.startswith("#") or not ids.isdisjoint(line.split(",")[:2]) or "id," in line
        ]
        (path.parent / name).write_text("\n".join(kept) + "\n", "utf-8")
    text = path.read_text("utf-8") + _MORE
    path.write_text(text, "utf-8")


_MORE: Final = """
[[constraints]]
kind = "distance"
members = ["01", "02"]
value_m = 1000.0
sigma = 5.0
"""


def _read_project(folder: Path) -> None:
    from fg_orient.formats.project import read_project

    read_project(folder / "project" / "project.toml")


def _binary_tables(folder: Path) -> None:
    """Write the tables of a project as Parquet and Arrow."""
    from fg_orient.formats.table_write import write_table

    columns = {
        "id": ["a", "b", "c"], "role": ["control", "tie", "check"], "lon_deg": [31.8, np.nan, 31.9],
        "lat_deg": [41.2, np.nan, 41.3], "height_m": [1.0, np.nan, 2.0], "sigma_east_m": [0.1, np.nan, 0.2],
        "sigma_north_m": [0.1, np.nan, 0.2], "sigma_up_m": [0.1, np.nan, 0.2],
    }  # fmt: skip
    for end in ("parquet", "arrow"):
        write_table(folder / f"points.{end}", columns)


def _read_binary(end: str) -> Callable[[Path], object]:
    def read(folder: Path) -> None:
        from fg_orient.formats.faults import Faults
        from fg_orient.formats.points import read_points

        faults = Faults(end)
        read_points(folder / f"points.{end}", "EPSG:4979", faults)
        faults.raise_if_any()

    return read


def _tables(folder: Path) -> None:
    """Write tables of the other commands."""
    from tests.support.page_files import map_points, photos_and_control, surface_points

    for name, make in (("map", map_points), ("photos", photos_and_control), ("surface", surface_points)):
        (folder / name).mkdir()
        make(folder / name)
    (folder / "model.csv").write_text(_MODEL, "utf-8")
    for path in folder.rglob("*.tif"):
        path.unlink()
    (folder / "navigation.csv").write_text(_NAVIGATION, "utf-8")
    (folder / "features.csv").write_text(_FEATURES, "utf-8")
    (folder / "line_points.csv").write_text(_LINE_POINTS, "utf-8")
    (folder / "measured.csv").write_text(_MEASURED, "utf-8")


_NAVIGATION: Final = (
    "image,strip,time_s,easting_m,northing_m,height_m,sigma_east_m,sigma_north_m,sigma_up_m,roll_deg,"
    "pitch_deg,heading_deg,sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg\n"
    "a,1,0.0,400000,4580000,1500,0.1,0.1,0.1,0.1,0.2,90,0.01,0.01,0.01\n"
)
_FEATURES: Final = """feature,lon_deg,lat_deg,height_m,sigma_across_m,sigma_up_m,kind
r,31.8,41.3,10,0.1,0.1,line
r,31.81,41.31,11,0.1,0.1,line
"""
_LINE_POINTS: Final = "image,feature,line,sample,sigma_line_px,sigma_sample_px\nleft,r,100,200,0.5,0.5\n"
_MODEL: Final = "id,x,y,z\na,1.5,2.5,0.25\nb,3.5,-4.5,1e-3\nc,0,7,1\n"
_MEASURED: Final = (
    "id,line,sample,lon_deg,lat_deg,height_m,role\n1,10,20,31.8,41.3,100,control\n2,30,40,31.9,41.4,50,check\n"
)


def _each(*reads: Callable[[], object]) -> None:
    """Call each function, also after an FgOrientError of another one; raise the first error at the end."""
    from fg_orient.model.errors import FgOrientError

    errors = []
    for read in reads:
        try:
            read()
        except FgOrientError as error:
            errors.append(error)
    for error in errors[:1]:
        raise error


def _read_tables(folder: Path) -> None:
    from fg_orient.closerange.files import read_control, read_ground_points, read_image_points, read_model_points
    from fg_orient.formats.lines import read_features, read_line_points
    from fg_orient.formats.navigation import read_navigation
    from fg_orient.rectification.points import read_map_points
    from fg_orient.rpc.points import read_measured

    _each(
        lambda: read_map_points(folder / "map" / "points.csv", UTM),
        lambda: read_control(folder / "photos" / "control.csv"),
        lambda: read_image_points(folder / "photos" / "image.csv"),
        lambda: read_ground_points(folder / "photos" / "ground.csv"),
        lambda: read_ground_points(folder / "surface" / "points.csv"), lambda: read_model_points(folder / "model.csv"),
        lambda: read_navigation(folder / "navigation.csv", UTM),
        lambda: read_features(folder / "features.csv", "EPSG:4979"),
        lambda: read_line_points(folder / "line_points.csv"), lambda: read_measured(folder / "measured.csv"),
    )  # fmt: skip


def _closerange_toml(folder: Path) -> None:
    from tests.support.page_files import photos_and_control

    photos_and_control(folder)
    for name in ("image.csv", "control.csv", "ground.csv"):
        (folder / name).unlink()
    (folder / "oriented.toml").write_text(_ORIENTED, "utf-8")


_ORIENTED: Final = """schema = 1

[[photos]]
name = "left"
focal = 60.0
principal = [0.01, -0.02]
rotation = [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.0, 0.8, 0.6]]
centre_m = [10.0, 20.0, 2.0]

[[photos]]
name = "right"
matrix = [[60.0, 0.0, 0.0, 1.0], [0.0, 60.0, 0.0, -2.0], [0.0, 0.0, -1.0, 5.0]]
origin_m = [10.0, 25.0, 2.0]
"""


def _read_closerange_toml(folder: Path) -> None:
    from fg_orient.closerange.files import interiors, oriented_photos
    from fg_orient.formats.closerange import read_photos
    from fg_orient.formats.schema import read_constraints

    _each(lambda: interiors(read_photos(folder / "cameras.toml")),
          lambda: oriented_photos(read_photos(folder / "oriented.toml")),
          lambda: read_constraints(folder / "constraints.toml"))  # fmt: skip


def _lines_package(folder: Path) -> None:
    import pyogrio
    import shapely

    from fg_orient.formats.gdal import plain_case
    from fg_orient.formats.lines import LAYER

    shape = shapely.to_wkb(np.array([shapely.LineString([[31.8, 41.3, 1.0], [31.9, 41.4, 2.0]])]))
    fields = {"feature": np.array(["r"], object), "sigma_across_m": np.array([0.1]), "sigma_up_m": np.array([0.1])}
    with plain_case():
        pyogrio.raw.write(folder / "lines.gpkg", shape, list(fields.values()), list(fields), layer=LAYER, driver="GPKG",
                          geometry_type="LineString Z", crs="EPSG:4979")  # fmt: skip


def _read_lines_package(folder: Path) -> None:
    from fg_orient.formats.lines import read_features

    read_features(folder / "lines.gpkg", "EPSG:4979")


def _workbook(kind: str) -> Reader:
    grid = [["id", "E", "N", "H"], *([f"P{k}", 400000.5 + k, 4580000.25 - k, 100.0 + k] for k in range(12))]

    def make(folder: Path) -> None:
        from tests.support.office import write_ods, write_xlsx

        (write_ods if kind == "ods" else write_xlsx)(folder / f"a.{kind}", sheet=grid)

    def read(folder: Path) -> None:
        from fg_orient.formats.office.sheets import read_sheets

        read_sheets(folder / f"a.{kind}")

    return Reader(kind, make, read)


def _office_text(folder: Path) -> None:
    rows = ["Nokta;Doğu;Kuzey;Kot", *(f"P{k};{400000 + k},25;{4580000 - k},5;{100 + k},1" for k in range(12))]
    (folder / "a.csv").write_bytes("\r\n".join(rows).encode("cp1254"))


def _read_office_text(folder: Path) -> None:
    from fg_orient.formats.office.sheets import read_sheets

    read_sheets(folder / "a.csv")


def _office_layer(folder: Path) -> None:
    _written("gpkg", ".gpkg")(folder)


def _read_office_layer(folder: Path) -> None:
    from fg_orient.formats.office.sheets import read_sheets

    read_sheets(folder / "seed.gpkg")


def _projects() -> list[Reader]:
    return [
        Reader("project", _project, _read_project),
        Reader("parquet", _binary_tables, _read_binary("parquet"), only="parquet"),
        Reader("arrow", _binary_tables, _read_binary("arrow"), only="arrow"),
        Reader("tables", _tables, _read_tables, only="csv"),
        Reader("closerange-toml", _closerange_toml, _read_closerange_toml),
        Reader("lines-gpkg", _lines_package, _read_lines_package),
        _workbook("xlsx"), _workbook("ods"), Reader("office-text", _office_text, _read_office_text),
        Reader("office-gpkg", _office_layer, _read_office_layer),
    ]  # fmt: skip


# --- CRS and rasters ---------------------------------------------------------------------------------------


def _crs(folder: Path) -> None:
    import pyproj

    compound = pyproj.CRS("EPSG:32636+5773")
    texts = {
        "code": "EPSG:32636+5773", "names": "EPSG:32636+EGM96", "utm": "WGS84 UTM 32N",
        "wkt1": compound.to_wkt("WKT1_GDAL"), "wkt2": compound.to_wkt(),
        "proj": "+proj=tmerc +lon_0=30 +k=1 +x_0=500000 +ellps=GRS80 +units=m +type=crs",
         "json": pyproj.CRS("EPSG:4979").to_json(),
        "bound": "+proj=utm +zone=36 +ellps=WGS84 +towgs84=0,0,0,0,0,0,0 +type=crs", "vertical": "EGM2008 height",
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")


#: Files that name a CRS by its code, by names, or a vertical one; others define a CRS.
_KINDS: Final = {"code": "code", "names": "names", "utm": "names", "vertical": "vertical"}


@cache
def _read_one_crs(text: str, kind: str) -> None:
    """Read a CRS; once, because PROJ takes seconds to search for unknown words."""
    from fg_orient.geodesy import area_of_use, crs_kind, known_crs
    from fg_orient.geodesy.crs import epsg_code, vertical_code, with_codes, wkt
    from fg_orient.geodesy.heights import vertical_reference, with_vertical

    always = [lambda: epsg_code(text), lambda: with_codes(text)]
    code = [lambda: crs_kind(text)]
    vertical = [lambda: vertical_code(text[:60])]
    whole = [lambda: known_crs(text), lambda: wkt(text), lambda: area_of_use(text), lambda: vertical_reference(text),
             lambda: with_vertical(text, "")]  # fmt: skip
    of_kind = {"code": code, "names": [], "vertical": vertical}.get(kind, whole)
    for read in (*code, *vertical, *(whole if any(mark in text for mark in "[{+:") else ())):
        if read not in of_kind:
            _expected(read)
    _each(*always, *of_kind)


def _read_crs(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        text = path.read_bytes().decode("utf-8", "surrogateescape")
        _read_one_crs(text, _KINDS.get(path.name, "whole"))


def _dem(folder: Path) -> None:
    import rasterio

    heights = np.add.outer(np.linspace(0.0, 500.0, 30), np.linspace(0.0, 90.0, 40)).astype("float32")
    for name, how in (
        ("plain", {}),
        ("packed", {"compress": "deflate", "tiled": True, "blockxsize": 16, "blockysize": 16}),
    ):
        with rasterio.open(
            folder / f"{name}.tif", "w", driver="GTiff", width=40, height=30, count=1, dtype="float32", crs="EPSG:4979",
            nodata=-9999.0, transform=rasterio.Affine(0.01, 0.0, 31.5, 0.0, -0.01, 41.6), **how,
        ) as out:  # fmt: skip
            out.write(heights, 1)


def _read_dem(folder: Path) -> None:
    from fg_orient.sensors.surface import RasterDem

    def height(name: str) -> None:
        RasterDem(folder / f"{name}.tif").height_m(np.array([31.7]), np.array([41.5]))

    _each(lambda: height("plain"), lambda: height("packed"))


def _geoid(folder: Path) -> None:
    import struct

    head = struct.pack(">4d2i", 40.0, 31.0, 0.25, 0.25, 9, 9)
    (folder / "geoid.gtx").write_bytes(head + np.linspace(30.0, 40.0, 81).astype(">f4").tobytes())


def _read_geoid(folder: Path) -> None:
    from fg_orient.geodesy.geoid import GeoidFile

    GeoidFile(folder / "geoid.gtx").undulation_m([31.5, 31.9], [41.0, 41.2])


def _rasters() -> list[Reader]:
    return [
        Reader("crs", _crs, _read_crs), Reader("dem", _dem, _read_dem), Reader("geoid", _geoid, _read_geoid),
    ]  # fmt: skip


# --- results -------------------------------------------------------------------------------------------------


@cache
def _solution() -> Any:
    import fg_orient as fg
    from fg_orient.simulate.block import BlockOptions, grid_block

    return fg.adjust(grid_block(BlockOptions(points=12))[0])


def _result(folder: Path) -> None:
    """Write a small result."""
    _solution().save(folder / "result")
    (folder / "result" / "report.html").unlink()


def _old_result(folder: Path) -> None:
    """Write a small result as a version without manifest wrote it."""
    _result(folder)
    _without_manifest(folder / "result", "result.json")


def _read_result(folder: Path) -> None:
    """Read a result by all commands that read one."""
    from fg_orient.orientation.replay import replay
    from fg_orient.report import write_report
    from fg_orient.report.adjusted_points import export_points
    from fg_orient.report.geofiles import export
    from fg_orient.result.record import read_any_result, read_result
    from fg_orient.rpc.handover import models_of

    result = folder / "result"
    commands = (
        lambda: write_report(result), lambda: write_report(result), lambda: read_result(result).to_geo(),
        lambda: export(result, folder / "out.geojson", overwrite=True),
        lambda: read_any_result(result).residual_summary(),
        lambda: export_points(result, folder / "out.csv", overwrite=True), lambda: _expected(lambda: models_of(result)),
        lambda: _expected(lambda: replay(result, folder / "again")),
    )  # fmt: skip
    content = b"".join(path.read_bytes() for path in sorted(result.iterdir()))
    try:  # all of them would take a second
        commands[zlib.crc32(content) % len(commands)]()
    finally:
        for name in ("result/report.html", "out.geojson", "out.csv"):
            (folder / name).unlink(missing_ok=True)


def _expected(read: Callable[[], object]) -> None:
    """Call what refuses this result in any case: it has no RPC, and its run is not repeated."""
    from fg_orient.model.errors import FgOrientError

    with suppress(FgOrientError):
        read()


def _closerange_result(folder: Path) -> None:
    from tests.support.command import in_process
    from tests.support.page_files import photos_and_control

    photos_and_control(folder)
    words = ("closerange", "dlt", folder / "control.csv", "--out", folder / "result")
    ended = in_process(*words)
    assert ended.code in (0, 4), ended.stderr
    _without_manifest(folder / "result", "closerange.json")


def _without_manifest(folder: Path, name: str) -> None:
    """Make a folder one of a version without manifest, which would refuse each changed file; ``name``: its record."""
    import json

    (folder / "manifest.json").unlink()
    record = json.loads((folder / name).read_text("utf-8"))
    del record.get("provenance", record)["manifest"]
    (folder / name).write_text(json.dumps(record, indent=1), "utf-8")


def _read_closerange_result(folder: Path) -> None:
    from fg_orient.closerange.report import write_report

    write_report(folder / "result")


def _transformation(folder: Path) -> None:
    from tests.support.command import in_process
    from tests.support.page_files import map_points

    map_points(folder)
    (folder / "IMAGE.tif").unlink()
    ended = in_process("rectify", "fit", folder / "points.csv", "--out", folder / "result")
    assert ended.code in (0, 4), ended.stderr
    (folder / "points.csv").unlink()
    _without_manifest(folder / "result", "result.json")


def _read_transformation(folder: Path) -> None:
    from fg_orient.rectification.job import read_differences
    from fg_orient.rectification.transformation import read_transformation

    _each(lambda: read_transformation(folder / "result"), lambda: read_differences(folder / "result"))


def _npz(folder: Path) -> None:
    np.savez(
        folder / "a.npz",
        format=np.array(1),
        numbers=np.arange(5.0),
        text=np.array(["a", "bcd"]),
        whole=np.eye(3, dtype=int),
    )


def _read_npz(folder: Path) -> None:
    from fg_orient.formats.load import load_npz

    for array in load_npz(folder / "a.npz", "checkpoint.unreadable").values():
        array.tolist()


def _results() -> list[Reader]:
    return [
        Reader("result", _result, _read_result), Reader("old-result", _old_result, _read_result),
        Reader("closerange-result", _closerange_result, _read_closerange_result, only="closerange.json"),
        Reader("transformation", _transformation, _read_transformation, only="json"),
        Reader("npz", _npz, _read_npz),
    ]  # fmt: skip


#: Readers by name.
READERS: Final = {one.name: one for one in (*_points(), *_metadata(), *_projects(), *_rasters(), *_results())}
