"""Numbers that are not finite, or that no measurement has, are refused before anything is computed."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fg_orient as fg
from fg_orient.cli.app import VARIABLE as COMPLETION
from fg_orient.cli.app import _usage_error
from fg_orient.cli.command import _value, image_sizes
from fg_orient.formats.exchange.convert import filled
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import Faults
from fg_orient.formats.heights import ZeroLevel
from fg_orient.formats.points import read_points
from fg_orient.formats.rpc import read_rpc
from fg_orient.model.declaration import declared
from fg_orient.model.digits import decimal
from fg_orient.model.errors import InputError
from fg_orient.model.limits import VARIABLE, limit
from fg_orient.rpc.files import ROUND_TRIP_PX, disagreement
from fg_orient.rpc.options import FitOptions
from tests.support.command import in_process

pytestmark = pytest.mark.behaviour

#: Texts that ``float`` reads, but that are not plain decimal numbers.
ODD = ("1_000", "٣", "３", "inf", "-inf", "nan", "1e400", " 1", "")


@pytest.mark.parametrize("text", ODD)
def test_a_text_that_is_not_a_plain_number_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\A"):
        decimal(text)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_is_read(value: float) -> None:
    assert decimal(repr(value)) == value


@pytest.mark.parametrize("value", [1e308, 1e20, math.nan, math.inf, -2.0])
def test_the_first_pixel_is_near_zero(tmp_path: Path, value: float) -> None:
    """The range is a fact of the reader, and applies to Python as to the command line."""
    with pytest.raises(InputError) as caught:
        read_rpc(tmp_path / "any_RPC.TXT", first_pixel=value)
    assert [(p.code, p.option) for p in caught.value.problems] == [("options.value", "first_pixel")]


@pytest.mark.parametrize(
    ("line", "sample", "good"),
    [(0.0, 1e-9, True), (math.nan, math.nan, False), (0.0, math.nan, False), (ROUND_TRIP_PX, 0.0, False)],
)
def test_an_rpc_that_does_not_read_back_is_doubted(line: float, sample: float, good: bool) -> None:
    found = disagreement([{"round_trip_line_px": line, "round_trip_sample_px": sample}, {"use": "no RPC"}])
    assert [(one.code, one.severity) for one in found] == ([] if good else [("rpc.round_trip", "doubt")])


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e9])
def test_an_impossible_undulation_is_refused(value: float) -> None:
    with pytest.raises(InputError, match="-10000 to 10000"):
        ZeroLevel(undulation_m=value)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, 0.0, -1.0])
@pytest.mark.parametrize("name", ["sigma_ground_m", "sigma_image_px"])
def test_an_impossible_sigma_is_not_filled_in(name: str, value: float) -> None:
    survey = Survey("", (), (), np.empty((0, 3)), np.empty((0, 3)), np.empty(0, bool))
    given = (value, 1.0, 1.0)[: 3 if name == "sigma_ground_m" else 2]
    with pytest.raises(InputError) as caught:
        filled(survey, **{name: given})
    assert [p.code for p in caught.value.problems] == ["options.value"]


@pytest.mark.parametrize(
    "words",
    [("--undulation", "inf"), ("--undulation", "nan"), ("--sigma-ground", "nan", "nan", "nan"), ("--height", "inf")],
)
def test_a_command_refuses_numbers_that_are_not_finite(tmp_path: Path, words: tuple[str, ...]) -> None:
    """The message names the flag, and no file is written."""
    (tmp_path / "p.csv").write_text("id,x,y,z\na,1,2,3\n", encoding="utf-8")
    ended = in_process("convert", tmp_path / "p.csv", "--out", tmp_path / "q.csv", *words, "--json")
    assert ended.code == 2
    assert [(e["code"], e["place"]) for e in json.loads(ended.stdout)["errors"]] == [("options.value", words[0])]
    assert not (tmp_path / "q.csv").exists()


@pytest.mark.parametrize(
    "options",
    [{"position_sigma_m": (1e308,) * 3}, {"attitude_sigma_rad": (1e308,) * 3}, {"look_sigma_rad": 1e308},
     {"curve_attitude_sigma_rad": 1e308}, {"memory_limit_gb": 1e308}, {"outlier_level": 5e-324}, {"kappa": math.inf}],
)  # fmt: skip
def test_an_option_whose_square_overflows_is_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        fg.Options(**options)


def test_an_infinite_penalty_of_an_rpc_is_refused() -> None:
    with pytest.raises(InputError, match="kappa"):
        FitOptions(kappa=math.inf)


def test_three_numbers_of_an_option_are_plain_decimal_numbers() -> None:
    """Other texts are not converted, and ``Options`` refuses texts."""
    position = declared(fg.Options)["position_sigma_m"]
    assert _value(position, {"position_sigma_m": "1, 2.5,1e-3"}) == (1.0, 2.5, 1e-3)
    assert _value(position, {"position_sigma_m": "1_000,٣,３"}) == ("1_000", "٣", "３")


@pytest.mark.parametrize("word", ["a=99999999999999999999,5", "a=٣,5", "a=0,5", "a=5", "a=1_0,5", "a=-1,5"])
def test_an_image_size_that_no_file_can_store_is_refused(word: str) -> None:
    with pytest.raises(InputError) as caught:
        image_sizes([word])
    assert [(p.code, p.value) for p in caught.value.problems] == [("interchange.image_size", word)]
    assert image_sizes(["a=12000,999999999"]) == {"a": (12000, 999_999_999)}


@pytest.mark.parametrize("height", ["1e160", "-1e308", "1.1e12"])
def test_a_height_whose_square_overflows_is_refused_at_its_line(tmp_path: Path, height: str) -> None:
    """There is no warning of numpy with lines of source code."""
    head = "id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m"
    path = tmp_path / "p.csv"
    path.write_text(f"{head}\na,control,31,41,5,1,1,1\nb,control,31,41,{height},1,1,1\n", encoding="utf-8")
    faults = Faults(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_points(path, "EPSG:4979", faults)
    assert [(p.code, p.place) for p in faults.problems] == [("points.too_large", "line 3, column height_m")]


@pytest.mark.parametrize("text", ["abc", "", "1e9", "-1"])
def test_a_wrong_time_of_the_environment_is_named(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """numpy reads this variable when scipy is imported."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    ended = in_process("convert", "--formats")
    assert ended.code == 2
    assert "SOURCE_DATE_EPOCH" in ended.stderr and len(ended.stderr.splitlines()) == 1


def test_a_compiler_that_is_switched_off_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The vector code of the kernels has no form in plain Python."""
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    ended = in_process("convert", "--formats")
    assert ended.code == 2
    (line,) = ended.stderr.splitlines()
    assert line == (
        "error: NUMBA_DISABLE_JIT: the environment variable has an impossible value (found '1'); unset it, or give 0"
    )


def test_completion_without_the_words_of_a_shell_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(COMPLETION, "complete_bash")
    assert _usage_error(KeyError("COMP_WORDS")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {COMPLETION}: ") and "(found complete_bash)" in line
    with pytest.raises(KeyError):
        _usage_error(KeyError("other"))


@pytest.mark.parametrize("number", ["inf", "1e400", "nan", "1_000", "-1"])
def test_a_limit_is_a_finite_number(monkeypatch: pytest.MonkeyPatch, number: str) -> None:
    monkeypatch.setenv(VARIABLE, f"toml_bytes={number}")
    with pytest.raises(InputError, match=VARIABLE):
        limit("toml_bytes")
