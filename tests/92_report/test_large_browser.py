"""The report of 1e5 image points is small enough, and its points can be found."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.report_browser import large_result, measure
from tests.support.browser import Browser

pytestmark = pytest.mark.behaviour


@pytest.mark.slow
@pytest.mark.browser
def test_report_of_1e5_image_points(browser: Browser, tmp_path: Path) -> None:
    out = large_result(tmp_path)
    found = measure(browser.page(), out / "report.html", runs=5, every=10, hovered=100)
    assert found["bytes"] < 10e6
    assert (found["points"], found["sought"], found["found"]) == (31_200, 3120, 3120)
    assert (found["hovered"], found["told"]) == (100, 100)
    assert found["troubles"] == []
