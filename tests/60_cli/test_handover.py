"""Other programs read files of refined RPC with their own code and compute the same pixels."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.formats.rpc import read_rpc, write_rpc
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.rpc.files import corrected
from fg_orient.rpc.handover import PROGRAMS, SAME_PX, Handed, translation
from fg_orient.sensors.rpc import RpcModel
from tests.support.command import Run
from tests.support.results import sealed
from tests.support.rpc_block import RpcTwin, rpc_twin, twin_with_models, write_folder
from tests.support.rpc_model import reference_project

rasterio = pytest.importorskip("rasterio")
Array = np.ndarray
IMAGES = ("left", "right")


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory, run: Run) -> tuple[RpcTwin, Path]:
    """Return the twin with a shift per image, and its result folder."""
    twin = rpc_twin("shift", seed=4)
    project = write_folder(tmp_path_factory.mktemp("rpc") / "twin", twin)
    ended = run("adjust", project, "--quiet")
    assert ended.code == 0, ended.stderr
    return twin, project.parent / "result"


def places(model: RpcModel, n: int = 50) -> Array:
    """Return the longitudes, latitudes, heights (3, n) in the cube of a model."""
    u = np.random.default_rng(1).uniform(-0.9, 0.9, (3, n))
    return model.offsets[2:, None] + model.scales[2:, None] * u


def wanted(result: Path, image: str, twin: RpcTwin) -> tuple[Array, Array]:
    """Return the places, and pixels (n, 2) of the vendor's model and the adjusted shift, term by term."""
    model = twin.block.images[IMAGES.index(image)].sensor.model
    table = [line.split(",") for line in (result / "eop.csv").read_text("utf-8").splitlines()]
    shift = [float(row[5]) for row in table if row[0] == image]
    ground = places(model)
    return ground, np.stack(reference_project(model, *ground), axis=1).astype(float) + shift[:2]


def blank(path: Path, shape: tuple[int, int]) -> Path:
    """Return an image without content, size and sidecar files only."""
    with rasterio.open(
        path, "w", driver="GTiff", width=shape[1], height=shape[0], count=1, dtype="uint8", SPARSE_OK=True
    ):
        pass
    return path


def by_gdal(image: Path, ground: Array) -> Array:
    """Return the pixels (n, 2) of GDAL; its transformer counts from the corner of the first pixel."""
    with rasterio.open(image) as source, rasterio.transform.RPCTransformer(source.rpcs) as transformer:
        row, column = transformer.rowcol(*ground, op=lambda value: value)
    return np.stack([row, column], axis=1) - 0.5


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("program", ["gdal", "qgis", "asp"])
def test_gdal_reads_the_files_beside_the_image(
    shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path, program: str
) -> None:
    twin, result = shifted
    ended = run("rpc", "convert", result, "--for", program, "--out", tmp_path, "--json")
    assert ended.code == 0, ended.stderr
    for name in IMAGES:
        ground, pixels = wanted(result, name, twin)
        sensor = twin.block.images[IMAGES.index(name)].sensor
        image = blank(tmp_path / f"{name}.tif", (sensor.n_lines, sensor.n_samples))
        assert np.abs(by_gdal(image, ground) - pixels).max() < 1e-6
        file = next(f for f in ended.json["files"] if f["image"] == name)
        assert Path(file["file"]).name in file["use"]


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_images_get_their_rpc_as_virtual_raster_or_copy(
    shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path
) -> None:
    """``rpc convert --image`` writes a virtual raster or a copy with the RPC and leaves the raster unchanged.

    A raster of another size is refused.
    """
    twin, result = shifted
    sensor = twin.block.images[0].sensor
    image = blank(tmp_path / "PAN.tif", (sensor.n_lines, sensor.n_samples))
    before = image.read_bytes()
    model = tmp_path / "left_RPC.TXT"
    shutil.copy(result / "rpc" / "left_RPC.TXT", model)
    out = tmp_path / "out"
    assert run("rpc", "convert", model, "--for", "gdal", "--out", out, "--image", image).code == 0
    assert sorted(path.name for path in out.iterdir()) == ["PAN.vrt", "PAN_RPC.TXT"]
    copied = tmp_path / "copy.tif"
    assert run("rpc", "convert", model, "--out", copied, "--image", image).code == 0
    ground, pixels = wanted(result, "left", twin)
    for path in (out / "PAN.vrt", copied):
        assert np.abs(by_gdal(path, ground) - pixels).max() < 1e-6
    assert image.read_bytes() == before
    small = blank(tmp_path / "small.tif", (10, 10))
    words = ("--image", f"left={small}", "--image", f"right={image}", "--out", tmp_path / "other")
    ended = run("rpc", "convert", result, "--to", "vrt", *words)
    assert (ended.code, "the image does not have the 12000 x 12000 pixels" in ended.stderr) == (2, True)


