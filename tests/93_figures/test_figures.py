"""Figures of a result: what they show is what the tables hold; files repeat, are safe, and say what is missing."""

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

from fg_orient.formats.atomic import RESULT
from fg_orient.model.errors import InputError
from fg_orient.report import captions, checks, maps, residuals, style, write
from fg_orient.report import figure_orientation as orientation
from fg_orient.report.figure_data import Folder, read_folder
from fg_orient.result.plain import Table

NAMES = {plot.name for plot in write.PLOTS}
#: Of an adjustment without regularisation.
DRAWN = NAMES - {"l_curve"}
AXES = ("east", "north", "up")


@pytest.fixture(scope="module")
def folder(adjusted: Path) -> Folder:
    return read_folder(adjusted)


@pytest.fixture(scope="module")
def written(adjusted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All figures as SVG."""
    out = tmp_path_factory.mktemp("written") / "figures"
    assert write.write_figures(adjusted, out, formats=("svg",))[0] == out
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def svg_texts(path: Path) -> list[str]:
    return ["".join(e.itertext()) for e in etree.fromstring(path.read_bytes()).iter("{*}text")]


@pytest.mark.behaviour
def test_every_plot_has_units_and_a_caption(written: Path) -> None:
    assert {p.name for p in written.iterdir()} == {f"{name}.svg" for name in DRAWN} | {"captions.md"}
    told = (written / "captions.md").read_text("utf-8")
    assert told.split("Not drawn:")[1].count("\n- ") == 1 and all(f"**{name}**" in told for name in DRAWN)
    words = {
        "map": ("longitude, WGS 84", "horizontal error"), "map_up": ("latitude, WGS 84", "Up error"),
        "residuals": ("line, px", "sample, px", "px"), "histograms": ("density", "w = v/(σ√r)"),
        "quantiles": ("quantile of N(0, 1)",), "corrections": ("prior σ", "µrad", "position X · τ²"),
        "correlations": ("correlation", "pitch τ²"), "singular_values": ("singular value, prior σ", "weak below"),
        "redundancy": ("redundancy number r", "minimal detectable bias, px"),
        "iterations": ("iteration", "largest step, prior σ or m"),
    }  # fmt: skip
    assert set(words) == DRAWN and set(captions.TEXTS) == NAMES == set(captions.ABSENT)
    for name, wanted in words.items():
        shown = "\n".join(svg_texts(written / f"{name}.svg"))
        assert all(word in shown for word in wanted), (name, shown)


@pytest.mark.behaviour
def test_files_repeat_and_hold_nothing_of_the_clock(folder: Folder, written: Path) -> None:
    def files(kind: str) -> list[bytes]:
        with matplotlib.rc_context(style.STYLE):
            figure = orientation.singular_values(folder, folder.images)
            return [style.file_of(figure, kind) for _ in range(2)]

    first, second = files("svg")
    assert first == second == (written / "singular_values.svg").read_bytes()
    assert b"<dc:date>" not in first
    first, second = files("pdf")
    assert first == second and first.startswith(b"%PDF") and b"CreationDate" not in first


@pytest.mark.consistency
def test_map_shows_the_differences_of_the_table(folder: Folder, adjusted: Path) -> None:
    table = {row["id"]: row for row in rows(adjusted / "points.csv") if row["difference_east_m"]}
    for up in (False, True):
        (axes,) = maps.error_map(folder, up=up).axes
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
        assert len(drawn) == 47 and len({q.scale for q in arrows}) == 1


@pytest.mark.oracle
def test_a_kilometre_is_as_long_east_as_north(folder: Folder) -> None:
    """The bar of kilometres and the aspect against pyproj's geodesic."""
    from pyproj import Geod

    (axes,) = maps.error_map(folder).axes
    (bar,) = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_linewidth() == 1.6]
    (west, east), (south, _) = bar.get_xdata(), bar.get_ydata()
    stated = next(float(t.get_text().split()[0]) for t in axes.texts if t.get_text().endswith("km"))
    geod, middle = Geod(ellps="WGS84"), sum(axes.get_ylim()) / 2.0
    assert geod.inv(west, middle, east, middle)[2] / 1000.0 == pytest.approx(stated, rel=0.005)
    metres_east = geod.inv(west, middle, west + 0.1, middle)[2]
    metres_north = geod.inv(west, middle - 0.05, west, middle + 0.05)[2]
    assert axes.get_aspect() == pytest.approx(metres_north / metres_east, rel=0.005)
    assert south < middle


