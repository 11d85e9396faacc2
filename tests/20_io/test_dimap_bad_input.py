"""Bad files give one line each with file, place, value and remedy; every code of xml and dimap is raised."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.model.errors import Finding, InputError
from fg_orient.sensors.metadata import PushbroomMetadata

pytestmark = pytest.mark.behaviour

Refused = Callable[..., Finding]

# old text (regular expression, first hit), new text, code, place, value
CHANGES_1 = [
    (r"<LINE_PERIOD>.*?</LINE_PERIOD>", "", "xml.missing_element", "Time_Stamp", ""),
    (r"(<LINE_PERIOD>.*?</LINE_PERIOD>)", r"\1\1", "xml.doubled", "LINE_PERIOD", "2 times"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD> <", "xml.empty", "LINE_PERIOD", ""),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>quick<", "xml.not_a_number", "LINE_PERIOD", "quick"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>1_0<", "xml.not_a_number", "LINE_PERIOD", "1_0"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>٣<", "xml.not_a_number", "LINE_PERIOD", "٣"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>0,00075<", "xml.decimal_comma", "LINE_PERIOD", "0,00075"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>NaN<", "xml.not_finite", "LINE_PERIOD", "NaN"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>-inf<", "xml.not_finite", "LINE_PERIOD", "-inf"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>1e400<", "xml.not_finite", "LINE_PERIOD", "1e400"),
    (r"<LINE_PERIOD>", '<LINE_PERIOD unit="m">', "xml.unit", "LINE_PERIOD", "m"),
    (r"<LINE_PERIOD>", '<LINE_PERIOD unit="">', "xml.unit", "LINE_PERIOD", "empty"),
    (r"<LINE_PERIOD>", '<LINE_PERIOD unit="ms">', "xml.out_of_range", "LINE_PERIOD", "0.00075"),
    (r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>0<", "xml.out_of_range", "LINE_PERIOD", "0"),
    (r"<LINE_PERIOD>", "<LINE_PERIOD><!-- -->", "xml.not_plain", "LINE_PERIOD", ""),
    (r"<NROWS>40<", "<NROWS>40.5<", "xml.not_whole", "NROWS", "40.5"),
    (r"<NROWS>40<", "<NROWS>-40<", "xml.out_of_range", "NROWS", "-40"),
    (r"<SCENE_CENTER_TIME>.*?<", "<SCENE_CENTER_TIME>noon<", "xml.not_a_time", "SCENE_CENTER_TIME", "noon"),
    (r"2005-03-13T", "2005-02-30T", "xml.not_a_time", "TIME", "2005-02-30"),
    (r"T05:19:07", "T24:19:07", "xml.not_a_time", "TIME", "T24"),
    (r"T05:19:07", "T05:19:60", "xml.not_a_time", "TIME", ":60"),
    (r"<PIXEL_ORIGIN>1<", "<PIXEL_ORIGIN>0<", "dimap.pixel_origin", "PIXEL_ORIGIN", "0"),
    (r"T05:19:07", "T05:20:07", "dimap.time_order", "Points/Point/TIME", "05:19:37"),
    (r"<Points>.*</Points>", "<Points></Points>", "xml.too_few", "Ephemeris/Points", "0 Point"),
    (r"(<Location>\s*<X>).*?<", r"\g<1>-7200000000.0<", "dimap.radius", "Points/Point", "e+09"),
    (r"(<Location>\s*<X)>", r'\1 unit="km">', "dimap.radius", "Points/Point", "e+09"),
    (r"(<Velocity>\s*<X>).*?<", r"\g<1>-70000.0<", "dimap.speed", "Points/Point", "70386"),
    (r"<PSI_Y>.*?<", "<PSI_Y>1.5<", "xml.out_of_range", "PSI_Y", "1.5"),
    (r"<DETECTOR_ID>7<", "<DETECTOR_ID>5<", "dimap.detector_order", "DETECTOR_ID", "5"),
    (r"<DETECTOR_ID>7<", "<DETECTOR_ID>700<", "xml.out_of_range", "DETECTOR_ID", "700"),
    (r"<NCOLS>24<", "<NCOLS>48<", "dimap.detectors_cover", "Instrument_Look_Angles", "1 to 24"),
    (r"<FRAME_LAT>.*?<", "<FRAME_LAT>95<", "xml.out_of_range", "FRAME_LAT", "95"),
    (r"<MISSION_INDEX>5<", "<MISSION_INDEX>6<", "xml.out_of_range", "MISSION_INDEX", "6"),
    (r"<MISSION>SPOT<", "<MISSION>FORMOSAT<", "dimap.other_mission", "MISSION", "FORMOSAT"),
    (r"SPOTSCENE_1A", "SPOTSCENE_1B", "dimap.other_level", "Metadata_Id", "SPOTSCENE_1B"),
    (r"SPOTSCENE_1A", "S2A_L1C", "dimap.other_mission", "Metadata_Id", "S2A_L1C"),
    (r"<PROCESSING_LEVEL>1A<", "<PROCESSING_LEVEL>2A<", "dimap.other_level", "PROCESSING_LEVEL", "2A"),
    (r'version="1.1"', 'version="1.0"', "dimap.other_version", "METADATA_FORMAT", "DIMAP 1.0"),
    (r' version="1.1"', "", "dimap.other_version", "METADATA_FORMAT", "without version"),
]  # fmt: skip

INCLUDE = '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="/etc/hostname" parse="text"/>'

CHANGES_2 = [
    (r'version="2.0"', 'version="3.0"', "dimap.other_version", "METADATA_FORMAT", "DIMAP 3.0"),
    (r">PHR_SENSOR<", ">PHR_ORTHO<", "dimap.other_level", "Metadata_Identification", "PHR_ORTHO"),
    (r">PHR_SENSOR<", ">PNEO_SENSOR<", "dimap.other_mission", "Metadata_Identification", "Pléiades Neo"),
    (r">PRODUCT<", ">RPC<", "dimap.rpc_file", "Metadata_Identification", "PHR_SENSOR"),
    (r'(<LINE_PERIOD unit="s">)7.35e-05', r"\g<1>7.35e-03", "dimap.duration", "LINE_PERIOD", "s"),
    (r"<OFFSET>.*?<", "<OFFSET>5.0<", "dimap.quaternion_span", "SCALE", "scaled time"),
    (r"<COEFFICIENTS>0.5 ", "<COEFFICIENTS>0.6 ", "dimap.quaternion_norm", "Polynomial_Quaternions", "norm 1.05"),
    (r"<COEFFICIENTS>0.5 ", "<COEFFICIENTS>", "xml.wrong_count", "COEFFICIENTS", "2 numbers"),
    (r"<XLOS_1>.*?</XLOS_1>", "", "xml.missing_element", "Polynomial_Look_Angles", ""),
    (r"<XLOS_1>.*?<", "<XLOS_1>0.7<", "dimap.look_angle", "Polynomial_Look_Angles", "XLOS"),
    (r'unit="m/s">[^ ]* ', 'unit="m/s">nan ', "xml.not_finite", "VELOCITY_XYZ", "nan"),
    (r'unit="m/s"', 'unit="knots"', "xml.unit", "VELOCITY_XYZ", "knots"),
    (r"<PIXEL_ORIGIN>1<", "<PIXEL_ORIGIN>0<", "dimap.pixel_origin", "PIXEL_ORIGIN", "0"),
    (r"<Polynomial_Quaternions>.*</Polynomial_Quaternions>", "", "xml.missing_element", "Attitudes", ""),
]  # fmt: skip

#: Codes raised elsewhere: files below, raw attitudes and writers in their own modules.
ELSEWHERE = {
    "dimap.speed_span", "dimap.speed_gap", "dimap.anchor", "dimap.not_writable", "dimap.other_format",
    "xml.missing_file", "xml.not_a_file", "xml.unreadable", "xml.empty_file", "xml.not_xml",
    "xml.html", "xml.malformed", "xml.doctype",
}  # fmt: skip


def change(path: Path, old: str, new: str) -> Path:
    before = path.read_text("utf-8")
    after, count = re.subn(old, new, before, count=1, flags=re.DOTALL)
    assert count == 1 and after != before
    path.write_text(after, "utf-8")
    return path


def line_of(problem: Finding) -> int:
    found = re.match("line ([0-9]+)", problem.place)
    assert found is not None, problem.place
    return int(found[1])


@pytest.mark.parametrize(
    ("name", "old", "new", "code", "place", "value"),
    [*(("dim1", *row) for row in CHANGES_1), *(("dim2", *row) for row in CHANGES_2),
     ("dim1", r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>&e;<", "xml.malformed", "line", ""),
     ("dim1", r"<LINE_PERIOD>.*?<", f"<LINE_PERIOD>{INCLUDE}<", "xml.not_plain", "LINE_PERIOD", "")],
)  # fmt: skip
def test_file_with_one_fault(
    request: pytest.FixtureRequest, refused: Refused, name: str, old: str, new: str, code: str, place: str, value: str
) -> None:
    """A SPOT 5 or Pléiades file with one fault is refused in one line with code, place, value and line number."""
    problem = refused(change(request.getfixturevalue(name), old, new), code, place, value)
    assert line_of(problem) >= 1


def test_the_line_number_is_that_of_the_element(dim1: Path, refused: Refused) -> None:
    change(dim1, r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>x<")
    lines = dim1.read_text().splitlines()
    wanted = next(k for k, text in enumerate(lines, start=1) if "<LINE_PERIOD>" in text)
    problem = refused(dim1, "xml.not_a_number", "Data_Strip/Sensor_Configuration/Time_Stamp/LINE_PERIOD", "x")
    assert line_of(problem) == wanted


def test_zero_quaternion_and_repeated_time(dim6: Path, refused: Refused) -> None:
    text = dim6.read_text()
    dim6.write_text(re.sub(r"<Q([0-3])>[^<]*<", r"<Q\1>0.0<", text, count=4))
    refused(dim6, "dimap.quaternion_norm", "Quaternion_List/Quaternion", "norm 0")
    times = re.findall(r"<TIME>([^<]*)<", text)
    dim6.write_text(text.replace(times[-1], times[-2]))
    refused(dim6, "dimap.time_order", "Quaternion_List/Quaternion/TIME", times[-2])


def test_every_code_has_a_test() -> None:
    from fg_orient.model.messages.files import WORDS

    tested = {row[2] for row in CHANGES_1 + CHANGES_2} | ELSEWHERE
    assert tested == {code for code in WORDS if code.startswith(("xml.", "dimap."))}


# --- whole files -----------------------------------------------------------------------------


def test_missing_file_and_folder(tmp_path: Path, refused: Refused) -> None:
    refused(tmp_path / "none.dim", "xml.missing_file")
    refused(tmp_path, "xml.not_a_file")


def test_unreadable_file(dim1: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that the system refuses to open is refused with the system's message.

    The refusal is simulated, because root may read everything.
    """

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    refused(dim1, "xml.unreadable", value="Permission denied")


