"""Without a browser the tests check size and policy of the report, and each drawing against the tables."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fg_orient.cli.output import number
from fg_orient.model.errors import as_record, finding
from fg_orient.report import html, maps, payload, plots, tables
from fg_orient.report.chart import log_ticks, ticks
from fg_orient.report.html import render
from fg_orient.report.maps import first_view
from fg_orient.report.page import script
from fg_orient.report.svg import svg
from fg_orient.report.tables import corrections, correlations, short_names
from fg_orient.report.words import orientation_words, signed
from fg_orient.result.record import Result
from tests.support.page import of_large_images, structure, with_columns


def elements(text: str) -> list[tuple[str, str]]:
    """Return the attributes and text of the script elements."""
    return re.findall(r"<script([^>]*)>(.*?)</script>", text, re.DOTALL)


def unpacked(column: dict[str, Any]) -> Any:
    """Read a packed column as the script does."""
    if "one" in column:
        return np.full(column["n"], column["one"])
    if "counts" in column:
        return np.repeat(np.arange(len(column["counts"])), column["counts"])
    data = base64.b64decode(column["base64"])
    if column["kind"] == "u3":
        digits = np.frombuffer(data, np.uint8).reshape(-1, 3)
        return column["low"] + column["step"] * (digits @ np.array([1, 256, 65536]))
    if column["kind"] == "d":
        out, change, weight = [0], 0, 1
        for byte in data:
            change, weight = change + (byte & 127) * weight, weight * 128
            if byte < 128:
                out.append(out[-1] + (-(change + 1) // 2 if change % 2 else change // 2))
                change, weight = 0, 1
        return np.array(out[1:])
    return np.frombuffer(data, f"<{column['kind']}")


@pytest.fixture(scope="session")
def text(folder: Path) -> str:
    return (folder / "report.html").read_text("utf-8")


@pytest.fixture(scope="session")
def data(text: str) -> Any:
    return json.loads(elements(text)[0][1])


@pytest.mark.behaviour
def test_one_small_script_and_a_policy_that_names_it(text: str) -> None:
    (data, _), (attributes, run) = elements(text)
    assert 'type="application/json"' in data and attributes == ""
    assert run == script() and len(run.encode()) < 60_000
    digest = base64.b64encode(hashlib.sha256(run.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    rules = dict(rule.split(" ", 1) for rule in policy.group(1).split("; "))
    assert rules["default-src"] == "'none'" and rules["script-src"] == f"'sha256-{digest}'"
    assert "unsafe-eval" not in policy.group(1) and "http" not in policy.group(1)
    assert text.index("Content-Security-Policy") < text.index("<style>")


@pytest.mark.behaviour
@pytest.mark.parametrize("word", ["eval(", "Function(", "innerHTML", "outerHTML", "insertAdjacent", "document.write",
                                  "import", "fetch", "XMLHttp", "WebSocket", "http:", "https:"])  # fmt: skip
def test_the_script_makes_no_code_and_asks_nobody(word: str) -> None:
    assert word not in script()


@pytest.mark.behaviour
def test_hostile_ids_are_words(folder: Path, text: str, data: Any) -> None:
    found = structure(folder / "report.html")
    assert found.tags.count("script") == 2 and "img" not in found.tags
    assert "<img src=x" not in text and "document.title = 'broken'</script>" not in text
    assert any("onerror" in name for name in data["points"]["id"])


@pytest.mark.consistency
def test_packed_columns_are_the_tables(result: Result, data: Any) -> None:
    table, rays = result.residuals, data["rays"]
    image = unpacked(rays["image"]).astype(int)
    names = [data["images"][k]["id"] for k in image]
    ids = [data["points"]["id"][k] for k in unpacked(rays["point"]).astype(int)]
    row = {key: k for k, key in enumerate(zip(table.words["image"], table.words["id"], strict=True))}
    rows = [row[key] for key in zip(names, ids, strict=True)]
    assert sorted(rows) == list(range(len(table)))
    for packed, column in (("line", "line"), ("vs", "v_sample_px"), ("wl", "w_line")):
        np.testing.assert_allclose(
            unpacked(rays[packed]), table.figures[column][rows], rtol=6e-8, atol=1e-3 * (packed == "line")
        )
    place = {name: k for k, name in enumerate(result.points.words["id"])}
    rows = [place[name] for name in data["points"]["id"]]
    degrees = np.stack([unpacked(data["points"][axis]) / data["kmPerDegree"][k] + data["centre"][k]
                        for k, axis in enumerate("xy")])  # fmt: skip
    np.testing.assert_allclose(degrees.T, result.points.numbers("lon_deg", "lat_deg")[rows], atol=1e-7)
    up = unpacked(data["points"]["up"])
    np.testing.assert_allclose(up, result.points.figures["difference_up_m"][rows][: len(up)], rtol=6e-8)
    assert len(up) == sum(role != "tie" for role in result.points.words["role"])


@pytest.mark.consistency
def test_packed_columns_are_read_again(rng: np.random.Generator) -> None:
    numbers = rng.integers(0, 2**26, 500) >> rng.integers(0, 26, 500)
    assert unpacked(payload.pack(numbers, "d")).tolist() == numbers.tolist()
    assert payload.pack([], "d")["base64"] == "" == payload.pack([], "u3")["base64"]
    places = rng.uniform(-40.0, 60.0, 500)
    np.testing.assert_allclose(unpacked(payload.pack(places, "u3")), places, atol=100.0 / 2**24)
    small = rng.normal(size=500) * 10.0 ** rng.integers(-3, 4, 500)
    np.testing.assert_allclose(unpacked(payload.pack(small, "f2")), small, rtol=5e-4, atol=4e-8)


@pytest.mark.behaviour
def test_constant_columns_are_one_value() -> None:
    assert payload.pack([0.3, 0.3, 0.3]) == {"one": float(np.float32(0.3)), "n": 3}
    for values in ([], [1.5], [1.5, 2.5], [np.nan, np.nan]):
        np.testing.assert_array_equal(unpacked(payload.pack(values)), np.array(values, np.float32))


@pytest.mark.behaviour
def test_large_blocks_keep_what_is_flagged(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    table = result.residuals
    figures = {**table.columns, "w_line": table.figures["w_line"].copy()}
    figures["w_line"][[3, 50, 90]] = [4.0, -3.5, 9.0]
    planted = with_columns(result, "residuals", figures)
    known = sum(role != "tie" for role in planted.points.words["role"])
    each, less = (payload._point_bytes(planted, width) for width in (payload.FINE, payload.COARSE))
    bytes_of_points = 94 * payload.FINE.ray + len(planted.points) * each + known * payload.KNOWN
    data = {**payload.payload(planted).data, "images": []}  # type: ignore[union-attr]
    assert len(payload.Payload(data, "").json()) < bytes_of_points + 2000  # names of the columns
    monkeypatch.setattr(payload, "LIMIT", 20)
    kept, of_ray = payload.chosen_points(planted)[0], payload.points_of_rays(planted)
    rows, words, width = payload.chosen_rays(planted, kept, of_ray)
    assert width == payload.COARSE
    assert {3, 50, 90} <= set(rows.tolist()) and len(rows) == 20 == len(set(rows.tolist()))
    assert rows.tolist() == payload.chosen_rays(planted, kept, of_ray)[0].tolist()
    assert "20 of 94 image points: all 3 with a residual beyond 3 σ" in words and "seed 1" in words
    page = render(planted)
    drawn = json.loads(elements(page)[0][1])
    assert drawn["rays"]["line"]["n"] == 20 and words in page
    roles = [drawn["roles"][k] for k in unpacked(drawn["points"]["role"]).astype(int)]
    assert (roles.count("control"), roles.count("check")) == (37, 10)
    monkeypatch.setattr(payload, "LIMIT", 2)
    assert payload.chosen_rays(planted, kept, of_ray)[0].tolist() == [3, 50, 90]
    # 23 of 47 control and check points, and two image points, fit into these bytes
    monkeypatch.setattr(payload, "BUDGET", 2 * 23 * (each + payload.KNOWN))
    room = payload.BUDGET - 23 * (less + payload.KNOWN)
    monkeypatch.setattr(payload, "COARSE", payload.COARSE._replace(ray=room / 2 - less))
    kept = payload.chosen_points(planted)[0]
    rows, words, _ = payload.chosen_rays(planted, kept, of_ray)
    assert rows.tolist() == [3, 90] and "the largest 2 of 3 with a residual beyond 3 σ" in words
    kept, words = payload.chosen_points(planted)
    known = np.array([role != "tie" for role in planted.points.words["role"]])
    assert (kept & known).sum() == 23 and "Of 47 control and check points they hold 23" in words
    drawn = json.loads(elements(render(planted))[0][1])
    assert sum(drawn["points"]["role"]["counts"]) <= 23 + 2 and drawn["rays"]["line"]["n"] <= 2


@pytest.mark.behaviour
def test_histogram_and_quantiles(result: Result) -> None:
    ratio, tested = result.normalised
    assert tested
    chart = plots.histogram(ratio, "left", tested)
    assert chart is not None
    drawing = svg(chart)
    columns = re.findall(r'class="column of-(line|sample)" d="M[\d.]+ ([\d.]+)V([\d.]+)', drawing)
    top = [float(m) for m in re.findall(r'<path class="grid" d="M50.0 ([\d.]+)H', drawing)]
    labels = [float(v) for v in re.findall(r'text-anchor="end">(\d+)</text>', drawing)]
    unit = (top[0] - top[-1]) / (labels[len(top) - 1] - labels[0])
    for k, axis in enumerate(("line", "sample")):
        counts = [(float(zero) - float(y)) / unit for name, zero, y in columns if name == axis]
        assert sum(counts) == pytest.approx(np.isfinite(ratio[:, k]).sum(), abs=0.1 * len(counts) / unit)
        w = ratio[np.isfinite(ratio[:, k]), k]
        assert f"{axis}: {round(w.mean(), 2) + 0.0:.2f} ± {w.std():.2f}".replace("-", "−") in drawing
    # the legend ends inside the frame: letters of 13 units are about half as wide
    assert all(26.0 + 6.6 * len(mark.label) < chart.inner[0] for mark in chart.marks)
    chart = plots.quantiles(ratio[:, :1] * np.array([[1.0, np.nan]]), "left", tested)
    assert chart is not None
    first = re.search(r'class="line-dot" d="M([\d.]+) ([\d.]+)a', svg(chart))
    assert first is not None
    x, y = chart.place(stats.norm.ppf(0.5 / 94), float(np.nanmin(ratio[:, 0])))
    assert (float(first.group(1)) + 2.6, float(first.group(2))) == pytest.approx((x, y), abs=0.11)


@pytest.mark.behaviour
def test_what_lies_beyond_the_axis_is_counted(result: Result) -> None:
    table = result.residuals
    figures = {**table.columns, "w_line": table.figures["w_line"].copy()}
    figures["w_line"][:3] = [5.5, -7.0, 40.0]
    planted = with_columns(result, "residuals", figures)
    page = render(planted)
    assert (
        page.count("beyond ±5 σ") == 1
        and "3 beyond ±5 σ" in page.partition("Image <span")[2].partition("</details>")[0]
    )
    worst = tables.largest_residuals(planted)
    assert worst is not None
    assert [row["w_line"] for row in worst["rows"][:3]] == [40.0, -7.0, 5.5]
    assert (worst["n"], worst["beyond"], worst["expected"]) == (188, 3, f"{188 * 2 * stats.norm.sf(3):.1f}")


@pytest.mark.behaviour
def test_without_redundancy_numbers_residuals_are_divided_by_the_given_sigmas(result: Result) -> None:
    table = result.residuals
    figures = {
        name: column for name, column in table.columns.items() if not name.startswith(("w_", "redundancy", "mdb"))
    }
    plain = with_columns(result, "residuals", figures)
    ratio, tested = plain.normalised
    assert not tested
    np.testing.assert_array_equal(ratio[:, 0], figures["v_line_px"] / figures["sigma_line_px"])
    page = render(plain)
    assert "over the standard deviations of the observations" in page and "Largest residuals" not in page
    assert "redundancy number r" not in page


@pytest.mark.consistency
def test_correlations_are_those_of_the_cofactors(result: Result) -> None:
    q = np.array([[4.0, -1.9, 0.0], [-1.9, 1.0, 0.1], [0.0, 0.1, 0.0]])
    np.testing.assert_allclose(correlations(q)[:2, :2], [[1.0, -0.95], [-0.95, 1.0]])
    assert np.isnan(correlations(q)[2, 2])
    names = short_names(result)
    assert names["left"][:3] == ["X", "X τ", "X τ²"] and len(names["right"]) == 18
    drawn = tables.image_correlations(result)
    assert list(drawn) == ["left", "right"]
    strong = next(c for c in result.record["correlations"]["largest"] if c["a"] == "right.y_0")
    written = f"roll with Y: {strong['correlation']:+.3f}".replace("-", "−")
    page = render(result)
    assert "right.y_0" not in page and '<td class="id">right Y</td><td class="id text">right roll</td>' in page
    drawing = svg(plots.heat_map("image right", names["right"], drawn["right"]))
    assert written in drawing and 'class="cell m5"' in drawing and drawing in page
    assert tables.image_correlations(dataclasses.replace(result, arrays={})) == {}
    none = {"n_parameters": [0], "image_cofactors": np.zeros((1, *result.arrays["image_cofactors"].shape[1:]))}
    arrays = {name: np.concatenate([value, result.arrays[name]]) for name, value in none.items()}
    record = {**result.record, "images": [{"id": "fixed"}, *result.record["images"]]}
    first = dataclasses.replace(result, record=record, arrays=arrays)
    moved = tables.image_correlations(first)  # an image without unknowns moves no other's figures
    assert moved.keys() == drawn.keys() and all(np.array_equal(moved[k], drawn[k]) for k in drawn)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("models", "words"),
    [
        (("pushbroom", "pushbroom"), "EOP set 15 PUA"),
        (("frame", "frame"), "frame images"),
        (("frame", "RPC"), "RPC compensation: shift and drift · frame images"),
        (("parallel", "pushbroom"), "EOP set 15 PUA · parallel images"),
    ],
)
def test_every_kind_of_image_has_words(result: Result, models: tuple[str, ...], words: str) -> None:
    """The words on the orientation name each kind of image of the block, joined by a dot."""
    images = [{**image, "model": model} for image, model in zip(result.record["images"], models, strict=True)]
    assert orientation_words({**result.record, "images": images, "rpc_compensation": "shift_drift"}) == words


@pytest.mark.behaviour
def test_what_is_rounded_to_zero_has_no_sign(result: Result) -> None:
    assert [signed(v) for v in (-0.0004, 0.0004, 0.0, -0.0006, 1.5)] == ["0.000", "0.000", "0.000", "−0.001", "+1.500"]
    assert [number(v) for v in (-0.0004, -0.0, -0.0006)] == ["0.000", "0.000", "-0.001"]
    points = dict(result.points.columns)
    points["difference_up_m"] = np.where(np.isnan(points["difference_up_m"]), np.nan, -1e-5)
    drawing = svg(maps.point_map(with_columns(result, "points", points)))
    assert "up 0.000 m" in drawing and "-0.000" not in drawing and "−0.000" not in drawing


@pytest.mark.behaviour
def test_a_map_opens_on_the_points_where_footprints_are_far_larger(result: Result) -> None:
    place = result.points.numbers("lon_deg", "lat_deg")
    low, high = np.nanmin(place, axis=0), np.nanmax(place, axis=0)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    assert first_view(place, [0.5 * (low + high) + 0.6 * (high - low) * square]) is None
    assert first_view(np.full((3, 2), np.nan), [square]) is None
    one = first_view(np.array([[0.0, 60.0]]), [square + np.array([0.0, 60.0])])  # a single point has a view of its own
    assert one is not None and np.ptp(one, axis=0) * [111.2 * 0.5, 111.2] == pytest.approx([0.124, 0.124], rel=1e-9)
    assert "beyond the border" not in render(result) and payload.payload(result).data["view"] is None
    large = of_large_images(result)
    view = np.array(payload.payload(large).data["view"])
    east, north = (unpacked(payload.payload(large).data["points"][axis]) for axis in ("x", "y"))
    border = 0.12 * float(max(np.ptp(east), np.ptp(north)))
    for axis, values in enumerate((east, north)):  # the border is taken at the latitude of the points, not of all
        assert view[:, axis] == pytest.approx([values.min() - border, values.max() + border], abs=1e-3 * border)
    page = render(large)
    chart = maps.point_map(large)
    assert chart is not None
    drawing = svg(chart)
    assert "reach beyond the border of this view" in page and drawing in page
    assert np.array([chart.x.limits, chart.y.limits]).T == pytest.approx(maps.view_of(large), abs=1e-9)
    inner = re.findall(
        r'<svg x="14" y="14" width="692.0" height="[\d.]+"><path class="foot" d="[^"]*"/></svg>', drawing
    )
    assert len(inner) == 2  # drawings in the drawing, which cut at their border
    places = [float(x) for x in re.findall(r'<path class="(?:check|tie)" d="M([-\d.]+) ', drawing)]
    assert np.ptp(places) > 0.5 * chart.width
    names = [tuple(map(float, at)) for at in re.findall(r'class="label" x="([\d.]+)" y="([\d.]+)"', drawing)]
    assert len(set(names)) == 2 and all(0 < x < chart.width and 0 < y < 80 for x, y in names)


@pytest.mark.behaviour
def test_the_first_view_of_an_image_shows_the_points(result: Result) -> None:
    """If the points fill a small part of an image, its drawing and the page's data show this part; else the image."""
    whole = plots.residual_vectors(result, "left")
    assert whole is not None and (whole.x.limits, whole.y.limits) == ((0.0, 12000.0), (0.0, 12000.0))
    rows, table = result.rows["left"], result.residuals
    figures = {name: table.figures[name].copy() for name in ("sample", "line")}
    for name, middle in (("sample", 3000.0), ("line", 9000.0)):
        figures[name][rows] = middle + 0.1 * (figures[name][rows] - figures[name][rows].mean())
    near = with_columns(result, "residuals", {**table.columns, **figures})
    chart = plots.residual_vectors(near, "left")
    assert chart is not None
    view = np.array([chart.x.limits, chart.y.limits]).T
    places = np.stack([figures["sample"][rows], figures["line"][rows]], axis=1)
    room = np.minimum(places.min(axis=0) - view[0], view[1] - places.max(axis=0)) / np.ptp(places, axis=0).max()
    assert room == pytest.approx(maps.BORDER)
    images = json.loads(elements(render(near))[0][1])["images"]
    assert images[0]["view"] == np.round(view, 1).tolist() and images[1]["view"] is None