@pytest.mark.oracle
def test_keyword_lists_of_ossim(shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path) -> None:
    """Keyword lists for OTB and CARS have OSSIM's keys and 80 coefficients, and project as the result.

    Each line has a key, a colon and a value.
    """
    twin, result = shifted
    for program in ("otb", "cars"):
        assert run("rpc", "convert", result, "--for", program, "--out", tmp_path / program).code == 0
    file = tmp_path / "otb" / "left.geom"
    pairs = dict(line.split(": ", 1) for line in file.read_text("ascii").splitlines())
    assert pairs["type"].strip().startswith("ossim") and pairs["polynomial_format"].strip() == "B"
    assert sum("_coeff_" in key for key in pairs) == 80 and float(pairs["line_den_coeff_00"]) == 1.0
    assert int(pairs["number_lines"]) == 12000
    ground, pixels = wanted(result, "left", twin)
    found = np.stack(read_rpc(file).project(*ground), axis=1)
    assert np.abs(found - pixels).max() < 1e-9
    assert file.read_bytes() == (tmp_path / "cars" / "left.geom").read_bytes()


@pytest.mark.oracle
def test_dimap_of_a_result_has_both_directions(shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path) -> None:
    """A DIMAP RPC of a result has both directions, and located pixels project back within 0.05 px."""
    twin, result = shifted
    assert run("rpc", "convert", result, "--to", "dimap", "--out", tmp_path).code == 0
    ground, pixels = wanted(result, "left", twin)
    model = read_rpc(tmp_path / "left.xml")
    assert np.abs(np.stack(model.project(*ground), axis=1) - pixels).max() < 1e-9
    rng = np.random.default_rng(2)
    line, sample, height = rng.uniform(0.0, 11999.0, 300), rng.uniform(0.0, 11999.0, 300), rng.uniform(0.0, 2000.0, 300)
    seen = np.stack(reference_project(model, *model.locate_directly(line, sample, height), height), axis=1)
    assert np.abs(seen.astype(float) - np.stack([line, sample], axis=1)).max() < 0.05


# --- ASP's movements of a camera -----------------------------------------------------------------


@pytest.mark.truth
def test_a_translation_of_the_camera_is_found() -> None:
    """A shift of the image is written for ASP as a translation within its limit; a change of scale is not."""
    model = twin_with_models()[2][0]
    small = np.array([0.6, -0.4, 0.0, 0.0, 0.0, 0.0])
    move = translation(Handed(corrected(model, small).model, small, "a"))
    assert move.is_same and move.most_px <= SAME_PX
    # as ASP uses the file: the vendor's model sees X - t where the compensated one sees X
    ground = places(model)
    moved = ecef_to_geodetic(geodetic_to_ecef(*ground) - [float(v) for v in move.text.split()[:3]])
    found = np.stack(reference_project(model, *moved), axis=1).astype(float)
    expected = np.stack(reference_project(model, *ground), axis=1).astype(float) + small[:2]
    assert np.abs(found - expected).max() < 2.0 * SAME_PX
    assert move.text.splitlines()[1] == "1 0 0 0"
    scale = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    assert not translation(Handed(corrected(model, scale).model, scale, "a")).is_same