@pytest.mark.parametrize(
    ("content", "code", "value"),
    [
        (b"", "xml.empty_file", "0 bytes"),
        (b" \r\n\t", "xml.empty_file", "4 bytes"),
        (b"<!DOCTYPE html><html><body>404 Not Found</body></html>", "xml.html", "html"),
        (b"\xef\xbb\xbf\n<html><head/></html>", "xml.html", "<html>"),
        (b"II*\0\x08\0\0\0", "xml.not_xml", "TIFF"),
        (b"PK\x03\x04...", "xml.not_xml", "zip"),
        (b"NROWS = 12", "xml.malformed", "Start tag expected"),
        (b"<Dimap_Document>\n<A>\0</A></Dimap_Document>", "xml.malformed", ""),
        ("<?xml version='1.0' encoding='UTF-8'?><A>ı</A>".encode("iso-8859-9"), "xml.malformed", ""),
        (b"<A>" * 300 + b"</A>" * 300, "xml.malformed", "depth"),
        (b"<?a?>" * 400_000, "xml.malformed", ""),  # 2 MB: the search for a DOCTYPE must not backtrack
        (b"<PHR_Dimap_Document/>", "xml.missing_element", ""),
        (b"<isd/>", "dimap.other_format", "DigitalGlobe"),
        (b"<VRTDataset/>", "dimap.other_format", "GDAL"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "dimap.other_format", "root element svg"),
        (b"<Dimap_Document/>", "xml.missing_element", ""),
    ],
)
def test_files_that_are_something_else(tmp_path: Path, refused: Refused, content: bytes, code: str, value: str) -> None:
    path = tmp_path / "input.xml"
    path.write_bytes(content)
    refused(path, code, value=value)


