"""Records of constants have named fields: no number indexes them, and the check can fail."""

from __future__ import annotations

import numpy as np
import pytest

from factors.records import Record
from tests.support.record_fields import FOLDERS, Program, sources

GOOD = """
from factors._contract import Equation, compiled, register
from factors.records import Record
RECORD = Record(place="x y z", distance=1, whitening=9)

@compiled
def residual(record, setup, x, ground):
    d = ground - record[RECORD.place]
    return np.array([d[0] * d[1] * d[2] - record[RECORD.distance] * x[7] * setup[1, 0] {bad}])

@compiled
def kernel(record, setup, x, ground, want):
    return residual(record, setup, x, ground), np.zeros((1, 8)), np.zeros((1, 3))

E = register(Equation("e", kernel, residual, (), ""))
{more}
"""


def found(bad: str = "", more: str = "", folder: str = "factors") -> list[str]:
    """Return the findings of a module with an equation, with a further term and further functions."""
    program = Program({f"{folder}/e.py": GOOD.replace("{bad}", bad).replace("{more}", more)})
    return list(dict.fromkeys(line.split(": ", 1)[1] for line in program.findings(FOLDERS)))


@pytest.mark.slow  # make lint runs the same check
@pytest.mark.repository
def test_nothing_is_indexed_by_a_number() -> None:
    assert list(Program(sources()).findings(FOLDERS)) == []


@pytest.mark.repository
def test_names_vectors_setups_and_unknowns_are_free() -> None:
    assert found() == []


@pytest.mark.repository
@pytest.mark.parametrize("text", ["record[3]", "record[0]", "record[2:5]", "record[:3]", "record[RECORD.distance + 2]"])
def test_numbers_in_an_equation(text: str) -> None:
    assert found(f"+ {text}") == [text]


@pytest.mark.repository
@pytest.mark.parametrize("name", ["c", "constants", "camera", "whatever", "turn"])
@pytest.mark.parametrize(
    "text", ["{}[3]", "{}[0]", "{}[i + 22 * n]", "{}[22 * n + i]", "{}[3:6]", "three({}, i + 28 * n, n)",
             "three({}, 4, n)", "{}.copy()[3]", "{}[RECORD.whitening][4]", "np.array({}[RECORD.whitening])[4]"],
)  # fmt: skip
@pytest.mark.parametrize("folder", ["factors", "fg_orient"])
def test_a_record_under_another_name(name: str, text: str, folder: str) -> None:
    """The check finds a record that a function indexes by number under another parameter name."""
    more = f"""
def three(a, i, n):
    return a[i], a[i + n]

def helper({name}, i, n):
    return {text.format(name)}
"""
    assert found("+ helper(record, k, n)", more, folder) == [text.format(name)]


@pytest.mark.repository
@pytest.mark.parametrize("text", ["a[:, 18]", "a[i, 18]", "a[:, 3:6]", "a[:, [5, 7]]", "a[..., 9:]"])
@pytest.mark.parametrize(
    "made", ["sensor.records(line)", "problem.control_records", "np.zeros((9, RECORD.size))", "RECORD.pack(distance=d)",
             "np.hstack([block.records, b])", "block.records.copy()"],
)  # fmt: skip
def test_many_records_of_a_writer(text: str, made: str) -> None:
    more = f"def write(i):\n    a = {made}\n    return {text}\n"
    assert found(more=more, folder="fg_orient") == [text]


@pytest.mark.repository
def test_what_nobody_calls_is_not_free_in_factors() -> None:
    more = "def f(a, b: Vector, k):\n    return a[1] + a[k + 2] + a[2 * k] + b[2] + b[3] + a[k + 1] + a.shape[1]\n"
    assert sorted(found(more=more)) == ["a[1]", "a[2 * k]", "a[k + 2]", "b[3]"]
    assert found(more=more, folder="fg_orient") == ["b[3]"]


@pytest.mark.behaviour
def test_fields_of_a_record() -> None:
    r = Record(tau=1, mounting="a b c", rest=2)
    assert (r.tau, r.mounting, r.b, r.rest, r.size) == (0, slice(1, 4), 2, slice(4, 6), 6)
    longer = Record(**r.fields, last=1)
    assert (longer.b, longer.last, longer.size) == (2, 6, 7)


@pytest.mark.behaviour
def test_pack_fills_every_field_once() -> None:
    r = Record(tau=1, place=3)
    packed = r.pack(tau=[1.0, 2.0], place=[3.0, 4.0, 5.0])
    assert packed.flags.c_contiguous and np.array_equal(packed, [[1.0, 3.0, 4.0, 5.0], [2.0, 3.0, 4.0, 5.0]])
    assert np.array_equal(r.pack(place=np.arange(3), tau=7), [7.0, 0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match="place"):
        r.pack(tau=1.0)
    with pytest.raises(ValueError, match="mounting"):
        r.pack(tau=1.0, place=np.zeros(3), mounting=1.0)
    with pytest.raises(ValueError, match="'place': 3 numbers"):
        r.pack(tau=1.0, place=np.zeros(4))
    with pytest.raises(ValueError, match="broadcast"):
        r.pack(tau=np.zeros(2), place=np.zeros((3, 3)))
