"""The tests check what the report shows and moves in a browser, and that no other code runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fg_orient.report.html import render
from fg_orient.result.record import Result
from tests.support.browser import Page
from tests.support.page import of_large_images

pytestmark = [pytest.mark.behaviour, pytest.mark.browser]

MAP = "document.querySelector('#live-map canvas')"
TIP = "document.querySelector('#live-map .tip').textContent"
TABLE = "document.querySelector('#residuals table.sortable')"


def find(page: Page, words: str, plot: str = "map") -> None:
    """Type words into the search of a drawing and press Enter."""
    page.value(
        f"(() => {{ const box = document.querySelector('#live-{plot} input[type=search]');"
        f" box.value = {json.dumps(words)};"
        " box.dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'})); })()"
    )


def middle(page: Page) -> tuple[float, float]:
    """Return the place of the middle of the map on the screen."""
    page.value(f"{MAP}.scrollIntoView({{block: 'center'}})")
    box = page.value(f"(() => {{ const b = {MAP}.getBoundingClientRect(); return [b.x, b.y, b.width, b.height] }})()")
    return box[0] + box[2] / 2, box[1] + box[3] / 2


def drawn(page: Page) -> str:
    """Return what the map looks like, once it has nothing more to draw."""
    page.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return str(page.value(f"{MAP}.toDataURL()"))


def test_both_drawings_show_ink(page: Page) -> None:
    for name in ("map", "residuals"):
        inked = page.value(
            f"(() => {{ const c = document.querySelector('#live-{name} canvas');"
            " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            " const seen = new Set(); for (let k = 0; k < d.length; k += 4)"
            " if (d[k + 3] > 200) seen.add(`${d[k]},${d[k + 1]},${d[k + 2]}`);"
            " return [...seen] })()"
        )
        assert "0,103,176" in inked, name  # the colour of control points and of residuals
    assert page.value("[...document.querySelectorAll('.static')].every((e) => getComputedStyle(e).display === 'none')")


def test_every_point_is_found_and_hovered(page: Page, folder: Path) -> None:
    ids = page.value("JSON.parse(document.getElementById('report-data').textContent).points.id")
    assert len(ids) == 47
    x, y = middle(page)
    for k, name in enumerate(ids):
        find(page, name)
        found = page.value(TIP)
        assert found.split("\n")[0].split(" ", 1)[1] == name
        assert ("adjusted − measured: East" in found) and ("left: line" in found)
        if k % 10 == 0:  # the point is in the middle now: deselect it and touch it
            page.value(f"{MAP}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Escape'}}))")
            assert page.value(TIP) == ""
            page.mouse("mouseMoved", x + 3, y + 2)
            page.until(f"{TIP} !== ''", 5)
            assert page.value(TIP).split("\n")[0].split(" ", 1)[1] == name
            page.mouse("mouseMoved", 1, 1)
    find(page, "no such point")
    assert page.value(TIP) == "no point with no such point in its id"


def test_tip_tells_the_figures_of_the_tables(page: Page, folder: Path) -> None:
    record = json.loads((folder / "result.json").read_text("utf-8"))
    worst = record["accuracy"]["check"]["largest"][0]
    find(page, worst["id"])
    axes = [f"{a.capitalize()} {worst[f'difference_{a}_m']:+.3f} m".replace("-", "−") for a in ("east", "north", "up")]
    assert f"adjusted − measured: {', '.join(axes)}" in page.value(TIP)


def test_zoom_and_pan_by_wheel_mouse_and_keys(page: Page) -> None:
    x, y = middle(page)
    looks = [drawn(page)]
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-1)  # not chosen yet: the wheel belongs to the page
    assert drawn(page) == looks[0]
    page.value(f"{MAP}.focus()")
    x, y = middle(page)
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-200)
    looks.append(drawn(page))
    page.mouse("mousePressed", x, y, button="left", clickCount=1)
    page.mouse("mouseMoved", x + 60, y + 30, button="left", buttons=1)
    page.mouse("mouseReleased", x + 60, y + 30, button="left")
    looks.append(drawn(page))
    for key, code in (("+", 187), ("ArrowLeft", 37), ("n", 78)):
        page.key(key, key if len(key) == 1 else "", code)
        looks.append(drawn(page))
    assert len(set(looks)) == len(looks)
    page.key("Escape", "", 27)
    page.key("0", "0", 48)
    page.mouse("mouseMoved", 1, 1)
    assert drawn(page) == looks[0]


def test_a_map_of_large_footprints_opens_on_the_points(page: Page, result: Result, tmp_path: Path) -> None:
    folder = tmp_path / "large"
    folder.mkdir()
    (folder / "report.html").write_text(render(of_large_images(result)), "utf-8")
    button = "[...document.querySelectorAll('#live-map button')].find((b) => b.textContent.includes('{}'))"
    assert page.value(button.format("points") + ".hidden")
    page.open(folder / "report.html", wait="performance.getEntriesByName('drawn').length > 0")
    looks = [drawn(page)]
    for name in ("whole footprints", "points"):
        page.value(button.format(name) + ".click()")
        looks.append(drawn(page))
    assert looks[0] == looks[2] != looks[1]
    page.value(f"{MAP}.focus()")
    page.key("0", "0", 48)
    assert drawn(page) == looks[1]


def test_vectors_roles_and_heights(page: Page) -> None:
    looks = [drawn(page)]
    change = "document.querySelector('#live-map {}')"
    for which, event, code in (
        ("input[type=range]", "input", "e.value = '1'"), ("select", "change", "e.selectedIndex = 1"),
        ("input[type=checkbox]", "change", "e.checked = false"),
    ):  # fmt: skip
        page.value(f"(() => {{ const e = {change.format(which)}; {code}; e.dispatchEvent(new Event('{event}')) }})()")
        looks.append(drawn(page))
    assert len(set(looks)) == 4


def test_tables_are_sorted_by_their_heads(page: Page) -> None:
    table = "document.querySelectorAll('#residuals table.sortable')[1]"
    column = f"[...{table}.tBodies[0].rows].map((r) => parseFloat(r.cells[2].textContent.replace('−', '-')))"
    before = page.value(column)
    for expected, said in ((sorted(before), "ascending"), (sorted(before, reverse=True), "descending"), (before, None)):
        page.value(f"{table}.tHead.rows[0].cells[2].querySelector('button').click()")
        assert page.value(column) == expected
        assert page.value(f"{table}.tHead.rows[0].cells[2].getAttribute('aria-sort')") == said
    assert before not in (sorted(before), sorted(before, reverse=True))


def test_another_image_is_drawn_where_its_point_is_sought(page: Page) -> None:
    image = "document.querySelector('#live-residuals select').value"
    assert page.value(image) == "left"
    page.value("(() => { const e = document.querySelector('#live-residuals select'); e.selectedIndex = 1;"
               " e.dispatchEvent(new Event('change')) })()")  # fmt: skip
    find(page, "20", "residuals")
    assert page.value("document.querySelector('#live-residuals .tip').textContent").startswith("20 at line ")
    assert page.value(image) == "right"  # seen in both: the image stays


def test_narrow_and_dark(tab: Page, folder: Path) -> None:
    tab.size(400, 800, dark=True)
    tab.open(folder / "report.html", wait="performance.getEntriesByName('drawn').length > 0")
    assert tab.value("document.documentElement.scrollWidth") == 400
    assert tab.value("getComputedStyle(document.body).backgroundColor") == "rgb(20, 25, 28)"
    assert tab.value(f"{MAP}.getBoundingClientRect().width") > 340
    assert tab.troubles == []


def test_printed_on_white_paper_and_nothing_is_cut(tab: Page, folder: Path) -> None:
    """Printed by a dark browser the report is white, opens all details, and fits in 190 mm.

    This is the width that a sheet of A4 leaves.
    """
    tab.size(718, 1000, dark=True)
    tab.open(folder / "report.html", wait="performance.getEntriesByName('drawn').length > 0")
    tab.call("Emulation.setEmulatedMedia", media="print", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    try:
        tab.value("dispatchEvent(new Event('beforeprint'))")
        colours = tab.value(
            "['--page', '--control'].map((n) => getComputedStyle(document.body).getPropertyValue(n).trim())"
        )
        assert colours == ["#fff", "#0067b0"]
        ends = tab.value("[...document.querySelectorAll('table, svg')].map((e) => e.getBoundingClientRect().right)")
        assert len(ends) > 20 and max(ends) <= 718
        assert tab.value("[...document.querySelectorAll('.live')].every((e) => !e.getBoundingClientRect().height)")
        assert tab.value("[...document.querySelectorAll('details')].every((e) => e.open)")
        assert tab.troubles == []
    finally:
        tab.call("Emulation.setEmulatedMedia", media="")
        tab.size(1000, 900)


def test_readable_without_the_script(tab: Page, folder: Path) -> None:
    tab.size(1000, 900, script=False)
    try:
        tab.open(folder / "report.html")
        shown = tab.value("[...document.querySelectorAll('.static')].map((e) => e.getBoundingClientRect().height)")
        assert shown and min(shown) > 200
        assert tab.value("[...document.querySelectorAll('.live')].every((e) => !e.getBoundingClientRect().height)")
        assert "root mean square error" in tab.value("document.getElementById('verdict').textContent")
    finally:
        tab.size(1000, 900)


def test_the_policy_lets_nothing_else_run(tab: Page, folder: Path) -> None:
    tab.size(1000, 900)
    tab.open(folder / "report.html", wait="performance.getEntriesByName('drawn').length > 0")
    assert tab.value("document.title").startswith("zonguldak twin")  # the hostile ids have not run
    assert tab.troubles == []
    tab.value("(() => { const s = document.createElement('script'); s.textContent = 'window.planted = 1';"
              " document.body.append(s); const i = new Image(); i.src = 'https://example.org/x.png'; })()")  # fmt: skip
    tab.value("new Promise((done) => setTimeout(done, 200))")
    assert tab.value("window.planted") is None
    assert sum("Content Security Policy" in text for text in tab.troubles) == 2, tab.troubles


def test_names_of_images_that_are_out_of_sight_are_not_drawn(page: Page) -> None:
    page.value(
        "window.named = []; const write = CanvasRenderingContext2D.prototype.fillText;"
        " CanvasRenderingContext2D.prototype.fillText = function (text, ...at)"
        " { window.named.push(text); write.call(this, text, ...at) }"
    )
    drawn(page)
    x, y = middle(page)
    page.mouse("mousePressed", x, y, button="left", clickCount=1)
    page.mouse("mouseMoved", x + 3, y, button="left", buttons=1)
    drawn(page)
    assert {"left", "right"} <= set(page.value("window.named.splice(0)"))
    page.mouse("mouseMoved", x + 3000, y, button="left", buttons=1)
    drawn(page)
    assert not {"left", "right"} & set(page.value("window.named.splice(0)"))
    page.mouse("mouseReleased", x + 3000, y, button="left", clickCount=1)
