"""SPOT 1 to 4: angular speeds are integrated from the first absolute angle; two detectors lie on a line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.dimap1 import SPEED_HOLD_S, straight_line
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.model.errors import Finding, OutOfTimeRange
from fg_orient.sensors.metadata import AngleAttitude, PushbroomMetadata

Refused = Callable[..., Finding]
CENTRE_S = 67.332158 - 60.0  # 05:21:07.332158


def sample(tag: str, second: float, roll: float, pitch: float, yaw: float) -> str:
    time = f"2005-03-13T05:21:{second:09.6f}"
    return f"<{tag}><TIME>{time}</TIME><YAW>{yaw!r}</YAW><PITCH>{pitch!r}</PITCH><ROLL>{roll!r}</ROLL></{tag}>"


def spot4(path: Path, angles: list[str], speeds: list[str]) -> Path:
    """Turn the SPOT-5 file at ``path`` into one of SPOT 4 with raw attitudes."""
    raw = (
        f"<Raw_Attitudes><Aocs_Attitude><Angles_List>{''.join(angles)}</Angles_List>"
        f"<Angular_Speeds_List>{''.join(speeds)}</Angular_Speeds_List></Aocs_Attitude></Raw_Attitudes>"
    )
    text = path.read_text().replace("<MISSION_INDEX>5<", "<MISSION_INDEX>4<")
    path.write_text(re.sub("<Corrected_Attitudes>.*</Corrected_Attitudes>", raw, text, flags=re.DOTALL))
    return path


def steps(first: float, count: int, roll: Callable[[int], float]) -> list[str]:
    return [sample("Angular_Speeds", first + 0.125 * k, roll(k), 2e-6, -3e-6) for k in range(count)]


def angles(metadata: PushbroomMetadata) -> AngleAttitude:
    assert isinstance(metadata.attitude, AngleAttitude)
    return metadata.attitude


@pytest.mark.truth
def test_constant_speeds_give_straight_angles(dim1: Path) -> None:
    """With constant speeds, angle = first absolute angle + speed times (t - its time), with the signs of the step."""
    path = spot4(dim1, [sample("Angles", 7.0, 1e-5, 2e-5, 3e-5)], steps(7.1, 6, lambda _: 1e-6))
    metadata = read_dimap(path)
    attitude = angles(metadata)
    day_s = 5 * 3600 + 21 * 60
    expected = np.array([1e-5, 2e-5, 3e-5]) + np.outer(attitude.time_s - day_s - 7.0, [1e-6, 2e-6, -3e-6])
    # sums of a dozen terms of 1e-5: rounding far below 1e-18
    np.testing.assert_allclose(attitude.angles_rad, expected * [-1, -1, 1], rtol=0, atol=1e-18)
    assert attitude.time_s[0] == pytest.approx(day_s + 7.0, abs=1e-11)
    assert metadata.mission == "SPOT 4"


@pytest.mark.truth
def test_a_speed_belongs_to_the_interval_before_its_time(dim1: Path) -> None:
    """A speed changes the angle only in the interval before its time tag."""
    speeds = [sample("Angular_Speeds", 7.0 + 0.125 * k, 8e-6 * (k == 3), 0.0, 0.0) for k in range(7)]
    attitude = angles(read_dimap(spot4(dim1, [sample("Angles", 7.0, 0.0, 0.0, 0.0)], speeds)))
    np.testing.assert_allclose(-attitude.angles_rad[:, 0], [0, 0, 0, 1e-6, 1e-6, 1e-6, 1e-6], rtol=0, atol=1e-20)


@pytest.mark.truth
def test_the_first_absolute_angle_may_lie_inside_the_list(dim1: Path) -> None:
    absolute = [sample("Angles", 7.25, 5e-6, 0.0, 0.0)]
    attitude = angles(read_dimap(spot4(dim1, absolute, steps(7.0, 7, lambda k: 1e-6 * k))))
    at_anchor = np.interp(5 * 3600 + 21 * 60 + 7.25, attitude.time_s, attitude.angles_rad[:, 0])
    assert at_anchor == pytest.approx(-5e-6, abs=1e-18)


@pytest.mark.behaviour
def test_holding_is_noted_with_its_length_and_the_closing_error(dim1: Path) -> None:
    """Notes state how long the speeds are held at both ends, the closing error, and frame points without attitudes.

    The list covers 7.25 to 7.40 s, the image 7.317 to 7.346 s; absolute angles are at 7.15 and 7.50 s.
    """
    absolute = [sample("Angles", 7.15, 0.0, 0.0, 0.0), sample("Angles", 7.5, 1.35e-6, 7e-7, -1.05e-6)]
    speeds = [sample("Angular_Speeds", t, 1e-6, 2e-6, -3e-6) for t in (7.25, 7.40)]
    metadata = read_dimap(spot4(dim1, absolute, speeds))
    held, closing = [
        text for text in map(str, metadata.notes) if "held" in text or "differ from the last absolute" in text
    ]
    assert "0.100 s before and 0.100 s after" in held
    # 0.35 s at 1e-6 rad/s make 0.35e-6, the file says 1.35e-6: the roll does not close by 1 microrad
    assert "by 1.00 microrad" in closing
    assert any("without attitudes" in str(n) for n in metadata.notes)


@pytest.mark.behaviour
def test_speeds_are_never_held_longer_than_the_limit(dim1: Path) -> None:
    """A list of speeds that ends 0.15 s before the image is read; one that ends 0.25 s before is refused."""
    absolute = [sample("Angles", 6.9, 0.0, 0.0, 0.0)]
    text = dim1.read_text()
    end = CENTRE_S + 19 * 7.5199643612e-4
    assert read_dimap(spot4(dim1, absolute, [sample("Angular_Speeds", end - d, 0.0, 0.0, 0.0) for d in (0.27, 0.15)]))
    dim1.write_text(text)
    short = [sample("Angular_Speeds", end - d, 0.0, 0.0, 0.0) for d in (0.4, 0.25)]
    with pytest.raises(OutOfTimeRange) as caught:
        read_dimap(spot4(dim1, absolute, short))
    assert [p.code for p in caught.value.problems] == ["dimap.speed_span"]
    assert f"{SPEED_HOLD_S} s" in str(caught.value)


def still(*times: float) -> list[str]:
    return [sample("Angular_Speeds", t, 0.0, 0.0, 0.0) for t in times]


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("mission", "angle_s", "speeds", "code", "place", "value"),
    [(4, 7.0, still(7.0, 7.125, 7.45), "dimap.speed_gap", "Angular_Speeds", "0.325 s"),
     (4, 5.0, steps(7.0, 6, lambda _: 0.0), "dimap.anchor", "Angles_List/Angles", "05:21:05"),
     # raw attitudes of SPOT 5 would be 600 m off: they are no substitute
     (5, 7.0, steps(7.0, 6, lambda _: 0.0), "xml.missing_element", "Satellite_Attitudes", "")],
    ids=["a gap in the speeds", "an angle far from the speeds", "SPOT 5 without corrected attitudes"],
)  # fmt: skip
def test_raw_attitudes_that_do_not_do_are_refused(
    dim1: Path, refused: Refused, mission: int, angle_s: float, speeds: list[str], code: str, place: str, value: str
) -> None:
    path = spot4(dim1, [sample("Angles", angle_s, 0.0, 0.0, 0.0)], speeds)
    path.write_text(path.read_text().replace("<MISSION_INDEX>4<", f"<MISSION_INDEX>{mission}<"))
    found = refused(path, code, place, value)
    assert mission == 4 or "Corrected_Attitudes" in found.message


# --- two detectors ---------------------------------------------------------------------------


def tilted_line(mirror_rad: float, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sample, psi_x, psi_y of a straight line of detectors that a mirror turns across track.

    Its field of view is +-2.06 degrees.
    """
    sample_ = np.arange(float(n))
    field = np.tan(np.radians(2.06)) * (2 * sample_ / (n - 1) - 1)
    forward = np.full(n, 0.01)
    across, down = np.cos(mirror_rad) * field + np.sin(mirror_rad), np.cos(mirror_rad) - np.sin(mirror_rad) * field
    return sample_, np.arctan(forward / down), np.arctan(across / down)


