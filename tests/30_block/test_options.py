"""Options and arrays of the data model are checked and sealed where they are made."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.formats.schema import Adjustment, Orientation, ProjectFile, validate
from fg_orient.model.block import Coordinates
from fg_orient.model.declaration import declared
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.names import SMALLEST
from fg_orient.model.options import Options

pytestmark = pytest.mark.behaviour

BAD = [
    ("eop_set", 0), ("eop_set", 21), ("eop_set", "PUA"), ("eop_set", 15.0), ("eop_set", True),
    ("look_polynomial", -1), ("look_polynomial", 6), ("look_polynomial", 2.0),
    ("priors", 1), ("small_angle", None),
    ("position_sigma_m", (1.0, 0.0, 1.0)), ("position_sigma_m", (1.0, 1.0)), ("position_sigma_m", 1.0),
    ("velocity_sigma_m_s", (1.0, float("nan"), 1.0)), ("attitude_sigma_rad", (1.0, 1.0, float("inf"))),
    ("attitude_sigma_rad", ("1", "1", "1")), ("look_sigma_rad", -1e-4), ("look_sigma_rad", float("inf")),
    ("max_iterations", 0), ("max_iterations", 10_001), ("check_points", "maybe"), ("check_points", None),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_wrong_option_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        fg.Options(**{name: value})
    (found,) = caught.value.problems
    assert (found.code, found.option, found.value) == ("options.value", name, repr(value))
    assert declared(Options)[name].expected in found.remedy
    with pytest.raises(InputError):
        dataclasses.replace(fg.Options(), **{name: value})


def test_all_wrong_options_are_named_at_once() -> None:
    with pytest.raises(InputError) as caught:
        fg.Options(eop_set=99, max_iterations=-1)
    assert [p.option for p in caught.value.problems] == ["eop_set", "max_iterations"]


@pytest.mark.parametrize(
    ("name", "value"),
    [("eop_set", 1), ("eop_set", 20), ("eop_set", np.int64(7)), ("look_polynomial", 0), ("look_polynomial", 5),
     ("max_iterations", 1), ("max_iterations", 10_000), ("look_sigma_rad", SMALLEST), ("position_sigma_m", (1, 2, 3))],
)  # fmt: skip
def test_the_ends_of_the_ranges_are_allowed(name: str, value: object) -> None:
    assert getattr(fg.Options(**{name: value}), name) == value


@pytest.mark.parametrize(
    ("name", "value"), [(n, v) for n, v in BAD if n != "eop_set" and v is not None and not isinstance(v, tuple)]
)
def test_the_project_file_has_the_same_bounds(name: str, value: object) -> None:
    """A value that ``Options`` refuses is refused in the project file with the same words.

    Only eop_set may be a name there.
    """
    table = "orientation" if name in Orientation.model_fields else "adjustment"
    assert table == "orientation" or name in Adjustment.model_fields
    content = {
        "schema": 1, "name": "n", "images": [{"id": "a", "metadata": "a.DIM"}],
        "points": {"file": "p", "crs": "EPSG:4979"}, "observations": {"file": "o"}, table: {name: value},
    }  # fmt: skip
    with pytest.raises(fg.InputError) as error:
        validate(content, "project.toml", ProjectFile)
    found = error.value.problems
    assert [(p.place, declared(Options)[name].expected in p.remedy) for p in found] == [(f"{table}.{name}", True)]
    assert isinstance(found[0], Finding)


def test_arrays_are_copies_that_cannot_be_changed() -> None:
    line = np.array([1.0, 2.0])
    sigma = np.full(2, 0.3)
    points = fg.ImagePoints(np.array([0, 1]), np.array([0, 0]), line, line + 1.0, sigma, sigma)
    known = Coordinates(np.zeros((2, 3)), np.ones((2, 3)), np.zeros(2, bool))
    line[0] = 99.0
    assert points.line[0] == 1.0, "the caller's array is not the record's"
    for record in (points, points.take(np.array([1])), known):
        for field in dataclasses.fields(record):
            array = getattr(record, field.name)
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
    assert points == points and points != points.take(np.array([0, 1])), "compared by identity"


def test_extra_observation_is_a_public_name() -> None:
    from fg_orient.model.block import ExtraObservation

    assert fg.ExtraObservation is ExtraObservation and "ExtraObservation" in fg.__all__
