"""Random tables are read correctly, or the command asks or refuses in one line; none is wrong without notice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.office.decisions import Decisions, Office
from fg_orient.formats.office.project import Given, draft
from fg_orient.model.errors import InputError
from tests.support.office import IMAGES, differences
from tests.support.office_random import Written, random_table

pytestmark = pytest.mark.oracle

GIVEN = Given((0.05, 0.05, 0.1), (0.5, 0.5))


def read(written: Written, **stated: object) -> tuple[Survey | None, str]:
    """Read a table as the command does with ``--yes``; give the survey, or the message."""
    decisions = Decisions()
    try:
        made = draft([written.folder], written.folder / "project", Office(**stated), GIVEN, decisions)  # type: ignore[arg-type]
    except InputError as error:
        assert all("\n" not in str(p) and p.message for p in error.problems)
        return None, str(error)
    assert made.survey is not None
    return made.survey, "\n".join(map(str, decisions.assumed))


def wrong(survey: Survey, written: Written) -> str:
    """Return what is wrong with a survey, "" if nothing is."""
    if not set(survey.images) <= set(IMAGES):
        return f"images {survey.images}"
    ground, pixel = differences(survey, written.there)
    roles = dict(zip(survey.ids, map(str, survey.roles), strict=True))
    expected = written.roles or dict.fromkeys(written.there.ids, "control")
    faults = [f"{ground:.4g} m"] * (ground > written.digits_m) + [f"{pixel:.3g} px"] * (pixel > 2e-4)
    return ", ".join(faults + ["roles"] * (roles != expected))


def run(folder: Path, seed: int) -> tuple[int, int]:
    """Return how often a random table becomes a project and how often a question.

    It is read without and with what its owner can state.
    """
    written = random_table(folder / str(seed), seed)
    counts = [0, 0]
    known = {"first_pixel": written.first_pixel, "heights": "ellipsoidal"} if written.ellipsoidal else {}
    for stated in ({}, known):
        survey, said = read(written, **stated)
        if survey is not None:
            fault = wrong(survey, written)
            assert not fault, (seed, fault, stated, written.story, said)
        counts[survey is None] += 1
    return counts[0], counts[1]


def test_seven_random_tables(tmp_path: Path) -> None:
    counts = np.sum([run(tmp_path, seed) for seed in range(7)], axis=0)
    assert counts[0] >= 3  # most of those whose owner states heights and pixel origin


@pytest.mark.slow
def test_two_hundred_random_tables(tmp_path: Path) -> None:
    counts = np.sum([run(tmp_path, seed) for seed in range(200)], axis=0)
    assert counts[0] >= 150