@pytest.mark.consistency
def test_residual_vectors_point_as_in_the_image(folder: Folder, adjusted: Path) -> None:
    """Lines run downwards, so a positive residual of the line points down."""
    left = [r for r in rows(adjusted / "residuals.csv") if r["image"] == "left"]
    axes = residuals.vectors(folder, ["left"]).axes[0]
    (bottom, top), (arrows,) = axes.get_ylim(), [c for c in axes.collections if type(c).__name__ == "Quiver"]
    assert bottom > top and axes.get_aspect() == 1.0
    assert np.allclose(arrows.U, [float(r["v_sample_px"]) for r in left])
    assert np.allclose(arrows.V, [-float(r["v_line_px"]) for r in left])
    assert np.allclose(arrows.XY, [[float(r["sample"]), float(r["line"])] for r in left])
    assert "left (47 points)" in axes.get_title()


@pytest.mark.behaviour
def test_large_residuals_survive_thinning(folder: Folder, rng: np.random.Generator) -> None:
    n = 30_000
    v = rng.standard_normal((n, 2))
    figures = {"v_line_px": v[:, 0], "v_sample_px": v[:, 1]}
    table = Table({"image": ["left"] * n, **figures})
    many = Folder(dataclasses.replace(folder.result, tables={**folder.result.tables, "residuals": table}))
    drawn, left_out = residuals.thinned(many, "left")
    assert len(drawn) + left_out == n and len(set(drawn.tolist())) == len(drawn) <= residuals.MAX_VECTORS
    largest = np.argsort(-np.linalg.norm(v, axis=1))[: residuals.MAX_VECTORS // 10]
    assert set(largest.tolist()) <= set(drawn.tolist())


@pytest.mark.oracle
def test_histograms_of_normalised_residuals(folder: Folder, adjusted: Path) -> None:
    left = [r for r in rows(adjusted / "residuals.csv") if r["image"] == "left"]
    axes = residuals.histograms(folder, ["left"]).axes[0]
    curve = axes.lines[-1]
    assert max(curve.get_ydata()) == pytest.approx(0.39894, abs=1e-5)
    for name, label in zip(("line", "sample"), axes.get_legend_handles_labels()[1], strict=False):
        w = np.array([float(r[f"w_{name}"]) for r in left])
        assert f"{name}: n 47, mean {w.mean():.2f}, s {w.std():.2f}" == label.replace("−", "-")
    x, y = axes.patches[0].get_xy().T
    assert np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2.0) == pytest.approx(1.0)


@pytest.mark.oracle
def test_band_of_normal_quantiles(rng: np.random.Generator) -> None:
    """One lies within 1.96; of 25 ordered ones each lies in its band in 95 % of 4000 samples, within 4 sigmas."""
    middle, low, high = residuals.normal_band(1)
    assert np.allclose([middle[0], low[0], high[0]], [0.0, -1.959964, 1.959964], atol=1e-6)
    middle, low, high = residuals.normal_band(25)
    samples = np.sort(rng.standard_normal((4000, 25)), axis=1)
    inside = ((samples > low) & (samples < high)).mean(axis=0)
    assert np.abs(inside - 0.95).max() < 4.0 * np.sqrt(0.95 * 0.05 / 4000)
    assert np.abs((samples < middle).mean(axis=0) - 0.5).max() < 4.0 * 0.5 / np.sqrt(4000)


@pytest.mark.consistency
def test_quantiles_draw_every_value(folder: Folder) -> None:
    axes = residuals.quantiles(folder, ["right"]).axes[0]
    w = folder.residuals.figures["w_sample"][folder.rows["right"]]
    drawn = next(line for line in axes.lines if line.get_label() == "sample")
    assert np.array_equal(drawn.get_ydata(), np.sort(w))
    kept = residuals._ends_kept(100_000)
    assert len(kept) <= residuals.MAX_QUANTILES and {0, 1, 99_998, 99_999} <= set(kept.tolist())