@pytest.mark.behaviour
def test_words_stand_below_their_heads(result: Result) -> None:
    """A column of text has a text head and is aligned with it in each table of the report."""
    held = 0
    for table in render(result).split("<table")[1:]:
        head, _, body = table.partition("</table>")[0].partition("</thead>")
        if head.count("<tr") != 1 or "<tr" not in body:  # heads of two rows have groups
            continue
        row = body[body.index("<tr") : body.index("</tr>")]
        kinds = [[bool(re.search(r'class="([^"]* )?text[ "]', cell)) for cell in re.findall(pattern, part)]
                 for pattern, part in ((r"<th\b[^>]*>", head), (r"<t[dh]\b[^>]*>", row))]  # fmt: skip
        assert kinds[0][1:] == kinds[1][1:], head
        held += 1
    assert held > 5


@pytest.mark.behaviour
def test_check_points_beyond_three_by_chance_are_no_doubt(result: Result) -> None:
    check = result.record["accuracy"]["check"]
    row = {"id": "c7", "axis": "east", "difference_m": 1.0, "ratio": 3.2}
    beyond = {"by_chance": True, "sentence": "1 of 30 lies beyond: as many as chance gives"}
    for chance, told, other in (
        (True, "beyond three standard deviations</h3>", "Check points to look at"),
        (False, "Check points to look at</h3>", "beyond three standard deviations</h3>"),
    ):
        changed = {**check, "suspicious": [row], "beyond_3_sigma": {**beyond, "by_chance": chance}}
        record = {**result.record, "accuracy": {**result.record["accuracy"], "check": changed}}
        page = render(dataclasses.replace(result, record=record))
        assert told in page and other not in page and "as many as chance gives." in page.replace("gives:", "gives.")


