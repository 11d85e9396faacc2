"""Figures of a result agree with the tables, are repeatable and safe, and state what is missing."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from lxml import etree
from scipy.stats import norm

from fg_orient.formats.atomic import RESULT
from fg_orient.model.errors import InputError
from fg_orient.report import figures, maps, paper, plots
from fg_orient.report.chart import Chart, Mark
from fg_orient.result.plain import Table
from fg_orient.result.record import Result, read_result
from tests.support.results import sealed

NAMES = set(figures.PLOTS)
#: Of an adjustment without regularisation.
DRAWN = NAMES - {"l_curve", "jitter"}
AXES = ("east", "north", "up")


@pytest.fixture(scope="module")
def folder(adjusted: Path) -> Result:
    return read_result(adjusted)


@pytest.fixture(scope="module")
def written(adjusted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return all figures as SVG."""
    out = tmp_path_factory.mktemp("written") / "figures"
    assert figures.write_figures(adjusted, out, formats=("svg",))[0] == out
    return out


def charts_of(folder: Result, name: str, images: list[str]) -> list[Chart]:
    """Return the charts of one kind of figure."""
    return [chart for chart in figures.PLOTS[name][1](folder, images) if chart is not None]


def marks_of(chart: Chart, shape: str) -> list[Mark]:
    return [mark for mark in chart.marks if mark.shape == shape]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def svg_texts(path: Path) -> list[str]:
    return ["".join(e.itertext()) for e in etree.fromstring(path.read_bytes()).iter("{*}text")]


@pytest.mark.behaviour
def test_every_plot_has_units_and_a_caption(written: Path) -> None:
    assert {p.name for p in written.iterdir()} == {f"{name}.svg" for name in DRAWN} | {"captions.md"}
    told = (written / "captions.md").read_text("utf-8")
    assert told.split("Not drawn:")[1].count("\n- ") == 2 and all(f"**{name}**" in told for name in DRAWN)
    words = {
        "map": ("longitude, WGS 84", "horizontal error"), "map_up": ("latitude, WGS 84", "Up error"),
        "residuals": ("line, px", "sample, px", "px"), "histograms": ("count", "w = v/(σ√r)"),
        "quantiles": ("quantile of N(0, 1)",), "corrections": ("prior standard deviations", "µrad", "position X · τ²"),
        "correlations": ("correlation", "pitch τ²"), "singular_values": ("singular value, prior σ", "weak below"),
        "redundancy": ("redundancy number r", "minimal detectable bias, px"),
        "iterations": ("iteration", "largest step, prior σ or m"),
    }  # fmt: skip
    assert set(words) == DRAWN
    for name, wanted in words.items():
        shown = "\n".join(svg_texts(written / f"{name}.svg"))
        assert all(word in shown for word in wanted), (name, shown)


@pytest.mark.behaviour
def test_no_axis_is_wider_than_its_figure(folder: Result) -> None:
    """The words of each axis lie inside the figure of a paper; constrained layout does not shorten them."""
    for name in figures.PLOTS:
        drawn = charts_of(folder, name, ["left", "right"])
        if not drawn:
            continue
        figure = paper.figure_of(drawn)
        figure.draw_without_rendering()
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            words, box = axis.label.get_text(), axis.label.get_window_extent()
            assert not words or (box.x0 >= 0.0 and box.x1 <= figure.bbox.x1), (name, words)


@pytest.mark.behaviour
def test_files_repeat_and_hold_nothing_of_the_clock(folder: Result, written: Path) -> None:
    def files(kind: str) -> list[bytes]:
        with matplotlib.rc_context(paper.STYLE):
            figure = paper.figure_of(charts_of(folder, "singular_values", folder.images))
            return [paper.file_of(figure, kind) for _ in range(2)]

    first, second = files("svg")
    assert first == second == (written / "singular_values.svg").read_bytes()
    assert b"<dc:date>" not in first
    first, second = files("pdf")
    assert first == second and first.startswith(b"%PDF") and b"CreationDate" not in first


