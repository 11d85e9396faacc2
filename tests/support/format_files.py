"""The module writes the files of other programs that pages on formats mention, with their shown lines."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fg_orient.formats.exchange.bal import bal_data_of, write_bal
from fg_orient.formats.exchange.bundler import write_bundler
from fg_orient.formats.exchange.colmap_text import write_colmap_text
from fg_orient.formats.exchange.tie_folders import write_match
from fg_orient.geodesy.crs import wkt

from .command import in_process
from .frame_models import frame_model
from .office import office_files

PAGES = Path(__file__).resolve().parents[2] / "docs" / "formats"

UTM = wkt("EPSG:32636")
OBSERVATIONS = (
    "image,id,line,sample,sigma_line_px,sigma_sample_px\nleft,01,512.25,1034.75,0.3,0.3\nright,01,500,1000,0.3,0.3\n"
)
MATCHES = np.array([[512.25, 1034.75], [700.5, 80.0]])
MARKERS_XML = f"""<document version="1.2.0"><chunk>
<cameras><camera id="0" label="left.tif"/></cameras><markers>{{}}</markers>
<frames><frame id="0"><markers><marker marker_id="7"><location camera_id="0" x="512.5" y="1034.75"/></marker></markers>
</frame></frames><reference>{UTM}</reference></chunk></document>
"""

#: Text export of PhotoModeler: two photos, a control point and a point seen in both.
PHOTOMODELER = r"""Bundle Soln a project
 0.000500 20 1000 800
 1.0 0.1 10.0 100.0 100.0 100.0 20.0 20.0 20.0
 10.0 5.0 4.0 10.0 8.0 1e-3 -1e-5 0.0 2e-4 -3e-4
 0.0 0.0 0.0 0.5 0.5 0.001 0.0001 0.0001 0.001 0.001
   0 C:\photos\left one.JPG
   0 1.0 2.0 30.0 90.0 -5.0 10.0
   0 0.1 0.1 0.1 0.1 0.1 0.1

   0 10.0 5.0 4.0 10.0 8.0 1e-3 -1e-5 0.0 2e-4 -3e-4
   0 0.0 0.0 0.0 0.5 0.5 0.001 0.0001 0.0001 0.001 0.001
   1 photos/right.JPG
   1 3.0 2.0 30.0 0.0 0.0 0.0
   1 0.1 0.1 0.1 0.1 0.1 0.1

    7 1.5 2.5 0.5 0.1 0.1 0.1

    7 1.5 2.5 0.5 0.1 0.1 0.1
    9 2.5 1.5 0.0 0.1 0.1 0.1

   0    9 400.25 300.5 1.0 1.0
   1    9 410.25 310.5 1.0 1.0
   1    7 600.0 500.0 1.0 1.0

  9  7