@pytest.mark.behaviour
def test_corrections_stand_at_their_share_of_the_prior(result: Result) -> None:
    rows = [{"name": "roll", "degree": "constant", "unit": "µrad", "value": -3.0, "sigma": 0.5, "prior": 2.0}]
    chart = plots.correction_chart("left", rows)
    assert chart is not None and chart.y.beside == ["−3.00 ± 0.50 µrad"]
    drawing = svg(chart)
    dot = re.search(r'class="line-dot" d="M([\d.]+) ', drawing)
    whisker = re.search(r'class="whisker" d="M([\d.]+) [\d.]+L([\d.]+)', drawing)
    assert dot is not None and whisker is not None
    x = chart.place([-1.5, -1.75, -1.25], [0.0] * 3)[:, 0]
    assert [float(dot.group(1)) + 2.6, *map(float, whisker.groups())] == pytest.approx(x, abs=0.11)
    own = plots.correction_chart("left", [{**rows[0], "prior": None}])
    assert own is not None and own.marks[-1].x.tolist() == [-6.0] and "own σ" in own.x.words
    assert plots.correction_chart("left", [{**rows[0], "prior": None, "sigma": None}]) is None
    assert len(corrections(result)) == 2


@pytest.mark.behaviour
def test_rejected_steps_are_drawn_apart() -> None:
    taken = {"accepted": True, "chi2": 1e4, "chi2_after": 1e2, "step": 1e-3}
    log = [
        {**taken, "iteration": 1},
        {**taken, "iteration": 2, "accepted": False},
        {**taken, "iteration": 3, "chi2": 1e2},
    ]
    squares, steps = plots.iteration_charts(log)
    assert [{m.kind: len(m.x) for m in chart.marks} for chart in (squares, steps)] == [
        {"curve": 3, "line-dot": 3, "sample-dot": 1}, {"curve": 2, "line-dot": 2, "sample-dot": 1},
    ]  # fmt: skip
    assert "rejected" in svg(steps) and plots.iteration_charts([]) == []


