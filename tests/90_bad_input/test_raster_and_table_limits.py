"""Small rasters and binary tables that imply large data are refused within time and memory."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.formats.arrow_sizes import decoded_sizes
from fg_orient.formats.faults import Faults
from fg_orient.formats.parquet_sizes import largest_group_bytes
from fg_orient.formats.points import read_points
from fg_orient.formats.rasters import Raster, place_of
from fg_orient.formats.rpc import read_rpc
from fg_orient.geodesy.geoid import GeoidFile
from fg_orient.model.errors import InputError
from fg_orient.model.limits import VARIABLE
from fg_orient.model.raster_limits import MAX_NESTED
from fg_orient.sensors.dem import RasterDem
from tests.fuzz.harness import outcome

pytestmark = pytest.mark.behaviour

#: Tags of TIFF 6.0: size, type of values, compression, strips, tiles.
WIDTH, LENGTH, BITS, COMPRESSION, PHOTOMETRIC, STRIPS, BANDS, ROWS, BYTES = 256, 257, 258, 259, 262, 273, 277, 278, 279
TILE_WIDTH, TILE_LENGTH, TILES, TILE_BYTES, SUBFILE, FORMAT = 322, 323, 324, 325, 254, 339
SHORT, LONG, ASCII, DOUBLE = 3, 4, 2, 12
#: Geographic place of the first pixel: scale, tie point and GeoKeys (GeoTIFF 1.0).
PLACE = struct.pack("<9d", 0.01, 0.01, 0.0, 0.0, 0.0, 0.0, 31.5, 41.6, 0.0)
PLACE += struct.pack("<16H", 1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326)
Entry = tuple[int, int, int, int]


def tiff(path: Path, entries: Sequence[Entry], pixels: bytes = b"", directories: int = 1) -> None:
    """Write a TIFF file with its pixels behind the place; tags with the value -1 are the position of the pixels."""
    first = [*entries, (33550, DOUBLE, 3, 8), (33922, DOUBLE, 6, 32), (34735, SHORT, 16, 80)]
    begin, out = 8 + len(PLACE) + len(pixels), bytearray()
    for k in range(directories):
        own = sorted(entries if k else first)
        at = begin + len(out)
        out += struct.pack("<H", len(own))
        for tag, kind, count, value in own:
            value = 8 + len(PLACE) if value == -1 else value
            out += struct.pack("<HHI", tag, kind, count) + struct.pack("<I" if kind != SHORT or count > 1 else "<HH",
                                                                       *((value,) if kind != SHORT or count > 1
                                                                         else (value, 0)))  # fmt: skip
        out += struct.pack("<I", at + 6 + 12 * len(own) if k < directories - 1 else 0)
    path.write_bytes(b"II*\0" + struct.pack("<I", begin) + PLACE + pixels + out)


def size(columns: int, rows: int, compression: int = 1) -> list[Entry]:
    """Return the tags of one band of float32."""
    return [(WIDTH, LONG, 1, columns), (LENGTH, LONG, 1, rows), (BITS, SHORT, 1, 32),
            (COMPRESSION, SHORT, 1, compression), (PHOTOMETRIC, SHORT, 1, 1), (BANDS, SHORT, 1, 1),
            (FORMAT, SHORT, 1, 3)]  # fmt: skip


def strips(rows: int, n_bytes: int = 0) -> list[Entry]:
    return [(ROWS, LONG, 1, rows), (STRIPS, LONG, 1, -1 if n_bytes else 0), (BYTES, LONG, 1, n_bytes)]


EDGE = 8_000


def zeros() -> bytes:
    """Return 256 MB of zeros, deflated to 1 MB."""
    return zlib.compress(bytes(4 * EDGE * EDGE), 1)


def _strip(path: Path) -> None:
    content = zeros()
    tiff(path, size(EDGE, EDGE, 8) + strips(EDGE, len(content)), content)


def _tile(path: Path) -> None:
    content = zeros()
    tile = [(TILE_WIDTH, LONG, 1, EDGE), (TILE_LENGTH, LONG, 1, EDGE), (TILES, LONG, 1, -1),
            (TILE_BYTES, LONG, 1, len(content))]  # fmt: skip
    tiff(path, size(EDGE, EDGE, 8) + tile, content)


def _virtual(path: Path) -> None:
    """Write a virtual raster of the strip."""
    _strip(path.with_name("source.tif"))
    _virtual_of(path, "source.tif")


def _virtual_of(path: Path, source: str, *, crs: str = "EPSG:4326", origin: str = "31.5", cell: str = "0.01") -> Path:
    """Write a virtual raster of a file beside it."""
    path.write_text(f'<VRTDataset rasterXSize="{EDGE}" rasterYSize="{EDGE}"><SRS>{crs}</SRS>'
                    f'<GeoTransform>{origin}, {cell}, 0, 41.6, 0, -{cell}</GeoTransform>'
                    '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
                    f'<SourceFilename relativeToVRT="1">{source}</SourceFilename>'
                    "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>", "utf-8")  # fmt: skip
    return path


def _small(*more: Entry, directories: int = 1) -> Callable[[Path], object]:
    return lambda path: tiff(path, [*size(40, 30), *strips(30), *more], directories=directories)


#: Raster: how it is written; the code of each reader's refusal, "" if it is read.
RASTERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "2^31 lines and samples": (lambda path: tiff(path, size(2**31 - 1, 2**31 - 1) + strips(1)), "limits.exceeded"),
    "2^31 lines": (lambda path: tiff(path, size(10, 2**31 - 1) + strips(1)), "limits.memory"),
    "60 000 directories": (_small((SUBFILE, LONG, 1, 1), directories=60_000), "limits.exceeded"),
    "a strip of 256 MB": (_strip, "limits.memory"),
    "a tile of 256 MB": (_tile, "limits.memory"),
    "a text of 2 GB": (_small((42112, ASCII, 2**31 - 1, 8)), ""),
    "RPC of 2^28 numbers": (_small((50844, DOUBLE, 2**28, 8)), ""),
    "nothing": (_small(), ""),
}


def _pixels(path: Path) -> object:
    return Raster(place_of(path, None, "left", "project.toml")).window(5, 5, 3, 3)


#: Readers of rasters; the code for a raster that is within the limits but not what the reader wants.
READERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "DEM": (lambda path: RasterDem(path).height_m(np.array([31.7]), np.array([41.5])), ""),
    "geoid": (lambda path: GeoidFile(path).undulation_m([31.7], [41.5]), "geoid.wrong"),
    "pixels": (_pixels, ""),
    "RPC": (lambda path: read_rpc(path, first_pixel=0.0), "rpc.no_tags"),
}


@pytest.mark.parametrize("name", RASTERS)
def test_raster_is_refused_within_time_and_memory(tmp_path: Path, name: str) -> None:
    pytest.importorskip("rasterio")
    write, code = RASTERS[name]
    path = tmp_path / "a.tif"
    write(path)
    for reader, (read, otherwise) in READERS.items():
        found = outcome(lambda read=read: read(path), path.stat().st_size)  # type: ignore[misc]
        assert found == (code or otherwise), (reader, found)


def test_virtual_raster_does_not_hide_its_source(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    path = tmp_path / "a.vrt"
    _virtual(path)
    for read in (_pixels, READERS["DEM"][0]):
        assert outcome(lambda read=read: read(path), path.stat().st_size) == "limits.memory"  # type: ignore[misc]


@pytest.mark.parametrize("sources", [("a.vrt",), ("b.vrt", "a.vrt"), ("b.vrt", "b.vrt")])
def test_virtual_raster_that_contains_itself_is_refused(tmp_path: Path, sources: tuple[str, ...]) -> None:
    """a.vrt and b.vrt have these sources."""
    pytest.importorskip("rasterio")
    for name, source in zip(("a.vrt", "b.vrt"), sources, strict=False):
        _virtual_of(tmp_path / name, source)
    for reader in ("DEM", "geoid", "pixels"):
        read = READERS[reader][0]
        assert outcome(lambda read=read: read(tmp_path / "a.vrt"), 1000) == "raster.source", reader  # type: ignore[misc]


def test_virtual_raster_of_a_pipe_is_refused(tmp_path: Path) -> None:
    """GDAL would wait for the pipe without end."""
    pytest.importorskip("rasterio")
    if not hasattr(os, "mkfifo"):
        pytest.skip("no named pipes")
    os.mkfifo(tmp_path / "&pipe")
    with pytest.raises(InputError, match="pipe or device"):
        RasterDem(_virtual_of(tmp_path / "a.vrt", "&amp;pipe"))


def test_nested_virtual_rasters_are_limited(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    _small()(tmp_path / "0.tif")
    _virtual_of(tmp_path / "0.vrt", "0.tif")
    for k in range(MAX_NESTED + 1):
        _virtual_of(tmp_path / f"{k + 1}.vrt", f"{k}.vrt")
    assert RasterDem(tmp_path / "2.vrt").shape == (EDGE, EDGE)
    with pytest.raises(InputError, match="nested"):
        RasterDem(tmp_path / f"{MAX_NESTED + 1}.vrt")


@pytest.mark.parametrize("cell", ["1e300", "1e-300", "nan", "inf"])
def test_cells_of_an_impossible_size_are_refused(tmp_path: Path, cell: str) -> None:
    pytest.importorskip("rasterio")
    _small()(tmp_path / "a.tif")
    path = _virtual_of(tmp_path / "a.vrt", "a.tif", cell=cell)
    for read in (RasterDem, GeoidFile):
        with pytest.raises(InputError, match="size of a cell"):
            read(path)


@pytest.mark.parametrize(
    ("crs", "code"),
    [('LOCAL_CS["x",UNIT["metre",1]]', "dem.local_crs"), ("+proj=longlat +R=1737400 +no_defs", "body.dem"),
     ("EPSG:4230", ""), ("EPSG:4314", ""), ("EPSG:4326", "")],
)  # fmt: skip
def test_a_dem_lies_on_the_earth(tmp_path: Path, crs: str, code: str) -> None:
    """The remedy is not a geoid grid. Other ellipsoids of the Earth are read."""
    pytest.importorskip("rasterio")
    _small()(tmp_path / "a.tif")
    path = _virtual_of(tmp_path / "a.vrt", "a.tif", crs=crs)
    if not code:
        assert RasterDem(path).shape == (EDGE, EDGE)
        return
    with pytest.raises(InputError) as caught:
        RasterDem(path)
    assert [p.code for p in caught.value.problems] == [code]


def test_damaged_pixels_are_refused(tmp_path: Path) -> None:
    """Damaged pixels of an image give an InputError with the name of the file. GDAL reports them."""
    pytest.importorskip("rasterio")
    path = tmp_path / "a.tif"
    tiff(path, size(40, 30, 8) + strips(30, 50), bytes(range(50)))
    with pytest.raises(InputError, match=r"a\.tif") as caught:
        _pixels(path)
    assert caught.value.problems[0].code == "match.pixels"


def test_limits_of_rasters_can_be_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rasterio")
    path = tmp_path / "a.tif"
    _small((SUBFILE, LONG, 1, 1), directories=3)(path)
    for name, text in (("raster_pixels", "1199"), ("tiff_directories", "2")):
        monkeypatch.setenv(VARIABLE, f"{name}={text}")
        with pytest.raises(InputError, match=name):
            _pixels(path)
        monkeypatch.setenv(VARIABLE, f"{name}={int(text) + 1}")
        _pixels(path)


# --- binary tables ------------------------------------------------------------------------------------

NUMBERS = ("lon_deg", "lat_deg", "height_m", "sigma_east_m", "sigma_north_m", "sigma_up_m")


def _table(pa: Any, n: int, ids: Any) -> Any:
    return pa.table({"id": ids, "role": pa.nulls(n, pa.string()), **{name: np.zeros(n) for name in NUMBERS}})


#: Table: number of rows, ids, and the code of the refusal as Parquet and as Arrow.
TABLES: dict[str, tuple[int, Callable[[Any], Any], str, str]] = {
    "2 000 000 equal rows": (2_000_000, lambda pa: pa.nulls(2_000_000, pa.string()), "limits.memory", "limits.memory"),
    "a text of 210 MB": (1, lambda pa: pa.array(["a" * 210_000_000]), "limits.memory", "limits.memory"),
    "long texts": (3000, lambda pa: pa.array(["a" * 80_000] * 3000), "table.text", "limits.memory"),
    "a large dictionary": (
        3000, lambda pa: pa.array([f"{k}" + "a" * 80_000 for k in range(3000)]).dictionary_encode(), "limits.memory",
        "limits.memory",
    ),
}  # fmt: skip


def _write(path: Path, table: Any, pa: Any) -> None:
    if path.suffix == ".parquet":
        pa.parquet.write_table(table, path, compression="zstd")
        return
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema, options=options) as writer:
        writer.write_table(table)


def _points(path: Path) -> None:
    faults = Faults(str(path))
    read_points(path, "EPSG:4979", faults)
    faults.raise_if_any()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if "210 MB" in name else name for name in TABLES]
)
def test_table_is_refused_within_time_and_memory(tmp_path: Path, name: str) -> None:
    pa = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet")
    n, ids, *codes = TABLES[name]
    table = _table(pa, n, ids(pa))
    for path, code in zip((tmp_path / "a.parquet", tmp_path / "a.arrow"), codes, strict=True):
        _write(path, table, pa)
        assert outcome(lambda path=path: _points(path), path.stat().st_size) == code, path.name  # type: ignore[misc]


def test_many_columns_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pa = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet")
    monkeypatch.setenv(VARIABLE, "table_columns=50")
    for path in (tmp_path / "a.parquet", tmp_path / "a.arrow"):
        _write(path, pa.table({f"c{k}": [0.0] for k in range(51)}), pa)
        assert outcome(lambda path=path: _points(path), path.stat().st_size) == "limits.exceeded"  # type: ignore[misc]


@pytest.mark.parametrize("compression", [None, "zstd", "lz4"])
def test_sizes_of_arrow_files_are_those_of_their_buffers(tmp_path: Path, compression: str | None) -> None:
    """The sizes read from an Arrow file are those of pyarrow's buffers, padded to 8 bytes."""
    pa = pytest.importorskip("pyarrow")
    ids = pa.array([f"point {k}" for k in range(1000)] * 3).dictionary_encode()
    table = pa.table({"id": ids, "number": np.arange(3000.0), "text": pa.array(["ab", None, "c"] * 1000)})
    options = pa.ipc.IpcWriteOptions(compression=compression)
    path = tmp_path / "a.arrow"
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=2000)
    with pa.ipc.open_file(str(path)) as reader:
        batches = [reader.get_batch(k) for k in range(reader.num_record_batches)]
    held = [sum(len(one) for column in batch.columns for one in column.buffers() if one) for batch in batches]
    words = sum(len(one) for one in ids.dictionary.buffers() if one)
    found = decoded_sizes(path)
    assert words <= found.dictionaries < words + 64 * 3
    assert max(held) <= found.largest < max(held) + 64 * 12


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("compression", ["none", "zstd", "snappy", "gzip"])
def test_sizes_of_parquet_files_are_those_of_their_pages(tmp_path: Path, compression: str, version: str) -> None:
    """The sizes read from the headers of the pages add up to those of the footer, which contain the headers, too."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = pa.table({"id": [f"point {k % 400}" for k in range(3000)], "number": np.arange(3000.0),
                      "text": ["ab", None, "c" * 90] * 1000, "flag": [True, False, None] * 1000})  # fmt: skip
    path = tmp_path / "a.parquet"
    parquet.write_table(
        table, path, row_group_size=2000, compression=compression, data_page_version=version, data_page_size=2000,
        write_page_checksum=True, use_dictionary=["id"],
    )  # fmt: skip
    meta = parquet.read_metadata(path)
    stated = [meta.row_group(k).total_byte_size for k in range(2)]
    pages = -(-stated[0] // 1000)  # at least 1000 bytes each; a header has at most 200 bytes with its statistics
    assert stated[0] - 200 * pages < largest_group_bytes(path) < stated[0]


def _varint(number: int, length: int) -> bytes:
    """Return a number of Thrift's compact protocol with a length that is given: zigzag, groups of 7 bits."""
    groups = [(2 * number) >> 7 * k & 127 for k in range(length)]
    return bytes([*(group | 128 for group in groups[:-1]), groups[-1]])