@pytest.mark.parametrize("part", [0.001, 0.3, 0.999])
def test_truncated_file_is_refused_with_its_line(dim1: Path, refused: Refused, part: float) -> None:
    data = dim1.read_bytes()
    cut = data[: int(part * len(data))]
    dim1.write_bytes(cut)
    problem = refused(dim1, "xml.malformed", "line")
    assert abs(line_of(problem) - (cut.count(b"\n") + 1)) <= 1


def test_size_limit_holds_before_parsing_and_can_be_raised(
    dim1: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = dim1.stat().st_size
    monkeypatch.setenv("FG_ORIENT_LIMITS", f"xml_bytes={size - 1}")
    problem = refused(dim1, "limits.exceeded", value=f"{size} bytes")
    assert 'FG_ORIENT_LIMITS="xml_bytes=' in problem.remedy
    monkeypatch.setenv("FG_ORIENT_LIMITS", f"xml_bytes={size}, memory_factor=1e3")
    assert read_dimap(dim1).mission == "SPOT 5"


ATTACKS = {
    # never loaded: a parser that resolves it would report a damaged file instead of the DOCTYPE
    "entity of a missing file": '<!DOCTYPE d [<!ENTITY e SYSTEM "file:///nowhere/none.txt">]>',
    "internal entity": '<!DOCTYPE d [<!ENTITY e "0.00075">]>',
    "external entity": '<!DOCTYPE d [<!ENTITY e SYSTEM "file:///etc/hostname">]>',
    "external DTD": '<!DOCTYPE d SYSTEM "http://localhost:9/d.dtd">',
    "parameter entity": '<!DOCTYPE d [<!ENTITY % p SYSTEM "file:///etc/hostname"> %p;]>',
    "plain": "<!DOCTYPE Dimap_Document>",
    "after comment": "<!-- a --><?b c?>\n<!-- d -->\n<!DOCTYPE Dimap_Document>",
    "billion laughs": '<!DOCTYPE d [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {y} "{("&" + x + ";") * 10}">' for x, y in zip("abcdefgh", "bcdefghe", strict=True))
    + "]>",
}


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_doctype_and_entities_are_refused(dim1: Path, refused: Refused, attack: str, encoding: str) -> None:
    """A file with a DOCTYPE is refused with its prolog as place, in UTF-8 and in UTF-16."""
    change(dim1, r"<LINE_PERIOD>.*?<", "<LINE_PERIOD>&e;<" if "ENTITY e" in ATTACKS[attack] else "<LINE_PERIOD>1<")
    head, body = dim1.read_text().replace('encoding="UTF-8"', f'encoding="{encoding}"').split("\n", 1)
    dim1.write_bytes(f"{head}\n{ATTACKS[attack]}\n{body}".encode(encoding))
    refused(dim1, "xml.doctype", "prolog", "<!DOCTYPE")