@pytest.mark.behaviour
def test_directions_stand_beside_their_singular_values(result: Result, text: str) -> None:
    part = text.partition("<summary>Directions that the data do not determine</summary>")[2].partition("</table>")[0]
    shown = re.findall(
        r'<td class="id">(\w+)</td><td class="text">([^<]*)</td><td class="text">its prior</td><td>(.*?)</td>', part
    )
    assert len(shown) == 22
    for image in result.record["observability"]:
        mine = [(words, float(value.replace("−", "-"))) for name, words, value in shown if name == image["image"]]
        assert [words for words, _ in mine] == image["held_by_the_prior"]
        assert [value for _, value in mine] == pytest.approx([s for s in image["singular_values"] if s < 1.0], rel=6e-3)


@pytest.mark.behaviour
def test_ticks() -> None:
    assert ticks(-5.0, 5.0, 5) == [-4.0, -2.0, 0.0, 2.0, 4.0]
    assert ticks(0.0, 12000.0, 3) == [0.0, 5000.0, 10000.0]
    assert ticks(1.0, 1.0) == [1.0]
    assert log_ticks(1e-8, 1e2) == pytest.approx([1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2])


@pytest.mark.behaviour
def test_a_folder_without_arrays_has_no_heat_map(result: Result, folder: Path) -> None:
    page = render(dataclasses.replace(result, arrays={}))
    assert "Correlations of the unknowns" not in page
    assert "Correlations of the unknowns" in (folder / "report.html").read_text("utf-8")


