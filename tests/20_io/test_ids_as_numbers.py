"""Ids of a regular table are compared as bytes in whole numbers, with the result of a dictionary."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_orient.formats.faults import Faults
from fg_orient.formats.tables import Table, read_table
from fg_orient.model.errors import InputError

ID = st.text(st.sampled_from("019aZ_-é"), min_size=1, max_size=30)


def table_of(path: Path, ids: list[str]) -> Table:
    path.write_text("id,x\n" + "".join(f"{one},1\n" for one in ids), encoding="utf-8")
    table = read_table(path, [("id", "x")], Faults(str(path)))
    assert table is not None
    return table


@pytest.mark.oracle
@settings(max_examples=100, deadline=None)
@given(known=st.lists(ID, min_size=1, max_size=12, unique=True), data=st.data())
def test_positions_of_ids_of_any_length_are_those_of_a_dictionary(tmp_path_factory, known, data):
    ids = data.draw(st.lists(st.sampled_from(known), min_size=1, max_size=20))
    table = table_of(tmp_path_factory.getbasetemp() / "ids.csv", ids)
    assert table.positions("id", known, "observations.point_unknown").tolist() == [known.index(one) for one in ids]
    table.require_valid()


@pytest.mark.behaviour
@pytest.mark.parametrize("wanted", ["a", "abc", "ab\0", "abcdefghij", "xbcdefghi", ""])
def test_an_id_that_is_not_known_is_refused(tmp_path, wanted):
    known = ["ab", "abcdefghi", wanted] if "\0" in wanted else ["ab", "abcdefghi"]
    table = table_of(tmp_path / "t.csv", ["ab", "abcdefghi", wanted.strip("\0") or "b"])
    found = table.positions("id", known, "observations.point_unknown")
    if "\0" in wanted:  # a name that is never in a file: "ab" is the first one
        np.testing.assert_array_equal(found, [0, 1, 0])
        return
    np.testing.assert_array_equal(found, [0, 1, 2])
    with pytest.raises(InputError):
        table.require_valid()


@pytest.mark.consistency
def test_ids_whose_mixed_bytes_are_equal_are_told_apart(tmp_path, monkeypatch):
    ids = [f"point_of_image_{k}" for k in range(50)]
    expected = table_of(tmp_path / "a.csv", ids[::-1]).positions("id", ids, "observations.point_unknown")
    monkeypatch.setattr("fg_orient.formats.columns._words", lambda texts: np.zeros(len(texts), np.uint64))
    found = table_of(tmp_path / "b.csv", ids[::-1]).positions("id", ids, "observations.point_unknown")
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found, np.arange(50)[::-1])