"""


#: Files of sba: two cameras, sixteen points in both, pixels rounded to a tenth.
_PLACES = np.round(np.random.default_rng(4).uniform([-2.0, -1.5, 8.0], [3.0, 1.5, 13.0], (16, 3)), 2)
_PIXELS = [np.round(850.0 * (_PLACES - [x, 0, 0])[:, :2] / _PLACES[:, 2:] + [320.0, 240.0], 1) for x in (0.0, 1.0)]
SBA_CAMS = "1 0 0 0 0 0 0\n1 0 0 0 -1 0 0\n"
SBA_PTS = "".join(
    f"{' '.join(map(repr, at.tolist()))} 2 0 {a[0]} {a[1]} 1 {b[0]} {b[1]}\n"
    for at, a, b in zip(_PLACES, *_PIXELS, strict=True)
)


def binary(folder: Path) -> None:
    """Write the problem of libmv with the numbers of the files of sba."""
    camera = struct.pack("<8f", 850.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    poses = b"".join(struct.pack("<i12f", k + 1, *np.eye(3).ravel(), -float(k), 0.0, 0.0) for k in range(2))
    points = b"".join(struct.pack("<i3f", k, *at) for k, at in enumerate(_PLACES.tolist()))
    marks = [struct.pack("<iiff", k + 1, j, *at) for k in range(2) for j, at in enumerate(_PIXELS[k].tolist())]
    tables = ((2, poses), (len(_PLACES), points), (len(marks), b"".join(marks)))
    whole = b"vP" + camera + b"".join(struct.pack("<i", n) + table for n, table in tables)
    (folder / "problem_01.bin").write_bytes(whole)


def samples(page: str) -> list[str]:
    """Return the lines of files that a page shows."""
    text = (PAGES / f"{page}.md").read_text("utf-8")
    return re.findall(r"^```text\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def own_tables(folder: Path) -> None:
    """Write points.csv as the page of our tables shows it, and its image points in two images."""
    (folder / "points.csv").write_text(samples("csv")[0], "utf-8")
    (folder / "observations.csv").write_text(OBSERVATIONS, "utf-8")


def shown(page: str, *files: tuple[str, str]) -> Callable[[Path], None]:
    """Return a function that writes the samples of a page to files of these names.

    The second word of each is the text of the file, in which the sample replaces ``{}``.
    """

    def write(folder: Path) -> None:
        for (name, around), sample in zip(files, samples(page), strict=True):
            (folder / name).write_text(around.replace("{}", sample), "utf-8")

    return write


def texts(**files: str) -> Callable[[Path], None]:
    """Write files that their page does not show; names without ``.txt``."""

    def write(folder: Path) -> None:
        for name, text in files.items():
            (folder / f"{name}.txt").write_text(text, "utf-8")

    return write


def matches(folder: Path) -> None:
    """Write a folder of matches of the Ames Stereo Pipeline."""
    (folder / "run").mkdir()
    write_match(folder / "run" / "run-left__right.match", MATCHES, MATCHES + 3.0)


def database(folder: Path) -> None:
    """Write a database of COLMAP from our own tables."""
    sizes = ("--image-size", "left=12000,12000", "--image-size", "right=12000,12000")
    ended = in_process(
        "convert", folder / "points.csv", folder / "observations.csv", "--from", "csv", *sizes,
        "--to", "colmap-database", "--out", folder / "database.db",
    )  # fmt: skip
    assert ended.code == 0, ended.stderr


def micmac_ties(folder: Path) -> None:
    """Write the two tables of MicMac that the page shows the beginning of."""
    (folder / "MulTieP" / "V1").mkdir(parents=True)
    for name in ("left", "right"):
        (folder / "MulTieP" / "V1" / f"PMUL-{name}.csv").write_text(samples("micmac-ties")[0], "utf-8")


def models(folder: Path) -> None:
    """Write one model of two photos as COLMAP, Bundler and BAL keep it."""
    model = frame_model(("none",))
    names = ("left.jpg", "right.jpg")
    camera = replace(model.cameras["1"], n_lines=4000, n_samples=6000, principal_px=np.array([1999.5, 2999.5]))
    poses = tuple(replace(pose, name=name) for pose, name in zip(model.poses, names, strict=True))
    model = replace(model, cameras={"1": camera}, poses=poses)
    write_colmap_text(folder / "sparse" / "0", model)
    data, _ = bal_data_of(model)
    write_bundler(folder / "bundle.out", data)
    (folder / "list.txt").write_text("".join(f"{name}\n" for name in names), "utf-8")
    write_bal(folder / "problem-49-7776-pre.txt.gz", data)


#: A model as COLMAP keeps it, markers of Metashape.
MODEL_FILES = (models,)
MARKER_FILES = (shown("metashape-xml", ("markers.xml", MARKERS_XML)),)

#: What each page on formats begins with.
FORMAT_FILES: dict[str, tuple[Callable[[Path], None], ...]] = {
    "index": (own_tables, shown("asp-gcp", ("points.gcp", "{}"))),
    "asp-gcp": (own_tables, shown("asp-gcp", ("points.gcp", "{}"))),
    "asp-match": (own_tables, matches),
    "bal": MODEL_FILES,
    "bundler": MODEL_FILES,
    "colmap-database": (own_tables, database),
    "colmap-text": MODEL_FILES,
    "csv": (own_tables,),
    "dbat": (shown("dbat", ("markpts.txt", "{}"), ("control.txt", "{}")),),
    "geojson": (own_tables, shown("geojson", ("points.geojson", '{"type": "FeatureCollection", "features": [{}]}'))),
    "gpkg": (own_tables,),
    "metashape-csv": (shown("metashape-csv", ("markers.csv", f"# CoordinateSystem: {UTM}\n{{}}")),),
    "metashape-xml": MARKER_FILES,
    "micmac": (own_tables, shown("micmac", ("gcp.txt", "{}"), ("gcp_images.txt", "{}"))),
    "micmac-ties": (micmac_ties,),
    "odm": (shown("odm", ("gcp_list.txt", "{}")),),
    "office": (office_files,),
    "photomodeler": (texts(pmexport=PHOTOMODELER), shown("photomodeler", ("2dpts.txt", "{}"))),
    "pix4d": (shown("pix4d", ("gcp.csv", "{}"), ("marks.csv", "{}")),),
    "libmv": (binary,),
    "sba": (texts(**{"7cams": SBA_CAMS, "7pts": SBA_PTS, "calib": "850 0 320\n0 850 240\n0 0 1\n"}),),
    "qgis-points": (shown("qgis-points", ("scene.tif.points", f"#CRS: {UTM}\n{{}}")),),
}