@pytest.mark.oracle
def test_correlations_are_those_of_the_cofactors(folder: Folder, adjusted: Path) -> None:
    with np.load(adjusted / "arrays.npz") as arrays:
        covariance, names = arrays["image_covariance"][1], arrays["parameter_names"].tolist()
    axes = orientation.correlations(folder, ["right"]).axes[0]
    sigma = np.sqrt(np.diag(covariance))
    assert np.allclose(axes.images[0].get_array(), covariance / sigma[:, None] / sigma, atol=1e-12)
    words = {"x": "X", "y": "Y", "z": "Z", "vx": "vX", "vy": "vY", "vz": "vZ"}
    parts = [name.rpartition("_") for name in names]
    shown = [words.get(component, component) + ("", " τ", " τ²")[int(degree)] for component, _, degree in parts]
    assert [t.get_text() for t in axes.get_yticklabels()] == shown


@pytest.mark.consistency
def test_corrections_stand_in_prior_sigmas(folder: Folder, adjusted: Path) -> None:
    table = [r for r in rows(adjusted / "eop.csv") if r["image"] == "left"]
    axes = orientation.corrections(folder, ["left"]).axes[0]
    dots = [float(c.lines[0].get_xdata()[0]) for c in axes.containers]
    bars = [c.lines[2][0].get_segments()[0] for c in axes.containers]
    assert np.allclose(dots, [float(r["value_per_tau"]) / float(r["prior_sigma"]) for r in table])
    lengths = [float(np.ptp(b[:, 0]) / 2.0) for b in bars]
    assert np.allclose(lengths, [float(r["sigma"]) / float(r["prior_sigma"]) for r in table])
    right = [t.get_text() for t in axes.child_axes[0].get_yticklabels()]
    roll = next(k for k, r in enumerate(table) if r["parameter"] == "roll_0")
    value, sigma = (1e6 * float(table[roll][name]) for name in ("value_per_tau", "sigma"))
    shown = right[roll].replace("−", "-").removesuffix(" µrad").split(" ± ")
    assert abs(float(shown[0]) - value) <= 0.5 and float(shown[1]) == pytest.approx(sigma, rel=0.06)


@pytest.mark.behaviour
def test_share_of_biases_that_are_found(folder: Folder) -> None:
    """A point without a minimal detectable bias is never found: the curve ends below one."""
    mdb = folder.residuals.figures["mdb_sample_px"].copy()
    mdb[:47] = np.nan
    spoilt = Table({**folder.residuals.columns, "mdb_sample_px": mdb})
    planted = Folder(dataclasses.replace(folder.result, tables={**folder.result.tables, "residuals": spoilt}))
    axes = checks.redundancy(planted, folder.images).axes[1]
    ends = {line.get_label(): float(line.get_ydata()[-1]) for line in axes.lines}
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
    folder = read_folder(result)
    with matplotlib.rc_context(style.STYLE):
        (tmp_path / "x.svg").write_bytes(style.file_of(residuals.vectors(folder, folder.images), "svg"))
    assert f"{hostile} (47 points)" in svg_texts(tmp_path / "x.svg")
    told = captions.page(folder, {"residuals": ("residuals", [hostile])})
    assert "\\<b\\>" in told and "<b>" not in told


@pytest.mark.behaviour
def test_what_is_not_drawn_is_told(result: Path) -> None:
    """Without statistics, covariances, coordinates and log the figures of these are missing, each with its reason."""
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
    folder = read_folder(result)
    for plot in write.PLOTS:
        if plot.name in ("map", "map_up", "correlations", "redundancy", "iterations"):
            assert plot.draw(folder, folder.images) is None, plot.name
    assert "residual v/σ" in residuals.histograms(folder, ["left"]).axes[0].get_xlabel()
    told = captions.page(folder, {"residuals": ("residuals", folder.images)})
    for name in ("map", "correlations", "redundancy", "iterations"):
        assert f"- {name}: {captions.ABSENT[name]}" in told


@pytest.mark.behaviour
def test_images_beyond_the_limit_are_told(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write, "MAX_IMAGES", 1)
    names = {name: (plot.name, images) for name, plot, images in write.planned(folder) if plot.name in DRAWN}
    assert names["residuals"] == ("residuals", ["left"])
    assert "1 more images have no figures of their own" in captions.page(folder, names)


@pytest.mark.behaviour
def test_command(run: Any, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write, "PLOTS", tuple(p for p in write.PLOTS if p.name == "iterations"))
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
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "report.damaged")
    (result / "arrays.npz").write_bytes(arrays)
    with pytest.raises(InputError, match="svg or pdf"):
        write.write_figures(result, formats=("png",))
    monkeypatch.setattr(style, "find_spec", lambda name: None)
    ended = run("report", result, "--figures", "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "report.no_matplotlib")
    assert not (result / "figures").exists()