@pytest.mark.consistency
def test_map_shows_the_differences_of_the_table(folder: Result, adjusted: Path) -> None:
    """The map draws the differences of the table as arrows in the scale of its bar."""
    table = {row["id"]: row for row in rows(adjusted / "points.csv") if row["difference_east_m"]}
    for up in (False, True):
        chart = maps.point_map(folder, up=up)
        assert chart is not None
        (axes,) = paper.figure_of([chart]).axes
        arrows = [c for c in axes.collections if type(c).__name__ == "Quiver"]
        drawn = sorted(
            (round(x, 9), round(y, 9), u, v)
            for q in arrows
            for (x, y), u, v in zip(q.XY, np.asarray(q.U), np.asarray(q.V), strict=True)
        )
        wanted = sorted(
            (round(float(r["lon_deg"]), 9), round(float(r["lat_deg"]), 9),
             0.0 if up else float(r["difference_east_m"]), float(r["difference_up_m" if up else "difference_north_m"]))
            for r in table.values()
        )  # fmt: skip
        assert np.allclose(drawn, wanted, rtol=0.0, atol=1e-12)
        assert len(drawn) == 47 and {q.scale for q in arrows} == {chart.per_width}
        (_, (share, words)) = chart.bars
        assert share * chart.per_width == pytest.approx(float(words.split()[0]))


@pytest.mark.oracle
def test_a_kilometre_is_as_long_east_as_north(folder: Result) -> None:
    """The map's bar is right within 0.5 % and both axes have one scale, by pyproj's geodesics."""
    from pyproj import Geod

    chart = maps.point_map(folder)
    assert chart is not None
    (axes,) = paper.figure_of([chart]).axes
    share, words = chart.bars[0]
    west, east = axes.get_xlim()
    geod, middle = Geod(ellps="WGS84"), sum(axes.get_ylim()) / 2.0
    long = geod.inv(west, middle, west + share * (east - west), middle)[2] / 1000.0
    assert words.endswith("km on the ground") and long == pytest.approx(float(words.split()[0]), rel=0.005)
    metres_east = geod.inv(west, middle, west + 0.1, middle)[2]
    metres_north = geod.inv(west, middle - 0.05, west, middle + 0.05)[2]
    assert axes.get_aspect() == pytest.approx(metres_north / metres_east, rel=0.005)
    wide, tall = chart.inner  # the page has the same scale along both axes
    assert wide / np.ptp(chart.x.limits) * axes.get_aspect() == pytest.approx(tall / np.ptp(chart.y.limits))


@pytest.mark.consistency
def test_residual_vectors_point_as_in_the_image(folder: Result, adjusted: Path) -> None:
    """Residual vectors point as in the image: lines increase downwards, so a positive line residual points down."""
    left = [r for r in rows(adjusted / "residuals.csv") if r["image"] == "left"]
    (axes,) = paper.figure_of(charts_of(folder, "residuals", ["left"])).axes
    (bottom, top), (arrows,) = axes.get_ylim(), [c for c in axes.collections if type(c).__name__ == "Quiver"]
    assert bottom > top and axes.get_aspect() == 1.0
    assert np.allclose(arrows.U, [float(r["v_sample_px"]) for r in left])
    assert np.allclose(arrows.V, [-float(r["v_line_px"]) for r in left])
    assert np.allclose(arrows.XY, [[float(r["sample"]), float(r["line"])] for r in left])
    assert "left (47 points)" in axes.get_title("left")