# --- anything --------------------------------------------------------------------------------

junk = st.one_of(
    st.sampled_from(["", " ", "nan", "1e400", "-1", "0", "1", "é", "1,5", "2005-03-13T05:21:07Z", "<A/>", "9" * 400]),
    st.text(st.characters(exclude_characters="<&>", exclude_categories=("Cs", "Cc")), max_size=8),
    st.floats().map(repr),
)


@pytest.mark.parametrize("name", ["dim1", "dim2", "dim6"])
def test_any_changed_value_is_refused_in_one_line_or_read(name: str, request: pytest.FixtureRequest) -> None:
    """After any change of a value or loss of a line the reader returns metadata or raises an InputError of one line."""
    path: Path = request.getfixturevalue(name)
    text = path.read_text("utf-8")
    leaves = [m.span(1) for m in re.finditer(r">([^<>\n]+)</", text)]
    lines = text.splitlines(keepends=True)

    @given(where=st.integers(0, 10**6), drop=st.booleans(), value=junk)
    def run(where: int, drop: bool, value: str) -> None:
        start, end = leaves[where % len(leaves)]
        k = where % len(lines)
        path.write_text("".join(lines[:k] + lines[k + 1 :]) if drop else text[:start] + value + text[end:], "utf-8")
        try:
            assert isinstance(read_dimap(path), PushbroomMetadata)
        except InputError as error:
            assert all(p.remedy and p.file for p in error.problems)
            assert "\n" not in str(error)

    run()
