"""The cases are commands on prepared files, each in a folder of its own."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.support import page_files, photomodeler
from tests.support.format_files import MARKER_FILES, MODEL_FILES

INPUTS = "inputs"


@dataclass(frozen=True)
class Case:
    """A command line in words of one string; ``{real}`` stands for the folder of real data."""

    name: str
    command: str

    @property
    def needs_real_data(self) -> bool:
        """Return whether the case reads files that are not part of the repository."""
        return "{real}" in self.command


def _blunders(folder: Path) -> None:
    """Write the twin with a wrong line and two exchanged points."""
    shutil.copytree(folder.parent / "twin", folder, dirs_exist_ok=True)
    table = folder / "observations.csv"
    rows = table.read_text("utf-8").splitlines()
    first = next(k for k, row in enumerate(rows) if row and not row.startswith("#")) + 1
    names, wrong = rows[first - 1].split(","), rows[first + 4].split(",")
    wrong[names.index("line")] = repr(float(wrong[names.index("line")]) + 25.0)
    rows[first + 4] = ",".join(wrong)
    one, other = rows[first + 9].split(","), rows[first + 12].split(",")
    at = names.index("id")
    one[at], other[at] = other[at], one[at]
    rows[first + 9], rows[first + 12] = ",".join(one), ",".join(other)
    table.write_text("\n".join(rows) + "\n", "utf-8")


def _image(folder: Path) -> None:
    """Copy the metadata of the left image."""
    shutil.copy(folder.parent / "pages" / "left.DIM", folder)


def _files(*writers: Callable[[Path], None]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        for writer in writers:
            writer(folder)

    return write


#: Folders of input files and what writes them.
WRITERS: dict[str, Callable[[Path], None]] = {
    "blunders": _blunders,
    "pages": page_files.satellite_files,
    "rpc": _files(_image, page_files.rpc_points),
    "maps": page_files.map_points,
    "photos": page_files.photos_and_control,
    "surface": page_files.surface_points,
    "photomodeler": photomodeler.write_projects,
    "exchange": _files(*MODEL_FILES, *MARKER_FILES),
}

#: Projects that commands write; their files are results, too.
SIMULATED = (
    Case("twin", "simulate zonguldak --seed 1 --dem --dem-step 60 --out twin"),
    Case("block", "simulate block --seed 1 --out block"),
    Case("mixed", "simulate mixed --seed 1 --out mixed"),
)

_ADJUST = {
    "schur": "", "graph": "--backend graph", "dense": "--backend dense --solver qr",
    "explicit": "--backend graph --optimizer dogleg", "tikhonov": "--backend dense --solver tikhonov_gcv",
    "look": "--eop-set PUA --look-polynomial 2", "snoop": "--snoop", "baarda": "--snoop --outlier-test baarda",
    "robust": "--loss tls --gnc", "huber": "--loss huber --backend graph", "components": "--variance-components",
    "parts": "--parts 4 --workers 1", "set-8": "--eop-set 8", "set-19": "--eop-set 19 --backend dense",
}  # fmt: skip
_REAL_MODELS = ("geocosicorr3d/SP2_METADATA.DIM", "geocosicorr3d/SPOT1.DIM", "geocosicorr3d/SPOT4.DIM",
                "geocosicorr3d/SPOT5.DIM", "geocosicorr3d/SPOT6.XML", "geoetrim-pleiades/DIM_PHR1A_derived_img1.XML",
                "asp/spot5_hrs1_segment.xml", "aster/out-Band3N.xml")  # fmt: skip
_REAL_RPC = ("asp/sample.RPB", "geocosicorr3d/SP2_RPC.txt", "geoetrim-pleiades/PHR1A_img1_RPC.txt")
_PAGES, _PHOTOS = "../inputs/pages", "../inputs/photos"

CASES = (
    *(Case(f"adjust-{name}", f"adjust ../inputs/twin/project.toml {words} --out out --json")
      for name, words in _ADJUST.items()),
    *(Case(f"blunders-{name}", f"adjust ../inputs/blunders/project.toml {words} --out out --json")
      for name, words in {"plain": "", "snoop": "--snoop", "tukey": "--loss tukey"}.items()),
    *(Case(f"{project}-{backend}", f"adjust ../inputs/{project}/project.toml --backend {backend} --out out --json")
      for project in ("block", "mixed") for backend in ("schur", "graph")),
    Case("truth", "report ../inputs/pages/result --json"),
    Case("validate", "validate ../inputs/twin/project.toml --json"),
    Case("reduce", "reduce ../inputs/twin/project.toml --json"),
    Case("compare", "compare ../inputs/twin/project.toml --eop-sets 1,2,8,19 --out out --json"),
    Case("accuracy", f"accuracy {_PAGES}/result --dem {_PAGES}/dem.tif --json"),
    Case("locate", f"locate {_PAGES}/IMAGE.DIM --line 6000 --sample 6000 --height 350 --json"),
    Case("locate-frame", f"locate {_PAGES}/IMAGE.DIM --frame --json"),
    Case("locate-dem", f"locate {_PAGES}/IMAGE.DIM --line 6000 --sample 6000 --dem {_PAGES}/dem.tif --json"),
    Case("locate-rpc", f"locate {_PAGES}/RPC.XML --line 6000 --sample 6000 --height 350 --json"),
    Case("project", f"project {_PAGES}/IMAGE.DIM --lon 31.8 --lat 41.3 --height 350 --json"),
    Case("intersect", f"intersect {_PAGES}/LEFT.DIM {_PAGES}/RIGHT.DIM --pixel 6000,6000 --pixel 5990.5,6010 "
                      f"--result {_PAGES}/result --json"),
    Case("footprint", f"footprint {_PAGES}/PROJECT.toml --height 300 --result {_PAGES}/result "
                      "--out footprints.geojson --json"),
    Case("rpc-check", f"rpc check {_PAGES}/RPC.XML --heights 0 3000 --points ../inputs/rpc/points.csv "
                      f"--against {_PAGES}/DIM.XML --json"),
    Case("rpc-convert", f"rpc convert {_PAGES}/RPC.XML --out scene.RPB --json"),
    Case("rpc-refine", f"rpc refine {_PAGES}/RPC.XML --points ../inputs/rpc/points.csv --out scene_RPC.TXT --json"),
    Case("rpc-fit-points", "rpc fit ../inputs/rpc/points.csv --degree 2 --out scene_RPC.TXT --json"),
    Case("rpc-fit-linear", "rpc fit ../inputs/rpc/points.csv --degree 3 --equations linear --solver svd_scaled --json"),
    Case("rpc-fit-model", f"rpc fit {_PAGES}/IMAGE.DIM --heights 0 3000 --result {_PAGES}/result --out a_RPC.TXT "
                          "--json"),
    Case("rectify-fit", "rectify fit ../inputs/maps/points.csv --degree 2 --out fit --json"),
    Case("rectify-fit-3", "rectify fit ../inputs/maps/points.csv --degree 3 --out fit --json"),
    Case("rectify-study", "rectify study ../inputs/maps/points.csv --counts 5,10,20 --json"),
    Case("rectify-check", "rectify check ../rectify-fit/fit --scale 50000 --json"),
    Case("dlt", f"closerange dlt {_PHOTOS}/control.csv --out cameras --json"),
    Case("resect", f"closerange resect {_PHOTOS}/control.csv {_PHOTOS}/cameras.toml --out oriented --json"),
    Case("closerange-intersect", f"closerange intersect {_PHOTOS}/image.csv ../resect/oriented/photos.toml --json"),
    Case("bundle", f"closerange bundle {_PHOTOS}/image.csv {_PHOTOS}/cameras.toml --sigma 0.005 "
                   f"--control {_PHOTOS}/ground.csv --constraints {_PHOTOS}/constraints.toml --out out --json"),
    Case("bundle-k1", f"closerange bundle {_PHOTOS}/image.csv {_PHOTOS}/cameras.toml --sigma 0.005 "
                      f"--control {_PHOTOS}/ground.csv --shared k1 --out out --json"),
    *(Case(f"surface-{kind}", f"closerange surface ../inputs/surface/points.csv --kind {kind} --sigma 0.001 --out out "
                              "--json") for kind in ("sphere", "spheroid", "ellipsoid", "quadric")),
    Case("convert-markers", "convert ../inputs/exchange/markers.xml --from metashape-xml --accept-unverified "
                            "--sigma-image 0.3 0.3 --to csv --out points.csv"),
    Case("convert-model", "convert ../inputs/exchange/sparse/0 --from colmap-text --to bundler --out bundle.out"),
    Case("convert-points", "convert ../inputs/twin/points.csv --from csv --to geojson --out points.geojson"),
    *(Case(f"reproduce-{study.replace(' --', '-')}", f"reproduce {study} --out out --json")
      for study in ("terlemezoglu2019", "terlemezoglu2019 --as-run", "topan2010 --as-run", "ayhan1996", "ipbuker1994")),
    *(Case(f"real-frame-{Path(file).stem}", f"locate {{real}}/{file} --frame --json") for file in _REAL_MODELS),
    *(Case(f"real-footprint-{Path(file).stem}", f"footprint {{real}}/{file} --height 300 --json")
      for file in _REAL_MODELS),
    *(Case(f"real-rpc-{Path(file).stem}", f"rpc check {{real}}/{file} --json") for file in _REAL_RPC),
)  # fmt: skip


def real_data() -> str:
    """Return the folder of real data, or "" where there is none."""
    return os.environ.get("FG_ORIENT_REAL_DATA", "")