@pytest.mark.behaviour
def test_large_residuals_survive_thinning(rng: np.random.Generator) -> None:
    n, most = 30_000, 2000
    v = rng.standard_normal((n, 2))
    drawn = plots.thinned(np.arange(n), v, most)
    assert len(set(drawn.tolist())) == len(drawn) <= most
    largest = np.argsort(-np.linalg.norm(v, axis=1))[: most // 10]
    assert set(largest.tolist()) <= set(drawn.tolist())


@pytest.mark.oracle
def test_histograms_of_normalised_residuals(folder: Result, adjusted: Path) -> None:
    left = [r for r in rows(adjusted / "residuals.csv") if r["image"] == "left"]
    (chart,) = charts_of(folder, "histograms", ["left"])
    (curve,), bars = marks_of(chart, "line"), marks_of(chart, "bars")
    width = float(np.diff(bars[0].x)[0])
    assert curve.y.max() == pytest.approx(0.39894 * 47 * width, rel=1e-4) and curve.label == "normal, σ = 1"
    for name, mark in zip(("line", "sample"), bars, strict=True):
        w = np.array([float(r[f"w_{name}"]) for r in left])
        assert f"{name}: {round(w.mean(), 2) + 0.0:.2f} ± {w.std():.2f}" == mark.label.replace("−", "-")
        assert mark.y.tolist() == np.histogram(w, mark.x)[0].tolist() and mark.y.sum() == 47


@pytest.mark.oracle
def test_band_of_normal_quantiles(rng: np.random.Generator) -> None:
    """The band of normal quantiles contains each of 25 sorted values in 95 % of 4000 samples.

    The band of one value is 1.96.
    """
    low, middle, high = plots.normal_band(1, np.arange(1))
    assert np.allclose([middle[0], low[0], high[0]], [0.0, -1.959964, 1.959964], atol=1e-6)
    low, middle, high = plots.normal_band(25, np.arange(25))
    samples = np.sort(rng.standard_normal((4000, 25)), axis=1)
    inside = ((samples > low) & (samples < high)).mean(axis=0)
    assert np.abs(inside - 0.95).max() < 4.0 * np.sqrt(0.95 * 0.05 / 4000)
    assert np.abs((samples < middle).mean(axis=0) - 0.5).max() < 4.0 * 0.5 / np.sqrt(4000)


@pytest.mark.oracle
def test_quantiles_draw_every_value(folder: Result, adjusted: Path) -> None:
    """The quantile plot has all sorted values of the table over scipy's normal quantiles."""
    (chart,) = charts_of(folder, "quantiles", ["right"])
    w = np.sort([float(r["w_sample"]) for r in rows(adjusted / "residuals.csv") if r["image"] == "right"])
    (drawn,) = (mark for mark in marks_of(chart, "dots") if mark.label == "sample")
    assert np.array_equal(drawn.y, w)
    assert drawn.x == pytest.approx(norm.ppf((np.arange(len(w)) + 0.5) / len(w)), abs=1e-9)
    kept = plots._spread_ranks(100_000, 2000)
    assert len(kept) <= 2000 and {0, 99_999} <= set(kept.tolist())


@pytest.mark.oracle
def test_correlations_are_those_of_the_cofactors(folder: Result, adjusted: Path) -> None:
    with np.load(adjusted / "arrays.npz") as arrays:
        covariance, names = arrays["image_covariance"][1], arrays["parameter_names"].tolist()
    axes = paper.figure_of(charts_of(folder, "correlations", ["right"])).axes[0]
    sigma = np.sqrt(np.diag(covariance))
    below = np.tri(len(sigma), k=-1, dtype=bool)
    assert np.allclose(axes.images[0].get_array()[below], (covariance / sigma[:, None] / sigma)[below], atol=1e-12)
    words = {"x": "X", "y": "Y", "z": "Z", "vx": "vX", "vy": "vY", "vz": "vZ"}
    parts = [name.rpartition("_") for name in names]
    shown = [words.get(component, component) + ("", " τ", " τ²")[int(degree)] for component, _, degree in parts]
    assert [t.get_text() for t in axes.get_yticklabels()] == shown


@pytest.mark.consistency
def test_corrections_stand_in_prior_sigmas(folder: Result, adjusted: Path) -> None:
    table = [r for r in rows(adjusted / "eop.csv") if r["image"] == "left"]
    (chart,) = charts_of(folder, "corrections", ["left"])
    (dots,), bars = marks_of(chart, "dots"), [m.x for m in chart.marks if m.kind == "whisker"]
    assert np.allclose(dots.x, [float(r["value_per_tau"]) / float(r["prior_sigma"]) for r in table])
    lengths = [float(np.ptp(x) / 2.0) for x in bars]
    assert np.allclose(lengths, [float(r["sigma"]) / float(r["prior_sigma"]) for r in table])
    right = [t.get_text() for t in paper.figure_of([chart]).axes[0].child_axes[0].get_yticklabels()]
    roll = next(k for k, r in enumerate(table) if r["parameter"] == "roll_0")
    value, sigma = (1e6 * float(table[roll][name]) for name in ("value_per_tau", "sigma"))
    shown = right[roll].replace("−", "-").removesuffix(" µrad").split(" ± ")
    assert abs(float(shown[0]) - value) <= 0.5 and float(shown[1]) == pytest.approx(sigma, rel=0.06)


@pytest.mark.behaviour
def test_share_of_biases_that_are_found(folder: Result) -> None:
    """Points without a minimal detectable bias keep the curve of detectable biases below one."""
    mdb = folder.residuals.figures["mdb_sample_px"].copy()
    mdb[:47] = np.nan
    spoilt = Table({**folder.residuals.columns, "mdb_sample_px": mdb})
    planted = dataclasses.replace(folder, tables={**folder.tables, "residuals": spoilt})
    chart = charts_of(planted, "redundancy", folder.images)[1]
    ends = {mark.label: float(mark.y[-1]) for mark in chart.marks}
    assert ends == {"line": 1.0, "sample": pytest.approx(0.5)}


@pytest.mark.behaviour
def test_hostile_names_are_words(adjusted: Path, result: Path, tmp_path: Path) -> None:
    hostile = "<b>$x_1$ & ]]>"
    record = json.loads((result / "result.json").read_text("utf-8"))
    record["images"][0]["id"] = record["observability"][0]["image"] = hostile
    (result / "result.json").write_text(json.dumps(record), encoding="utf-8")
    for name in ("residuals.csv", "eop.csv"):
        text = (result / name).read_text("utf-8").replace("\nleft,", f"\n{hostile},")
        (result / name).write_text(text, encoding="utf-8")
    folder = read_result(sealed(result))
    with matplotlib.rc_context(paper.STYLE):
        figure = paper.figure_of(charts_of(folder, "residuals", folder.images))
        (tmp_path / "x.svg").write_bytes(paper.file_of(figure, "svg"))
    assert f"{hostile} (47 points)" in svg_texts(tmp_path / "x.svg")
    told = figures.captions(folder, [("residuals", "residuals", [hostile])])
    assert "\\<b\\>" in told and "<b>" not in told


@pytest.mark.behaviour
def test_what_is_not_drawn_is_told(result: Path) -> None:
    """Figures whose data are missing are not drawn, and the captions state each reason.

    Missing are statistics, covariances, coordinates and log.
    """
    table = rows(result / "residuals.csv")
    with (result / "residuals.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(table[0])[:8], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(table)
    points = rows(result / "points.csv")
    with (result / "points.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(points[0]))
        writer.writeheader()
        writer.writerows({**row, "lon_deg": "", "lat_deg": ""} for row in points)
    (result / "iterations.jsonl").write_text("", encoding="utf-8")
    with np.load(result / "arrays.npz") as arrays:
        kept = dict(arrays)
    kept["image_cofactors"][:] = np.nan
    np.savez(result / "arrays.npz", **kept)
    folder = read_result(sealed(result))
    for name in ("map", "map_up", "correlations", "redundancy", "iterations"):
        assert charts_of(folder, name, folder.images) == [], name
    assert charts_of(folder, "histograms", ["left"])[0].x.words == "residual v/σ"
    told = figures.captions(folder, [("residuals", "residuals", folder.images)])
    reasons = dict(line[2:].split(": ", 1) for line in told.splitlines() if line.startswith("- "))
    assert set(reasons) == NAMES - {"residuals"} and all(reasons.values())
    assert reasons["map"] == "the points have no geographic coordinates"


@pytest.mark.behaviour
def test_images_beyond_the_limit_are_told(folder: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "MAX_IMAGES", 1)
    drawn = [one for one in figures.planned(folder) if one[1] in DRAWN]
    assert ("residuals", "residuals", ["left"]) in drawn
    assert "1 more images have no figures of their own" in figures.captions(folder, drawn)


@pytest.mark.behaviour
def test_command(run: Any, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "PLOTS", {"iterations": figures.PLOTS["iterations"]})
    ended = run("report", result, "--figures", "--json", "--log", result.parent / "run.log")
    assert ended.code == 0, ended.stderr
    log = [json.loads(line) for line in (result.parent / "run.log").read_text("utf-8").splitlines()]
    assert [(e["done"], e["total"], e["text"]) for e in log if e["event"] == "progress"] == [(1, 1, "figures")]
    files = ["captions.md", "iterations.pdf", "iterations.svg"]
    assert ended.json["figures"] == {"folder": str(result / "figures"), "files": files}
    assert sorted(p.name for p in (result / "figures").iterdir()) == files
    again = run("report", result, "--figures", "--json")
    assert (again.code, again.json["errors"][0]["code"]) == (2, "output.exists")
    assert run("report", result, "--figures", "--overwrite").code == 0
    assert RESULT.first_foreign(result) == ""  # figures do not keep a result from being replaced


@pytest.mark.behaviour
def test_refusals(run: Any, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("", encoding="utf-8")
    ended = run("report", result, "--figures-out", tmp_path / "mine", "--overwrite", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "output.foreign")
    arrays = (result / "arrays.npz").read_bytes()
    (result / "arrays.npz").write_bytes(b"PK")
    ended = run("report", result, "--figures", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "manifest.incomplete")
    (result / "arrays.npz").write_bytes(arrays)
    with pytest.raises(InputError, match="svg or pdf"):
        figures.write_figures(result, formats=("png",))
    monkeypatch.setattr(paper, "find_spec", lambda name: None)
    ended = run("report", result, "--figures", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "report.no_matplotlib")
    assert not (result / "figures").exists()
