"""Draw the pictures of the documentation: concepts, factor graph, tutorials and examples, from their own commands.

    python docs/pictures.py [FOLDER]

FOLDER is docs/_static unless another one is given. Pictures of tutorials are drawn after all code blocks of their page
have run in a temporary folder. Pictures of concepts are drawn from the simulated pair of the
tutorials, and pictures of examples with the functions of the example script.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fg_orient as fg  # noqa: E402
from fg_orient.formats.sensor import read_sensor  # noqa: E402
from fg_orient.geodesy import geodetic_to_ecef  # noqa: E402
from fg_orient.model.distributions import INSIDE_95  # noqa: E402
from fg_orient.model.names import COMPONENTS  # noqa: E402
from fg_orient.quality.jitter_system import without_quadratic  # noqa: E402
from fg_orient.report import chart, paper  # noqa: E402
from fg_orient.report.graph import write_graph  # noqa: E402
from fg_orient.result.record import read_result  # noqa: E402
from fg_orient.sensors.correction import Correction  # noqa: E402
from fg_orient.simulate import ZonguldakOptions, zonguldak_block  # noqa: E402
from tests.support import pages  # noqa: E402
from tests.support.command import in_process  # noqa: E402

Array = npt.NDArray[np.float64]

#: Rotation of the sensor in the picture of signs, rad (0.7 degrees); yaw is four times as large.
TURN = 0.012
#: Height of the ground, m.
HEIGHT = 400.0


def keep(figure: object, path: Path) -> None:
    """Write a figure as SVG; the same figure gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(paper.file_of(figure, "svg"))  # type: ignore[arg-type]


