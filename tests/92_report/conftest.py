"""Fixtures are a result of the twin with hostile ids, its report, and a browser, made once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fg_orient.report import write_report
from fg_orient.result.record import Result, read_result
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.browser import VARIABLE, Browser, Page, executable, open_browser
from tests.support.command import in_process
from tests.support.results import sealed

#: In place of the ids 01, 02 ... of the twin.
HOSTILE = ("</script><script>document.title = 'broken'</script>", "<img src=x onerror=alert(1)>", "a&lt;b \\u003c '\"")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the result folder with its report; not to be changed."""
    made = tmp_path_factory.mktemp("report")
    simulate_zonguldak(made / "twin", ZonguldakOptions())
    out = made / "result"
    assert in_process("adjust", made / "twin" / "project.toml", "--out", out, "--quiet").code == 0
    for name, before in (("points.csv", "\n"), ("residuals.csv", ",")):
        text = (out / name).read_text("utf-8")
        for k, hostile in enumerate(HOSTILE):
            cell = '"' + hostile.replace('"', '""') + '"'
            text = text.replace(f"{before}{k + 1:02d},", f"{before}{cell},")
        (out / name).write_text(text, encoding="utf-8")
    write_report(sealed(out))
    return out


@pytest.fixture(scope="session")
def result(folder: Path) -> Result:
    """Return the folder as read."""
    return read_result(folder)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Yield one browser for all tests, or a skip."""
    program = executable()
    if program is None:
        pytest.skip(f"no browser: {VARIABLE} names none, and there is neither chromium nor google-chrome on the path")
    with open_browser(program, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="session")
def tab(browser: Browser) -> Page:
    """Return one tab of it."""
    return browser.page()


@pytest.fixture
def page(tab: Page, folder: Path) -> Iterator[Page]:
    """Yield the report as a person opens it; nothing may have gone wrong when the test ends."""
    tab.size(1000, 900)
    tab.open(folder / "report.html", wait="performance.getEntriesByName('drawn').length > 0")
    yield tab
    assert tab.troubles == []