@pytest.mark.oracle
@pytest.mark.parametrize("mirror_deg", [0.0, -6.0, 9.0, 27.0])
def test_two_detectors_give_all_of_a_straight_line(mirror_deg: float) -> None:
    sample_, psi_x, psi_y = tilted_line(np.radians(mirror_deg), 601)
    table = straight_line(sample_[[0, -1]], psi_x[[0, -1]], psi_y[[0, -1]])
    np.testing.assert_array_equal(table.sample, sample_)
    # the ends are equally long by construction only up to rounding
    np.testing.assert_allclose(table.psi_x_rad, psi_x, rtol=0, atol=1e-15)
    np.testing.assert_allclose(table.psi_y_rad, psi_y, rtol=0, atol=1e-15)


@pytest.mark.oracle
def test_tangents_about_the_nadir_would_be_far_off() -> None:
    """Interpolation about the nadir would move the centre detector by more than 500 m at 27 degrees.

    Therefore the reader needs the rule that is tested above.
    """
    sample_, _, psi_y = tilted_line(np.radians(27.0), 601)
    tangent = np.interp(300.0, sample_[[0, -1]], np.tan(psi_y[[0, -1]]))
    assert abs(tangent - np.tan(psi_y[300])) * 830e3 > 500.0


@pytest.mark.behaviour
def test_given_rows_are_kept_bit_by_bit() -> None:
    sample_, psi_x, psi_y = tilted_line(0.3, 40)
    some = [0, 7, 39]
    table = straight_line(sample_[some], psi_x[some], psi_y[some])
    np.testing.assert_array_equal(table.psi_y_rad[some], psi_y[some])
    np.testing.assert_array_equal(table.psi_x_rad[some], psi_x[some])
    full = straight_line(sample_, psi_x, psi_y)
    np.testing.assert_array_equal(full.psi_y_rad, psi_y)