@contextlib.contextmanager
def ran(page: str) -> Iterator[None]:
    """Run all code blocks of a tutorial in a temporary folder, which stays the current folder until the end."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            path = ROOT / "docs" / "tutorials" / f"{page}.md"
            pages.run_page(pages.fences(path, page), {}, ROOT, lambda _: True)
            yield
        finally:
            os.chdir(before)


def made(*words: object) -> None:
    """Run a command; a failure ends the program."""
    ended = in_process(*words)
    if ended.code not in (0, 4):  # 4: the page shows a model without a term, which is not trustworthy
        raise SystemExit(ended.stderr)


# --- concepts --------------------------------------------------------------------------------------


def pixels(out: Path) -> None:
    """Draw the first pixels of an image, with the coordinates of their centres in other conventions."""
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.3)
    axes = figure.add_subplot()
    axes.set(xlim=(-1.1, 6.2), ylim=(2.7, -1.15), aspect="equal")
    axes.axis("off")
    for k in range(4):
        axes.plot([k - 0.5] * 2, [-0.5, 2.5], color=chart.GREY, lw=0.7)
        axes.plot([-0.5, 2.5], [k - 0.5] * 2, color=chart.GREY, lw=0.7) if k < 4 else None
    at = [(line, sample) for line in range(3) for sample in range(3)]
    axes.plot([s for _, s in at], [n for n, _ in at], ls="", marker="o", ms=3, color=chart.BLUE)
    for line, sample in at:
        axes.annotate(f"{line}, {sample}", (sample, line), (0, -9), textcoords="offset points", ha="center", fontsize=7)
    arrow = {"arrowstyle": "->", "color": chart.INK, "lw": 0.9}
    axes.annotate("sample", (2.4, -0.75), (1.0, -0.75), arrowprops=arrow, va="center", ha="right")
    axes.annotate("line", (-0.7, 2.4), (-0.7, 1.0), arrowprops=arrow, ha="center")
    words = [
        ("the centre of the first pixel is", "", chart.INK),
        ("(0, 0)", "fg_orient, MicMac, ASP", chart.BLUE),
        ("(0.5, 0.5)", "COLMAP, Metashape, Pix4D (x, y)", chart.ORANGE),
        ("(1, 1)", "DIMAP files, GeoEtrim", chart.GREEN),
    ]
    for k, (name, whose, ink) in enumerate(words):
        axes.text(3.0, 0.1 + 0.55 * k, name, color=ink, va="center")
        axes.text(4.0, 0.1 + 0.55 * k, whose, va="center")
    axes.plot([-0.5], [-0.5], ls="", marker="x", ms=5, color=chart.ORANGE)
    axes.annotate("-0.5, -0.5", (-0.5, -0.5), (-4, 5), textcoords="offset points", fontsize=7, color=chart.ORANGE)
    keep(figure, out / "pixels.svg")


def outline(correction: Correction | None, image: Path) -> Array:
    """Return the corners (4, 2) of an image on the ground, around the image from its first pixel.

    Coordinates are in km, across the flight (to the right) and along it, from the middle of the uncorrected image.
    """
    sensor = read_sensor(image)
    last_line, last_sample = sensor.n_lines - 1.0, sensor.n_samples - 1.0
    line = np.array([0.0, 0.0, last_line, last_line])
    sample = np.array([0.0, last_sample, last_sample, 0.0])
    middle = sensor.locate([last_line / 2], [last_sample / 2], height_m=HEIGHT)[0]
    ahead = sensor.locate([last_line / 2 + 100.0], [last_sample / 2], height_m=HEIGHT)[0] - middle
    right = np.cross(ahead, middle)
    axes = np.stack([right / np.linalg.norm(right), ahead / np.linalg.norm(ahead)])
    return (sensor.locate(line, sample, height_m=HEIGHT, correction=correction) - middle) @ axes.T / 1000.0


def signs(out: Path, image: Path) -> None:
    """Draw where positive roll, pitch and yaw move the footprint of an image; flight is upwards."""
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.9)
    before = outline(None, image)
    for panel, (k, name) in zip(figure.subplots(1, 3), ((6, "roll"), (7, "pitch"), (8, "yaw")), strict=True):
        eop = np.zeros((9, 3))
        eop[k, 0] = TURN * (4.0 if name == "yaw" else 1.0)
        after = outline(Correction(eop), image)
        for corners, ink, dashes in ((before, chart.GREY, "--"), (after, chart.BLUE, "-")):
            panel.plot(*np.vstack([corners, corners[:1]]).T, color=ink, ls=dashes, lw=1.1)
            panel.plot(*corners[0], marker="o", ms=4, color=ink)
        for a, b in zip(before, after, strict=True):
            panel.annotate("", b, a, arrowprops={"arrowstyle": "->", "color": chart.ORANGE, "lw": 0.9})
        panel.annotate("", (0.0, 18.0), (0.0, -18.0), arrowprops={"arrowstyle": "->", "color": chart.INK, "lw": 0.7})
        panel.text(1.5, 0.0, "flight", fontsize=7)
        panel.set(
            title=f"positive {name}", aspect="equal", xlim=(-55, 55), ylim=(-55, 55), xlabel="right of flight, km"
        )
        panel.locator_params(nbins=5)
    figure.axes[0].set_ylabel("along flight, km")
    keep(figure, out / "signs.svg")


def planted(project: Path, image: str, point: str, error_px: float) -> None:
    """Replace the line of one observation by a wrong value."""
    path = project.parent / "observations.csv"
    lines = path.read_text("utf-8").splitlines(keepends=True)
    for k, line in enumerate(lines):
        cells = line.split(",")
        if cells[:2] == [image, point]:
            cells[2] = repr(float(cells[2]) + error_px)
            lines[k] = ",".join(cells)
    path.write_text("".join(lines), "utf-8")


def patterns(out: Path, folder: Path) -> None:
    """Draw residuals of one image: noise, a model that lacks a term, one gross error."""
    cases = {"noise alone": (), "a term is missing": ("--distortion", 4e-5), "one gross error": ()}
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.75)
    for number, (panel, (name, more)) in enumerate(zip(figure.subplots(1, 3), cases.items(), strict=True)):
        project = folder / f"case{number}" / "project.toml"
        made("simulate", "zonguldak", "--seed", 1, *more, "--out", project.parent)
        if name == "one gross error":
            planted(project, "left", "12", 8.0)
        made("adjust", project, "--out", folder / f"result{number}")
        result = read_result(folder / f"result{number}")
        found, rows = result.residuals, result.rows["left"]
        at, v = found.numbers("sample", "line")[rows], found.numbers("v_sample_px", "v_line_px")[rows]
        panel.scatter(*at.T, s=2.0, color=chart.INK, lw=0)
        longest = float(np.linalg.norm(v, axis=1).max())
        arrows = panel.quiver(*at.T, v[:, 0], -v[:, 1], color=chart.BLUE, angles="uv", scale=longest / 0.25,
                              scale_units="width", width=0.007)  # fmt: skip
        length = 0.5 if longest < 1.5 else 2.0 if longest < 4.0 else 4.0
        panel.quiverkey(arrows, 0.82, 1.05, length, f"{length:g} px", labelpos="W", fontproperties={"size": 7})
        panel.set(xlim=(-0.5, 11999.5), ylim=(11999.5, -0.5), aspect="equal", xlabel="sample, px")
        panel.set_title(name, loc="left")
        panel.set_xticks([0, 6000, 12000])
        panel.set_yticks([0, 6000, 12000])
    figure.axes[0].set_ylabel("line, px")
    keep(figure, out / "residual-patterns.svg")


def concepts(out: Path) -> None:
    """Draw the pictures of the concepts page."""
    with tempfile.TemporaryDirectory() as folder:
        patterns(out, Path(folder))
        pixels(out)
        signs(out, Path(folder) / "case0" / "left.DIM")


def factor_graph(out: Path) -> None:
    """Keep the drawings of the graph of the simulated pair."""
    with tempfile.TemporaryDirectory() as folder:
        write_graph(zonguldak_block(ZonguldakOptions(seed=1))[0], Path(folder) / "graph")
        for name in ("graph", "reduced", "tree", "matrix"):
            (out / f"{name}.svg").write_bytes((Path(folder) / "graph" / f"{name}.svg").read_bytes())


# --- tutorials -------------------------------------------------------------------------------------


def stereo(out: Path) -> None:
    """Keep two figures that the last commands of the page write."""
    with ran("stereo"):
        for name in ("map", "residuals"):
            (out / f"stereo-{name}.svg").write_bytes(Path(f"oriented/figures/{name}.svg").read_bytes())


def dense_sparse(out: Path) -> None:
    """Draw the singular values of both images, unknowns in prior sigmas."""
    with ran("dense-sparse"):
        block = fg.read_project("pair/project.toml")
        solution = fg.adjust(block, backend="dense", solver="qr")
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.5)
    axes = figure.add_subplot()
    for k, (name, ink, mark) in enumerate((("left", chart.BLUE, "o"), ("right", chart.ORANGE, "s"))):
        record = solution.observability[k]
        axes.plot(np.arange(1, len(record.singular_values) + 1), record.singular_values, marker=mark, ms=3, lw=0.8,
                  color=ink, label=f"image {name}")  # fmt: skip
    axes.axhline(1.0, color=chart.GREY, lw=0.8)
    axes.set_yscale("log")
    axes.set_xticks(range(1, 19))
    axes.set(xlabel="direction", ylabel="singular value, prior sigmas")
    axes.legend()
    keep(figure, out / "dense-sparse-spectra.svg")


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file without comments."""
    return list(csv.DictReader(line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")))


def rpc(out: Path) -> None:
    """Draw the misfit of the vendor's and of the refined RPC at the points of the page."""
    with ran("rpc"):
        rows = table(Path("points.csv"))
        pixel = np.array([[float(r["line"]), float(r["sample"])] for r in rows])
        place = [np.array([float(r[c]) for r in rows]) for c in ("lon_deg", "lat_deg", "height_m")]
        misfit = {}
        for name in ("vendor", "refined"):
            found = read_sensor(Path(f"{name}_RPC.TXT")).project(geodetic_to_ecef(*place))
            misfit[name] = np.stack(found[:2], axis=1) - pixel
    check = np.array([r["role"] == "check" for r in rows])
    figure = paper.new_figure(paper.TWO_COLUMNS, 3.3)
    for panel, (name, v) in zip(figure.subplots(1, 2), misfit.items(), strict=True):
        panel_of_vectors(panel, pixel[:, ::-1], v, check)
        panel.set_title(f"{name} RPC", loc="left")
    figure.axes[0].set_ylabel("line, px")
    keep(figure, out / "rpc-misfit.svg")


def panel_of_vectors(panel: object, at: Array, v: Array, check: npt.NDArray[np.bool_]) -> None:
    """Draw vectors (line, sample) at pixels (sample, line). Lines go down; the mean length is a tenth of the width."""
    size = float(np.median(np.linalg.norm(v, axis=1)))
    length = float(f"{size:.0e}")
    for rows, ink, mark, name in ((~check, chart.BLUE, "^", "control"), (check, chart.ORANGE, "o", "check")):
        panel.plot(*at[rows].T, ls="", marker=mark, ms=3, color=ink, label=name)  # type: ignore[attr-defined]
        arrows = panel.quiver(*at[rows].T, v[rows, 1], -v[rows, 0], color=ink, angles="uv", scale=size / 0.08,  # type: ignore[attr-defined]
                              scale_units="width", width=0.004)  # fmt: skip
    panel.quiverkey(arrows, 0.85, 1.04, length, f"{length:g} px", labelpos="W", fontproperties={"size": 7},  # type: ignore[attr-defined]
                    color=chart.INK)  # fmt: skip
    panel.set(xlim=(-0.5, 11999.5), ylim=(11999.5, -0.5), aspect="equal", xlabel="sample, px")  # type: ignore[attr-defined]
    panel.locator_params(nbins=5)  # type: ignore[attr-defined]
    panel.legend(loc="lower left")  # type: ignore[attr-defined]


def calibrate(out: Path) -> None:
    """Draw the residuals of the first photo at one scale: with c alone, and with x0, y0 and k1."""
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.9)
    with ran("calibrate"):
        at = {(r["photo"], r["id"]): (float(r["x"]), float(r["y"])) for r in table(Path("image.csv"))}
        for panel, (folder, name) in zip(
            figure.subplots(1, 2), (("only-c", "c alone"), ("calibrated", "c, x0, y0, k1")), strict=True
        ):
            found = json.loads(Path(folder, "closerange.json").read_text("utf-8"))["residuals"]
            rows = [row for row in found if row["photo"] == "photo0"]
            xy = np.array([at[r["photo"], r["id"]] for r in rows])
            v = np.array([[r["residual_x"], r["residual_y"]] for r in rows])
            panel.scatter(*xy.T, s=2.0, color=chart.INK, lw=0)
            arrows = panel.quiver(
                *xy.T, *v.T, color=chart.BLUE, angles="uv", scale=0.15, scale_units="width", width=0.004
            )
            panel.quiverkey(arrows, 0.82, 1.04, 0.02, "20 µm", labelpos="W", fontproperties={"size": 7})
            panel.set(aspect="equal", xlabel="x, mm")
            panel.set_title(name, loc="left")
    figure.axes[0].set_ylabel("y, mm")
    keep(figure, out / "calibrate-residuals.svg")


# --- examples --------------------------------------------------------------------------------------


def functions(example: str) -> dict[str, Any]:
    """Return the functions of an example by name, without running the example."""
    return runpy.run_path(str(ROOT / "examples" / f"{example}.py"))


def rectify_by_points(out: Path) -> None:
    """Draw the residuals of the first fit, before the wrong point is left out."""
    own = functions("rectify_by_points")
    control = own["scene"](30, np.random.default_rng(1))
    control.target[11] += (150.0, 0.0)
    found = own["fit"](control, own["find_model"]("affine"))
    v = control.target - found.transformation.apply(control.source)
    suspected = own["point_tests"](found).suspicious
    figure = paper.new_figure(paper.ONE_COLUMN, 2.8)
    panel = figure.add_subplot()
    for rows, ink, name in ((~suspected, chart.BLUE, "control"), (suspected, chart.ORANGE, "suspected")):
        at = control.source[rows]
        panel.plot(*at.T, ls="", marker="o", ms=3, color=ink, label=name)
        arrows = panel.quiver(*at.T, *v[rows].T, color=ink, angles="uv", scale=600.0, scale_units="width", width=0.005)
    panel.quiverkey(arrows, 0.85, 1.05, 50.0, "50 m", labelpos="W", fontproperties={"size": 7}, color=chart.INK)
    panel.set(xlim=(-100, 1123), ylim=(1123, -100), aspect="equal", xlabel="sample, px", ylabel="line, px")
    panel.set_title("affine fit", loc="left")
    panel.legend(loc="lower right")
    keep(figure, out / "rectify-by-points.svg")


def rpc_bundle(out: Path) -> None:
    """Draw the distance of the rays of each point, with the original and with the adjusted RPC, without control."""
    own = functions("rpc_bundle")
    with contextlib.redirect_stdout(io.StringIO()):
        block = own["without_control"](own["rpc_block"]())
    relative = fg.adjust(block, rpc_compensation="shift")
    figure = paper.new_figure(paper.ONE_COLUMN, 2.3)
    panel = figure.add_subplot()
    cases = (("as they came", relative.problem.start, chart.ORANGE, "s"), ("adjusted", relative.state, chart.BLUE, "o"))
    for name, state, ink, mark in cases:
        parallax = own["y_parallaxes"](relative.problem, state)[1]
        panel.plot(np.arange(1, len(parallax) + 1), parallax, ls="", marker=mark, ms=3, color=ink, label=name)
    panel.set(xlabel="point", ylabel="y-parallax, px", ylim=(0.0, None))
    panel.legend(loc="center right")
    keep(figure, out / "rpc-bundle.svg")


def jitter(out: Path) -> None:
    """Draw the curves that the adjustment of the page finds, with the true jitter."""
    block, truth = zonguldak_block(ZonguldakOptions(jitter_px=1.2, jitter_cycles=3.0, jitter_images=("left",)))
    evidence = fg.adjust(block, jitter="auto").jitter
    assert evidence is not None
    found = [angle for angle in evidence.angles if angle.band is not None]
    figure = paper.new_figure(paper.TWO_COLUMNS, 2.5)
    for k, angle in enumerate(found):
        band = angle.band
        assert band is not None
        panel = figure.add_subplot(1, len(found), k + 1)
        half = INSIDE_95 * band.sd
        panel.fill_between(angle.line, band.value - half, band.value + half, color=chart.GREY, alpha=0.35, lw=0)
        panel.plot(angle.line, band.value, color=chart.BLUE, label="estimate")
        waves = truth.corrections[block.images.index(next(i for i in block.images if i.id == angle.image))].waves
        wave = next(w for w in waves if COMPONENTS[w.component] == angle.angle)
        true = without_quadratic(band.tau, wave.at(band.tau)) * angle.px_per_rad
        panel.plot(angle.line, true, color=chart.ORANGE, ls="--", label="true")
        panel.set(xlabel="line", ylabel="jitter, px", title=f"{angle.angle} of {angle.image}")
        panel.legend(loc="upper right")
    keep(figure, out / "band.svg")


#: Functions that draw pictures, by the folder of these pictures.
PICTURES: dict[str, tuple[Callable[[Path], None], ...]] = {
    "concepts": (concepts,),
    "factor-graph": (factor_graph,),
    "tutorials": (stereo, dense_sparse, rpc, calibrate),
    "examples": (rectify_by_points, rpc_bundle),
    "jitter": (jitter,),
}


def main(target: Path) -> None:
    """Draw all."""
    from matplotlib import rc_context

    with rc_context(paper.STYLE):
        for folder, drawn in PICTURES.items():
            (target / folder).mkdir(parents=True, exist_ok=True)
            for draw in drawn:
                draw(target / folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "_static")
