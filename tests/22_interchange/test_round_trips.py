"""For every format, data that it can contain are read back exactly; losses are named; unverified formats ask."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.convert import read_survey, write_survey
from fg_orient.formats.registry import Format, Holds, Settings, formats
from fg_orient.model.errors import InputError
from tests.support.survey import assert_same, random_survey

#: The reader gets these options, because the format does not state them.
FORMATS = {
    "csv": ("EPSG:32636", "EPSG:4979", "EPSG:5254"),
    "asp-gcp": ("EPSG:4979",),
    "metashape-csv": ("EPSG:32636", "EPSG:5254"),
    "metashape-xml": ("EPSG:32636", "EPSG:5254"),
    "pix4d": ("EPSG:32636", "EPSG:4979", "EPSG:5254"),
    "odm": ("EPSG:32636", "EPSG:5254"),
    "micmac": ("EPSG:32636", "EPSG:4979"),
    "qgis-points": ("EPSG:32636", "EPSG:5254"),
    "geojson": ("EPSG:4979",),
    "gpkg": ("EPSG:32636", "EPSG:4979", "EPSG:5254"),
}
#: Formats whose names are words between blanks.
PLAIN = {"asp-gcp", "odm", "micmac"}
ROUNDED_PX = 4e-12  # adding and taking off half a pixel at 12 000 pixels: two roundings


def there_and_back(format_: Format, folder: Path, survey, **told: str):  # type: ignore[no-untyped-def]
    out = folder / f"scene{format_.suffixes[0]}"
    settings = Settings(image="left.tif", sigma_axes="enu", **told)
    written, lost = write_survey(survey, [out], format_, settings)
    again = Settings(
        crs="" if Holds.CRS in format_.holds else survey.crs, image=settings.image, sigma_axes=settings.sigma_axes
    )
    return read_survey(written, format_, again, accept_unverified=True)[0], written, lost


@pytest.mark.consistency
@pytest.mark.parametrize(("name", "crs"), [(name, crs) for name, crss in FORMATS.items() for crs in crss])
def test_what_a_format_holds_comes_back(name: str, crs: str, tmp_path: Path, rng: np.random.Generator) -> None:
    format_ = formats()[name]
    for k in range(5):
        survey = random_survey(rng, format_, crs, plain=name in PLAIN)
        folder = tmp_path / str(k)
        folder.mkdir()
        found, written, lost = there_and_back(format_, folder, survey)
        assert [p.code for p in lost] == ([] if Holds.CRS in format_.holds else ["lost.crs"])
        assert len(written) == len(format_.files)
        assert_same(found, survey, pixels=ROUNDED_PX)


@pytest.mark.behaviour
def test_unverified_formats_ask_before_they_are_read(tmp_path: Path, rng: np.random.Generator) -> None:
    format_ = formats()["asp-gcp"]
    path = tmp_path / "a.gcp"
    write_survey(random_survey(rng, format_, "EPSG:4979", plain=True), [path], format_, Settings())
    with pytest.raises(InputError, match="option accept_unverified"):
        read_survey([path], format_, Settings(crs="EPSG:4979"))
    remarks = read_survey([path], format_, Settings(crs="EPSG:4979"), accept_unverified=True)[1]
    assert [p.code for p in remarks] == ["remark.unverified"]
