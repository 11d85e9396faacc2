"""RPC files of every writer are read back unchanged; an error is one line with place and remedy."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factors.cameras.rfm import permutation
from fg_orient.formats.registry import formats
from fg_orient.formats.rpc import dimap as rpc_dimap
from fg_orient.formats.rpc import read_rpc, rpc_format, write_rpc
from fg_orient.formats.rpc.fields import FIRST_PIXEL, POLYNOMIALS
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel, RpcValidity
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.changed_text import changed
from tests.support.rpc_model import synthetic_model

GEOM = """\
bias_error:  0.5
rand_error:  0.25
number_lines:  20000
number_samples:  24000
polynomial_format:  {order}
type:  {kind}
adjustment_0.adj_param_0.parameter:  {adjusted}
"""


@pytest.fixture
def model() -> RpcModel:
    """Return the model with error estimates, as RPC00B files have them."""
    return synthetic_model(err_bias_m=2.5, err_rand_m=0.125)


def assert_same(found: RpcModel, expected: RpcModel, relative: float = 0.0) -> None:
    """Assert that two models are equal, by default to the last digit."""
    for name in ("offsets", "scales", "coefficients"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert np.all(np.abs(ours - theirs) <= relative * np.abs(theirs)), name


def geotiff(path: Path) -> Path:
    import rasterio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", width=7, height=5, count=1, dtype="uint8") as image:
            image.write(np.arange(35, dtype="uint8").reshape(5, 7), 1)
    return path


@pytest.mark.consistency
@pytest.mark.parametrize("name", ["a_RPC.TXT", "a_rpc.txt", "a.RPB"])
def test_text_formats_round_trip_to_the_last_digit(tmp_path: Path, model: RpcModel, name: str) -> None:
    write_rpc(tmp_path / name, model)
    found = read_rpc(tmp_path / name)
    assert_same(found, model)
    assert (found.err_bias_m, found.err_rand_m) == (2.5, 0.125)
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.consistency
@pytest.mark.parametrize(
    ("form", "first"),
    [("DIMAP 2.15 PHR_SENSOR", 1), ("DIMAP 2.0 S6_SENSOR", 0), ("DIMAP 2.12 S7_SENSOR", 0),
     ("DIMAP 3.0 PNEO_SENSOR", 0), (rpc_dimap.V1_NAME, 1)],
)  # fmt: skip
def test_dimap_round_trip_in_every_version(tmp_path: Path, model: RpcModel, form: str, first: int) -> None:
    """Each version of DIMAP RPC is read back with both models and the validity, and writes its own pixel origin."""
    direct = synthetic_model(5).coefficients
    stated = RpcValidity((0.0, 19000.0), (0.0, 23000.0), (31.7, 31.9), (41.3, 41.5), (0.0, 1000.0))
    given = replace(model, format=form, direct=direct, stated_validity=stated)
    write_rpc(tmp_path / "RPC.XML", given)
    found = read_rpc(tmp_path / "RPC.XML")
    assert_same(found, given)
    assert found.direct is not None
    assert np.array_equal(found.direct, direct)
    assert found.validity == stated
    assert found.format == form
    tag = "B" if form == rpc_dimap.V1_NAME else "LINE_OFF"
    text = (tmp_path / "RPC.XML").read_text()
    values = [float(v) for v in re.findall(rf"<{tag}>([^<]*)<", text)]
    assert values[0] == model.offsets[0] + first


@pytest.mark.behaviour
def test_a_model_of_another_format_becomes_pleiades_dimap_without_direct_model(tmp_path: Path, model: RpcModel) -> None:
    write_rpc(tmp_path / "RPC.XML", replace(model, format="RPB"))
    found = read_rpc(tmp_path / "RPC.XML")
    assert_same(found, model)
    assert found.format == "DIMAP 2.15 PHR_SENSOR"
    with pytest.raises(InputError, match="no coefficients from image to ground"):
        found.locate_directly(0.0, 0.0, 0.0)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["image.tif", "image.TIFF"])
def test_geotiff_tags_round_trip_and_pixels_stay(tmp_path: Path, model: RpcModel, name: str) -> None:
    """The tags written to a GeoTIFF are read back, GDAL reads them as its RPC, and the pixels do not change."""
    import rasterio

    path = geotiff(tmp_path / name)
    write_rpc(path, model)
    found = read_rpc(path)
    assert_same(found, model, relative=5e-15)  # GDAL hands tags over as text with 15 digits
    assert (found.n_lines, found.n_samples) == (5, 7)
    assert (found.err_bias_m, found.err_rand_m) == (2.5, 0.125)
    with rasterio.open(path) as image:
        assert np.array_equal(image.read(1).ravel(), np.arange(35))
        rpc = image.rpcs
    fields = [
        [getattr(rpc, f"{axis}_{what}") for axis in ("line", "samp", "long", "lat", "height")]
        for what in ("off", "scale")
    ]
    np.testing.assert_allclose(fields, [model.offsets, model.scales], rtol=5e-15)
    polynomials = [getattr(rpc, f"{axis}_{part}_coeff") for axis in ("line", "samp") for part in ("num", "den")]
    np.testing.assert_allclose(polynomials, model.coefficients, rtol=5e-15)
    assert {p.name for p in tmp_path.iterdir()} <= {name, f"{name}.aux.xml"}


@pytest.mark.behaviour
def test_geotiff_without_tags_and_without_an_image(tmp_path: Path, model: RpcModel) -> None:
    with pytest.raises(InputError, match="contains no RPC"):
        read_rpc(geotiff(tmp_path / "image.tif"))
    with pytest.raises(InputError, match="existing GeoTIFF"):
        write_rpc(tmp_path / "none.tif", model)
    (tmp_path / "broken.tif").write_bytes(b"II*\0 and nothing else")
    with pytest.raises(InputError, match="cannot be read"):
        read_rpc(tmp_path / "broken.tif")


def geom_text(model: RpcModel, order: str = "B", kind: str = "ossimRpcModel", adjusted: str = "0") -> str:
    """Return the text of an OSSIM keyword list."""
    lines = []
    for k, axis in enumerate(("line", "samp", "long", "lat", "height")):
        lines += [f"{axis}_off:  {float(model.offsets[k])!r}", f"{axis}_scale:  {float(model.scales[k])!r}"]
    for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True):
        lines += [f"{stem.lower()}_coeff_{k:02d}:  {float(v)!r}" for k, v in enumerate(row)]
    return GEOM.format(order=order, kind=kind, adjusted=adjusted) + "\n".join(lines) + "\n"


@pytest.mark.behaviour
def test_ossim_keyword_list(tmp_path: Path, model: RpcModel) -> None:
    path = tmp_path / "a.geom"
    path.write_text(geom_text(model, adjusted="0.25"))
    found = read_rpc(path)
    assert_same(found, model)
    assert (found.n_lines, found.n_samples, found.err_bias_m) == (20000, 24000, 0.5)
    assert found.validity.line == (0.0, 19999.0)
    assert any("not applied" in str(note) for note in found.notes)


@pytest.mark.behaviour
def test_ossim_spot_offsets_that_lost_a_pixel_get_it_back(tmp_path: Path) -> None:
    """For SPOT in OSSIM, offsets one pixel below the scales are corrected with a note; equal ones are kept.

    The vendor's offsets equal the scales; versions of OSSIM differ (docs/rpc.md).
    """
    scales = synthetic_model().scales
    for lost in (0.0, 1.0):
        offsets = synthetic_model().offsets.copy()
        offsets[:2] = scales[:2] - lost
        path = tmp_path / f"{lost:g}.geom"
        path.write_text(geom_text(synthetic_model(offsets=offsets), kind="ossimSpot6Model"))
        found = read_rpc(path)
        assert found.offsets[:2].tolist() == scales[:2].tolist()
        assert len(found.notes) == lost


def isd_text(model: RpcModel, spec: str = "RPC00B") -> str:
    """Return the DigitalGlobe XML with an RPB section."""
    cells = "".join(
        f"<{name}OFFSET>{float(model.offsets[k])!r}</{name}OFFSET><{name}SCALE>{float(model.scales[k])!r}</{name}SCALE>"
        for k, name in enumerate(("LINE", "SAMP", "LONG", "LAT", "HEIGHT"))
    )
    for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True):
        tag = stem.replace("_", "") + "COEF"
        cells += f"<{tag}List><{tag}>{' '.join(repr(float(v)) for v in row)}</{tag}></{tag}List>"
    head = "<IMD><NUMROWS>20000</NUMROWS><NUMCOLUMNS>24000</NUMCOLUMNS></IMD>"
    return f"<isd>{head}<RPB><SPECID>{spec}</SPECID><IMAGE>{cells}</IMAGE></RPB></isd>"


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["a.XML", "a.vrt"])
def test_digitalglobe_xml_and_virtual_raster(tmp_path: Path, model: RpcModel, name: str) -> None:
    path = tmp_path / name
    path.write_text({"a.XML": isd_text, "a.vrt": vrt_text}[name](model))
    found = read_rpc(path)
    assert_same(found, model)
    assert (found.n_lines, found.n_samples) == (20000, 24000)
    if name == "a.vrt":
        path.write_text(vrt_text(model).replace('domain="RPC"', 'domain="RPB"'))
        with pytest.raises(InputError, match="contains no RPC"):
            read_rpc(path)


def vrt_text(model: RpcModel) -> str:
    """Return the virtual raster of GDAL with an RPC domain, and a source that must not be opened."""
    names = [(axis, k) for k, axis in enumerate(("LINE", "SAMP", "LONG", "LAT", "HEIGHT"))]
    cells = [(f"{axis}_OFF", [model.offsets[k]]) for axis, k in names]
    cells += [(f"{axis}_SCALE", [model.scales[k]]) for axis, k in names]
    cells += [(f"{stem}_COEFF", list(row)) for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True)]
    body = "".join(f'<MDI key="{key}">{" ".join(repr(float(v)) for v in row)}</MDI>' for key, row in cells)
    band = "<VRTRasterBand><SimpleSource><SourceFilename>/nowhere</SourceFilename></SimpleSource></VRTRasterBand>"
    size = 'rasterXSize="24000" rasterYSize="20000"'
    return f'<VRTDataset {size}><Metadata/><Metadata domain="RPC">{body}</Metadata>{band}</VRTDataset>'


def list_text(model: RpcModel) -> str:
    """Return the text of a list of 90 numbers with latitude before longitude."""
    order = [0, 1, 3, 2, 4]
    numbers = [*model.offsets[order], *model.scales[order], *model.coefficients.ravel()]
    return "\n".join(repr(float(v)) for v in numbers)


@pytest.mark.behaviour
def test_list_of_numbers_needs_the_origin(tmp_path: Path, model: RpcModel) -> None:
    path = tmp_path / "a.txt"
    path.write_text(list_text(model))
    with pytest.raises(
        InputError, match=r"option first_pixel 0, or 1 for Pléiades; in Python read_rpc\(path, first_pixel=0\)"
    ):
        read_rpc(path)
    assert_same(read_rpc(path, first_pixel=0), model)
    assert read_rpc(path, first_pixel=1).offsets[:2].tolist() == (model.offsets[:2] - 1).tolist()


# --- pixel origins and term orders -----------------------------------------------------------


@pytest.mark.behaviour
def test_pixel_origins_are_those_of_the_table() -> None:
    """The first pixel of each RPC format is that of the table in docs/rpc.md."""
    assert FIRST_PIXEL == 0.0
    assert rpc_dimap.FIRST_PIXEL == {"PHR": (1, 1), "S6": (0, 1), "S7": (0, 1), "PNEO": (0, 0)}


@pytest.mark.behaviour
def test_first_pixel_given_wins(tmp_path: Path, model: RpcModel) -> None:
    write_rpc(tmp_path / "RPC.XML", replace(model, format="DIMAP 2.0 S6_SENSOR"))
    found = read_rpc(tmp_path / "RPC.XML", first_pixel=1)
    assert found.offsets[0] == model.offsets[0] - 1.0


@pytest.mark.behaviour
def test_unknown_profile_takes_the_first_row_of_its_domain_and_says_so(tmp_path: Path, model: RpcModel) -> None:
    write_rpc(tmp_path / "RPC.XML", replace(model, format="DIMAP 2.0 PHR_SENSOR"))
    text = (tmp_path / "RPC.XML").read_text().replace("PHR_SENSOR", "PER1_SENSOR")
    (tmp_path / "RPC.XML").write_text(text)
    found = read_rpc(tmp_path / "RPC.XML")
    assert found.offsets[0] == model.offsets[0]
    assert any("first_pixel=" in str(note) for note in found.notes)


@pytest.mark.behaviour
def test_exchanged_longitude_and_latitude_of_the_domain_are_put_right(tmp_path: Path, model: RpcModel) -> None:
    write_rpc(tmp_path / "RPC.XML", replace(model, format="DIMAP 2.0 S6_SENSOR"))
    text = (tmp_path / "RPC.XML").read_text()
    text = text.replace("_LON>", "_XXX>").replace("_LAT>", "_LON>").replace("_XXX>", "_LAT>")
    (tmp_path / "RPC.XML").write_text(text)
    found = read_rpc(tmp_path / "RPC.XML")
    assert found.validity == model.validity
    assert any("exchanged" in str(note) for note in found.notes)


@pytest.mark.consistency
@pytest.mark.parametrize("order", ["RPC00A", "T2.54"])
def test_other_term_orders_are_read_when_asked_for(tmp_path: Path, model: RpcModel, order: str) -> None:
    shuffled = replace(model, coefficients=model.coefficients[:, permutation("RPC00B", order)])
    write_rpc(tmp_path / "a_RPC.TXT", shuffled)
    assert_same(read_rpc(tmp_path / "a_RPC.TXT", order=order), model)


@pytest.mark.behaviour
def test_files_that_name_rpc00a_are_refused_until_asked_for(tmp_path: Path, model: RpcModel) -> None:
    shuffled = replace(model, coefficients=model.coefficients[:, permutation("RPC00B", "RPC00A")])
    write_rpc(tmp_path / "a.RPB", shuffled)
    write_rpc(tmp_path / "a.XML", shuffled)
    (tmp_path / "a.geom").write_text(geom_text(shuffled, order="A"))
    (tmp_path / "isd.XML").write_text(isd_text(shuffled, "RPC00A"))
    for name in ("a.RPB", "a.XML"):
        (tmp_path / name).write_text((tmp_path / name).read_text().replace("RPC00B", "RPC00A"))
    for name in ("a.RPB", "a.XML", "a.geom", "isd.XML"):
        with pytest.raises(InputError, match=r"read_rpc\(path, order='RPC00A'\)") as caught:
            read_rpc(tmp_path / name)
        assert caught.value.problems[0].place
        assert_same(read_rpc(tmp_path / name, order="RPC00A"), model)


@pytest.mark.behaviour
def test_unknown_order() -> None:
    with pytest.raises(InputError, match="choose one of RPC00B, RPC00A, T2"):
        read_rpc("none", order="RPC00C")


# --- bad input -------------------------------------------------------------------------------


def without(key: str) -> Callable[[str], str]:
    return lambda text: "".join(row for row in text.splitlines(keepends=True) if not row.startswith(key))


def sub(pattern: str, new: str) -> Callable[[str], str]:
    return lambda text: re.sub(pattern, new, text, count=1, flags=re.MULTILINE)


BAD_TEXT = [
    (without("LINE_NUM_COEFF_20"), "rpc.coefficient_count", "LINE_NUM_COEFF", "19"),
    (lambda t: t + "SAMP_DEN_COEFF_21: 0\n", "rpc.coefficient_count", "SAMP_DEN_COEFF", "21"),
    (sub(r"^SAMP_DEN_COEFF_20:", "SAMP_DEN_COEFF_21:"), "rpc.missing", "", "SAMP_DEN_COEFF_20"),
    (without("HEIGHT_OFF"), "rpc.missing", "", "HEIGHT_OFF"),
    (lambda t: t + "LINE_OFF: 1\n", "rpc.doubled", "line 93", "LINE_OFF"),
    (sub(r"^LAT_SCALE: \S+", "LAT_SCALE: 0.0"), "rpc.zero_scale", "scale of latitude", "0"),
    (sub(r"^LINE_DEN_COEFF_1: \S+", "LINE_DEN_COEFF_1: 2"), "rpc.denominator_constant", "line denominator", "2"),
    (sub(r"^LONG_OFF: \S+", "LONG_OFF: 31,8"), "rpc.not_a_number", "line 6, LONG_OFF", "31,8"),
    (sub(r"^LONG_OFF: \S+", "LONG_OFF: nan"), "rpc.not_a_number", "LONG_OFF", "nan"),
    (sub(r"^LONG_OFF: \S+", "LONG_OFF: 1e999"), "rpc.not_a_number", "LONG_OFF", "1e999"),
    (sub(r"^LONG_OFF: .*", "LONG_OFF = 31.8"), "rpc.syntax", "line 6", "LONG_OFF = 31.8"),
    (sub(r"^LONG_OFF", "LONGITUDE_OFF"), "rpc.syntax", "line 6", "LONGITUDE_OFF"),
    (lambda t: "\n".join(f"{k} {k}" for k in "abc"), "rpc.unknown_format", "content", "a a"),
]  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize(("spoil", "code", "place", "value"), BAD_TEXT)
def test_bad_text_file(
    tmp_path: Path, model: RpcModel, spoil: Callable[[str], str], code: str, place: str, value: str
) -> None:
    path = tmp_path / "a_RPC.TXT"
    write_rpc(path, model)
    path.write_text(spoil(path.read_text()))
    with pytest.raises(InputError) as caught:
        read_rpc(path)
    (fault,) = caught.value.problems
    assert fault.code == code
    assert place in fault.place
    assert value in str(fault)
    assert fault.file == str(path)
    assert fault.remedy
    assert "\n" not in str(fault)


@pytest.mark.behaviour
def test_bad_rpb_and_dimap_name_the_place(tmp_path: Path, model: RpcModel) -> None:
    rpb, xml = tmp_path / "a.RPB", tmp_path / "a.XML"
    write_rpc(rpb, model)
    write_rpc(xml, replace(model, direct=model.coefficients))
    rpb.write_text(re.sub(r",\n\s*[-\d.e]+\);", ");", rpb.read_text(), count=1))
    with pytest.raises(InputError, match=r"LINE_NUM_COEFF: 20 coefficients are needed, 19 are given"):
        read_rpc(rpb)
    text = xml.read_text()
    for old, new, expected in (
        ("<LINE_SCALE>10000.0</LINE_SCALE>", "", "LINE_SCALE is missing"),
        (
            "<LINE_OFF>10001.0<",
            "<LINE_OFF>many<",
            r"line \d+, .*LINE_OFF.*this is not a plain finite number \(found many\)",
        ),
        ("<LINE_SCALE>10000.0<", "<LINE_SCALE>0<", "scale of line: the scale is zero"),
    ):
        xml.write_text(changed(text, (old, new)))
        with pytest.raises(InputError, match=expected):
            read_rpc(xml)
    zero = re.sub(r"<SAMP_DEN_COEFF_1>1.0<", "<SAMP_DEN_COEFF_1>0<", text, count=1)
    xml.write_text(zero)
    with pytest.raises(InputError, match="constant of a denominator must be 1"):
        read_rpc(xml)


@pytest.mark.behaviour
def test_direct_models_are_scaled_to_unit_constants(tmp_path: Path, model: RpcModel) -> None:
    """A direct model whose denominator begins with another constant than 1 is read with both parts scaled to 1.

    Some programs write 0.9996.
    """
    direct = synthetic_model(5).coefficients.copy()
    path = tmp_path / "a.XML"
    write_rpc(path, replace(model, direct=np.concatenate([direct[:2] * 0.5, direct[2:]])))
    found = read_rpc(path).direct
    assert found is not None
    assert np.array_equal(found, direct)


@pytest.mark.behaviour
def test_other_bad_files(tmp_path: Path, model: RpcModel) -> None:
    short = tmp_path / "list.txt"
    short.write_text(list_text(model).rsplit("\n", 1)[0])
    for first_pixel in (1.0, None):  # a table of other numbers is none, whatever it counts from
        with pytest.raises(InputError, match=r"must contain 90 numbers \(found 89 numbers\)"):
            read_rpc(short, first_pixel=first_pixel)
    isd = tmp_path / "isd.XML"
    isd.write_text("<isd><IMD/></isd>")
    with pytest.raises(InputError, match="element RPB is missing"):
        read_rpc(isd)
    geom = tmp_path / "a.geom"
    geom.write_text(geom_text(model).replace("number_lines:  20000", "number_lines:  many"))
    with pytest.raises(InputError, match="line 3, number_lines: this is not a plain finite number"):
        read_rpc(geom)
    with pytest.raises(InputError, match="does not exist"):
        read_rpc(tmp_path / "none")
    with pytest.raises(InputError, match="folder"):
        read_rpc(tmp_path)
    with pytest.raises(InputError, match=r"end the name with _RPC\.TXT"):
        write_rpc(tmp_path / "model.dat", model)
    with pytest.raises(InputError, match=r"none.*model\.RPB"):
        write_rpc(tmp_path / "none" / "model.RPB", model)


@pytest.mark.behaviour
def test_each_format_is_told_from_all_others(tmp_path: Path, model: RpcModel) -> None:
    write_rpc(tmp_path / "a_RPC.TXT", model)
    write_rpc(tmp_path / "a.RPB", model)
    write_rpc(tmp_path / "a.XML", model)
    write_rpc(tmp_path / "v1.XML", replace(model, format=rpc_dimap.V1_NAME, direct=model.coefficients))
    write_rpc(geotiff(tmp_path / "a.tif"), model)
    (tmp_path / "a.geom").write_text(geom_text(model))
    (tmp_path / "isd.XML").write_text(isd_text(model))
    (tmp_path / "list.txt").write_text(list_text(model))
    (tmp_path / "a.vrt").write_text(vrt_text(model))
    files = ("a.tif", "a.vrt", "a.XML", "v1.XML", "isd.XML", "a.RPB", "a_RPC.TXT", "a.geom", "list.txt")
    found = [rpc_format(tmp_path / name) for name in files]
    titles = ("GeoTIFF", "GDAL VRT or .aux.xml", "DIMAP 2 or 3 RPC XML", "PHR_DIMAP", "DigitalGlobe XML", "RPB",
              "_RPC.TXT", "OSSIM .geom", "list of 90 numbers")  # fmt: skip
    assert [form and form.title for form in found] == list(titles)
    known = formats("rpc")
    assert len(known) == len(titles)
    for name, title in zip(files, titles, strict=True):
        head = (tmp_path / name).read_bytes()[:65536].decode("latin-1")
        claims = [form.title for form in known.values() if form.sniff is not None and form.sniff(tmp_path / name, head)]
        assert claims == [title]
    assert isinstance(read_sensor(tmp_path / "a_RPC.TXT"), RpcSensor)


@pytest.mark.behaviour
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path, model: RpcModel) -> None:
    """The reader raises nothing but an InputError of one line if bytes of an RPC file are changed at random."""
    rng = np.random.default_rng(7)
    given = replace(model, direct=model.coefficients)
    for name, form in (
        ("a_RPC.TXT", ""),
        ("a.RPB", ""),
        ("2.XML", "DIMAP 2.0 S6_SENSOR"),
        ("1.XML", rpc_dimap.V1_NAME),
    ):
        write_rpc(tmp_path / name, replace(given, format=form))
    texts = [path.read_bytes() for path in sorted(tmp_path.iterdir())]
    texts += [text.encode() for text in (geom_text(model), isd_text(model), vrt_text(model), list_text(model))]
    path, refused = tmp_path / "damaged", 0
    for k in range(400):
        data = bytearray(texts[k % len(texts)])
        first = int(rng.integers(0, len(data)))
        last = first + int(rng.integers(1, 60))
        part = [b"", data[first:last] * 2, b"\x00", b"nan", b"<", b"9e99"][int(rng.integers(0, 6))]
        data[first:last] = part
        path.write_bytes(data)
        try:
            read_rpc(path, first_pixel=0)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error.problems[0])
    assert refused > 200


@pytest.mark.behaviour
def test_without_rasterio_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    path = geotiff(tmp_path / "a.tif")
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match="fg-orient\\[geo\\]"):
        read_rpc(path)
