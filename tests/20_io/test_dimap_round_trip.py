"""Written files are read back bit by bit; the tests check their conventions of pixels and times."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_orient.formats.dimap_write import write_dimap1
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.model.errors import InputError
from fg_orient.sensors.metadata import (
    AngleAttitude,
    FramePoint,
    LineTiming,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
)
from tests.support.dimap2_files import write_dimap2


def differences(a: object, b: object, name: str = "metadata") -> list[str]:
    """Return the names of the fields that are not equal, bit by bit."""
    if is_dataclass(a) and type(a) is type(b):
        return [d for f in fields(a) for d in differences(getattr(a, f.name), getattr(b, f.name), f"{name}.{f.name}")]
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        return [d for k, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{name}[{k}]")]
    same = np.array_equal(a, b) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a == b
    return [] if same else [name]


@pytest.mark.consistency
def test_spot5_comes_back_bit_by_bit(spot5: PushbroomMetadata, dim1: Path) -> None:
    back = read_dimap(dim1)
    assert differences(spot5, replace(back, file="")) == []
    assert back.file == str(dim1)


@pytest.mark.consistency
def test_pleiades_comes_back_bit_by_bit(pleiades: PushbroomMetadata, dim2: Path) -> None:
    assert differences(pleiades, replace(read_dimap(dim2), file="")) == []


@pytest.mark.consistency
def test_spot6_comes_back_but_for_the_normalisation(spot6: PushbroomMetadata, dim6: Path) -> None:
    back = read_dimap(dim6)
    assert isinstance(spot6.attitude, QuaternionList) and isinstance(back.attitude, QuaternionList)
    tolerance = 4 * np.finfo(float).eps  # normalising a unit quaternion again moves each component by rounding only
    np.testing.assert_allclose(back.attitude.quaternion, spot6.attitude.quaternion, rtol=0, atol=tolerance)
    assert differences(spot6, replace(back, file="", attitude=spot6.attitude)) == []


finite = st.floats(-1e-2, 1e-2, allow_nan=False)


@pytest.mark.consistency
@given(
    seconds=st.one_of(st.floats(0.0, 86399.999), st.sampled_from([0.0, 1e-7, 43200.0, 86399.9999999])),
    roll=finite, psi=finite, period=st.floats(2e-5, 5e-3),
)  # fmt: skip
def test_any_float_survives_the_print(
    tmp_path_factory: pytest.TempPathFactory, seconds: float, roll: float, psi: float, period: float
) -> None:
    """A written DIMAP 1 file is read back unchanged for any digits and any time of day.

    Its lists cross midnight on both sides.
    """
    around = seconds + 30.0 * np.arange(-4, 5)
    angles = np.stack([np.full(9, roll), np.linspace(-roll, roll, 9), np.zeros(9)], axis=1)
    sample = np.arange(3.0)
    metadata = PushbroomMetadata(
        file="", mission="SPOT 5", instrument="HRG 2", format="DIMAP 1.1", epoch=np.datetime64("2000-02-29", "D"),
        n_lines=9, n_samples=3, timing=LineTiming(4.0, seconds, period),
        ephemeris=orbit_like(around), attitude=AngleAttitude(around, angles),
        look=LookAngleTable(sample, np.full(3, psi), psi + 1e-5 * sample),
    )  # fmt: skip
    path = tmp_path_factory.mktemp("any") / "METADATA.DIM"
    write_dimap1(path, metadata)
    assert differences(metadata, replace(read_dimap(path), file="")) == []


def orbit_like(time_s: np.ndarray) -> object:
    from fg_orient.sensors.metadata import Ephemeris

    phase = 1e-3 * (time_s - time_s[0])
    turn = np.stack([np.cos(phase), np.sin(phase), np.zeros_like(phase)], axis=1)
    return Ephemeris(time_s, 7.2e6 * turn, 7.4e3 * turn[:, [1, 0, 2]])


@pytest.mark.behaviour
def test_first_pixel_is_one_in_the_file_and_zero_in_the_records(spot5: PushbroomMetadata, tmp_path: Path) -> None:
    """The writer adds 1 to line, sample and detector, and the reader subtracts it."""
    path = tmp_path / "one.dim"
    write_dimap1(path, spot5)
    text = path.read_text()
    first = re.search(r"<Vertex>(.*?)</Vertex>", text, re.DOTALL)
    assert first is not None
    assert "<FRAME_ROW>1.0</FRAME_ROW>" in first[1] and "<FRAME_COL>1.0</FRAME_COL>" in first[1]
    assert "<SCENE_CENTER_LINE>21.0</SCENE_CENTER_LINE>" in text
    assert re.search(r"<DETECTOR_ID>([0-9]+)", text)[1] == "1"  # type: ignore[index]
    back = read_dimap(path)
    corner = back.frame_points[0]
    assert (corner.line, corner.sample) == (0.0, 0.0)
    assert back.timing.reference_line == 20.0
    assert isinstance(back.look, LookAngleTable) and back.look.sample[0] == 0.0


@pytest.mark.behaviour
def test_first_column_of_the_swath_is_one_in_the_file(dim2: Path) -> None:
    text = dim2.read_text()
    assert "<FIRST_COL>1</FIRST_COL>" in text
    dim2.write_text(text.replace("<FIRST_COL>1</FIRST_COL>", "<FIRST_COL>4</FIRST_COL>"))
    assert read_dimap(dim2).look.origin_sample == 3.0  # type: ignore[union-attr]


@pytest.mark.behaviour
def test_the_sign_step_negates_roll_and_pitch_and_keeps_yaw(spot5: PushbroomMetadata, dim1: Path) -> None:
    assert isinstance(spot5.attitude, AngleAttitude)
    roll, pitch, yaw = spot5.attitude.angles_rad[0]
    first = re.search(r"<Angles>.*?</Angles>", dim1.read_text(), re.DOTALL)
    assert first is not None
    in_file = {tag: float(value) for tag, value in re.findall(r"<(ROLL|PITCH|YAW)>([^<]*)", first[0])}
    assert in_file == {"ROLL": -roll, "PITCH": -pitch, "YAW": yaw}


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("name", "text", "factor"),
    [("dim2", "ms", 1e-3), ("dim2", "s", 1.0), ("dim2", "microsecond", 1e-6), ("dim2", None, 1e-3),
     ("dim1", "ms", 1e-3)],
)  # fmt: skip
def test_line_period_follows_its_unit(
    request: pytest.FixtureRequest, name: str, text: str | None, factor: float
) -> None:
    """The line period is read in the unit of its attribute; without it in the unit of the format.

    That is milliseconds in version 2.
    """
    path, period = request.getfixturevalue(name), {"dim1": 7.5e-4, "dim2": 7.35e-5}[name]
    unit = f' unit="{text}"' if text else ""
    old = path.read_text()
    new = re.sub(r"<LINE_PERIOD[^<]*<", f"<LINE_PERIOD{unit}>{period / factor!r}<", old)
    assert new != old or text == "s"
    path.write_text(new)
    assert read_dimap(path).timing.line_period_s == pytest.approx(period, rel=1e-15, abs=0.0)


@pytest.mark.oracle
def test_sign_jumps_of_quaternions_are_turned_back(spot6: PushbroomMetadata, tmp_path: Path) -> None:
    """The reader gives each quaternion the sign that makes its product with the row before positive."""
    assert isinstance(spot6.attitude, QuaternionList)
    jumping = spot6.attitude.quaternion * np.array([1.0, -1.0, -1.0, 1.0, -1.0])[:, None]
    path = tmp_path / "jump.xml"
    write_dimap2(path, replace(spot6, attitude=QuaternionList(spot6.attitude.time_s, jumping)))
    text = path.read_text()
    stated = np.array([[float(v) for v in re.findall(rf"<Q{k}>([^<]*)<", text)] for k in range(4)]).T
    sign = np.sign(np.sum(stated[1:] * stated[:-1], axis=1))
    assert (sign < 0.0).any()
    back = read_dimap(path).attitude
    assert isinstance(back, QuaternionList)
    expected = stated * np.cumprod(np.r_[1.0, sign])[:, None]
    np.testing.assert_allclose(back.quaternion, expected, rtol=0, atol=4 * np.finfo(float).eps)


@pytest.mark.behaviour
def test_a_norm_slightly_off_is_normalised(dim6: Path) -> None:
    dim6.write_text(re.sub(r"<Q0>([^<]*)<", lambda m: f"<Q0>{float(m[1]) * 1.0005!r}<", dim6.read_text()))
    back = read_dimap(dim6).attitude
    assert isinstance(back, QuaternionList)
    np.testing.assert_allclose(np.linalg.norm(back.quaternion, axis=1), 1.0, rtol=0, atol=4 * np.finfo(float).eps)


@pytest.mark.behaviour
def test_names_in_the_dataset_name_are_escaped(spot5: PushbroomMetadata, tmp_path: Path) -> None:
    path = tmp_path / "ğüş <&> .dim"
    write_dimap1(path, spot5, dataset_name="<script>&ı")
    assert "&lt;script&gt;&amp;ı" in path.read_text("utf-8")
    assert read_dimap(path).mission == "SPOT 5"


@pytest.mark.behaviour
def test_the_writer_refuses_what_the_format_cannot_hold(
    spot5: PushbroomMetadata, pleiades: PushbroomMetadata, tmp_path: Path
) -> None:
    path = tmp_path / "no.dim"
    odd_table = replace(spot5, look=LookAngleTable(np.array([0.0, 0.5]), np.zeros(2), np.zeros(2)))
    for metadata in (pleiades, replace(spot5, mission="SPOT 4"), odd_table):
        with pytest.raises(InputError) as caught:
            write_dimap1(path, metadata)
        assert [p.code for p in caught.value.problems] == ["dimap.not_writable"]
    assert not path.exists()


@pytest.mark.behaviour
def test_a_file_without_frame_points_is_read(spot5: PushbroomMetadata, tmp_path: Path) -> None:
    path = tmp_path / "bare.dim"
    write_dimap1(path, replace(spot5, frame_points=()))
    assert read_dimap(path).frame_points == ()


@pytest.mark.behaviour
def test_frame_points_keep_their_height_rule(dim1: Path, dim2: Path) -> None:
    """Frame points of DIMAP 1.1 have the height 0 on the ellipsoid; those of version 2 have no height.

    They lie on the terrain, whose height the file does not state.
    """
    assert {p.height_m for p in read_dimap(dim1).frame_points} == {0.0}
    assert {p.height_m for p in read_dimap(dim2).frame_points} == {None}
    assert read_dimap(dim1).frame_points[4] == FramePoint("centre", 20.0, 12.0, 30.5, 40.5, 0.0)