@pytest.mark.behaviour
def test_no_translation_gives_the_reason_and_no_adjust_file(
    shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path
) -> None:
    ended = run("rpc", "convert", shifted[1], "--for", "asp", "--out", tmp_path / "out", "--json")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"left.RPB", "right.RPB"}
    refused = [f for f in ended.json["findings"] if f["code"] == "handover.no_translation"]
    assert [f["severity"] for f in refused] == ["warning"] * 2
    assert all("is not a translation of the camera" in f["message"] for f in refused)


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_what_is_refused(shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path) -> None:
    result, out = shifted[1], tmp_path / "out"
    for words, message in (
        (("--for", "envi"), "unknown program (found envi); give one of: gdal, qgis, otb, asp, cars, s2p"),
        ((), "needs the program or the format"),
        (("--to", "vrt"), "is a raster, so it needs the image"),
        (("--for", "gdal", "--to", "rpb"), "exclude each other"),
        (("--for", "gdal", "--image", "middle=a.tif"), "there is no RPC image with this id"),
        (("--for", "gdal", "--image", "a.tif"), "does not state to which image the raster belongs"),
    ):
        ended = run("rpc", "convert", result, "--out", out, *words)
        assert ended.code == 2 and message in ended.stderr and ended.stderr.count("\n") == 1, ended.stderr
    assert not out.exists()
    assert run("rpc", "convert", result, "--for", "s2p", "--out", out).code == 0
    again = run("rpc", "convert", result, "--for", "s2p", "--out", out)
    assert (again.code, "left_RPC.TXT" in again.stderr) == (2, True)
    other = tmp_path / "no_result"
    other.mkdir()
    assert run("rpc", "convert", other, "--for", "gdal", "--out", tmp_path / "b").code == 2


@pytest.mark.behaviour
def test_a_doubtful_result_is_heard(shifted: tuple[RpcTwin, Path], run: Run, tmp_path: Path) -> None:
    copy = shutil.copytree(shifted[1], tmp_path / "result")
    record = json.loads((copy / "result.json").read_text("utf-8"))
    record["status"] = "not_trustworthy"
    (copy / "result.json").write_text(json.dumps(record), "utf-8")
    ended = run("rpc", "convert", sealed(copy), "--for", "gdal", "--out", tmp_path / "out")
    assert ended.code == 4 and f"doubt: {copy}: this result is not trustworthy" in ended.stderr


# --- other programs, by their own code -----------------------------------------------------------

#: Modules of programs that no extra installs; their tests are skipped where they are not.
MODULES = {"rpcm": "rpcm", "shareloc": "shareloc.geomodels", "orthority": "orthority.camera"}


def by_rpcm(folder: Path, name: str, ground: Array) -> Array:
    column, row = import_module(MODULES["rpcm"]).rpc_from_rpc_file(str(folder / f"{name}_RPC.TXT")).projection(*ground)
    return np.stack([row, column], axis=1)


def by_shareloc(folder: Path, name: str, ground: Array) -> Array:
    row, column, _ = (
        import_module(MODULES["shareloc"]).GeoModel(str(folder / f"{name}.geom"), "RPC").inverse_loc(*ground)
    )
    return np.stack([row, column], axis=1) - 0.5


def by_orthority(folder: Path, name: str, ground: Array) -> Array:
    with rasterio.open(folder / f"{name}.tif") as source:
        camera = import_module(MODULES["orthority"]).RpcCamera(
            (source.width, source.height), source.rpcs.to_dict(), crs="EPSG:4979"
        )
    column, row = camera.world_to_pixel(ground)
    return np.stack([row, column], axis=1)


def by_otb(folder: Path, name: str, ground: Array) -> Array:
    """Return the pixels by an orthoimage of two bands whose values are line and sample; two places are sufficient."""
    model, cell = read_rpc(folder / f"{name}.geom"), 512
    assert model.n_lines and model.n_samples
    rows, columns = model.n_lines // cell + 4, model.n_samples // cell + 4
    line, sample = ((np.arange(n) - 0.5) * cell - 0.5 for n in (rows, columns))
    with rasterio.open(
        folder / "nodes.tif", "w", driver="GTiff", width=columns, height=rows, count=2, dtype="float64"
    ) as nodes:
        nodes.write(np.stack(np.broadcast_arrays(line[:, None], sample[None])))
    band = (
        '<VRTRasterBand dataType="Float64" band="{0}"><ComplexSource resampling="bilinear"><SourceFilename '
        'relativeToVRT="1">nodes.tif</SourceFilename><SourceBand>{0}</SourceBand><SrcRect xOff="0" yOff="0" '
        f'xSize="{columns}" ySize="{rows}"/><DstRect xOff="-{cell}" yOff="-{cell}" xSize="{columns * cell}" '
        f'ySize="{rows * cell}"/></ComplexSource></VRTRasterBand>'
    )
    (folder / f"{name}.vrt").write_text(
        f'<VRTDataset rasterXSize="{model.n_samples}" rasterYSize="{model.n_lines}">{band.format(1)}{band.format(2)}'
        "</VRTDataset>", "utf-8",
    )  # fmt: skip
    out, found = folder / "ortho.tif", []
    for lon, lat, height in ground.T.tolist():
        place = ["-outputs.mode", "auto", "-outputs.ulx", lon, "-outputs.uly", lat, "-outputs.sizex", 3,
                 "-outputs.sizey", 3, "-outputs.spacingx", 1e-7, "-outputs.spacingy", -1e-7]  # fmt: skip
        words = ["otbcli_OrthoRectification", "-io.in", folder / f"{name}.vrt", "-io.out", out, "double", "-map", "wgs",
                 *place, "-elev.default", height, "-interpolator", "linear", "-opt.gridspacing", 1e-7]  # fmt: skip
        subprocess.run(list(map(str, words)), check=True, capture_output=True)
        with rasterio.open(out) as ortho:
            # OTB reads places as float32: the difference of the place counts by the model itself
            there = ortho.xy(0, 0)
            values = ortho.read()[:, 0, 0]
        found.append(values - np.ravel(model.project(*there, height)) + np.ravel(model.project(lon, lat, height)))
    return np.array(found)


