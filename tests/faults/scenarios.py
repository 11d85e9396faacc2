"""These commands, whose writing calls fail, run on small inputs that this module makes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.faults.harness import command, run
from tests.faults.trials import Scenario


def _good(folder: Path, *words: object) -> None:
    ended = run(command(*words), folder, count=False)
    assert ended.code == 0, ended


def _twin(folder: Path) -> Path:
    from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak

    return simulate_zonguldak(folder / "twin", ZonguldakOptions(seed=1))


def adjust(folder: Path) -> Scenario:
    _twin(folder)
    words = ("--checkpoint-every", "0", "--quiet")
    return Scenario("adjust", folder, lambda f: ("adjust", f / "twin/project.toml", "--out", f / "out", *words),
                    ("--overwrite",), (".out.checkpoint.npz",), other=("--eop-set", "9"))  # fmt: skip


def resume(folder: Path) -> Scenario:
    """Return ``adjust`` with many iterations; the run after a killed one continues from its checkpoint."""
    _twin(folder)
    words = ("--loss", "huber", "--checkpoint-every", "0", "--quiet")
    return Scenario("resume", folder, lambda f: ("adjust", f / "twin/project.toml", "--out", f / "out", *words),
                    ("--overwrite",), (".out.checkpoint.npz",), ("--resume",))  # fmt: skip


def parts(folder: Path) -> Scenario:
    """Return ``adjust`` of a block in parts with a work folder, continued from its checkpoint."""
    _twin(folder)
    (folder / "work").mkdir()
    words = ("--parts", "3", "--checkpoint-every", "0", "--quiet")
    return Scenario(
        "parts", folder,
        lambda f: ("adjust", f / "twin/project.toml", "--out", f / "out", "--work-dir", f / "work", *words),
        ("--overwrite",), (".out.checkpoint.npz",), ("--resume",),
    )  # fmt: skip


def parquet(folder: Path) -> Scenario:
    """Return ``adjust --tables parquet``."""
    _twin(folder)
    words = ("--tables", "parquet", "--quiet")
    return Scenario("parquet", folder, lambda f: ("adjust", f / "twin/project.toml", "--out", f / "out", *words),
                    ("--overwrite",), (".out.checkpoint.npz",))  # fmt: skip


def replace(folder: Path) -> Scenario:
    """Return ``adjust`` over an existing result."""
    project = _twin(folder)
    _good(folder, "adjust", project, "--out", folder / "out", "--quiet")
    words = ("--checkpoint-every", "0", "--quiet", "--overwrite")
    return Scenario("replace", folder, lambda f: ("adjust", f / "twin/project.toml", "--out", f / "out", *words),
                    (), (".out.checkpoint.npz",))  # fmt: skip


def simulate(folder: Path) -> Scenario:
    (folder / "empty").mkdir()
    return Scenario("simulate", folder, lambda f: ("simulate", "zonguldak", "--out", f / "a/twin"), ("--overwrite",),
                    other=("--seed", "7"))  # fmt: skip


def compare(folder: Path) -> Scenario:
    _twin(folder)
    words = ("--eop-sets", "1,9", "--solvers", "qr", "--backends", "dense", "--quiet")
    return Scenario("compare", folder, lambda f: ("compare", f / "twin/project.toml", "--out", f / "out", *words),
                    ("--overwrite",), other=("--target", "9"))  # fmt: skip


def _survey(folder: Path) -> Path:
    from fg_orient.formats.exchange.gis import write_geopackage
    from fg_orient.formats.exchange.survey import Survey
    from fg_orient.formats.registry import Settings
    from fg_orient.model.names import Role

    rng = np.random.default_rng(1)
    place = np.column_stack([rng.uniform(31.0, 32.0, 50), rng.uniform(41.0, 42.0, 50), rng.uniform(0.0, 500.0, 50)])
    names = tuple(f"p{k}" for k in range(50))
    survey = Survey("EPSG:4979", names, (Role.CONTROL,) * 50, place, np.full((50, 3), 0.1), np.zeros(50, bool))
    write_geopackage(survey, (folder / "points.gpkg",), Settings())
    return folder / "points.gpkg"


def convert(folder: Path) -> Scenario:
    path = _survey(folder).name
    return Scenario("convert", folder, lambda f: ("convert", f / path, "--to", "csv",
                                                  "--out", f / "points.csv"), ("--overwrite",))  # fmt: skip


def geopackage(folder: Path) -> Scenario:
    """Return ``convert`` to a file that SQLite writes."""
    path = _survey(folder).name
    return Scenario("geopackage", folder, lambda f: ("convert", f / path, "--to-crs", "EPSG:4978", "--out",
                                                     f / "other.gpkg"), ("--overwrite",))  # fmt: skip


def pair(folder: Path) -> Scenario:
    """Return ``convert`` to two tables."""
    project = _twin(folder)
    files = [project.parent / name for name in ("points.csv", "observations.csv")]
    return Scenario("pair", folder, lambda f: ("convert", *(f / "twin" / file.name for file in files),
                                               "--from", "csv", "--to", "csv",
                                               "--out", f / "other.csv"), ("--overwrite",),
                    other=("--to-crs", "EPSG:4978"))  # fmt: skip


def model(folder: Path) -> Scenario:
    """Return ``convert`` of a bundle to the three files of COLMAP."""
    from fg_orient.formats.exchange.bal import BalData, write_bal

    rng = np.random.default_rng(4)
    cameras = np.column_stack([rng.normal(0.0, 0.1, (3, 6)), np.full((3, 3), (900.0, 0.0, 0.0))])
    which = np.repeat(np.arange(3), 8)
    write_bal(folder / "block.txt", BalData(which, np.tile(np.arange(8), 3), rng.normal(0.0, 99.0, (24, 2)), cameras,
                                            rng.normal((0.0, 0.0, -9.0), 1.0, (8, 3))))  # fmt: skip
    return Scenario("model", folder, lambda f: ("convert", f / "block.txt", "--from", "bal", "--to", "colmap-text",
                                                "--out", f / "colmap"), ("--overwrite",))  # fmt: skip


def projection(folder: Path) -> Scenario:
    """Return ``rectify projection``, which writes one table."""
    (folder / "points.csv").write_text("id,lon_deg,lat_deg\na,31.5,41.5\nb,31.6,41.4\n", "utf-8")
    return Scenario("projection", folder, lambda f: ("rectify", "projection", f / "points.csv", "--to", "EPSG:32636",
                                                     "--out", f / "map.csv"), ("--overwrite",))  # fmt: skip


def rectify(folder: Path) -> Scenario:
    rng = np.random.default_rng(2)
    image = rng.uniform(0.0, 1000.0, (30, 2))
    plane = np.column_stack([4e5 + 28.0 * image[:, 1], 4.5e6 - 28.0 * image[:, 0]]) + rng.normal(0.0, 5.0, (30, 2))
    rows = [
        f"P{k},{a[0]!r},{a[1]!r},{b[0]!r},{b[1]!r},control"
        for k, (a, b) in enumerate(zip(image.tolist(), plane.tolist(), strict=True))
    ]
    text = "\n".join(["id,line,sample,easting_m,northing_m,role", *rows, ""])
    (folder / "points.csv").write_text(text, "utf-8")
    words = ("--crs", "EPSG:32635", "--quiet")
    return Scenario("rectify", folder, lambda f: ("rectify", "fit", f / "points.csv", "--out", f / "out", *words),
                    ("--overwrite",), other=("--degree", "2"))  # fmt: skip


def ortho(folder: Path) -> Scenario:
    """Return ``rectify ortho`` to a cloud optimised GeoTIFF, which GDAL writes twice."""
    import rasterio

    rectify(folder)
    _good(folder, "rectify", "fit", folder / "points.csv", "--crs", "EPSG:32635", "--out", folder / "fit")
    grey = np.random.default_rng(3).integers(1, 255, (1000, 1000), dtype=np.uint8)
    with rasterio.open(
        folder / "image.tif", "w", driver="GTiff", width=1000, height=1000, count=1, dtype="uint8"
    ) as sink:
        sink.write(grey, 1)
    return Scenario(
        "ortho", folder, lambda f: ("rectify", "ortho", f / "image.tif", f / "fit", "--out", f / "map.tif", "--cog"),
        ("--overwrite",),
    )  # fmt: skip


def _rendered(folder: Path, *, chips: bool = False) -> None:
    from tests.support.rendered_pair import Scene, View, write_pair

    views, scene = [View("a", (0.25, -0.05), 130), View("b", (-0.25, 0.1), 130, shift_px=(2.5, -1.5))], None
    scene = Scene(60.0, 3, relief_m=5.0, walls=3)
    write_pair(folder, scene, tuple(views), snr=50.0)
    if chips:
        rng = np.random.default_rng(8)
        scene.write_chips(folder / "chips.gpkg", rng.uniform(-15.0, 15.0, (2, 4)), 20, rng)


def match(folder: Path) -> Scenario:
    _rendered(folder)
    return Scenario("match", folder, lambda f: ("match", f / "project.toml", "--quiet"), ("--overwrite",),
                    (".project.match",), ("--resume",), other=("--correlation", "0.97"))  # fmt: skip


def control(folder: Path) -> Scenario:
    """Return ``match --control``, which also writes a table of points."""
    _rendered(folder, chips=True)
    return Scenario("control", folder, lambda f: ("match", f / "project.toml", "--control", f / "chips.gpkg",
                                                  "--quiet"), ("--overwrite",), (".project.match",))  # fmt: skip


def report(folder: Path) -> Scenario:
    project = _twin(folder)
    _good(folder, "adjust", project, "--out", folder / "out", "--quiet")
    return Scenario("report", folder, lambda f: ("report", f / "out", "--truth", f / "twin/truth"))


def figures(folder: Path) -> Scenario:
    """Return ``report --figures``; the page is an output of its own and is written first."""
    project = _twin(folder)
    _good(folder, "adjust", project, "--out", folder / "out", "--quiet")
    return Scenario("figures", folder, lambda f: ("report", f / "out", "--figures"), ("--overwrite",),
                    ("out/report.html",))  # fmt: skip


def layers(folder: Path) -> Scenario:
    """Return ``report --export`` to a GeoPackage; the page is written first."""
    project = _twin(folder)
    _good(folder, "adjust", project, "--out", folder / "out", "--quiet")
    return Scenario("layers", folder, lambda f: ("report", f / "out", "--export", f / "layers.gpkg"), ("--overwrite",),
                    ("out/report.html",))  # fmt: skip


def cloud(folder: Path) -> Scenario:
    """Return ``dsm-points`` to a file that laspy writes."""
    project = _twin(folder)
    _good(folder, "adjust", project, "--out", folder / "out", "--quiet")
    return Scenario("cloud", folder, lambda f: ("dsm-points", f / "out", "--out", f / "points.las"),
                    ("--overwrite",))  # fmt: skip


SCENARIOS: dict[str, Callable[[Path], Scenario]] = {
    one.__name__: one
    for one in (
        adjust, replace, resume, parts, parquet, simulate, compare, convert, pair, model, geopackage, rectify, ortho,
        projection, match, control, report, figures, layers, cloud,
    )
}  # fmt: skip


def made(name: str, work: Path) -> Scenario:
    """Make a scenario in a folder."""
    folder = work / f"{name}-template"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return SCENARIOS[name](folder)
