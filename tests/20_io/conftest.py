"""Fixtures write small synthetic metadata files and check the form of a refusal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fg_orient.formats.dimap_write import write_dimap1
from fg_orient.formats.metadata.dimap import read_dimap
from fg_orient.model.errors import Finding, InputError
from fg_orient.sensors.metadata import PushbroomMetadata
from tests.support import small_metadata
from tests.support.dimap2_files import write_dimap2


@pytest.fixture
def spot5() -> PushbroomMetadata:
    """Return the SPOT-5-like metadata."""
    return small_metadata.spot5()


@pytest.fixture
def pleiades() -> PushbroomMetadata:
    """Return the Pléiades-like metadata."""
    return small_metadata.pleiades()


@pytest.fixture
def spot6() -> PushbroomMetadata:
    """Return the SPOT-6-like metadata."""
    return small_metadata.spot6()


@pytest.fixture
def dim1(spot5: PushbroomMetadata, tmp_path: Path) -> Path:
    """Return the path of a written SPOT-5 file."""
    path = tmp_path / "METADATA.DIM"
    write_dimap1(path, spot5)
    return path


@pytest.fixture
def dim2(pleiades: PushbroomMetadata, tmp_path: Path) -> Path:
    """Return the path of a written Pléiades file."""
    path = tmp_path / "DIM_PHR.XML"
    write_dimap2(path, pleiades)
    return path


@pytest.fixture
def dim6(spot6: PushbroomMetadata, tmp_path: Path) -> Path:
    """Return the path of a written SPOT-6 file."""
    path = tmp_path / "DIM_SPOT6.XML"
    write_dimap2(path, spot6)
    return path


@pytest.fixture
def refused() -> Callable[..., Finding]:
    """Return the function that reads a bad file and checks the one-line refusal."""
    return refusal


def refusal(path: Path, code: str, place: str = "", value: str = "") -> Finding:
    """Return one InputError with one problem: code, file, place, value and remedy, in one line."""
    with pytest.raises(InputError) as caught:
        read_dimap(path)
    (problem,) = caught.value.problems
    text = str(caught.value)
    assert problem.code == code, text
    assert caught.value.exit_code == 2
    assert problem.file == str(path)
    assert place in problem.place, text
    assert value in problem.value, text
    assert problem.remedy and problem.remedy in text
    assert "\n" not in text
    assert "Traceback" not in text
    return problem