PEERS: dict[str, tuple[Callable[[Path, str, Array], Array], bool, int]] = {
    name: (function, bool(importlib.util.find_spec(name)), 20)
    for name, function in (("rpcm", by_rpcm), ("shareloc", by_shareloc), ("orthority", by_orthority))
}
PEERS["rasterio"] = lambda folder, name, ground: by_gdal(folder / f"{name}.tif", ground), True, 20
PEERS["otb"] = by_otb, shutil.which("otbcli_OrthoRectification") is not None, 2
#: Compensations (px) of one image of each real pair.
REAL = {
    "spot": ("micmac-spot7-rpc/RPC_1A.xml", (-0.073, -0.316, -0.035, -0.15, 0.02, 0.011)),
    "neo": (
        "micmac-pneo-pair/RPC_PNEO3_202309051055014_PAN_SEN_PWOI_000129104_1_1_F_1.XML",
        (1.2, -3.4, 0.8, -0.5, 0.3, 0.6),
    ),
}


def handed(real_data: Path, name: str, folder: Path, run: Run) -> tuple[Array, Array]:
    """Write the files of all programs for a refined real image; places, and their pixels by vendor and compensation."""
    file, values = REAL[name]
    vendor = read_rpc(real_data / file)
    new = corrected(vendor, values).model
    write_rpc(folder / f"{name}_RPC.TXT", new)
    text = (folder / f"{name}_RPC.TXT").read_bytes()
    for program in PROGRAMS:
        ended = run("rpc", "convert", folder / f"{name}_RPC.TXT", "--for", program, "--out", folder, "--overwrite")
        assert ended.code == 0, ended.stderr
    assert (folder / f"{name}_RPC.TXT").read_bytes() == text
    shape = new.n_lines or int(new.validity.line[1]) + 1, new.n_samples or int(new.validity.sample[1]) + 1
    blank(folder / f"{name}.tif", shape)
    geom = folder / f"{name}.geom"
    geom.write_text(f"{geom.read_text('ascii')}number_lines:  {shape[0]}\nnumber_samples:  {shape[1]}\n", "ascii")
    ground = places(new, 20)
    ground[2] = np.round(ground[2])  # OTB reads float32
    return ground, np.stack(vendor.project(*ground, np.array(values)), axis=1)


@pytest.mark.oracle
@pytest.mark.real_data
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("name", list(REAL))
@pytest.mark.parametrize("peer", list(PEERS))
def test_other_programs_project_alike(real_data: Path, tmp_path: Path, run: Run, name: str, peer: str) -> None:
    """Other programs project with the written RPC as we do, within 1e-5 px, and OTB within 0.005 px.

    OTB's places have 1e-7 degrees, 0.01 m.
    """
    function, is_here, count = PEERS[peer]
    if not is_here:
        pytest.skip(f"{peer} is not installed")
    ground, pixels = handed(real_data, name, tmp_path, run)
    found: Any = function(tmp_path, name, ground[:, :count])
    assert np.abs(found - pixels[:count]).max() < (5e-3 if peer == "otb" else 1e-5)