@pytest.mark.behaviour
def test_first_page_names_what_a_test_suspects_and_repeats_no_verdict(result: Result) -> None:
    said = "sigma0 = 51.140 lies above 1.190"
    suspects = [{"sentence": f"point {k} in image right: gross error"} for k in ("a<b", "c", "d", "e", "f")]
    decided = finding("verdict.sigma0", size=51.14, limit=1.19)
    told = as_record([decided, finding("solution.no_check")])
    verdict = {"status": "not_trustworthy", "reason": said, "suspicious_observations": suspects}
    record = {**result.record, **told, **verdict}
    page = render(dataclasses.replace(result, record=record))
    problems = page[page.index('id="problems"') : page.index("<nav")]
    assert re.findall("<li>(.*?)</li>", problems) == [
        *(f"look at point {k} in image right: gross error" for k in ("a&lt;b", "c", "d")),
        "2 more observations to look at are listed with the residuals",
        "no check points: the accuracy is not verified independently",
    ]  # fmt: skip
    assert page.count(said) == 1


@pytest.mark.behaviour
def test_a_section_from_outside_is_one_declaration(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """One declaration adds a section with heading, link, values and template; without values it is omitted."""
    monkeypatch.setattr(html, "SECTIONS", [*html.SECTIONS])
    template = "<p>{{ n }} rays of {{ r.name }}, {{ worst }}</p>"

    @html.section("rays-of", "Rays of the points", template, before="residuals")
    def rays(result: Result) -> dict[str, Any]:
        return {"n": len(result.residuals), "worst": "<b>"}

    html.section("nothing", "Nothing", "<p>never</p>")(lambda result: None)
    page = render(result)
    assert f"<p>94 rays of {result.record['name']}, &lt;b&gt;</p>" in page and "never" not in page
    places = [page.index(f'<section id="{name}"><h2>') for name in ("accuracy", "rays-of", "residuals")]
    assert places == sorted(places)
    assert '<a href="#rays-of">Rays of the points</a>' in page
    assert rays(result)["n"] == 94 and 'href="#nothing"' not in page