def test_pages_larger_than_the_footer_states_are_refused(tmp_path: Path) -> None:
    """A text of 240 MB in 20 kB, whose footer states 9 bytes, is refused before it is decompressed."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    parquet.write_table(_table(pa, 1, ["a" * 240_000_000]), path, compression="zstd", use_dictionary=False,
                        write_statistics=False)  # fmt: skip
    group = parquet.read_metadata(path).row_group(0)
    begin, data = max(group.column(k).data_page_offset for k in range(8)), path.read_bytes()
    footer = data[begin:]
    for number in (group.total_byte_size, group.column(0).total_uncompressed_size):
        length = next(k for k in range(1, 9) if 2 * number < 128**k)
        assert _varint(number, length) in footer
        footer = footer.replace(_varint(number, length), _varint(9, length))
    path.write_bytes(data[:begin] + footer)
    assert parquet.read_metadata(path).row_group(0).total_byte_size == 9
    assert outcome(lambda: _points(path), path.stat().st_size) == "limits.memory"


@pytest.mark.parametrize("damage", [
    b"\x15\x00\x15\x01", b"\x15\x00\x15\x02\x15\x01", b"\xff" * 12, b"\x1c" * 12, b"\x19\xfc" + b"\xff" * 8,
    b"\x1d\x00",
])  # fmt: skip
def test_damaged_headers_of_pages_are_one_line(tmp_path: Path, damage: bytes) -> None:
    """Negative sizes, endless numbers, deep structs, long lists and unknown types: one error names the file."""
    pa = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    _write(path, _table(pa, 1, ["a"]), pa)
    data = path.read_bytes()
    path.write_bytes(data[:4] + damage + data[4 + len(damage) :])
    with pytest.raises(InputError, match=r"a\.parquet") as caught:
        _points(path)
    assert [one.code for one in caught.value.problems] == ["table.damaged"]
